"""Fill unknown cells."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from alight.arrays import F32, Mask

T = TypeVar("T", bound=np.generic)


def nearest_known(values: NDArray[T], known: Mask) -> NDArray[T]:
    """Give unknown cells of (R, C, ...) the value of the nearest known one; unchanged if none is known."""
    if known.all() or not known.any():
        return values
    at = distance_transform_edt(~known, return_distances=False, return_indices=True)
    return np.asarray(values[tuple(at)])


def filled_surface(height: F32) -> F32:
    """Heights (R, C) about their median, where float32 keeps its digits; NaN becomes the nearest known one, or 0."""
    known = np.isfinite(height)
    middle = np.float32(np.median(height[known])) if known.any() else np.float32(0)
    return np.asarray(np.nan_to_num(nearest_known(height - middle, known)))
