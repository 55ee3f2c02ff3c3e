"""Heights above the ellipsoid and above the world's plane, on a grid."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from alight.arrays import F32, F64
from alight.geometry.geodesy import LocalFrame
from alight.geometry.grid import Grid

EARTH_RADIUS = 6371008.8  # metres, mean


def ellipsoid_fall(grid: Grid) -> F64:
    """Height of the origin's tangent plane above the ellipsoid's surface through the origin, (R, C) metres.

    It is d^2 / 2R at the distance d from the origin: 7 mm at 300 m.
    """
    east, north = grid.xy()
    return np.asarray((east[None, :] ** 2 + north[:, None] ** 2) / (2 * EARTH_RADIUS))


def world_up(height: NDArray[np.floating[Any]], grid: Grid, local: LocalFrame) -> F32:
    """Convert heights above the ellipsoid, (R, C) metres, to metres above the origin's tangent plane."""
    return (height.astype(np.float64) - local.height - ellipsoid_fall(grid)).astype(np.float32)
