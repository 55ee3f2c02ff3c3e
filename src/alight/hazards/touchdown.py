"""Measure a touchdown at every cell: ground under and beside the lander (docs/method/hazards.md, G0 to G6a)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from alight.arrays import F32, U8, Mask
from alight.hazards import footprint_kernels as kernels
from alight.raster import (
    block_quantile,
    close_mask,
    disc_any,
    disc_crosses_edge,
    disc_mask,
    disc_mean,
    disc_share,
    disc_spans,
    upsample,
    weighted_gaussian,
)
from alight.records import ElevationMap, Flag, Terrain, TerrainMap, is_flagged, is_measured
from alight.settings import HazardsSettings, Lander

ROUNDING = 1e-4  # tolerance of a share, or of a number of cells


@dataclass(frozen=True, eq=False)
class Footprint:
    """Ground under the footprint disc around every cell, (R, C) float32 arrays."""

    unknown: F32  # share of the footprint that is unknown
    level: F32  # metres, height of the plane at the centre
    grad_c: F32  # metres per column
    grad_r: F32  # metres per row
    slope: F32  # rad
    roughness: F32  # metres, largest deviation (G2)
    rise: F32  # metres, highest ground above the plane
    scatter: F32  # metres, 1-sigma of the deviations from the plane
    count: F32  # number of known cells


def footprint_of(height: F32, radius: float, cell: float) -> Footprint:
    """Fit the least-squares plane of the footprint around every cell (G1, G2); `height`, `radius`, `cell`: metres."""
    spans = disc_spans(radius / cell)
    reach = spans.size // 2
    planes = np.empty((5, *height.shape), np.float32)
    kernels.fit_planes(np.ascontiguousarray(height), spans, planes)
    count, level, grad_c, grad_r, squares = planes
    rise, dip = np.zeros_like(height), np.zeros_like(height)
    kernels.deviations(np.pad(height, ((0, 0), (reach, reach)), constant_values=np.nan), planes, spans, rise, dip)
    judged = np.isfinite(level)
    slope = np.arctan(np.hypot(grad_c, grad_r) / np.float32(cell))
    scatter = np.sqrt(squares / np.maximum(count - 3, 1))
    unknown = 1 - count / np.float32(disc_mask(spans).sum())
    nan = np.float32(np.nan)
    rough, rise, scatter = (np.where(judged, a, nan) for a in (np.maximum(rise, -dip), rise, scatter))
    return Footprint(unknown, level, grad_c, grad_r, slope, rough, rise, scatter, count)


def step_of(height: F32, radius: float, cell: float) -> F32:
    """Compute the largest height difference between neighbouring cells in the footprint, metres; NaN if unknown."""
    cross = np.asarray(cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3)), np.uint8)
    up = cv2.dilate(np.fmax(height, np.float32(-np.inf)), cross) - height
    down = height - cv2.erode(np.fmin(height, np.float32(np.inf)), cross)
    worst = cv2.dilate(np.fmax(np.maximum(up, down), np.float32(-1)), disc_mask(disc_spans(radius / cell)))
    return np.where(worst >= 0, worst, np.float32(np.nan))


@dataclass(frozen=True, eq=False)
class Inputs:
    """Map to assess, lander and settings."""

    elevation: ElevationMap
    land_cover: TerrainMap | None  # None: unknown
    lander: Lander
    settings: HazardsSettings

    @property
    def cell(self) -> float:
        """Cell size, metres."""
        return self.elevation.grid.cell

    @property
    def common_tilt(self) -> float:
        """1-sigma of the tilt common to all cells, rad: from the map's poses and from the user's setting."""
        poses = 0.0 if self.elevation.datum is None else self.elevation.datum.tilt_sigma
        return float(np.hypot(poses, self.settings.tilt_sigma))


@dataclass(frozen=True, eq=False)
class Touchdowns:
    """Measurements of a touchdown centred on every cell, (R, C) arrays."""

    footprint: Footprint
    sigma: F32  # metres, root mean square sigma of the heights under the lander
    slope: F32  # rad, slope of the footprint, or worst tilt of feet or skids
    rise: F32 | None  # metres, ground under the belly above the worst contact plane; None: not judged
    rotor: F32 | None  # sigmas, least margin below rotors beyond the footprint; None: no rotors reach there
    step: F32  # metres, largest step in the footprint
    smooth_roughness: F32  # metres, largest deviation of heights smoothed by 0.2 m, to reduce noise
    trend_roughness: F32  # metres, largest deviation of heights smoothed by 0.45 m: curvature of the ground
    measured: F32  # metres, all measured heights, doubtful ones included
    measured_roughness: F32  # metres, largest deviation of the measured heights
    unmeasured: F32  # share of the footprint without a measured height
    edge: Mask  # footprint, gear or rotors leave the map
    unknown: Mask
    blocked: Mask  # the ground reaches into the clearance of the belly or rotors
    vetoed: Mask  # the land cover is not landable, or rises into the rotors


def measure(on: Inputs) -> Touchdowns:
    """Measure slope, roughness, clearances and vetoes of a touchdown centred on every cell."""
    e, lander, settings, cell = on.elevation, on.lander, on.settings, on.cell
    height, measured = (of(e, lander, settings) for of in (usable_height, measured_height))
    footprint, beyond = footprint_of(height, lander.radius, cell), lander.ground_reach > lander.radius
    if beyond:  # the gear also rests on noisy heights beside the footprint
        footprint = replace(footprint, scatter=footprint_of(height, lander.ground_reach, cell).scatter)
    variance = np.where(np.isfinite(height), e.sigma**2, np.float32(np.nan))
    sigma = np.sqrt(disc_mean(variance, lander.ground_reach, cell))
    edge, unknown = _edge_and_unknown(height, footprint, on)
    rotor, vetoed = _rotor(height, footprint, on), _vetoed(height, on)
    slope, rise, blocked = footprint.slope, None, np.zeros_like(edge) if rotor is None else rotor < 0
    if lander.has_gear:
        from alight.hazards.gear import gear_contact, is_coarse

        known = sigma[np.isfinite(sigma)]
        exact = 5.0 * float(np.quantile(known, 0.9)) if known.size else 0.0  # 5 sigma around the belly's clearance
        slope, above = gear_contact(height, footprint, edge | unknown, lander, cell, exact)
        unknown |= np.isnan(slope) & ~edge
        if lander.belly_clearance is not None:
            rise = above
            blocked |= above > lander.belly_clearance
        slope = np.maximum(slope, footprint.slope) if is_coarse(lander, cell) else slope
    smooth = trend = footprint.roughness
    every = footprint
    if settings.smoothed:
        smooth, trend = (
            smoothed_roughness(height, lander.radius, cell, s) for s in (settings.even_length, settings.broad_length)
        )
        every = footprint_of(measured, lander.radius, cell)
    return Touchdowns(
        footprint, sigma, slope, rise, rotor, step_of(height, lander.radius, cell), smooth, trend, measured,
        every.roughness, every.unknown, edge, unknown, blocked, vetoed,
    )  # fmt: skip


def smoothed_roughness(height: F32, radius: float, cell: float, length: float) -> F32:
    """Smooth heights by `length` (1-sigma) and compute the largest deviation from their plane, (R, C); all in metres.

    Cells of twice the size are used if `length` and `radius` are wide enough.
    """
    known = np.isfinite(height)
    mean = weighted_gaussian(height, known.astype(np.float32), max(length / cell, 0.3)).mean
    smooth = np.where(known, mean, np.float32(np.nan))
    if length / cell + ROUNDING < 2 or radius < 4 * cell:  # a smaller footprint has too few blocks for a plane
        return footprint_of(smooth, radius, cell).roughness
    wide = block_quantile(smooth, 2, 0.5)
    return upsample(footprint_of(wide, radius, 2 * cell).roughness, 2, height.shape)


def _edge_and_unknown(height: F32, footprint: Footprint, on: Inputs) -> tuple[Mask, Mask]:
    """Return two masks of touchdowns: those that leave the map, and those with too much unknown ground (G6a)."""
    lander, settings, cell, radius = on.lander, on.settings, on.cell, on.lander.radius
    unseen = np.isnan(on.elevation.height) | is_flagged(on.elevation.flags, Flag.UNSEEN)
    no_height = np.isnan(height)
    doubtful = settings.doubtful_share if settings.smoothed else settings.unknown_share
    edge = disc_crosses_edge(height.shape, radius, cell)
    unknown = np.isnan(footprint.level) | (footprint.unknown > doubtful) | (unseen if settings.smoothed else no_height)
    unknown |= disc_share(unseen, radius, cell) > settings.unknown_share + ROUNDING
    for reach in {lander.ground_reach, lander.reach} - {radius}:
        edge |= disc_crosses_edge(height.shape, reach, cell)
        for mask, most in ((unseen, settings.unknown_share), (no_height, doubtful)):
            unknown |= ring_share(mask, radius, reach, cell) > most + ROUNDING
    return edge, unknown


def ring_share(mask: Mask, inner: float, outer: float, cell: float) -> F32:
    """Compute the share of True cells of a mask in the ring between two radii around every cell; lengths in metres."""
    ring = _ring(inner, outer, cell)
    kernel = ring.astype(np.float32) / max(float(ring.sum()), 1.0)
    share = cv2.filter2D(mask.astype(np.float32), cv2.CV_32F, kernel, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(share, np.float32)


def _ring(inner: float, outer: float, cell: float) -> U8:
    """Return the disc of radius `outer` without that of radius `inner`, (2 n + 1, 2 n + 1) ones and zeros."""
    wide, narrow = (disc_mask(disc_spans(radius / cell)) for radius in (outer, inner))
    return wide - np.pad(narrow, (len(wide) - len(narrow)) // 2)


def _vetoed(height: F32, on: Inputs) -> Mask:
    """Return the mask, (R, C), of touchdowns vetoed by land cover under the gear or in reach of the rotors.

    `height`: (R, C) usable heights, NaN elsewhere. Tall vegetation vetoes rotors only where it is NaN. Cells without a
    class veto nothing.
    """
    cover, lander, cell = on.land_cover, on.lander, on.cell
    if cover is None:
        return np.zeros(height.shape, np.bool_)
    vetoed = disc_any(cover.landable < on.settings.min_landable, lander.ground_reach, cell)
    if lander.rotor_radius is not None and lander.rotor_radius > lander.radius:
        plants = (cover.label == Terrain.TALL_VEGETATION) & np.isnan(height)
        standing = plants | np.isin(cover.label, (Terrain.TREE, Terrain.STRUCTURE))
        vetoed |= disc_any(standing, lander.rotor_radius, cell)
    return vetoed


def _rotor(height: F32, footprint: Footprint, on: Inputs) -> F32 | None:
    """Return the least margin below rotors beyond the footprint, (R, C) sigmas; None: no rotors reach there."""
    e, lander = on.elevation, on.lander
    if lander.rotor_radius is None or lander.rotor_radius <= lander.radius:
        return None
    tops = np.where(np.isfinite(height), height, _supported(e, height))
    most = np.float32(0.5 * lander.rotor_rise)  # largest sigma used for a doubtful height
    return rotor_margin(tops, np.where(e.trusted, e.sigma, np.fmin(e.sigma, most)), footprint, lander, on.cell)


def rotor_margin(height: F32, sigma: F32, footprint: Footprint, lander: Lander, cell: float) -> F32:
    """Compute the least margin below the rotors outside the footprint, (R, C) in sigmas of the heights (G6, G8c).

    The ground under the rotors may rise above the footprint's plane by at most `rotor_rise`. NaN heights are unknown.
    """
    assert lander.rotor_radius is not None
    ring = _ring(lander.radius, lander.rotor_radius, cell)
    pad, weight = len(ring) // 2, 1 / np.fmax(sigma, np.finfo(np.float32).tiny)
    limit, margin = footprint.level + np.float32(lander.rotor_rise), np.full_like(height, np.inf)
    about = (np.pad(a, pad, constant_values=np.nan) for a in (height, weight))
    kernels.lower_to_margins(*about, np.argwhere(ring) - pad, limit, footprint.grad_c, footprint.grad_r, margin)
    return margin


def _supported(elevation: ElevationMap, height: F32) -> F32:
    """Remove peaks narrower than 0.15 m from the measured heights, (R, C) metres above the zero of `height`.

    A single high doubtful height is a wrong match. A square of 0.15 m with equally high heights is an object. NaN where
    some heights are unknown.
    """
    side, at = max(2, round(0.15 / elevation.grid.cell)), int(np.isfinite(height).argmax())
    level = elevation.height.flat[at] - height.flat[at]
    tops = np.where(is_measured(elevation.flags), elevation.height - level, np.float32(np.nan))
    square = np.ones((side, side), np.uint8)
    low = cv2.erode(np.where(np.isfinite(tops), tops, np.float32(-np.inf)), square, anchor=(0, 0))
    opened = cv2.dilate(low, square, anchor=(side - 1, side - 1))
    return np.where(np.isfinite(opened), opened, np.float32(np.nan)).astype(np.float32)


def usable_height(elevation: ElevationMap, lander: Lander, settings: HazardsSettings) -> F32:
    """Return the usable heights relative to their median, which keeps float32 digits; NaN elsewhere (G0).

    Trusted heights are usable. So are doubtful heights in gaps narrower than twice `settings.bridge` that agree with
    the trusted heights around them to within half the height of the tallest obstacle. Such heights are ambiguous
    matches at the level of the surrounding ground.
    """
    known = elevation.trusted
    if not known.any():
        return np.full(elevation.grid.shape, np.nan, dtype=np.float32)
    height = elevation.height - np.float32(np.median(elevation.height[known]))
    flags = elevation.flags
    usable = np.isfinite(height) & ~is_flagged(flags, Flag.UNSEEN | Flag.MOVING | Flag.RANGE)  # flags of wrong heights
    plain = is_flagged(flags, Flag.TEXTURE | Flag.SATURATED)  # an obstacle would be visible on plain ground
    for reach, where in (
        (settings.bridge, usable & ~is_flagged(flags, Flag.SATURATED)),
        (settings.bridge_plain, usable & plain),
    ):
        cells = reach / elevation.grid.cell
        if cells >= 1:
            gap = close_mask(known, int(cells + 1e-6)) & ~known & where
            about = weighted_gaussian(height, known.astype(np.float32), cells).where_near
            known = known | (gap & (np.abs(height - about) <= 0.5 * lander.tallest_obstacle))
    return np.where(known, height, np.float32(np.nan))


def measured_height(elevation: ElevationMap, lander: Lander, settings: HazardsSettings) -> F32:
    """Return the measured heights, (R, C) metres, doubtful ones included, as evidence of obstacles (G7f).

    A height with a large sigma is kept if it differs by several sigmas from the trusted ground within 0.5 m. Otherwise
    it is moved by one sigma towards that ground, or set to NaN if it lies within one sigma of it.
    """
    vague = elevation.sigma > np.float32(settings.vague * lander.tallest_obstacle)
    known = elevation.trusted
    if not vague.any() or not known.any():
        return np.where(vague, np.float32(np.nan), elevation.height)
    middle = np.float32(np.median(elevation.height[known]))
    near = weighted_gaussian(elevation.height - middle, known.astype(np.float32), 0.5 / elevation.grid.cell)
    about = near.where_near + middle
    off = elevation.height - about
    vague &= ~(np.abs(off) > np.float32(settings.surely_sigmas) * elevation.sigma)
    above = np.abs(off) - elevation.sigma
    least = np.where(above > 0, about + np.copysign(above, off), np.float32(np.nan))
    return np.where(vague, least, elevation.height)
