"""Hazard assessment: judge a touchdown centred on each cell of a map."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from alight.arrays import F32, U16, Mask
from alight.hazards.factors import factors_of
from alight.hazards.touchdown import Inputs, Touchdowns, measure
from alight.hazards.wires import no_wire, under_wires
from alight.raster import clearance_of, disc_any, disc_max, disc_mean, log_brightness
from alight.records import NOTHING_MISSING, ElevationMap, Hazard, HazardMap, MissingVeto, TerrainMap, Wire, is_site
from alight.settings import HazardsSettings, Lander


def limits_broken(t: Touchdowns, on: Inputs) -> U16:
    """Return the limits that a touchdown would break, (R, C), as bits of `Hazard`.

    The largest of hundreds of noisy heights is mostly noise. If heights are noisy (`smoothed`), a small excess over the
    roughness limit therefore lowers P(safe) instead of refusing the touchdown.
    """
    lander, settings = on.lander, on.settings
    single, averaged = settings.surely_sigmas * settings.smoothed, settings.clearly_sigmas * settings.smoothed
    rough = t.footprint.roughness > lander.max_roughness + np.float32(single) * t.sigma
    rough |= t.smooth_roughness > lander.max_roughness + np.float32(averaged) * t.sigma
    rough |= t.trend_roughness > lander.max_roughness
    belly = lander.has_gear and lander.belly_clearance is not None  # the belly limit replaces the roughness limit
    broken = {
        Hazard.EDGE: t.edge,
        Hazard.UNKNOWN: t.unknown & ~t.edge,  # ground beyond the map is EDGE, not UNKNOWN
        Hazard.SLOPE: t.slope > lander.max_slope,
        Hazard.ROUGHNESS: rough & (not belly),
        Hazard.STEP: t.step > (np.inf if lander.max_step is None else lander.max_step),
        Hazard.CLEARANCE: t.blocked,
        Hazard.TERRAIN: t.vetoed,
    }
    out = np.zeros(t.edge.shape, dtype=np.uint16)
    for bit, where in broken.items():
        _refuse(out, where, bit)
    return out


def _refuse(reasons: U16, where: Mask, bit: Hazard) -> None:
    reasons |= np.where(where, np.uint16(bit), np.uint16(0))


def _contrast(on: Inputs) -> F32:
    """Compute the largest contrast of log brightness, (R, C), between patches within twice the lander's radius."""
    light = np.where(on.elevation.rgb.any(axis=2), log_brightness(on.elevation.rgb), np.float32(np.nan))
    light = disc_mean(light, on.settings.patch_length, on.cell)
    ends = (disc_max(np.nan_to_num(v, nan=-np.inf), 2 * on.lander.radius, on.cell) for v in (light, -light))
    return np.maximum(sum(ends), np.float32(0))


def _quality(t: Touchdowns, on: Inputs) -> F32:
    """Compute the quality Q of every touchdown, (R, C), by eq. 5 of the paper (G10)."""
    lander, settings = on.lander, on.settings
    flatness = (t.slope / lander.max_slope) ** 2 + (t.footprint.roughness / lander.max_roughness) ** 2
    uncertainty = (t.sigma / np.float32(lander.max_roughness)) ** 2
    cover = np.zeros_like(uncertainty)
    if on.land_cover is not None:
        cover = np.nan_to_num(1 - disc_mean(on.land_cover.landable, lander.radius, on.cell), nan=0.0)
    terms = cover + (_contrast(on) / np.float32(settings.patch_contrast)) ** 2 + uncertainty
    return np.asarray(-settings.alpha * flatness - settings.beta * terms, np.float32)


def assess(
    elevation: ElevationMap,
    land_cover: TerrainMap | None,
    lander: Lander,
    settings: HazardsSettings,
    missing: MissingVeto = NOTHING_MISSING,
    passed: Mask | None = None,
    came: Mask | None = None,
    wires: Sequence[Wire] = (),
) -> HazardMap:
    """Judge a touchdown centred on each cell, at the worst heading.

    The footprint is every cell whose centre lies within the lander's radius. Gear and rotors may reach beyond it; the
    ground there is judged as well (G6, G6a). Unknown ground is never safe.

    Args:
        elevation: heights; cells that a flag refuses are treated as unknown.
        land_cover: classes, which can refuse a touchdown but never permit one; None: the kind of ground is not
            judged, and `p_ground` is NaN.
        lander: shape and limits of the vehicle.
        settings: limits of the judgement.
        missing: vetoes that could not be applied for want of data.
        passed: (R, C) mask of cells that a moving object crossed recently; None: no cell.
        came: (R, C) mask of cells where a person or object recently came to stand; None: no cell.
        wires: wires over the ground, found and doubtful.

    Raises:
        ValueError: the two maps have different grids.
    """
    if land_cover is not None and land_cover.grid != elevation.grid:
        raise ValueError("land cover and elevation must share one grid")
    on = Inputs(elevation, land_cover, lander, settings)
    found = measure(on)
    reasons = limits_broken(found, on)
    for where, margin in ((passed, settings.traffic_margin), (came, 0.0)):
        if where is not None and where.any():
            _refuse(reasons, disc_any(where, lander.reach + margin, on.cell), Hazard.TRAFFIC)
    if wires:
        _refuse(reasons, under_wires(wires, elevation.grid, lander), Hazard.WIRE)
    quality, f = _quality(found, on), factors_of(found, on, missing)
    judged, slope, roughness, step = ~(found.edge | found.unknown), found.slope, found.footprint.roughness, found.step
    del found  # a third of the memory needed to judge a large map
    p_wires = no_wire(wires, elevation.grid, lander)
    nearer = np.fmin(f.settles_at, np.float32(0.5) * elevation.picture_sampling)  # shows a line twice as wide
    settles_at = np.where(p_wires < 1, nearer, f.settles_at)
    for factor in (f.relief, f.obstacle, f.ground, p_wires):
        factor[~judged] = np.nan
    p = f.relief * f.obstacle * f.ground * p_wires
    p[judged & (reasons != 0)] = 0
    if land_cover is None:
        f.ground[:] = np.nan
    _refuse(reasons, judged & (reasons == 0) & ~is_site(p, settings.p_safe), Hazard.DOUBT)
    return HazardMap(
        grid=elevation.grid, slope=slope, roughness=roughness, step=step,
        clearance=clearance_of(reasons == 0, on.cell), p_safe=p, p_relief=f.relief, p_obstacle=f.obstacle,
        p_ground=f.ground, p_wires=p_wires, resolved=f.resolved, settles_at=settles_at, quality=quality,
        reasons=reasons, wires=tuple(wires),
    )  # fmt: skip
