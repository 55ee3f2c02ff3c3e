"""Evidence for the land cover from the map itself: shape, matching and texture (docs/method/land-cover.md, T1).

No absolute colour and no library: this evidence holds where the pictures are unlike all known ground. The model of
appearance may only add refusals to it. Widths are in metres, so that ground seen from far and from near compares.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain

import numpy as np

from alight.arrays import F32
from alight.learned.terms import FRAME_TERMS, RELATIVE, PictureTerm, SurfaceTerm, band
from alight.raster import gaussian_mean, gradient, linear_ramp, local_max, log_at_least, log_offset, nearest_known
from alight.records import REFUSED, ElevationMap, Flag, is_measured
from alight.terrain.appearance import Appearance, seen
from alight.terrain.picture_bands import picture_bands
from alight.terrain.relief import Relief

NEAR, WIDE = 0.4, 2.0  # metres, 1-sigma over which the strength of detail is gathered
REACH = 0.5  # metres, radius of local maxima and minima
BUMP = np.float32(0.03)  # metres, scale of the arsinh of heights
FLOOR = np.float32(0.003)  # log brightness, added before the logarithm of a strength
USUAL_SAMPLING, USUAL_PIXEL = 0.1, 0.05  # metres


def plants(colours: Appearance, shape: Relief, moving: F32) -> F32:
    """Joint score of tall plants (G16): textured, rough or raised in height, green, moving."""
    texture = linear_ramp(colours.texture, 0.055, 0.09)
    high = np.maximum(linear_ramp(shape.height_above, 0.15, 0.5), linear_ramp(shape.rough, 0.04, 0.10))
    tone = linear_ramp(colours.green, 0.06, 0.14) * np.float32(colours.coloured)
    return np.asarray(3.5 * texture + 3.0 * high + 2.0 * tone + 2.0 * moving - 5.0, np.float32)


def land_cover_terms(elevation: ElevationMap, colours: Appearance, shape: Relief) -> Iterator[tuple[str, F32]]:
    """The evidence of every cell, (R, C) each, one after the other, with its identifier (T1)."""
    known = seen(elevation)
    for name, values in chain(_let_go(surface_terms(elevation, colours, shape)), _pictured(elevation)):
        yield name, values
        if name in FRAME_TERMS:
            some = values[::4, ::4][known[::4, ::4]]
            usual = np.float32(np.median(some)) if some.size else np.float32(0)
            yield name + RELATIVE, values - usual


def _pictured(elevation: ElevationMap) -> Iterator[tuple[str, F32]]:
    yield from _let_go(picture_terms(elevation))


def _let_go(terms: dict[str, F32]) -> Iterator[tuple[str, F32]]:
    """Yield each term once and release it: all terms of millions of cells are gigabytes."""
    for name in list(terms):
        yield name, terms.pop(name)


def _strength(power: F32, cell: float, metres: float = NEAR) -> F32:
    near = np.maximum(gaussian_mean(power, metres / cell), 0)
    return np.asarray(np.log(np.sqrt(near) + FLOOR), np.float32)


def picture_terms(elevation: ElevationMap) -> dict[str, F32]:
    """Strength of the detail of the picture, by its width."""
    cell, found = elevation.grid.cell, picture_bands(elevation)
    out: dict[str, F32] = {band(k): _strength(power, cell) for k, power in enumerate(found.bands)}
    return out | {
        PictureTerm.BELOW: _strength(found.below, cell),
        PictureTerm.DARK: found.dark,
        PictureTerm.BRIGHT: found.bright,
        PictureTerm.TINT: _strength(found.tint, cell),
        PictureTerm.TINT_2M: _strength(found.tint, cell, WIDE),
        PictureTerm.LOCAL: found.local,
        PictureTerm.BROAD: found.broad,
    }


def surface_terms(elevation: ElevationMap, colours: Appearance, shape: Relief) -> dict[str, F32]:
    """Roughness, height, residual, flags over some decimetres to metres."""
    cell = elevation.grid.cell
    height = nearest_known(elevation.height, np.isfinite(elevation.height))
    height = np.nan_to_num(height - np.float32(np.nanmedian(height)) if np.isfinite(height).any() else height)
    means = {s: gaussian_mean(height, s / cell) for s in (0.2, 0.5, 1.0, 1.5, 4.0)}

    def near(values: F32, metres: float) -> F32:
        return gaussian_mean(np.nan_to_num(values), metres / cell)

    def rough(metres: float) -> F32:
        off = height - means[metres]
        return log_offset(np.sqrt(np.maximum(near(off * off, NEAR), 0)), 0.005)

    def flagged(flags: int) -> F32:
        return np.asarray((elevation.flags & np.uint16(flags)) != 0, np.float32)

    standing = np.where(is_measured(elevation.flags), elevation.height - shape.ground, np.float32(0))
    moving, residual = flagged(Flag.MOVING | Flag.INCONSISTENT), np.nan_to_num(elevation.residual)
    reach = max(1, round(REACH / cell))
    north, east = gradient(means[0.5] / np.float32(cell))
    local = means[0.2] - means[1.0]
    return {
        SurfaceTerm.ROUGH_02: rough(0.2),
        SurfaceTerm.ROUGH_05: rough(0.5),
        SurfaceTerm.ROUGH_15: rough(1.5),
        SurfaceTerm.HEIGHT_ABOVE_GROUND: np.nan_to_num(shape.height_above).clip(-1, 6),
        SurfaceTerm.HEIGHT_ABOVE_BED: near(standing, 0.3).clip(-2, 8),
        SurfaceTerm.HEIGHT_LOCAL: _squashed(local),
        SurfaceTerm.HEIGHT_BROAD: _squashed(means[1.0] - means[4.0]),
        SurfaceTerm.HIGHEST_NEAR: _squashed(local_max(local, reach)),
        SurfaceTerm.LOWEST_NEAR: _squashed(local_max(-local, reach)),
        SurfaceTerm.STEEP: np.asarray(np.log(np.hypot(north, east) + np.float32(0.02)), np.float32),
        SurfaceTerm.RESIDUAL: log_offset(near(residual, 0.5), 0.02),
        SurfaceTerm.RESIDUAL_2M: log_offset(near(residual, WIDE), 0.02),
        SurfaceTerm.SIGMA: log_offset(near(elevation.sigma, 0.5), 0.005),
        SurfaceTerm.MOVING: near(moving, 0.3),
        SurfaceTerm.MOVING_2M: near(moving, WIDE),
        SurfaceTerm.UNSURE: near(flagged(Flag.UNSURE), 0.5),
        SurfaceTerm.REFUSED_2M: near(flagged(REFUSED), WIDE),
        SurfaceTerm.TEXTURELESS: near(flagged(Flag.TEXTURE), 0.5),
        SurfaceTerm.SATURATED: near(flagged(Flag.SATURATED), 0.5),
        SurfaceTerm.PLANTS: plants(colours, shape, near(moving, 0.3)),
        SurfaceTerm.SAMPLING: _log_ratio(elevation.sampling, USUAL_SAMPLING),
        SurfaceTerm.PIXEL: _log_ratio(elevation.picture_sampling, USUAL_PIXEL),
    }


def _log_ratio(values: F32, usual: float) -> F32:
    """Natural logarithm of values over the usual one; unknown values count as usual."""
    return log_at_least(np.where(np.isfinite(values), values / np.float32(usual), np.float32(1)), 1e-3)


def _squashed(metres: F32) -> F32:
    return np.asarray(np.arcsinh(metres / BUMP), np.float32)
