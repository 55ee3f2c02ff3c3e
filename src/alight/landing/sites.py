"""Landing sites, candidates with the view that settles their doubt, or the reason for none (eq. 5, G11, G11a, G19)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from alight.arrays import F32, F64, Mask
from alight.geometry import Grid
from alight.raster import DiscWindow, clearance_of, disc_mean, disc_window
from alight.records import (
    Doubt,
    ElevationMap,
    Hazard,
    HazardMap,
    NextView,
    Observer,
    Site,
    Sites,
    Terrain,
    TerrainMap,
    keeps_margin,
)
from alight.settings import Lander, SitesSettings

Cell = tuple[int, int]  # row, column
RADII_APART = 4.0  # least distance of two sites in footprint radii: one hazard must not make both unusable
REASON_WORDS = {
    Hazard.ROUGHNESS: "is too rough",
    Hazard.SLOPE: "is too steep",
    Hazard.STEP: "has too high a step",
    Hazard.CLEARANCE: "leaves the rotor or the belly no room",
    Hazard.TERRAIN: "is covered by what cannot be landed on (water, plants, structures)",
    Hazard.TRAFFIC: "is where something moved a moment ago",
    Hazard.WIRE: "lies under a wire",
    Hazard.ZONE: "is refused by a zone",
    Hazard.AVOID: "is in a zone to be avoided",
    Hazard.UNKNOWN: "has unknown ground within the footprint",
    Hazard.EDGE: "is too near to the map's edge",
    Hazard.DOUBT: "meets every limit, but not surely enough",
}


def separation(settings: SitesSettings, lander: Lander) -> float:
    """Return the least distance between two sites or candidates, metres."""
    return max(settings.separation or 0.0, RADII_APART * lander.radius)


def next_view(place: F64, settles_at: float, observer: Observer, settings: SitesSettings) -> NextView | None:
    """Propose the highest view whose pixels are fine enough to settle the doubt about a position.

    The width of a pixel on the ground is the height divided by the focal length in pixels. The view is at least
    `lowest_look` and at most the present height above the ground. A single camera needs a baseline, so its view is
    beside the position, towards the vehicle. Two cameras have their own baseline, so their view is straight above.

    Args:
        place: (3,) metres, on the ground.
        settles_at: width of a pixel on the ground that settles the doubt, metres; NaN: no width does.
        observer: the vehicle and its cameras.
        settings: the least height and the baseline.

    Returns:
        The view; None if no pixel settles the doubt.
    """
    if not math.isfinite(settles_at):
        return None
    wanted = settles_at * observer.focal
    height = max(min(wanted, observer.height_above_ground), settings.lowest_look)
    base = 0.0 if observer.stereo else settings.look_base * height
    east, north = (float(v) for v in place[:2] + base * _towards(place, observer.position))
    return NextView(east, north, float(place[2]) + height, height, settles=height <= wanted)


def _towards(place: F64, vehicle: F64) -> F64:
    """Return the horizontal unit vector, (2,), from a position to the vehicle; north if the vehicle is overhead."""
    way = np.asarray(vehicle[:2] - place[:2], dtype=np.float64)
    distance = float(np.hypot(*way))
    return way / distance if distance > 1e-3 else np.array([0.0, 1.0])


@dataclass(frozen=True, eq=False)
class _Choice:
    hazards: HazardMap
    land_cover: TerrainMap | None
    elevation: ElevationMap
    settings: SitesSettings
    lander: Lander
    observer: Observer | None

    def score(self, allowed: Mask, clearance: F32) -> F64:
        """Compute the score of each cell (G11) by quality, clearance (R, C), P(safe), distance; -inf if not allowed."""
        hazards, settings = self.hazards, self.settings
        allowed = allowed & keeps_margin(clearance, settings.margin) & np.isfinite(hazards.quality)
        room = np.minimum(clearance / settings.roomy, 1.0)
        doubt = 1 - np.nan_to_num(hazards.p_safe).astype(np.float64)
        score = hazards.quality + room - settings.doubt_weight * doubt
        if self.observer is not None and settings.distance_weight > 0:
            east, north = hazards.grid.xy()
            vehicle = self.observer.position
            distance = np.hypot(east[None, :] - vehicle[0], north[:, None] - vehicle[1])
            score -= settings.distance_weight * distance
        score = np.where(allowed, score, -np.inf)
        if hazards.preferred is not None and allowed.any():
            score[hazards.preferred] += np.ptp(score[allowed]) + 1.0  # above all others
        return score

    def candidate_score(self, allowed: Mask, clearance: F32) -> F64:
        """Compute the score of candidates (G11a), (R, C): mean P(safe) in steps, then score of a site; else -inf."""
        hazards, step = self.hazards, self.settings.chance_step
        chance = disc_mean(np.nan_to_num(hazards.p_safe), self.settings.margin, hazards.grid.cell)
        score = self.score(allowed, clearance)
        best = float(score.max(initial=-np.inf))
        if not np.isfinite(best):
            return score
        return np.where(np.isfinite(score), np.floor(chance / step) + 0.99 * np.exp(score - best), -np.inf)

    def place(self, rank: int, at: Cell, clearance: F32, candidate: bool) -> Site:
        """Build the site or candidate at a cell; a candidate gets its doubt and the view that would settle it."""
        hazards, grid, room = self.hazards, self.hazards.grid, float(clearance[at])
        east, north = grid.east + at[1] * grid.cell, grid.north - at[0] * grid.cell
        up, sigma = self._height_at(east, north)
        factors: dict[Doubt, float] = {
            "relief": float(hazards.p_relief[at]),
            "obstacle": float(hazards.p_obstacle[at]),
            "ground": float(hazards.p_ground[at]),
            "wires": 1.0 if hazards.p_wires is None else float(hazards.p_wires[at]),
        }
        doubt: Doubt = min(factors, key=lambda k: np.nan_to_num(factors[k], nan=1.0))
        reasons, avoid = Hazard(int(hazards.reasons[at])), ""
        if Hazard.AVOID in reasons and hazards.zone is not None:
            avoid = hazards.zone_labels[hazards.zone[at] - 1]
            doubt = doubt if Hazard.DOUBT in reasons else "zone"
        look = None
        if candidate and self.observer is not None:
            place, settles_at = np.array([east, north, up]), float(hazards.settles_at[at])
            look = next_view(place, settles_at, self.observer, self.settings)
        return Site(
            rank=rank, east=east, north=north, up=up, height_sigma=sigma, p_safe=float(hazards.p_safe[at]),
            p_relief=factors["relief"], p_obstacle=factors["obstacle"], p_ground=factors["ground"],
            p_wires=factors["wires"], resolved=float(hazards.resolved[at]), quality=float(hazards.quality[at]),
            slope=float(hazards.slope[at]), roughness=float(hazards.roughness[at]), clearance=room,
            radius=self.lander.radius + room,
            terrain=self._landing_class(east, north), heading=_heading(east, north, self.observer),
            doubt=doubt if candidate else None, look=look, avoid=avoid,
            preferred=hazards.preferred is not None and bool(hazards.preferred[at]),
        )  # fmt: skip

    def _height_at(self, east: float, north: float) -> tuple[float, float]:
        """Return mean height and sigma, m, of the trusted cells of the footprint at a position; of all if none is."""
        e = self.elevation
        for reach in (self.lander.radius, self.lander.radius + self.hazards.grid.cell):
            rows, cols, disc = _footprint(e.grid, east, north, reach)
            height, sigma = e.height[rows, cols], e.relative_sigma[rows, cols].astype(np.float64)
            known = disc & np.isfinite(height)
            if known.any():
                break
        trusted = known & e.trusted[rows, cols]
        here = trusted if trusted.any() else known
        return float(height[here].mean()), float(np.sqrt(np.mean(sigma[here] ** 2)))

    def _landing_class(self, east: float, north: float) -> Terrain:
        if self.land_cover is None:
            return Terrain.UNKNOWN
        rows, cols, disc = _footprint(self.land_cover.grid, east, north, self.lander.radius)
        labels = self.land_cover.label[rows, cols][disc]
        counts = np.bincount(labels[labels != Terrain.UNKNOWN], minlength=len(Terrain))
        return Terrain(int(counts.argmax())) if counts.any() else Terrain.UNKNOWN


def _footprint(grid: Grid, east: float, north: float, radius: float) -> DiscWindow:
    row, col = (round(float(i)) for i in grid.index(np.array(east), np.array(north)))
    return disc_window(grid.shape, row, col, radius / grid.cell)


def _heading(east: float, north: float, observer: Observer | None) -> float:
    """Return the bearing from the vehicle to a position, rad clockwise from north; 0 if it is overhead or unknown."""
    if observer is None or math.hypot(east - observer.position[0], north - observer.position[1]) < 1.0:
        return 0.0
    return math.atan2(east - observer.position[0], north - observer.position[1]) % (2 * math.pi)


def _peaks(score: F64, grid: Grid, count: int, apart: float, taken: list[Cell]) -> list[Cell]:
    """Return up to `count` best cells, best first, more than `apart` metres from each other and from all `taken`."""
    remaining, found = score.copy(), list[Cell]()

    def take(cell: Cell) -> None:
        rows, cols, disc = disc_window(remaining.shape, *cell, apart / grid.cell)
        remaining[rows, cols][disc] = -np.inf

    for cell in taken:
        take(cell)
    while len(found) < count:
        row, col = divmod(int(np.argmax(remaining)), remaining.shape[1])
        if not np.isfinite(remaining[row, col]):
            break
        found.append((row, col))
        take((row, col))
    return found


def _spread(score: F64, hazards: HazardMap, count: int, apart: float, taken: list[Cell]) -> list[Cell]:
    """Return up to `count` best cells, best first, spread over the judged ground; nearer ones if others are few."""
    area = float(np.isfinite(hazards.p_safe).sum()) * hazards.grid.cell**2
    found = _peaks(score, hazards.grid, count, max(apart, math.sqrt(area / max(count, 1))), taken)
    found += _peaks(score, hazards.grid, count - len(found), apart, taken + found)
    return sorted(found, key=score.__getitem__, reverse=True)


def choose_sites(
    hazards: HazardMap,
    land_cover: TerrainMap | None,
    elevation: ElevationMap,
    settings: SitesSettings,
    lander: Lander,
    observer: Observer | None = None,
) -> Sites:
    """Rank the sites, then the candidates: cells that no limit refuses, with P(safe) below the limit.

    The best site comes first; the other sites are held in reserve. A candidate is worth another look. Cells that are to
    be avoided (`Hazard.AVOID`) are the last candidates, or the sites if there is neither.

    Args:
        hazards: reasons against a touchdown, P(safe) with its factors, quality and clearance of every cell.
        land_cover: classes to report for each site; None: the kind of ground was not judged.
        elevation: heights; its cells may be finer than the cells of the hazards.
        settings: number of sites, their least distance, and weights of the score.
        lander: the vehicle's footprint.
        observer: the vehicle, for the heading of the approach and the views of candidates; None: unknown.

    Returns:
        Sites and candidates in order of rank. Without a site, `reason` explains why in a sentence; nothing is raised.
    """
    c = _Choice(hazards, land_cover, elevation, settings, lander, observer)
    apart, grid = separation(settings, lander), hazards.grid
    doubt, avoid = np.uint16(Hazard.DOUBT), np.uint16(Hazard.AVOID)
    # a candidate's clearance is the distance to refused cells; undecided cells do not reduce it
    room, clearance = clearance_of((hazards.reasons & ~(doubt | avoid)) == 0, grid.cell), hazards.clearance
    safe = _peaks(c.score(hazards.reasons == 0, clearance), grid, settings.count, apart, [])
    undecided = _spread(
        c.candidate_score(hazards.reasons == doubt, room), hazards, settings.count - len(safe), apart, safe
    )
    if hazards.zone is not None:
        if not safe and not undecided:
            clearance = clearance_of((hazards.reasons & ~avoid) == 0, grid.cell)
            safe = _peaks(c.score(hazards.reasons == avoid, clearance), grid, settings.count, apart, [])
        left, avoided = settings.count - len(safe) - len(undecided), (hazards.reasons & ~doubt) == avoid
        undecided += _spread(c.candidate_score(avoided, room), hazards, left, apart, [*safe, *undecided])
    sites = tuple(c.place(i + 1, at, clearance, False) for i, at in enumerate(safe))
    candidates = tuple(c.place(len(safe) + i + 1, at, room, True) for i, at in enumerate(undecided))
    reason = "" if sites else why_no_site(hazards, elevation, settings, lander)
    return Sites(sites, reason, candidates=candidates, ground_judged=land_cover is not None)


def why_no_site(hazards: HazardMap, elevation: ElevationMap, settings: SitesSettings, lander: Lander) -> str:
    """Return the reasons against a landing in one sentence, as shares of the seen ground; these shares may overlap."""
    seen, cell, hazards = elevation.trusted, hazards.grid.cell, hazards.on(elevation.grid)
    if not seen.any():
        return "no safe site: no ground was seen well enough to know its height"
    if ((hazards.reasons[seen] & Hazard.EDGE) != 0).all():
        return "no safe site: the map is smaller than the footprint"
    safe = seen & (hazards.reasons == 0)
    if safe.any():
        room = float(hazards.clearance[safe].max())
        return (
            f"no safe site: {safe.sum() / seen.sum():.1%} of the seen ground is safe, but the most room there is "
            f"{math.floor(100 * room) / 100:.2f} m and {settings.margin:.2f} m is wanted"
        )
    shares = {bit: float(((hazards.reasons[seen] & bit) != 0).mean()) for bit in REASON_WORDS}
    ranked = sorted((s, b) for b, s in shares.items() if s >= 0.005)[::-1]
    parts = [f"{100 * share:.0f} % {REASON_WORDS[bit]}{_zones_of(bit, hazards)}" for share, bit in ranked]
    too_wide = f"; cells of {cell:g} m are wider than the radius of {lander.radius:g} m, so no plane fits"
    return "no safe site: of the seen ground " + ", ".join(parts) + (too_wide if lander.radius < cell else "")


def _zones_of(bit: Hazard, hazards: HazardMap, most: int = 3) -> str:
    """Return the names of the zones behind a reason of refusal, the largest first, in brackets; else empty."""
    if not (largest := hazards.zones_behind(bit)):
        return ""
    more = f", {len(largest) - most} more" if len(largest) > most else ""
    return f" ({', '.join(largest[:most])}{more})"
