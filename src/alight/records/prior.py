"""Heights that are known before a run: a DEM from elsewhere, on the world's grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from alight.arrays import F32, F64
from alight.geometry import Grid


@dataclass(frozen=True, eq=False)
class PriorHeights:
    """A DEM in the world. Its vertical datum need not be known: the pictures give its offset."""

    name: str
    grid: Grid
    height: F32  # (R, C) metres above the origin, as if counted from the ellipsoid; NaN = unknown

    def at(self, east: F64, north: F64) -> F64:
        """The height of the nearest cell to each place (metres), NaN where it is unknown."""
        return self.grid.nearest_at(self.height, east, north).astype(np.float64)

    def over(self, grid: Grid) -> F64:
        """Its heights on another grid, (R, C) metres."""
        return self.grid.nearest_on(grid, self.height).astype(np.float64)


@dataclass(frozen=True)
class PriorComparison:
    """A map against a DEM from elsewhere: map less DEM, over the heights that are given out."""

    name: str
    bias: float  # metres, median
    nmad: float  # metres
    area: float  # m^2 where both have heights

    @property
    def line(self) -> str:
        """The comparison in words."""
        return (
            f"{self.name}: the map lies {self.bias:+.2f} m above it (median), NMAD {self.nmad:.2f} m "
            f"over {self.area:,.0f} m²"
        )
