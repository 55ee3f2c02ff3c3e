"""From hazards to sites: the best places to touch down, ranked, or the reason why there is none."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from alight.records import F32, F64, ElevationMap, Hazard, HazardMap, NextView, Site, Sites, Terrain, TerrainMap
from alight.settings import Lander, SitesSettings

Bool = NDArray[np.bool_]
Term = tuple[float, F32]  # of Q: weight, and (R, C) values
NEARER = 0.5  # of the height above ground: half the pixel, half the noise
SURE_OF_PLACE = 2.0  # sigmas of its place that the clearance of a site must cover, to be a site in another frame
LOWEST = 8.0  # metres above the place: lower, one is about to land

_SPOKEN = {
    Hazard.ROUGHNESS: "is too rough",
    Hazard.SLOPE: "is too steep",
    Hazard.STEP: "has too high a step",
    Hazard.CLEARANCE: "leaves the rotor or the belly no room",
    Hazard.TERRAIN: "is covered by what cannot be landed on (water, plants, structures)",
    Hazard.UNKNOWN: "has unknown ground within the footprint",
    Hazard.EDGE: "is too near to the map's edge",
    Hazard.DOUBT: "meets every limit, but not surely enough",
}


def _score(hazards: HazardMap, settings: SitesSettings, vehicle: F64 | None, extra: Sequence[Term]) -> F64:
    """Worth of every cell (G11): quality, room around it, nearness; -inf where no touchdown is allowed."""
    allowed = (hazards.reasons == 0) & (hazards.clearance >= settings.margin) & np.isfinite(hazards.quality)
    room = np.minimum(hazards.clearance / settings.roomy, 1.0)
    score = hazards.quality.astype(np.float64) + settings.room_weight * room
    if vehicle is not None and settings.distance_weight > 0:
        east, north = hazards.grid.xy()
        away = np.hypot(east[None, :] - vehicle[0], north[:, None] - vehicle[1])
        score -= settings.distance_weight * away
    for weight, values in extra:
        score -= weight * values
        allowed &= np.isfinite(values)
    return np.where(allowed, score, -np.inf)


def _within(shape: tuple[int, int], row: int, col: int, radius_cells: float) -> tuple[slice, slice, Bool]:
    """The window of the disc about a cell, cut at the map's edge, and the disc in it."""
    reach = math.floor(radius_cells + 1e-6)
    rows = slice(max(0, row - reach), min(shape[0], row + reach + 1))
    cols = slice(max(0, col - reach), min(shape[1], col + reach + 1))
    y, x = np.ogrid[rows.start - row : rows.stop - row, cols.start - col : cols.stop - col]
    return rows, cols, np.hypot(x, y) <= radius_cells + 1e-6


def _peaks(score: F64, count: int, apart_cells: float) -> list[tuple[int, int]]:
    """The best cells, best first, none nearer to a better one than `apart_cells` (non-maximum suppression)."""
    left = score.copy()
    found: list[tuple[int, int]] = []
    while len(found) < count:
        row, col = divmod(int(np.argmax(left)), left.shape[1])
        if not np.isfinite(left[row, col]):
            break
        found.append((row, col))
        rows, cols, disc = _within(left.shape, row, col, apart_cells)
        left[rows, cols][disc] = -np.inf
    return found


def _cover(terrain: TerrainMap | None, rows: slice, cols: slice, disc: Bool) -> Terrain:
    """The most frequent known class in the footprint."""
    if terrain is None:
        return Terrain.UNKNOWN
    labels = terrain.label[rows, cols][disc]
    counts = np.bincount(labels[labels != Terrain.UNKNOWN], minlength=len(Terrain))
    return Terrain(int(counts.argmax())) if counts.any() else Terrain.UNKNOWN


def _heading(east: float, north: float, vehicle: F64 | None) -> float:
    """Bearing of the approach, clockwise from north; north if the vehicle is overhead or not known."""
    if vehicle is None or math.hypot(east - vehicle[0], north - vehicle[1]) < 1.0:
        return 0.0
    return math.atan2(east - vehicle[0], north - vehicle[1]) % (2 * math.pi)


def _site(
    rank: int,
    at: tuple[int, int],
    hazards: HazardMap,
    terrain: TerrainMap | None,
    elevation: ElevationMap,
    lander: Lander,
    vehicle: F64 | None,
) -> Site:
    """Put down everything that is known about one peak."""
    grid = hazards.grid
    east, north = grid.east + at[1] * grid.cell, grid.north - at[0] * grid.cell
    rows, cols, disc = _within(grid.shape, *at, lander.radius / grid.cell)
    ground = disc & elevation.trusted[rows, cols]
    sigma: F32 = elevation.sigma[rows, cols][ground]
    return Site(
        rank=rank,
        east=east,
        north=north,
        up=float(elevation.height[rows, cols][ground].mean()),
        p_safe=float(hazards.p_safe[at]),
        quality=float(hazards.quality[at]),
        slope=float(hazards.slope[at]),
        roughness=float(hazards.roughness[at]),
        clearance=float(hazards.clearance[at]),
        radius=lander.radius + float(hazards.clearance[at]),
        terrain=_cover(terrain, rows, cols, disc),
        heading=_heading(east, north, vehicle),
        height_sigma=float(np.sqrt(np.mean(sigma.astype(np.float64) ** 2))),
    )


def why_no_site(hazards: HazardMap, elevation: ElevationMap, settings: SitesSettings) -> str:
    """Say in a sentence what stands against landing, as shares of the ground that was seen; they may overlap."""
    seen = elevation.trusted
    if not seen.any():
        return "no safe site: no ground was seen well enough to know its height"
    if ((hazards.reasons[seen] & Hazard.EDGE) != 0).all():
        return "no safe site: the map is smaller than the footprint"
    safe = seen & (hazards.reasons == 0)
    if safe.any():
        room = float(hazards.clearance[safe].max())
        return (
            f"no safe site: {safe.sum() / seen.sum():.1%} of the seen ground is safe, but the most room there is "
            f"{room:.2f} m and {settings.margin:.2f} m is wanted"
        )
    shares = {bit: float(((hazards.reasons[seen] & bit) != 0).mean()) for bit in _SPOKEN}
    ranked = sorted((s, b) for b, s in shares.items() if s >= 0.005)[::-1]
    parts = [f"{100 * share:.0f} % {_SPOKEN[bit]}" for share, bit in ranked]
    return "no safe site: of the seen ground " + ", ".join(parts)


def choose_sites(
    hazards: HazardMap,
    terrain: TerrainMap | None,
    elevation: ElevationMap,
    settings: SitesSettings,
    lander: Lander,
    vehicle: F64 | None = None,
    extra: Sequence[Term] = (),
) -> Sites:
    """Rank the places where a touchdown is safe; the first is the choice, the others are kept in reserve.

    Args:
        hazards: the verdict on every cell.
        terrain: what covers the ground, named at each site; None for not known.
        elevation: heights, on the same grid.
        settings: how many, how far apart, and what counts.
        lander: its footprint.
        vehicle: (3,) position in the world, metres: gives the heading of the approach; None for not known.
        extra: further terms of Q (eq. 5), a weight and (R, C) values each, larger is worse: energy, wind, people. NaN
            refuses the cell.

    Returns:
        Sites in order of rank. Without any, the reason is a sentence: it is an answer, not an error.
    """
    apart = settings.separation or 2 * lander.radius
    peaks = _peaks(_score(hazards, settings, vehicle, extra), settings.count, apart / hazards.grid.cell)
    if not peaks:
        return Sites((), why_no_site(hazards, elevation, settings))
    return Sites(tuple(_site(i + 1, at, hazards, terrain, elevation, lander, vehicle) for i, at in enumerate(peaks)))


def next_view(
    hazards: HazardMap, elevation: ElevationMap, settings: SitesSettings, lander: Lander, above: float
) -> NextView | None:
    """Say from where the most promising undecided place should be seen again: straight above it, and nearer.

    Promising is what no limit refuses and of which P is highest over a footprint's surroundings; nearer by `nearer`,
    because pixels, the noise of heights and the size of what is flattened shrink with the distance.

    Args:
        hazards: the verdict.
        elevation: heights, on the same grid.
        settings: how much nearer.
        lander: its footprint.
        above: metres, the height above ground from which the map was seen.

    Returns:
        The view, or None where every place is refused for good or one is safe already.
    """
    undecided = (hazards.reasons == Hazard.DOUBT) & np.isfinite(hazards.p_safe)
    if (hazards.reasons == 0).any() or not undecided.any():
        return None
    p = np.where(undecided, hazards.p_safe, np.float32(0))
    side = 2 * max(1, round(lander.radius / hazards.grid.cell)) + 1
    around = cv2.blur(p, (side, side), borderType=cv2.BORDER_CONSTANT)
    row, col = divmod(int(np.argmax(np.where(undecided, around, -1.0))), p.shape[1])
    rows, cols, disc = _within(p.shape, row, col, lander.radius / hazards.grid.cell)
    ground = elevation.height[rows, cols][disc & elevation.trusted[rows, cols]]
    if not ground.size:
        return None
    grid, up = hazards.grid, float(np.median(ground))
    place = np.array([grid.east + col * grid.cell, grid.north - row * grid.cell, up])
    height = max(settings.nearer * above, settings.lowest_look)
    return NextView(place + np.array([0.0, 0.0, height]), place, float(p[row, col]), height)


@dataclass(frozen=True)
class Reserve:
    """The sites known in flight, kept up to date from map to map; what fell out, with the reason."""

    sites: tuple[Site, ...] = ()
    lost: tuple[tuple[Site, str], ...] = ()  # by the newest map
    frame_id: int = 0  # of the map that their places belong to

    def tied(self, shift: F64, sigma: float, frame_id: int) -> Reserve:
        """Move all sites into another frame; those are lost whose clearance does not cover what is unknown of the tie.

        Args:
            shift: (3,) metres, to add.
            sigma: metres, 1-sigma of it on the ground.
            frame_id: of the other frame.
        """
        moved = [replace(s, east=s.east + shift[0], north=s.north + shift[1], up=s.up + shift[2]) for s in self.sites]
        kept = [s for s in moved if s.clearance >= SURE_OF_PLACE * sigma]
        why = f"the motion began anew, and its place is known to {sigma:.2f} m only"
        lost = tuple((s, why) for s in moved if s not in kept)
        return Reserve(tuple(replace(s, rank=i + 1) for i, s in enumerate(kept)), lost, frame_id)

    def updated(self, found: Sites, hazards: HazardMap, apart: float) -> Reserve:
        """Take the sites of a newer map; older ones stay while nothing says otherwise.

        Args:
            found: chosen from the newer map.
            hazards: its verdict, which confirms, refuses or does not see the older ones.
            apart: metres within which two sites are the same.

        Returns:
            The newer sites first, then older ones that the newer map does not see; refused ones are lost.
        """
        kept, lost = list(found.sites), []
        for old in self.sites:
            if any(math.hypot(old.east - s.east, old.north - s.north) <= apart for s in kept):
                continue
            why = _refusal(hazards, old)
            if why is None:
                kept.append(old)
            else:
                lost.append((old, why))
        return replace(self, sites=tuple(replace(s, rank=i + 1) for i, s in enumerate(kept)), lost=tuple(lost))


def _refusal(hazards: HazardMap, site: Site) -> str | None:
    """Why a verdict refuses the place of a site; None where it does not, or does not see it."""
    row, col = (int(np.rint(v)) for v in hazards.grid.index(np.array(site.east), np.array(site.north)))
    if not (0 <= row < hazards.grid.rows and 0 <= col < hazards.grid.cols):
        return None
    reasons = Hazard(int(hazards.reasons[row, col])) & ~(Hazard.EDGE | Hazard.UNKNOWN)
    return ", ".join(_SPOKEN[bit] for bit in reasons) or None
