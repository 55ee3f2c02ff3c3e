"""What a matching window flattens: stones and tufts too small for the heights, betrayed by light, shade and colour.

On pixels finer than the heights' cells, where the map has them (docs/method/hazards.md, G9b).
"""

from __future__ import annotations

import cv2
import numpy as np

from alight.geometry import cells_as_blocks
from alight.records import F32, U8, ElevationMap

SURROUNDINGS = 0.25  # metres, 1-sigma of what a spot is compared with
SPOT = 0.7  # fine pixels, 1-sigma: no spot is smaller than what a lens shows


def _shown(rgb: U8) -> F32:
    """Where a picture shows something."""
    return np.asarray(cv2.erode((rgb.max(axis=2) > 0).astype(np.float32), np.ones((3, 3), np.uint8)), np.float32)


def _against_surroundings(values: F32, seen: F32, sigma: float) -> F32:
    share = cv2.GaussianBlur(seen, (0, 0), sigma)
    near = cv2.GaussianBlur(values * seen, (0, 0), sigma) / np.maximum(share, np.float32(1e-3))
    return np.asarray((cv2.GaussianBlur(values, (0, 0), SPOT) - near) * seen, np.float32)


def _most(values: F32, factor: int) -> F32:
    """The largest value of the pixels of each cell."""
    return np.asarray(cells_as_blocks(values, factor).max(axis=(1, 3)), np.float32)


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
        _against_surroundings(np.asarray(v, np.float32), seen, sigma)
        for v in (np.log(picture.mean(axis=2)), np.log(picture[..., 0]) - green, np.log(picture[..., 2]) - green)
    )
    return {
        "dark": _most(-light, factor),
        "bright": _most(light, factor),
        "tint": _most(np.hypot(red, blue), factor),
    }
