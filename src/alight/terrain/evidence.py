"""Evidence for the land cover from the map itself: shape, matching, detail (docs/method/land-cover.md, T1, T1b).

No absolute colour is used, so this evidence is valid where the pictures are unlike all training data. Widths are in
metres, so that ground seen from near and far is comparable. Exposure and white balance cancel. Detail that the pixels
do not resolve is weak. The appearance model can only add refusals to this evidence.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain, pairwise

import numpy as np

from alight.arrays import F32
from alight.learned.terms import BAND_LIMITS, FRAME_TERMS, RELATIVE, PictureTerm, SurfaceTerm, band
from alight.raster import (
    block_light,
    block_mean,
    difference_of_gaussians,
    gaussian_mean,
    gradient,
    linear_ramp,
    local_max,
    log_at_least,
    log_levels,
    log_offset,
    nearest_known,
)
from alight.records import REFUSED, ElevationMap, Flag, is_flagged, is_measured
from alight.terrain.appearance import Appearance, seen
from alight.terrain.relief import Relief

Terms = Iterator[tuple[str, F32]]  # features one by one, (R, C) each: all of them at once would take gigabytes

NEAR, WIDE = 0.4, 2.0  # metres, 1-sigma of the mean of the strength of detail; NEAR is also the search radius of spots
REACH = 0.5  # metres, radius of local maxima and minima of the heights
OF_MATCHING = frozenset(  # unknown for surveyed heights
    (SurfaceTerm.RESIDUAL, SurfaceTerm.RESIDUAL_2M, SurfaceTerm.SIGMA, SurfaceTerm.MOVING, SurfaceTerm.MOVING_2M,
     SurfaceTerm.UNSURE, SurfaceTerm.REFUSED_2M, SurfaceTerm.TEXTURELESS, SurfaceTerm.SATURATED)
)  # fmt: skip


def plants(colours: Appearance, shape: Relief, moving: F32) -> F32:
    """Compute the score of tall plants (G16), (R, C); `moving`: (R, C) share of nearby cells that move."""
    texture = linear_ramp(colours.texture, 0.055, 0.09)
    high = np.maximum(linear_ramp(shape.height_above, 0.15, 0.5), linear_ramp(shape.rough, 0.04, 0.10))
    tone = linear_ramp(colours.green, 0.06, 0.14) * np.float32(colours.coloured)
    return np.asarray(3.5 * texture + 3.0 * high + 2.0 * tone + 2.0 * moving - 5.0, np.float32)


def land_cover_terms(elevation: ElevationMap, colours: Appearance, shape: Relief) -> Terms:
    """Yield the identifier and the values of each feature of every cell (T1)."""
    known, matched = seen(elevation), np.isfinite(elevation.residual).any()
    for name, values in chain(_surface_terms(elevation, colours, shape), _picture_terms(elevation)):
        if name in OF_MATCHING and not matched:
            values = np.full_like(values, np.nan)
        yield name, values
        if name in FRAME_TERMS:
            some = values[::4, ::4][known[::4, ::4]]
            usual = np.float32(np.median(some)) if some.size else np.float32(0)
            yield name + RELATIVE, values - usual


def _strength(power: F32, cell: float, metres: float = NEAR) -> F32:
    near = np.maximum(gaussian_mean(power, metres / cell), 0)
    return np.asarray(np.log(np.sqrt(near) + np.float32(0.003)), np.float32)


def _picture_terms(elevation: ElevationMap) -> Terms:
    """Yield the identifier and the values of each feature of the finest picture's detail (T1b)."""
    rgb, factor = elevation.finest
    cell, halves = elevation.grid.cell, elevation.pixels_a_cell(BAND_LIMITS[0])
    light, share, within = block_light(rgb, factor // halves, within=True)
    yield PictureTerm.BELOW, _strength(block_mean(within, halves), cell)  # detail finer than all bands
    pixel = cell / halves
    light = _filled(light, share, 1.0 / pixel)
    del share, within  # arrays as fine as the picture are large
    spot = block_mean(_between(light, 0.07, 0.35, pixel), halves)
    reach = max(1, round(NEAR / cell))
    yield PictureTerm.DARK, local_max(-spot, reach)
    yield PictureTerm.BRIGHT, local_max(spot, reach)
    smooth = (gaussian_mean(light, s / pixel) if s / pixel > 0.3 else light for s in BAND_LIMITS)
    for k, (one, wider) in enumerate(pairwise(smooth)):
        yield band(k), _strength(block_mean((one - wider) ** 2, halves), cell)
    coarse = block_mean(light, halves)
    del light
    yield PictureTerm.LOCAL, _between(coarse, 0.15, 0.8, cell)
    yield PictureTerm.BROAD, _between(coarse, 0.8, 3.2, cell)
    r, g, b = (log_levels(elevation.rgb[..., k]) for k in range(3))
    tint = _between(r - g, 0.1, 0.8, cell) ** 2 + _between(b - g, 0.1, 0.8, cell) ** 2
    yield PictureTerm.TINT, _strength(tint, cell)
    yield PictureTerm.TINT_2M, _strength(tint, cell, WIDE)


def _filled(light: F32, share: F32, sigma: float) -> F32:
    """Fill unseen pixels of log brightness by a Gaussian of `sigma` px; `share`: seen share of each pixel."""
    if share.min() > 0.999:
        return light
    about = np.maximum(gaussian_mean(share, sigma), np.float32(1e-3))
    around = gaussian_mean(np.where(share > 0, light, np.float32(0)), sigma) / about
    return np.where(share > 0.999, light, around)


def _between(values: F32, narrow: float, wide: float, pixel: float) -> F32:
    """Return the detail of values (R, C) between two 1-sigma widths; `pixel`: side of a pixel; all in metres."""
    return difference_of_gaussians(values, narrow / pixel, wide / pixel)


def _surface_terms(elevation: ElevationMap, colours: Appearance, shape: Relief) -> Terms:
    cell = elevation.grid.cell
    height = nearest_known(elevation.height, np.isfinite(elevation.height))
    height = np.nan_to_num(height - np.float32(np.nanmedian(height)) if np.isfinite(height).any() else height)
    means = {s: gaussian_mean(height, s / cell) for s in (0.2, 0.5, 1.0, 1.5, 4.0)}

    def near(values: F32, metres: float) -> F32:
        return gaussian_mean(np.nan_to_num(values), metres / cell)

    def rough(metres: float) -> F32:
        off = height - means[metres]
        return log_offset(np.sqrt(np.maximum(near(off * off, NEAR), 0)), 0.005)

    def flagged(bits: Flag, metres: float) -> F32:
        return near(is_flagged(elevation.flags, bits).astype(np.float32), metres)

    standing = np.where(is_measured(elevation.flags), elevation.height - shape.ground, np.float32(0))
    restless, residual = Flag.MOVING | Flag.INCONSISTENT, np.nan_to_num(elevation.residual)
    reach = max(1, round(REACH / cell))
    north, east = gradient(means[0.5] / np.float32(cell))
    local = means[0.2] - means[1.0]
    yield SurfaceTerm.ROUGH_02, rough(0.2)
    yield SurfaceTerm.ROUGH_05, rough(0.5)
    yield SurfaceTerm.ROUGH_15, rough(1.5)
    yield SurfaceTerm.HEIGHT_ABOVE_GROUND, np.nan_to_num(shape.height_above).clip(-1, 6)
    yield SurfaceTerm.HEIGHT_ABOVE_BED, near(standing, 0.3).clip(-2, 8)
    yield SurfaceTerm.HEIGHT_LOCAL, _squashed(local)
    yield SurfaceTerm.HEIGHT_BROAD, _squashed(means[1.0] - means[4.0])
    yield SurfaceTerm.HIGHEST_NEAR, _squashed(local_max(local, reach))
    yield SurfaceTerm.LOWEST_NEAR, _squashed(local_max(-local, reach))
    yield SurfaceTerm.STEEP, np.asarray(np.log(np.hypot(north, east) + np.float32(0.02)), np.float32)
    yield SurfaceTerm.RESIDUAL, log_offset(near(residual, 0.5), 0.02)
    yield SurfaceTerm.RESIDUAL_2M, log_offset(near(residual, WIDE), 0.02)
    yield SurfaceTerm.SIGMA, log_offset(near(elevation.sigma, 0.5), 0.005)
    moving = flagged(restless, 0.3)
    yield SurfaceTerm.MOVING, moving
    yield SurfaceTerm.MOVING_2M, flagged(restless, WIDE)
    yield SurfaceTerm.UNSURE, flagged(Flag.UNSURE, 0.5)
    yield SurfaceTerm.REFUSED_2M, flagged(REFUSED, WIDE)
    yield SurfaceTerm.TEXTURELESS, flagged(Flag.TEXTURE, 0.5)
    yield SurfaceTerm.SATURATED, flagged(Flag.SATURATED, 0.5)
    yield SurfaceTerm.PLANTS, plants(colours, shape, moving)
    yield SurfaceTerm.SAMPLING, _log_ratio(elevation.sampling, 0.1)  # relative to usual widths, metres
    yield SurfaceTerm.PIXEL, _log_ratio(elevation.picture_sampling, 0.05)


def _log_ratio(values: F32, usual: float) -> F32:
    return log_at_least(np.where(np.isfinite(values), values / np.float32(usual), np.float32(1)), 1e-3)


def _squashed(metres: F32) -> F32:
    return np.asarray(np.arcsinh(metres / np.float32(0.03)), np.float32)
