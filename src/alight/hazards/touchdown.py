"""Measure a touchdown at every cell: the ground under the lander and beside it (docs/method/hazards.md, G0 to G6a)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from alight.arrays import F32, I64, Mask
from alight.hazards import footprint_kernels as kernels
from alight.raster import (
    LEAST_SHARE,
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

ROUNDING = 1e-4  # of a share, or of a number of cells
CERTAIN = np.float32(40.0)  # sigmas; a limit is kept, or broken, for sure
NO_NOISE = 1e-9  # metres, or rad; a smaller sigma is none


@dataclass(frozen=True, eq=False)
class Footprint:
    """The ground under the footprint disc about every cell, all (R, C) float32."""

    unknown: F32  # share of the footprint that is unknown
    level: F32  # metres, the plane at the centre
    grad_c: F32  # metres a column
    grad_r: F32  # metres a row
    slope: F32  # rad
    roughness: F32  # metres, largest deviation (G2)
    rise: F32  # metres, the highest ground over the plane
    scatter: F32  # metres, 1-sigma of the deviations
    count: F32  # known cells


def footprint_of(height: F32, radius: float, cell: float) -> Footprint:
    """Lay the least-squares plane of the footprint about every cell (G1, G2)."""
    spans = disc_spans(radius / cell)
    reach = spans.size // 2
    count, level, grad_c, grad_r, squares = _planes(height, spans)
    rise, dip = np.empty_like(height), np.empty_like(height)
    padded = np.pad(height, ((0, 0), (reach, reach)), constant_values=np.nan)
    kernels.deviations(padded, level, grad_c, grad_r, spans, rise, dip)
    judged = np.isfinite(level)
    slope = np.arctan(np.hypot(grad_c, grad_r) / np.float32(cell))
    scatter = np.sqrt(squares / np.maximum(count - 3, 1))
    unknown = 1 - count / np.float32(disc_mask(spans).sum())
    nan = np.float32(np.nan)
    rough, rise, scatter = (np.where(judged, a, nan) for a in (np.maximum(rise, -dip), rise, scatter))
    return Footprint(unknown, level, grad_c, grad_r, slope, rough, rise, scatter, count)


def _planes(height: F32, spans: I64, strip: int = 512) -> list[F32]:
    """Known cells, the plane's level and rise per column and per row, and the squared deviations from it; (R, C) each.

    By strips of rows, as the running sums take twelve times the memory of the heights.
    """
    rows, cols = height.shape
    reach, out = spans.size // 2, [np.empty_like(height) for _ in range(5)]
    for top in range(0, rows, strip):
        first, bottom = max(top - reach, 0), min(top + strip, rows)
        part = np.ascontiguousarray(height[first : bottom + reach])
        sums, found = np.empty((len(part), 6, cols + 1 + 2 * reach)), [np.empty_like(part) for _ in out]
        kernels.row_sums(part, reach, sums)
        kernels.fit_planes(sums, spans, *found)
        for whole, some in zip(out, found, strict=True):
            whole[top:bottom] = some[top - first : bottom - first]
    return out


def step_of(height: F32, radius: float, cell: float) -> F32:
    """Largest height difference between neighbouring known cells in the footprint, metres; NaN where none is known."""
    step = np.empty_like(height)
    kernels.neighbour_steps(height, step)
    disc = disc_mask(disc_spans(radius / cell))
    worst = cv2.dilate(
        np.where(np.isnan(step), np.float32(-1), step), disc, borderType=cv2.BORDER_CONSTANT, borderValue=-1
    )
    return np.where(worst >= 0, worst, np.float32(np.nan))


@dataclass(frozen=True, eq=False)
class Inputs:
    """The map to assess, and for whom."""

    elevation: ElevationMap
    land_cover: TerrainMap | None  # None: not known
    lander: Lander
    settings: HazardsSettings

    @property
    def cell(self) -> float:
        """Cell size, metres."""
        return self.elevation.grid.cell

    @property
    def common_tilt(self) -> float:
        """1-sigma of the tilt that all cells share, rad: from the poses of the map, and the user's setting besides."""
        poses = 0.0 if self.elevation.datum is None else self.elevation.datum.tilt_sigma
        return float(np.hypot(poses, self.settings.tilt_sigma))


@dataclass(frozen=True, eq=False)
class Touchdowns:
    """A touchdown centred on every cell, (R, C) each."""

    footprint: Footprint
    sigma: F32  # metres, root mean square of the heights under the lander
    slope: F32  # rad, of the footprint, or the worst tilt of feet or skids
    rise: F32 | None  # metres, of the ground under the belly above the worst contact plane; None: not judged
    rotor: F32 | None  # sigmas, the least margin of the ground beside the footprint below the rotors; None: none there
    step: F32  # metres
    smooth_roughness: F32  # metres, largest deviation of heights smoothed by 0.2 m: less noise
    trend_roughness: F32  # metres, of heights smoothed by 0.45 m: bends of the ground, no noise
    measured: F32  # metres, the measured heights of the cells, doubtful ones as well
    measured_roughness: F32  # metres, largest deviation of these
    unmeasured: F32  # share of the footprint without any
    edge: Mask  # the footprint, gear or rotors leave the map
    unknown: Mask
    blocked: Mask  # the ground reaches into the belly's or the rotor's clearance
    vetoed: Mask  # the land cover may not be landed on, or rises into the rotors


def measure(on: Inputs) -> Touchdowns:
    """Measure a touchdown centred on every cell."""
    e, lander, settings, cell = on.elevation, on.lander, on.settings, on.cell
    height, measured = (of(e, lander, settings) for of in (usable_height, measured_height))
    footprint, beyond = footprint_of(height, lander.radius, cell), lander.ground_reach > lander.radius
    if beyond:  # gear stands on the noise beside the footprint
        footprint = replace(footprint, scatter=footprint_of(height, lander.ground_reach, cell).scatter)
    variance = np.where(np.isfinite(height), e.sigma**2, np.float32(np.nan))
    sigma = np.sqrt(disc_mean(variance, lander.ground_reach, cell))
    edge, unknown = _edge_and_unknown(height, footprint, on)
    rotor, vetoed = _rotor(height, footprint, on), _vetoed(height, on)
    slope, rise, blocked = footprint.slope, None, np.zeros_like(edge) if rotor is None else rotor < 0
    if lander.has_gear:
        from alight.hazards.gear import gear_contact, is_coarse

        known = sigma[np.isfinite(sigma)]
        exact = 5.0 * float(np.quantile(known, 0.9)) if known.size else 0.0  # 5 sigma about the belly's clearance
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
    """Largest deviation of heights smoothed by `length`, metres; on wider cells if that and the radius allow it."""
    smooth = smoothed_height(height, cell, length)
    if length / cell + ROUNDING < 2 or radius < 4 * cell:  # a smaller footprint holds too few blocks for a plane
        return footprint_of(smooth, radius, cell).roughness
    wide = block_quantile(smooth, 2, 0.5)
    return upsample(footprint_of(wide, radius, 2 * cell).roughness, 2, height.shape)


def _edge_and_unknown(height: F32, footprint: Footprint, on: Inputs) -> tuple[Mask, Mask]:
    """Touchdowns that leave the map, and those with too much unseen ground or too many doubtful heights (G6a)."""
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
    """Share of the ring between two radii (metres) about every cell where the mask holds; 0 where it has no cells."""
    spans = disc_spans(outer / cell)
    ring = disc_mask(spans) - disc_mask(padded_spans(disc_spans(inner / cell), spans.size // 2))
    kernel = ring.astype(np.float32) / max(float(ring.sum()), 1.0)
    share = cv2.filter2D(mask.astype(np.float32), cv2.CV_32F, kernel, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(share, np.float32)


def padded_spans(spans: I64, reach: int) -> I64:
    """Spans of a disc padded with -1 to the rows of a larger one, so that both fit the same loops."""
    return np.pad(spans, reach - spans.size // 2, constant_values=-1)


def _vetoed(height: F32, on: Inputs) -> Mask:
    """Touchdowns on land cover that may not be landed on, or beside what rises into the rotors; (R, C).

    A cell without a class is not refused.
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
    """Margin of the ground beside every footprint below the rotors, (R, C) sigmas; None: they lie within it."""
    e, lander = on.elevation, on.lander
    if lander.rotor_radius is None or lander.rotor_radius <= lander.radius:
        return None
    tops = np.where(np.isfinite(height), height, _supported(e, height))
    most = np.float32(0.5 * lander.rotor_rise)  # largest sigma that a doubtful height counts with
    return rotor_margin(tops, np.where(e.trusted, e.sigma, np.fmin(e.sigma, most)), footprint, lander, on.cell)


def rotor_margin(height: F32, sigma: F32, footprint: Footprint, lander: Lander, cell: float) -> F32:
    """Least margin below the rotor between the footprint's rim and its own, (R, C) in sigmas of the heights (G6, G8c).

    The ground under the rotor may rise above the footprint's plane by at most `rotor_rise`; NaN is unknown ground.
    """
    assert lander.rotor_radius is not None
    outer = disc_spans(lander.rotor_radius / cell)
    inner = padded_spans(disc_spans(lander.radius / cell), outer.size // 2)
    margin, weight = np.empty_like(height), 1 / np.fmax(sigma, np.float32(NO_NOISE))
    limit = footprint.level + np.float32(lander.rotor_rise)
    kernels.least_margin(height, weight, limit, footprint.grad_c, footprint.grad_r, inner, outer, margin)
    return margin.clip(-CERTAIN, CERTAIN)


def _supported(elevation: ElevationMap, height: F32) -> F32:
    """Measured heights (R, C), opened by a square (erosion, then dilation); metres on the level of `height`.

    A single doubtful height is a wrong match. Several as high in a square of 0.15 m are an object. NaN where not all
    are known.
    """
    side, at = max(2, round(0.15 / elevation.grid.cell)), int(np.isfinite(height).argmax())
    level = elevation.height.flat[at] - height.flat[at]
    tops = np.where(is_measured(elevation.flags), elevation.height - level, np.float32(np.nan))
    square = np.ones((side, side), np.uint8)
    low = cv2.erode(np.where(np.isfinite(tops), tops, np.float32(-np.inf)), square, anchor=(0, 0))
    opened = cv2.dilate(low, square, anchor=(side - 1, side - 1))
    return np.where(np.isfinite(opened), opened, np.float32(np.nan)).astype(np.float32)


def _about(height: F32, known: Mask, sigma: float) -> F32:
    """Gaussian mean of the known heights about every cell, NaN where none is near; `sigma` in cells."""
    near = weighted_gaussian(height, known.astype(np.float32), sigma)
    return np.where(near.share > LEAST_SHARE, near.mean, np.float32(np.nan))


def usable_height(elevation: ElevationMap, lander: Lander, settings: HazardsSettings) -> F32:
    """Usable heights, about their own median (float32 keeps its digits there), NaN elsewhere (G0).

    These are the trusted heights, and doubtful ones in gaps narrower than twice `settings.bridge` that agree with the
    trusted ones beside them to half the height that the lander stands: an ambiguous match that lies on the ground
    around it. On the rendered sample flight 0.15 m finds a quarter more of the safe ground at the same false-safe rate;
    0.25 m quadruples that rate (a tree crown matched at ground level is let in).
    """
    known = elevation.trusted
    if not known.any():
        return np.full(elevation.grid.shape, np.nan, dtype=np.float32)
    height = elevation.height - np.float32(np.median(elevation.height[known]))
    flags = elevation.flags
    usable = np.isfinite(height) & ~is_flagged(flags, Flag.UNSEEN | Flag.MOVING | Flag.RANGE)  # these cannot be right
    plain = is_flagged(flags, Flag.TEXTURE | Flag.SATURATED)  # an obstacle would stand out against it
    for reach, where in (
        (settings.bridge, usable & ~is_flagged(flags, Flag.SATURATED)),
        (settings.bridge_plain, usable & plain),
    ):
        cells = reach / elevation.grid.cell
        if cells >= 1:
            gap = close_mask(known, int(cells + 1e-6)) & ~known & where
            known = known | (gap & (np.abs(height - _about(height, known, cells)) <= 0.5 * lander.tallest_obstacle))
    return np.where(known, height, np.float32(np.nan))


def measured_height(elevation: ElevationMap, lander: Lander, settings: HazardsSettings) -> F32:
    """Measured heights (R, C), doubtful ones as well, as evidence of obstacles, metres (G7f).

    A vague one counts in full where it stands out by several of its sigmas from the trusted ground within 0.5 m; else
    it is lowered by one sigma towards that ground, and counts as not measured, NaN, within one sigma.
    """
    vague = elevation.sigma > np.float32(settings.vague * lander.tallest_obstacle)
    known = elevation.trusted
    if not vague.any() or not known.any():
        return np.where(vague, np.float32(np.nan), elevation.height)
    middle = np.float32(np.median(elevation.height[known]))
    about = _about(elevation.height - middle, known, 0.5 / elevation.grid.cell) + middle
    off = elevation.height - about
    vague &= ~(np.abs(off) > np.float32(settings.stands_out) * elevation.sigma)
    above = np.abs(off) - elevation.sigma
    least = np.where(above > 0, about + np.copysign(above, off), np.float32(np.nan))
    return np.where(vague, least, elevation.height)


def smoothed_height(height: F32, cell: float, sigma: float) -> F32:
    """Heights (R, C) smoothed by `sigma` metres, NaN where unknown: their largest deviation is less noise."""
    known = np.isfinite(height)
    mean = weighted_gaussian(height, known.astype(np.float32), max(sigma / cell, 0.3)).mean
    return np.where(known, mean, np.float32(np.nan))
