"""The world grid: square cells on the reference ground plane, and the projection of its cells into a camera.

`p_i(x, y, h) = H_i (x, y, 1)^T + h b_i` with `H_i = P_i[:, (0, 1, 3)]` and `b_i = P_i[:, 2]`
(docs/method/parallax.md, eqs. 1-3): the ground-plane homography of the 2004 paper and the image of the vertical.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alight.arrays import F64
from alight.geometry.cameras import Camera
from alight.geometry.poses import Pose

Box = tuple[slice, slice]  # rows and columns of a rectangle of a grid's cells


@dataclass(frozen=True)
class Grid:
    """A north-up raster of square cells in the world; row 0 is the northernmost.

    `east`, `north` are the centre of cell (row 0, column 0); a cell's centre is at integer row and column.
    """

    east: float  # metres
    north: float  # metres
    cell: float  # metres
    rows: int
    cols: int

    @property
    def shape(self) -> tuple[int, int]:
        """Number of rows and of columns."""
        return self.rows, self.cols

    def xy(self) -> tuple[F64, F64]:
        """East of every column (cols,) and north of every row (rows,), metres."""
        return self.east + self.cell * np.arange(self.cols, dtype=np.float64), self.north - self.cell * np.arange(
            self.rows, dtype=np.float64
        )

    def index(self, east: NDArray[np.float64], north: NDArray[np.float64]) -> tuple[F64, F64]:
        """Fractional (row, column) of world positions."""
        return (self.north - np.asarray(north)) / self.cell, (np.asarray(east) - self.east) / self.cell

    def nearest_at(self, values: NDArray[Any], east: F64, north: F64, outside: float | None = None) -> NDArray[Any]:
        """Look up the value of the cell that is nearest to each place.

        Args:
            values: (R, C, ...), one for each cell.
            east, north: metres, of any shapes that broadcast.
            outside: for places beyond the grid; None: NaN, or 0 where the values are no floating-point numbers.
        """
        row, col = (np.rint(i).astype(np.int64) for i in self.index(east, north))
        inside = (row >= 0) & (row < self.rows) & (col >= 0) & (col < self.cols)
        out = np.asarray(values[row.clip(0, self.rows - 1), col.clip(0, self.cols - 1)])
        if outside is None:
            outside = np.nan if np.issubdtype(values.dtype, np.floating) else 0
        out[~inside] = outside
        return out

    def nearest_on(self, target: Grid, values: NDArray[Any], outside: float | None = None) -> NDArray[Any]:
        """Look up values by `nearest_at` at the centres of another grid's cells: (target rows, target columns, ...)."""
        east, north = target.xy()
        return self.nearest_at(values, east[None, :], north[:, None], outside)

    def window(self, row: int, col: int, rows: int, cols: int) -> Grid:
        """Return the part of the grid that starts at (row, col)."""
        return Grid(self.east + col * self.cell, self.north - row * self.cell, self.cell, rows, cols)

    def part(self, box: Box) -> Grid:
        """Return the grid of a rectangle of its cells."""
        rows, cols = box
        return self.window(rows.start, cols.start, rows.stop - rows.start, cols.stop - cols.start)

    def coarser(self, factor: int) -> Grid:
        """Return the grid whose cells are `factor` x `factor` of these; the last row and column may reach beyond."""
        shift = 0.5 * (factor - 1) * self.cell
        rows, cols = -(-self.rows // factor), -(-self.cols // factor)
        return Grid(self.east + shift, self.north - shift, self.cell * factor, rows, cols)

    def finer(self, factor: int) -> Grid:
        """Return the grid of `factor` x `factor` pixels in each cell, of the same extent."""
        pixel = self.cell / factor
        shift = 0.5 * (self.cell - pixel)
        return Grid(self.east - shift, self.north + shift, pixel, self.rows * factor, self.cols * factor)

    @property
    def transform(self) -> tuple[float, float, float, float, float, float]:
        """Affine coefficients (a, b, c, d, e, f) from (column, row) corners to world, as rasters store it."""
        c = self.cell
        return c, 0.0, self.east - c / 2, 0.0, -c, self.north + c / 2


def box_of(mask: NDArray[np.bool_]) -> Box:
    """Rows and columns of the rectangle about the cells of a mask (R, C); empty where there are none."""
    rows, cols = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        return slice(0, 0), slice(0, 0)
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(cols[0]), int(cols[-1]) + 1)


def plane_on(xs: F64, ys: F64, plane: F64, about: F64) -> NDArray[np.float32]:
    """Heights (R, C) at columns `xs`, rows `ys` of a plane (3,): height at `about` (2,), slopes east and north."""
    up = plane[0] + plane[1] * (xs - about[0])[None, :] + plane[2] * (ys - about[1])[:, None]
    return np.asarray(up, dtype=np.float32)


def ground_projection(camera: Camera, world_from_cam: Pose) -> tuple[F64, F64]:
    """Return `H` (3, 3) and `b` (3,) in *normalised* image coordinates (K left out; the lens comes after, per cell)."""
    cam_from_world = world_from_cam.inverse
    R, t = cam_from_world.rotation, cam_from_world.translation
    return np.column_stack([R[:, 0], R[:, 1], t]), R[:, 2].copy()
