"""Fill unknown cells."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from alight.arrays import Mask

T = TypeVar("T", bound=np.generic)


def nearest_known(values: NDArray[T], known: Mask) -> NDArray[T]:
    """Give unknown cells of (R, C, ...) the value of the nearest known one; unchanged if none is known."""
    if known.all() or not known.any():
        return values
    at = distance_transform_edt(~known, return_distances=False, return_indices=True)
    return np.asarray(values[tuple(at)])
