"""Log brightness of a picture: contrasts in it do not depend on the exposure."""

from __future__ import annotations

import cv2
import numpy as np

from alight.arrays import F32, U8

GREY = 2.0  # levels added: noise in the dark is no contrast
_LOG = np.log(np.arange(256, dtype=np.float32) + np.float32(GREY))


def log_levels(levels: U8) -> F32:
    """Natural logarithm of grey levels, of any shape."""
    return np.asarray(_LOG[levels])


def log_brightness(rgb: U8) -> F32:
    """Natural logarithm of the brightness of a picture, (R, C) of (R, C, 3)."""
    return log_levels(np.asarray(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), np.uint8))
