"""Rise of a raster along its rows and columns."""

from __future__ import annotations

from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

T = TypeVar("T", bound=np.floating[Any])


class Rise(NamedTuple):
    """Central differences, (R, C) each, a unit of the spacing."""

    down: NDArray[Any]  # towards the next row
    right: NDArray[Any]  # towards the next column


def gradient(values: NDArray[T], spacing: float = 1.0) -> Rise:
    """As `numpy.gradient`, but 0 along a side of one cell, where that raises."""
    sides = [np.gradient(values, spacing, axis=k) if values.shape[k] > 1 else np.zeros_like(values) for k in range(2)]
    return Rise(*sides)
