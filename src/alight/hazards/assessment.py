"""From heights to hazards: what a touchdown centred on each cell would meet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from alight.hazards.contact import (
    Footprint,
    any_near,
    footprint_of,
    gear_contact,
    near_edge,
    rotor_rise,
    share_near,
    step_of,
)
from alight.hazards.evidence import Shape, hazard_terms, unresolved
from alight.hazards.monotone_net import safe_belief
from alight.hazards.probability import SURELY, Margins, margins_over_sigma, mean_near, safe_probability
from alight.hazards.usable_heights import evened, judged_height
from alight.records import F32, U8, ElevationMap, Flag, Hazard, HazardMap, TerrainMap
from alight.settings import HazardsSettings, Lander

Bool = NDArray[np.bool_]
ROUNDING = 1e-4  # of a share


@dataclass(frozen=True, eq=False)
class _Findings:
    """Everything that a verdict is made of, (R, C) each."""

    footprint: Footprint
    slope: F32
    step: F32
    edge: Bool
    unknown: Bool
    rise: F32 | None  # metres, of the ground under the belly above the worst contact plane
    blocked: Bool  # something stands in the belly's or rotor's way
    vetoed: Bool
    even: F32  # metres, largest deviation of heights averaged over what their noise shares
    broad: F32  # metres, of heights averaged over twice as much: what bends, not what is noise


def _veto(terrain: TerrainMap | None, settings: HazardsSettings, shape: tuple[int, int]) -> Bool:
    """Cells whose cover may not be landed on; no evidence is no veto."""
    if terrain is None:
        return np.zeros(shape, dtype=np.bool_)
    return terrain.landable < settings.min_landable


def _find(
    height: F32,
    unseen: Bool,
    terrain: TerrainMap | None,
    spare: float,
    lander: Lander,
    settings: HazardsSettings,
    cell: float,
) -> _Findings:
    fp = footprint_of(height, lander.radius, cell)
    edge = near_edge(height.shape, lander.radius, cell)
    doubtful = settings.doubtful_share if settings.smoothed else settings.unknown_share
    unknown = np.isnan(fp.level) | (fp.unknown > doubtful) | (unseen if settings.smoothed else np.isnan(height))
    unknown |= share_near(unseen, lander.radius, cell) > settings.unknown_share + ROUNDING
    blocked, slope, rise = np.zeros_like(edge), fp.slope, None
    if lander.rotor_radius is not None and lander.rotor_radius > lander.radius:
        blocked |= rotor_rise(height, fp, lander, cell) > lander.rotor_rise
        unknown |= share_near(np.isnan(height), lander.rotor_radius, cell) > doubtful + ROUNDING
        edge |= near_edge(height.shape, lander.rotor_radius, cell)
    if lander.has_gear:
        slope, rise = gear_contact(height, fp, edge | unknown, lander, cell, spare)
        unknown |= np.isnan(slope) & ~edge
        blocked |= rise > (np.inf if lander.belly_clearance is None else lander.belly_clearance)
        rise = None if lander.belly_clearance is None else rise
    vetoed = any_near(_veto(terrain, settings, height.shape), lander.radius, cell)
    even = broad = fp.roughness
    if settings.smoothed:
        even = footprint_of(evened(height, cell, settings.even_length), lander.radius, cell).roughness
        broad = footprint_of(evened(height, cell, settings.broad_length), lander.radius, cell).roughness
    return _Findings(fp, slope, step_of(height, lander.radius, cell), edge, unknown, rise, blocked, vetoed, even, broad)


def _spare(sigma: F32) -> float:
    """How near to the belly's clearance the rise is wanted in numbers, metres: beyond, the odds are settled."""
    known = sigma[np.isfinite(sigma)]
    return 5.0 * float(np.quantile(known, 0.9)) if known.size else 0.0


def common_tilt(elevation: ElevationMap, settings: HazardsSettings) -> float:
    """1-sigma of the tilt that all cells share, rad: from the poses of the map, and what the user says besides."""
    poses = 0.0 if elevation.gauge is None else elevation.gauge.tilt_sigma
    return float(np.hypot(poses, settings.tilt_sigma))


def _probability(
    elevation: ElevationMap,
    terrain: TerrainMap | None,
    f: _Findings,
    sigma: F32,
    lander: Lander,
    settings: HazardsSettings,
) -> F32:
    """P(safe) by the margins alone, or of all evidence where heights from matched images may hide what is small."""
    cell = elevation.grid.cell
    margins = Margins(f.footprint, f.slope, f.rise, sigma, common_tilt(elevation, settings))
    tilt, rise = margins_over_sigma(margins, lander, settings, cell)
    if not settings.smoothed:
        return safe_probability(tilt, rise, f.footprint.unknown, settings)
    level = safe_probability(tilt, np.full_like(tilt, SURELY), np.zeros_like(tilt), settings)
    level = level * np.float32(1 - unresolved(elevation, lander, settings))
    return level * safe_belief(hazard_terms(elevation, terrain, Shape(f.footprint, f.even, f.broad, rise), lander))


def _reasons(f: _Findings, sigma: F32, lander: Lander, settings: HazardsSettings) -> U8:
    """Every limit that a touchdown would break, as bits of `Hazard`.

    The largest of hundreds of noisy heights is not the ground's: where heights are noisy (`smoothed`), what breaks the
    limit of roughness by little is left to P.
    """
    single, averaged = settings.surely_sigmas * settings.smoothed, settings.clearly_sigmas * settings.smoothed
    rough = f.footprint.roughness > lander.max_roughness + np.float32(single) * sigma
    rough |= f.even > lander.max_roughness + np.float32(averaged) * sigma
    rough |= f.broad > lander.max_roughness
    if lander.has_gear and lander.belly_clearance is not None:  # the belly's own limit says more
        rough = np.zeros_like(rough)
    high_step = f.step > (np.inf if lander.max_step is None else lander.max_step)
    broken = {
        Hazard.EDGE: f.edge,
        Hazard.UNKNOWN: f.unknown,
        Hazard.SLOPE: f.slope > lander.max_slope,
        Hazard.ROUGHNESS: rough,
        Hazard.STEP: high_step,
        Hazard.CLEARANCE: f.blocked,
        Hazard.TERRAIN: f.vetoed,
    }
    out = np.zeros(f.edge.shape, dtype=np.uint8)
    for bit, where in broken.items():
        out |= np.where(where, np.uint8(bit), np.uint8(0))
    return out


def _quality(
    f: _Findings, terrain: TerrainMap | None, sigma: F32, lander: Lander, settings: HazardsSettings, cell: float
) -> F32:
    """Q of the paper's eq. 5 (G10): F from slope and roughness, G from the cover and from how well it is known."""
    flatness = (f.slope / lander.max_slope) ** 2 + (f.footprint.roughness / lander.max_roughness) ** 2
    doubt = (sigma / np.float32(lander.max_roughness)) ** 2
    cover = np.zeros_like(doubt)
    if terrain is not None:
        cover = np.nan_to_num(1 - mean_near(terrain.landable, lander.radius, cell), nan=0.0)
    q: F32 = (-settings.alpha * flatness - settings.beta * (cover + doubt)).astype(np.float32)
    return q


def clearance_of(safe: Bool, cell: float) -> F32:
    """Distance of every cell's centre to the rim of the nearest cell that is refused, metres; 0 on those."""
    if safe.all():  # cannot happen with a rim of EDGE, but the transform needs one zero
        return np.full(safe.shape, np.inf, dtype=np.float32)
    # not OpenCV's: the last bits of its distances go with the number of threads that are free
    cells: F32 = distance_transform_edt(safe).astype(np.float32)
    out: F32 = np.maximum(cells - np.float32(0.5), np.float32(0)) * np.float32(cell)
    return out


def assess(elevation: ElevationMap, terrain: TerrainMap | None, lander: Lander, settings: HazardsSettings) -> HazardMap:
    """Judge each cell as the centre of a touchdown, at the worst heading.

    The footprint is every cell whose centre lies within the lander's radius. Unknown ground is never safe.

    Args:
        elevation: heights; cells that a flag refuses count as unknown.
        terrain: classes, which may refuse and never permit; None for none.
        lander: its shape and its limits.
        settings: how strict.

    Raises:
        ValueError: the two maps do not share a grid.
    """
    if terrain is not None and terrain.grid != elevation.grid:
        raise ValueError("terrain and elevation must share one grid")
    cell = elevation.grid.cell
    height = judged_height(elevation, lander, settings)
    variance = np.where(np.isfinite(height), elevation.sigma**2, np.float32(np.nan))
    sigma = np.sqrt(mean_near(variance, lander.radius, cell))
    unseen = np.isnan(elevation.height) | ((elevation.flags & np.uint16(Flag.UNSEEN)) != 0)
    found = _find(height, unseen, terrain, _spare(sigma), lander, settings, cell)
    reasons = _reasons(found, sigma, lander, settings)
    p = _probability(elevation, terrain, found, sigma, lander, settings)
    judged = ~(found.edge | found.unknown)
    p = np.where(judged, np.where(reasons == 0, p, np.float32(0)), np.float32(np.nan))
    reasons |= np.where(judged & (reasons == 0) & ~(p >= settings.p_safe), np.uint8(Hazard.DOUBT), np.uint8(0))
    return HazardMap(
        grid=elevation.grid,
        slope=found.slope,
        roughness=found.footprint.roughness,
        step=found.step,
        clearance=clearance_of(reasons == 0, cell),
        p_safe=p,
        quality=_quality(found, terrain, sigma, lander, settings, cell),
        reasons=reasons,
    )
