"""Landing sites: the best places to touch down, ranked, or the reason why there is none (eq. 5 of the paper, G11)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from alight.arrays import F32, F64, Mask
from alight.landing.reasons import why_no_site
from alight.raster import disc_window
from alight.records import ElevationMap, HazardMap, Site, Sites, Terrain, TerrainMap
from alight.settings import Lander, SitesSettings

Term = tuple[float, F32]  # of Q: weight, and (R, C) values


def _score(hazards: HazardMap, settings: SitesSettings, vehicle: F64 | None, extra: Sequence[Term]) -> F64:
    """Score of every cell (G11): quality, room around it, nearness; -inf where no touchdown is allowed."""
    allowed = (hazards.reasons == 0) & (hazards.clearance >= settings.margin) & np.isfinite(hazards.quality)
    room = np.minimum(hazards.clearance / settings.roomy, 1.0)
    score = hazards.quality.astype(np.float64) + settings.room_weight * room
    if vehicle is not None and settings.distance_weight > 0:
        east, north = hazards.grid.xy()
        distance = np.hypot(east[None, :] - vehicle[0], north[:, None] - vehicle[1])
        score -= settings.distance_weight * distance
    for weight, values in extra:
        score -= weight * values
        allowed &= np.isfinite(values)
    return np.where(allowed, score, -np.inf)


def _peaks(score: F64, count: int, apart_cells: float) -> list[tuple[int, int]]:
    """The best cells, best first, none nearer to a better one than `apart_cells` (non-maximum suppression)."""
    remaining = score.copy()
    found: list[tuple[int, int]] = []
    while len(found) < count:
        row, col = divmod(int(np.argmax(remaining)), remaining.shape[1])
        if not np.isfinite(remaining[row, col]):
            break
        found.append((row, col))
        rows, cols, disc = disc_window(remaining.shape, row, col, apart_cells)
        remaining[rows, cols][disc] = -np.inf
    return found


def _landing_class(land_cover: TerrainMap | None, rows: slice, cols: slice, disc: Mask) -> Terrain:
    """The most frequent known class in the footprint."""
    if land_cover is None:
        return Terrain.UNKNOWN
    labels = land_cover.label[rows, cols][disc]
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
    land_cover: TerrainMap | None,
    elevation: ElevationMap,
    lander: Lander,
    vehicle: F64 | None,
) -> Site:
    """The record of the site at one peak of the score."""
    grid = hazards.grid
    east, north = grid.east + at[1] * grid.cell, grid.north - at[0] * grid.cell
    rows, cols, disc = disc_window(grid.shape, *at, lander.radius / grid.cell)
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
        terrain=_landing_class(land_cover, rows, cols, disc),
        heading=_heading(east, north, vehicle),
        height_sigma=float(np.sqrt(np.mean(sigma.astype(np.float64) ** 2))),
    )


def choose_sites(
    hazards: HazardMap,
    land_cover: TerrainMap | None,
    elevation: ElevationMap,
    settings: SitesSettings,
    lander: Lander,
    vehicle: F64 | None = None,
    extra: Sequence[Term] = (),
) -> Sites:
    """Rank the places where a touchdown is safe; the first is the choice, the others are kept in reserve.

    Args:
        hazards: reasons against a touchdown, P(safe), quality and clearance of every cell.
        land_cover: classes, named at each site; None for not known.
        elevation: heights, on the same grid.
        settings: how many, how far apart, and what counts.
        lander: its footprint.
        vehicle: (3,) position in the world, metres, for the heading of the approach; None if not known.
        extra: further terms of Q (eq. 5), a weight and (R, C) values each, larger is worse: energy, wind, people. NaN
            refuses the cell.

    Returns:
        Sites in order of rank. Without any, the reason is a sentence: it is an answer, not an error.
    """
    apart = settings.separation or 2 * lander.radius
    peaks = _peaks(_score(hazards, settings, vehicle, extra), settings.count, apart / hazards.grid.cell)
    if not peaks:
        return Sites((), why_no_site(hazards, elevation, settings))
    return Sites(tuple(_site(i + 1, at, hazards, land_cover, elevation, lander, vehicle) for i, at in enumerate(peaks)))
