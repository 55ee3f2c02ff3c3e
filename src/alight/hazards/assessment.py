"""Hazard assessment: every cell of a map judged as the centre of a touchdown."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from alight.arrays import F32, U16, Mask
from alight.hazards.beside import ROUNDING, beside_of
from alight.hazards.contact import Footprint, footprint_of, step_of
from alight.hazards.evidence import FootprintShape
from alight.hazards.factors import Evidence, evidence_of, factors_of
from alight.hazards.footprint import is_coarse
from alight.hazards.probability import TouchdownGeometry, margins_over_sigma
from alight.hazards.usable_heights import measured_height, smoothed_height, usable_height
from alight.raster import (
    block_quantile,
    clearance_of,
    disc_any,
    disc_crosses_edge,
    disc_max,
    disc_mean,
    disc_share,
    linear_ramp,
    log_brightness,
    upsample,
)
from alight.records import NOTHING_MISSING, ElevationMap, Flag, Hazard, HazardMap, MissingVeto, TerrainMap, is_site
from alight.settings import HazardsSettings, Lander

LEAST_BLOCKS = 4.0  # cells of radius: a smaller footprint holds too few blocks of 2 x 2 cells for a plane


@dataclass(frozen=True, eq=False)
class _Findings:
    """Measurements of every footprint, (R, C) each."""

    footprint: Footprint
    slope: F32
    step: F32
    edge: Mask
    unknown: Mask
    rise: F32 | None  # metres, of the ground under the belly above the worst contact plane
    rotor: F32 | None  # sigmas, the least margin of the ground beside the footprint below the rotors
    blocked: Mask  # the ground reaches into the belly's or the rotor's clearance
    vetoed: Mask
    roughness_smooth: F32  # metres, largest deviation of heights smoothed by 0.2 m: less noise
    roughness_trend: F32  # metres, of heights smoothed by 0.45 m: bends of the ground, no noise
    measured_roughness: F32  # metres, of all measured heights, doubtful ones as well
    unmeasured: F32  # share of the footprint without any height
    measured: F32  # metres, all measured heights, of the cells

    @property
    def shape(self) -> FootprintShape:
        """Shape of the footprints, for the evidence."""
        smooth, trend = self.roughness_smooth, self.roughness_trend
        return FootprintShape(self.footprint, smooth, trend, self.measured_roughness, self.measured, self.unmeasured)

    def margins(self, sigma: F32, elevation: ElevationMap, settings: HazardsSettings) -> TouchdownGeometry:
        """Geometry of the touchdowns, for the margins to the limits; `sigma` (R, C) metres, of the footprint."""
        tilt = common_tilt(elevation, settings)
        return TouchdownGeometry(self.footprint, self.slope, self.rise, self.rotor, sigma, tilt)


def _veto(terrain: TerrainMap | None, settings: HazardsSettings, shape: tuple[int, int]) -> Mask:
    """Cells whose land cover may not be landed on; a cell without a class is not refused."""
    if terrain is None:
        return np.zeros(shape, dtype=np.bool_)
    return terrain.landable < settings.min_landable


def _smoothed_roughness(height: F32, radius: float, cell: float, length: float) -> F32:
    """Largest deviation of heights smoothed by `length`, metres; on wider cells if that and the radius allow it."""
    smooth = smoothed_height(height, cell, length)
    if length / cell + ROUNDING < 2 or radius < LEAST_BLOCKS * cell:
        return footprint_of(smooth, radius, cell).roughness
    wide = block_quantile(smooth, 2, 0.5)
    return upsample(footprint_of(wide, radius, 2 * cell).roughness, 2, height.shape)


def _find(
    height: F32,
    measured: F32,
    unseen: Mask,
    elevation: ElevationMap,
    terrain: TerrainMap | None,
    spare: float,
    lander: Lander,
    settings: HazardsSettings,
) -> _Findings:
    cell = elevation.grid.cell
    fp = footprint_of(height, lander.radius, cell)
    if lander.ground_reach > lander.radius:  # gear stands on the noise beside the footprint
        fp = replace(fp, scatter=footprint_of(height, lander.ground_reach, cell).scatter)
    edge = disc_crosses_edge(height.shape, lander.radius, cell)
    doubtful = settings.doubtful_share if settings.smoothed else settings.unknown_share
    unknown = np.isnan(fp.level) | (fp.unknown > doubtful) | (unseen if settings.smoothed else np.isnan(height))
    unknown |= disc_share(unseen, lander.radius, cell) > settings.unknown_share + ROUNDING
    about = beside_of(height, unseen, elevation, terrain, fp, lander, settings)
    edge, unknown, slope, rise = edge | about.edge, unknown | about.unknown, fp.slope, None
    blocked = np.zeros_like(edge) if about.rotor is None else about.rotor < 0
    if lander.has_gear:
        from alight.hazards.gear import gear_contact

        slope, rise = gear_contact(height, fp, edge | unknown, lander, cell, spare)
        unknown |= np.isnan(slope) & ~edge
        blocked |= rise > (np.inf if lander.belly_clearance is None else lander.belly_clearance)
        rise = None if lander.belly_clearance is None else rise
        slope = np.maximum(slope, fp.slope) if is_coarse(lander, cell) else slope
    vetoed = about.standing | disc_any(_veto(terrain, settings, height.shape), lander.ground_reach, cell)
    smooth = trend = fp.roughness
    if settings.smoothed:
        smooth, trend = (
            _smoothed_roughness(height, lander.radius, cell, length)
            for length in (settings.even_length, settings.broad_length)
        )
    every = footprint_of(measured, lander.radius, cell) if settings.smoothed else fp
    step = step_of(height, lander.radius, cell)
    return _Findings(
        fp, slope, step, edge, unknown, rise, about.rotor, blocked, vetoed, smooth, trend, every.roughness,
        every.unknown, measured,
    )  # fmt: skip


def _spare(sigma: F32) -> float:
    """Distance from the belly's clearance within which the rise is computed exactly, metres: 5 sigma."""
    known = sigma[np.isfinite(sigma)]
    return 5.0 * float(np.quantile(known, 0.9)) if known.size else 0.0


def common_tilt(elevation: ElevationMap, settings: HazardsSettings) -> float:
    """1-sigma of the tilt that all cells share, rad: from the poses of the map, and the user's setting besides."""
    poses = 0.0 if elevation.datum is None else elevation.datum.tilt_sigma
    return float(np.hypot(poses, settings.tilt_sigma))


def _reasons(f: _Findings, sigma: F32, lander: Lander, settings: HazardsSettings) -> U16:
    """Every limit that a touchdown would break, as bits of `Hazard`.

    The largest of hundreds of noisy heights is mostly noise: where heights are noisy (`smoothed`), a small excess over
    the roughness limit lowers P(safe) instead of refusing.
    """
    single, averaged = settings.surely_sigmas * settings.smoothed, settings.clearly_sigmas * settings.smoothed
    rough = f.footprint.roughness > lander.max_roughness + np.float32(single) * sigma
    rough |= f.roughness_smooth > lander.max_roughness + np.float32(averaged) * sigma
    rough |= f.roughness_trend > lander.max_roughness
    if lander.has_gear and lander.belly_clearance is not None:  # the limit of the belly replaces it
        rough = np.zeros_like(rough)
    high_step = f.step > (np.inf if lander.max_step is None else lander.max_step)
    broken = {
        Hazard.EDGE: f.edge,
        Hazard.UNKNOWN: f.unknown & ~f.edge,  # ground beyond the map is no unknown ground of it
        Hazard.SLOPE: f.slope > lander.max_slope,
        Hazard.ROUGHNESS: rough,
        Hazard.STEP: high_step,
        Hazard.CLEARANCE: f.blocked,
        Hazard.TERRAIN: f.vetoed,
    }
    out = np.zeros(f.edge.shape, dtype=np.uint16)
    for bit, where in broken.items():
        out |= np.where(where, np.uint16(bit), np.uint16(0))
    return out


def _appearance(elevation: ElevationMap, lander: Lander, settings: HazardsSettings) -> F32:
    """The darkest patch of a footprint against its surroundings, and its patchiness: from 0, plain ground, to 2."""
    cell, seen = elevation.grid.cell, elevation.rgb.any(axis=2)
    light = np.where(seen, log_brightness(elevation.rgb), np.float32(np.nan))
    below = disc_mean(light, settings.dark_radius, cell) - light
    darker = linear_ramp(below, settings.dark_least, settings.dark_most)
    dark = disc_max(disc_mean(darker, settings.patchy_length, cell), lander.radius, cell)  # one puddle is enough
    smooth = disc_mean(light, settings.patchy_length, cell)
    mean, square = (disc_mean(v, lander.radius, cell) for v in (smooth, smooth * smooth))
    spread = np.sqrt(np.maximum(square - mean * mean, 0))
    return dark + linear_ramp(spread, settings.patchy_least, settings.patchy_most)


def _quality(
    f: _Findings,
    elevation: ElevationMap,
    terrain: TerrainMap | None,
    sigma: F32,
    lander: Lander,
    settings: HazardsSettings,
) -> F32:
    """Q of the paper's eq. 5 (G10): F from slope and roughness, G from land cover, appearance and sigma."""
    flatness = (f.slope / lander.max_slope) ** 2 + (f.footprint.roughness / lander.max_roughness) ** 2
    uncertainty = (sigma / np.float32(lander.max_roughness)) ** 2
    cover = np.zeros_like(uncertainty)
    if terrain is not None:
        cover = np.nan_to_num(1 - disc_mean(terrain.landable, lander.radius, elevation.grid.cell), nan=0.0)
    terms = cover + _appearance(elevation, lander, settings) + uncertainty
    q: F32 = (-settings.alpha * flatness - settings.beta * terms).astype(np.float32)
    return q


def _measure(
    elevation: ElevationMap, terrain: TerrainMap | None, lander: Lander, settings: HazardsSettings
) -> tuple[_Findings, F32, U16]:
    """Every footprint's geometry, root mean square sigma (metres), and the limits that it breaks."""
    cell = elevation.grid.cell
    height = usable_height(elevation, lander, settings)
    variance = np.where(np.isfinite(height), elevation.sigma**2, np.float32(np.nan))
    sigma = np.sqrt(disc_mean(variance, lander.ground_reach, cell))
    unseen = np.isnan(elevation.height) | ((elevation.flags & np.uint16(Flag.UNSEEN)) != 0)
    measured = measured_height(elevation, lander, settings)
    found = _find(height, measured, unseen, elevation, terrain, _spare(sigma), lander, settings)
    reasons = _reasons(found, sigma, lander, settings)
    return found, sigma, reasons


def evidence(
    elevation: ElevationMap, terrain: TerrainMap | None, lander: Lander, settings: HazardsSettings
) -> tuple[Evidence, U16]:
    """Evidence of P(safe), and the limits that every footprint breaks as bits of `Hazard`, (R, C): for the fit."""
    found, sigma, reasons = _measure(elevation, terrain, lander, settings)
    margins = margins_over_sigma(found.margins(sigma, elevation, settings), lander, settings, elevation.grid.cell)
    return evidence_of(elevation, terrain, margins.tilt, found.shape, lander), reasons


def assess(
    elevation: ElevationMap,
    terrain: TerrainMap | None,
    lander: Lander,
    settings: HazardsSettings,
    missing: MissingVeto = NOTHING_MISSING,
    passed: Mask | None = None,
    came: Mask | None = None,
) -> HazardMap:
    """Judge each cell as the centre of a touchdown, at the worst heading.

    The footprint is every cell whose centre lies within the lander's radius. Gear and rotors may reach beyond it, and
    the ground there counts as well (G6, G6a). Unknown ground is never safe.

    Args:
        elevation: heights; cells that a flag refuses count as unknown.
        terrain: classes, which may refuse and never permit; None for none.
        lander: its shape and its limits.
        settings: limits of the judgement.
        missing: vetoes that could have refused ground and were missing.
        passed: (R, C), cells that something moved across a moment ago; None: nothing did.
        came: (R, C), cells on which somebody came to stand a moment ago; None: nobody did.

    Raises:
        ValueError: the two maps do not share a grid.
    """
    if terrain is not None and terrain.grid != elevation.grid:
        raise ValueError("terrain and elevation must share one grid")
    found, sigma, reasons = _measure(elevation, terrain, lander, settings)
    for where, margin in ((passed, settings.traffic_margin), (came, 0.0)):
        if where is not None and where.any():
            near = disc_any(where, lander.reach + margin, elevation.grid.cell)
            reasons |= np.where(near, np.uint16(Hazard.TRAFFIC), np.uint16(0))
    quality = _quality(found, elevation, terrain, sigma, lander, settings)
    f = factors_of(
        elevation, terrain, found.margins(sigma, elevation, settings), found.shape, lander, settings, missing
    )
    judged, slope, roughness, step = ~(found.edge | found.unknown), found.slope, found.footprint.roughness, found.step
    del found, sigma  # a third of the memory that judging a large map takes
    for factor in (f.relief, f.obstacle, f.ground):
        factor[~judged] = np.nan
    p = f.relief * f.obstacle * f.ground
    p[judged & (reasons != 0)] = 0
    doubtful = judged & (reasons == 0) & ~is_site(p, settings.p_safe)
    reasons |= np.where(doubtful, np.uint16(Hazard.DOUBT), np.uint16(0))
    return HazardMap(
        grid=elevation.grid,
        slope=slope,
        roughness=roughness,
        step=step,
        clearance=clearance_of(reasons == 0, elevation.grid.cell),
        p_safe=p,
        p_relief=f.relief,
        p_obstacle=f.obstacle,
        p_ground=f.ground,
        resolved=f.resolved,
        settles_at=f.settles_at,
        quality=quality,
        reasons=reasons,
    )
