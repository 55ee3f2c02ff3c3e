"""Euclidean distance transform."""

from __future__ import annotations

import cv2
import numpy as np

from alight.arrays import F32, Mask


def distance_to(mask: Mask) -> F32:
    """Distance of every cell's centre to the nearest centre in the mask, (R, C) cells; infinite for an empty mask."""
    if not mask.any():
        return np.full(mask.shape, np.inf, dtype=np.float32)
    away = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.asarray(away, np.float32)
