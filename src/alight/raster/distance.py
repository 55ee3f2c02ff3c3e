"""Euclidean distance transform."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import distance_transform_edt

from alight.arrays import F32, Mask


def distance_to(mask: Mask) -> F32:
    """Distance of every cell's centre to the nearest centre in the mask, (R, C) cells; infinite for an empty mask."""
    if not mask.any():
        return np.full(mask.shape, np.inf, dtype=np.float32)
    # not OpenCV's: the last bits of its distances change with the number of free threads
    return np.asarray(distance_transform_edt(~mask), np.float32)


def clearance_of(free: Mask, cell: float) -> F32:
    """Distance of every cell's centre to the rim of the nearest cell that is not free, (R, C) metres; 0 on these."""
    out: F32 = np.maximum(distance_to(~free) - np.float32(0.5), np.float32(0)) * np.float32(cell)
    return out
