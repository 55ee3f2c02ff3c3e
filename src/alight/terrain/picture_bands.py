"""Detail of the picture by its width in metres: bands of log brightness and tint (docs/method/land-cover.md, T1b)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from alight.arrays import F32
from alight.raster import block_light, block_mean, difference_of_gaussians, gaussian_mean, local_max, log_levels
from alight.records import ElevationMap

WIDTHS = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6)  # metres, 1-sigma: bands lie between each and the next
TINT = (0.1, 0.8)  # metres: the band of the tints
SPOT = (0.07, 0.35)  # metres: the band of dark and bright spots
REACH = 0.4  # metres over which spots are looked for


@dataclass(frozen=True, eq=False)
class PictureBands:
    """Each (R, C) float32, natural logarithms of brightness or of a ratio of two colours."""

    below: F32  # variance within a pixel of about the narrowest width: detail finer than all bands
    bands: tuple[F32, ...]  # of log brightness, fine to coarse
    dark: F32  # largest darkness of a spot within `REACH`, against its surroundings
    bright: F32
    tint: F32  # variance of the tints in their band
    local: F32  # brightness against 0.8 m about it
    broad: F32  # 0.8 m against 3.2 m


def _filled(grey: F32, seen: F32, sigma: float) -> F32:
    """Log brightness, unseen pixels filled from their surroundings."""
    if seen.min() > 0.999:
        return grey
    share = np.maximum(gaussian_mean(seen, sigma), np.float32(1e-3))
    around = gaussian_mean(np.where(seen > 0, grey, np.float32(0)), sigma) / share
    return np.where(seen > 0.999, grey, around)


def _difference(values: F32, narrow: float, wide: float, pixel: float) -> F32:
    return difference_of_gaussians(values, narrow / pixel, wide / pixel)


def picture_bands(elevation: ElevationMap) -> PictureBands:
    """Measure the finest picture of the map, on pixels of about the narrowest width and wider.

    Widths are in metres, so that maps of any cell compare; detail that the pixels do not show is weak. Exposure and
    white balance cancel.
    """
    rgb, factor = elevation.finest
    cell, halves = elevation.grid.cell, elevation.pixels_a_cell(WIDTHS[0])
    mean, seen, within = block_light(rgb, factor // halves, within=True)
    below = block_mean(within, halves)
    pixel = cell / halves
    mean = _filled(mean, seen, 1.0 / pixel)
    del seen, within  # arrays as fine as the picture are large
    spot = block_mean(_difference(mean, *SPOT, pixel), halves)
    coarse = block_mean(mean, halves)
    red, blue = _tints(elevation)
    reach = max(1, round(REACH / cell))
    return PictureBands(
        below=below,
        bands=tuple(_bands(mean, pixel, halves)),
        dark=local_max(-spot, reach),
        bright=local_max(spot, reach),
        tint=_difference(red, *TINT, cell) ** 2 + _difference(blue, *TINT, cell) ** 2,
        local=_difference(coarse, 0.15, 0.8, cell),
        broad=_difference(coarse, 0.8, 3.2, cell),
    )


def _bands(mean: F32, pixel: float, halves: int) -> Iterator[F32]:
    """Mean square on each cell of the detail that is wider than one width and narrower than the next."""
    smooth = (gaussian_mean(mean, s / pixel) if s / pixel > 0.3 else mean for s in WIDTHS)
    for one, wider in pairwise(smooth):
        yield block_mean((one - wider) ** 2, halves)


def _tints(elevation: ElevationMap) -> tuple[F32, F32]:
    """Log ratio of red and of blue to green, (R, C) each."""
    r, g, b = (log_levels(elevation.rgb[..., k]) for k in range(3))
    return r - g, b - g
