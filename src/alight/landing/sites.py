"""Landing sites, candidates with the view that settles their doubt, or the reason for none (eq. 5, G11, G11a, G19)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from alight.arrays import F64
from alight.geometry import Grid
from alight.landing.search import (
    AVOIDED,
    AVOIDED_SITES,
    SAFE,
    UNDECIDED,
    Best,
    Cell,
    Part,
    SearchedMap,
    SiteSearch,
    WantedTouchdowns,
    WholeMap,
)
from alight.raster import DiscWindow, disc_window
from alight.records import (
    Doubt,
    ElevationMap,
    Hazard,
    HazardMap,
    NextView,
    Observer,
    Site,
    Sites,
    Tally,
    Terrain,
    TerrainMap,
)
from alight.settings import Lander, SitesSettings

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


def _site(part: Part, rank: int, cell: Cell, grid: Grid, wanted: WantedTouchdowns) -> Site:
    """Build the site or candidate at a cell; a candidate gets its doubt and the view that would settle it.

    `grid`: of the whole map.
    """
    hazards, at = part.hazards, (cell[0] - part.first[0], cell[1] - part.first[1])
    room, candidate = float(part.clearance(wanted)[at]), wanted.candidates
    east, north = grid.east + cell[1] * grid.cell, grid.north - cell[0] * grid.cell
    up, sigma = _height_at(part, east, north)
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
    if candidate and part.observer is not None:
        place, settles_at = np.array([east, north, up]), float(hazards.settles_at[at])
        look = next_view(place, settles_at, part.observer, part.settings)
    return Site(
        rank=rank, east=east, north=north, up=up, height_sigma=sigma, p_safe=float(hazards.p_safe[at]),
        p_relief=factors["relief"], p_obstacle=factors["obstacle"], p_ground=factors["ground"],
        p_wires=factors["wires"], resolved=float(hazards.resolved[at]), quality=float(hazards.quality[at]),
        slope=float(hazards.slope[at]), roughness=float(hazards.roughness[at]), clearance=room,
        radius=part.lander.radius + room,
        terrain=_landing_class(part, east, north), heading=_heading(east, north, part.observer),
        doubt=doubt if candidate else None, look=look, avoid=avoid,
        preferred=hazards.preferred is not None and bool(hazards.preferred[at]),
    )  # fmt: skip


def _height_at(part: Part, east: float, north: float) -> tuple[float, float]:
    """Return mean height and sigma, m, of the trusted cells of the footprint at a position; of all if none is."""
    e = part.elevation
    assert e is not None
    for reach in (part.lander.radius, part.lander.radius + part.hazards.grid.cell):
        rows, cols, disc = _footprint(e.grid, east, north, reach)
        height, sigma = e.height[rows, cols], e.relative_sigma[rows, cols].astype(np.float64)
        known = disc & np.isfinite(height)
        if known.any():
            break
    trusted = known & e.trusted[rows, cols]
    here = trusted if trusted.any() else known
    return float(height[here].mean()), float(np.sqrt(np.mean(sigma[here] ** 2)))


def _landing_class(part: Part, east: float, north: float) -> Terrain:
    if part.land_cover is None:
        return Terrain.UNKNOWN
    rows, cols, disc = _footprint(part.land_cover.grid, east, north, part.lander.radius)
    labels = part.land_cover.label[rows, cols][disc]
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


def _spread(search: SiteSearch, count: int, apart: float, taken: Sequence[Best]) -> list[Best]:
    """Return up to `count` best cells, best first, spread over the judged ground; nearer ones if others are few."""
    if count <= 0:
        return []
    area = float(search.ground.judged) * search.ground.grid.cell**2
    found = search.peaks(count, max(apart, math.sqrt(area / count)), taken)
    found += search.peaks(count - len(found), apart, [*taken, *found])
    return sorted(found, key=lambda best: best.score, reverse=True)


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
    found = find_sites(WholeMap(Part(hazards, land_cover, elevation, settings, lander, observer)), settings, lander)
    if not found.sites:
        seen = Tally.of(hazards.on(elevation.grid), elevation.trusted)
        found = replace(found, reason=why_no_site(seen, hazards.grid.cell, settings, lander))
    return replace(found, ground_judged=land_cover is not None)


def find_sites(ground: SearchedMap, settings: SitesSettings, lander: Lander) -> Sites:
    """Rank the sites and candidates of a map that is at hand as a whole or in parts, without the reason for none."""
    apart, count = separation(settings, lander), settings.count
    kind, safe = SAFE, SiteSearch(ground, SAFE).peaks(count, apart)
    undecided = _spread(SiteSearch(ground, UNDECIDED), count - len(safe), apart, safe) if len(safe) < count else []
    listed = [(UNDECIDED, best.cell) for best in undecided]
    if ground.zoned:
        if not safe and not undecided:
            kind, safe = AVOIDED_SITES, SiteSearch(ground, AVOIDED_SITES).peaks(count, apart)
        if (left := count - len(safe) - len(undecided)) > 0:
            taken = [*safe, *undecided]
            listed += [(AVOIDED, best.cell) for best in _spread(SiteSearch(ground, AVOIDED), left, apart, taken)]
    listed = [(kind, best.cell) for best in safe] + listed
    made = tuple(_site(ground.about(at), n, at, ground.grid, wanted) for n, (wanted, at) in enumerate(listed, 1))
    return Sites(made[: len(safe)], candidates=made[len(safe) :])


def why_no_site(seen: Tally, cell: float, settings: SitesSettings, lander: Lander) -> str:
    """Return the reasons against a landing in one sentence, as shares of the seen ground; these shares may overlap."""
    if not seen.cells:
        return "no safe site: no ground was seen well enough to know its height"
    if seen.reasons[Hazard.EDGE] == seen.cells:
        return "no safe site: the map is smaller than the footprint"
    if seen.safe:
        return (
            f"no safe site: {seen.safe / seen.cells:.1%} of the seen ground is safe, but the most room there is "
            f"{math.floor(100 * seen.room) / 100:.2f} m and {settings.margin:.2f} m is wanted"
        )
    ranked = sorted((s, b) for b in REASON_WORDS if (s := seen.share(b)) >= 0.005)[::-1]
    parts = [f"{100 * share:.0f} % {REASON_WORDS[bit]}{_zones_of(bit, seen)}" for share, bit in ranked]
    too_wide = f"; cells of {cell:g} m are wider than the radius of {lander.radius:g} m, so no plane fits"
    return "no safe site: of the seen ground " + ", ".join(parts) + (too_wide if lander.radius < cell else "")


def _zones_of(bit: Hazard, seen: Tally, most: int = 3) -> str:
    """Return the names of the zones behind a reason of refusal, the largest first, in brackets; else empty."""
    if not (largest := [label for (reason, label), _ in seen.zones.most_common() if reason == bit]):
        return ""
    more = f", {len(largest) - most} more" if len(largest) > most else ""
    return f" ({', '.join(largest[:most])}{more})"
