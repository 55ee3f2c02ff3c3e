"""Blob contrast: small dark, bright or discoloured spots, difference of Gaussians on fine pixels (G9b).

Image matching flattens stones and tufts that are smaller than its window; light, shade and colour still show them. The
map's finer pixels are used where it has them (docs/method/hazards.md).
"""

from __future__ import annotations

import cv2
import numpy as np

from alight.arrays import F32, U8
from alight.raster import block_max, gaussian_mean, weighted_gaussian
from alight.records import ElevationMap

SURROUNDINGS = 0.25  # metres, 1-sigma of the wide Gaussian
SPOT = 0.7  # fine pixels, 1-sigma of the narrow Gaussian: the blur of a lens


def _seen(rgb: U8) -> F32:
    """1 on pixels that were seen, and their neighbours too; else 0."""
    return np.asarray(cv2.erode((rgb.max(axis=2) > 0).astype(np.float32), np.ones((3, 3), np.uint8)), np.float32)


def _difference_of_gaussians(values: F32, seen: F32, sigma: float) -> F32:
    """Values smoothed by `SPOT` less those smoothed by `sigma` (fine pixels) over what was seen; 0 elsewhere."""
    surroundings = weighted_gaussian(values, seen, sigma).mean
    return np.asarray((gaussian_mean(values, SPOT) - surroundings) * seen, np.float32)


def blob_contrast(elevation: ElevationMap) -> dict[str, F32]:
    """Largest contrast of a pixel of each cell to its surroundings, (R, C) natural logarithms.

    Ratios to the surroundings: exposure and white balance cancel.

    Returns:
        `dark` and `bright` of brightness, `tint` of red and blue over green together.
    """
    rgb, factor = elevation.finest
    picture, seen = rgb.astype(np.float32) + 2, _seen(rgb)
    sigma = max(SURROUNDINGS * factor / elevation.grid.cell, 2 * SPOT)
    green = np.log(picture[..., 1])
    light, red, blue = (
        _difference_of_gaussians(np.asarray(v, np.float32), seen, sigma)
        for v in (np.log(picture.mean(axis=2)), np.log(picture[..., 0]) - green, np.log(picture[..., 2]) - green)
    )
    return {
        "dark": block_max(-light, factor),
        "bright": block_max(light, factor),
        "tint": block_max(np.hypot(red, blue), factor),
    }
