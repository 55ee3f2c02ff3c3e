"""What a matching window flattens: stones and tufts too small for the heights, betrayed by light, shade and colour.

On pixels finer than the heights' cells, where the map has them (docs/method-hazards.md, G9b).
"""

from __future__ import annotations

import cv2
import numpy as np

from alight.raster import block_max, gaussian_mean, weighted_gaussian
from alight.records import F32, U8, ElevationMap

SURROUNDINGS = 0.25  # metres, 1-sigma of what a spot is compared with
SPOT = 0.7  # fine pixels, 1-sigma: no spot is smaller than what a lens shows


def _shown(rgb: U8) -> F32:
    """Where a picture shows something."""
    return np.asarray(cv2.erode((rgb.max(axis=2) > 0).astype(np.float32), np.ones((3, 3), np.uint8)), np.float32)


def _difference_of_gaussians(values: F32, seen: F32, sigma: float) -> F32:
    """Values smoothed by `SPOT` less those smoothed by `sigma` (fine pixels) over what was seen; 0 elsewhere."""
    surroundings = weighted_gaussian(values, seen, sigma).mean
    return np.asarray((gaussian_mean(values, SPOT) - surroundings) * seen, np.float32)


def blob_contrast(elevation: ElevationMap) -> dict[str, F32]:
    """How much the most conspicuous pixel of each cell differs from its surroundings, (R, C) natural logarithms.

    Ratios to the surroundings: exposure and white balance cancel.

    Returns:
        `dark` and `bright` of brightness, `tint` of red and blue over green together.
    """
    rgb, factor = elevation.finest
    picture, seen = rgb.astype(np.float32) + 2, _shown(rgb)
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
