"""Local detail: bands of brightness, tint and height at several widths (docs/method/land-cover.md, T1b).

On pixels finer than the heights' cells, where the map has them. Stones, tufts and the texture of a sward
differ in the width of their detail, its strength, and whether the heights show it too.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from alight.arrays import F32, U8
from alight.learned.terms import POWER_BANDS, DetailTerm, band
from alight.raster import block_max, block_mean, gaussian_mean, local_max, nearest_known
from alight.records import ElevationMap, Flag

Found = Iterator[tuple[str, F32]]
WIDTHS = (0.7, 1.4, 2.8, 5.6, 11.2)  # fine pixels, 1-sigma: bands lie between each and the next
HEIGHT_WIDTHS = (0.8, 1.6, 3.2, 6.4)  # cells
NEAR, WIDE = 0.3, 1.0  # metres over which the strength of a band is gathered
REACH = 0.5  # metres, radius of local maxima and minima
FLOOR = np.float32(0.003)  # log brightness, added before the logarithm of a strength
BUMP = np.float32(0.03)  # metres, scale of the arsinh of heights
FLAGS = {
    DetailTerm.AMBIGUOUS: Flag.AMBIGUOUS,
    DetailTerm.MOVING: Flag.INCONSISTENT | Flag.MOVING,
    DetailTerm.STEP: Flag.STEP,
    DetailTerm.SATURATED: Flag.SATURATED,
    DetailTerm.TEXTURELESS: Flag.TEXTURE,
}


def _strength(power: F32, sigma: float) -> F32:
    return np.asarray(np.log(np.sqrt(np.maximum(gaussian_mean(power, sigma), 0)) + FLOOR), np.float32)


def _squashed(metres: F32) -> F32:
    return np.asarray(np.arcsinh(metres / BUMP), np.float32)


def _local_max(values: F32, cell: float) -> F32:
    return local_max(values, max(1, round(REACH / cell)))


def channels(rgb: U8) -> dict[str, F32]:
    """Log brightness and log ratios of red and blue to green; unseen pixels take the nearest seen value."""
    picture = nearest_known(rgb, rgb.max(axis=2) > 0).astype(np.float32) + 2
    green = np.log(picture[..., 1])
    red, blue = np.log(picture[..., 0]) - green, np.log(picture[..., 2]) - green
    return {"light": np.asarray(np.log(picture.mean(axis=2)), np.float32), "red": red, "blue": blue}


def bands(name: str, values: F32, factor: int, cell: float) -> Found:
    """Differences of Gaussians of one channel at each width, and the strength of each width near a cell."""
    narrow = gaussian_mean(values, WIDTHS[0])
    for k, sigma in enumerate(WIDTHS[1:]):
        wide = gaussian_mean(values, sigma)
        difference = narrow - wide
        if k == 0:
            yield band(name, 0, "max"), block_max(difference, factor)
            yield band(name, 0, "min"), -block_max(-difference, factor)
        else:
            yield band(name, k), block_mean(difference, factor)
        if k in POWER_BANDS[name]:
            power = block_mean(difference * difference, factor)
            yield band(name, k, "near"), _strength(power, NEAR / cell)
            yield band(name, k, "wide"), _strength(power, WIDE / cell)
        narrow = wide
    coarse = block_mean(values, factor)
    fine, local, trend = (gaussian_mean(coarse, metres / cell) for metres in (0.15, 0.8, 3.0))
    yield f"{name}_local", fine - local
    yield f"{name}_broad", local - trend


def bumps(height: F32, cell: float) -> Found:
    """Differences of Gaussians of the heights at each width, local maximum and minimum, slope."""
    means = [height, *(gaussian_mean(height, s) for s in HEIGHT_WIDTHS)]
    for k, (narrow, wide) in enumerate(pairwise(means)):
        yield band("height", k), _squashed(narrow - wide)
    usual = gaussian_mean(height, 1.0 / cell)
    yield DetailTerm.HEIGHT_LOCAL, _squashed(gaussian_mean(height, 0.2 / cell) - usual)
    yield DetailTerm.HEIGHT_BROAD, _squashed(usual - gaussian_mean(height, 4.0 / cell))
    yield DetailTerm.HIGHEST_NEAR, _squashed(_local_max(means[1] - usual, cell))
    yield DetailTerm.LOWEST_NEAR, _squashed(_local_max(usual - means[1], cell))
    north, east = np.gradient(gaussian_mean(height, 0.3 / cell) / np.float32(cell))
    yield DetailTerm.STEEP, np.asarray(np.log(np.hypot(north, east) + np.float32(0.02)), np.float32)


def spot_bands(light: F32, factor: int, cell: float) -> Found:
    """Darkest and brightest spot within `REACH`: a stone and its shadow."""
    spot = gaussian_mean(light, WIDTHS[0]) - gaussian_mean(light, 0.8 * factor / cell)
    yield DetailTerm.DARKEST_NEAR, _local_max(block_max(-spot, factor), cell)
    yield DetailTerm.BRIGHTEST_NEAR, _local_max(block_max(spot, factor), cell)


def match_terms(elevation: ElevationMap) -> Found:
    """Residual less its local mean, and the share of nearby cells with each flag."""
    cell, residual = elevation.grid.cell, np.nan_to_num(elevation.residual)
    yield DetailTerm.RESIDUAL_SPOT, gaussian_mean(residual, 0.7) - gaussian_mean(residual, 1.0 / cell)
    for name, flags in FLAGS.items():
        yield name, gaussian_mean(np.asarray((elevation.flags & np.uint16(flags)) != 0, np.float32), NEAR / cell)


def detail_terms(elevation: ElevationMap) -> Found:
    """All terms of this module, (R, C) each, one after the other: together they would be several times the map."""
    rgb, factor = elevation.finest
    cell = elevation.grid.cell
    for name, values in channels(rgb).items():
        yield from bands(name, values, factor, cell)
        if name == "light":
            yield from spot_bands(values, factor, cell)
    height = nearest_known(elevation.height, np.isfinite(elevation.height))
    yield from bumps(np.nan_to_num(height - np.float32(np.median(height))), cell)
    yield from match_terms(elevation)
