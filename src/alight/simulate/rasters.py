"""Worlds out of arrays, and a user's own height raster, classes and orthophoto."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydantic import Field

from alight.geometry import Grid
from alight.records import F32, U8
from alight.simulate.section import Section
from alight.simulate.things.base import Box
from alight.simulate.tiles import SIDE, Tile


class Raster(Section):
    """GeoTIFFs that a world is made of."""

    height: Path = Field(description="heights, metres, any projected CRS or degrees")


@dataclass(frozen=True, eq=False)
class Arrays:
    """A source of tiles out of arrays that are there; outside, their edge goes on."""

    grid: Grid
    height: F32  # (R, C) metres above the origin
    label: U8  # (R, C)
    depth: F32 | None = None  # (R, C) metres of water
    look: U8 | None = None  # (R, C)
    tint: F32 | None = None  # (R, C, 3)

    @property
    def cell(self) -> float:
        """Metres."""
        return self.grid.cell

    @property
    def anchor(self) -> tuple[float, float]:
        """The south-west corner."""
        grid = self.grid
        return grid.east - 0.5 * grid.cell, grid.north + 0.5 * grid.cell - grid.rows * grid.cell

    @property
    def extent(self) -> Box:
        """West, south, east, north."""
        west, south = self.anchor
        return west, south, west + self.grid.cols * self.cell, south + self.grid.rows * self.cell

    def tile(self, i: int, j: int) -> Tile:
        """A window; beyond the edge the nearest cell."""
        k = np.arange(SIDE)
        cols = np.clip(i * SIDE + k, 0, self.grid.cols - 1)
        rows = np.clip(self.grid.rows - (j + 1) * SIDE + k, 0, self.grid.rows - 1)
        at = np.ix_(rows, cols)
        depth = np.zeros((SIDE, SIDE), np.float32) if self.depth is None else self.depth[at]
        look = np.zeros((SIDE, SIDE), np.uint8) if self.look is None else self.look[at]
        return Tile(self.height[at], self.label[at], depth, look, None if self.tint is None else self.tint[at])

    def range(self, box: Box) -> tuple[float, float]:
        """Of all heights."""
        west, south, east, north = box
        rows, cols = self.grid.index(np.array([west, east]), np.array([north, south]))
        r0, r1 = (int(v) for v in np.clip([np.floor(rows[0]), np.ceil(rows[1])], 0, self.grid.rows - 1))
        c0, c1 = (int(v) for v in np.clip([np.floor(cols[0]), np.ceil(cols[1])], 0, self.grid.cols - 1))
        part = self.height[r0 : r1 + 1, c0 : c1 + 1]
        return float(part.min()), float(part.max())
