"""The world grid: square cells on the reference ground plane, and their projection into a camera.

`p_i(x, y, h) = H_i (x, y, 1)^T + h b_i` with `H_i = P_i[:, (0, 1, 3)]` and `b_i = P_i[:, 2]` (docs/method/parallax.md,
eqs. 1-3). `H_i` is the ground-plane homography of the 2004 paper, `b_i` the image of the vertical.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alight.arrays import F64
from alight.geometry.poses import Pose

Box = tuple[slice, slice]  # rows and columns of a rectangular part of a grid


@dataclass(frozen=True)
class Grid:
    """North-up raster of square cells in the world frame; row 0 is the northernmost row.

    `east` and `north` are the centre of cell (row 0, column 0). Integer rows and columns are cell centres.
    """

    east: float  # metres
    north: float  # metres
    cell: float  # metres
    rows: int
    cols: int

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of rows and columns."""
        return self.rows, self.cols

    def xy(self) -> tuple[F64, F64]:
        """Return the cell centres in metres: east of every column (cols,) and north of every row (rows,)."""
        return self.east + self.cell * np.arange(self.cols, dtype=np.float64), self.north - self.cell * np.arange(
            self.rows, dtype=np.float64
        )

    def index(self, east: NDArray[np.float64], north: NDArray[np.float64]) -> tuple[F64, F64]:
        """Compute the fractional row and column of world positions; `east` and `north` in metres."""
        return (self.north - np.asarray(north)) / self.cell, (np.asarray(east) - self.east) / self.cell

    def nearest_at(self, values: NDArray[Any], east: F64, north: F64, outside: float | None = None) -> NDArray[Any]:
        """Look up the value of the cell nearest to each position.

        Args:
            values: (R, C, ...), one value per cell.
            east, north: positions in metres, of any shapes that broadcast.
            outside: value for positions beyond the grid; None: NaN for floating-point values, else 0.
        """
        row, col = (np.rint(i).astype(np.int64) for i in self.index(east, north))
        inside = (row >= 0) & (row < self.rows) & (col >= 0) & (col < self.cols)
        out = np.asarray(values[row.clip(0, self.rows - 1), col.clip(0, self.cols - 1)])
        if outside is None:
            outside = np.nan if np.issubdtype(values.dtype, np.floating) else 0
        out[~inside] = outside
        return out

    def nearest_on(self, target: Grid, values: NDArray[Any], outside: float | None = None) -> NDArray[Any]:
        """Look up the value nearest to each cell centre of the grid `target`; see `nearest_at` for the arguments."""
        east, north = target.xy()
        row, col = (np.rint(i).astype(np.int64) for i in self.index(east, north))
        out = np.asarray(values[row.clip(0, self.rows - 1)][:, col.clip(0, self.cols - 1)])
        if outside is None:
            outside = np.nan if np.issubdtype(values.dtype, np.floating) else 0
        out[(row < 0) | (row >= self.rows)] = outside
        out[:, (col < 0) | (col >= self.cols)] = outside
        return out

    def window(self, row: int, col: int, rows: int, cols: int) -> Grid:
        """Return the grid of the `rows` x `cols` cells whose first cell is (row, col) of this grid."""
        return Grid(self.east + col * self.cell, self.north - row * self.cell, self.cell, rows, cols)

    def part(self, box: Box) -> Grid:
        """Return the grid of the cells in a box of rows and columns."""
        rows, cols = box
        return self.window(rows.start, cols.start, rows.stop - rows.start, cols.stop - cols.start)

    def box_about(self, places: F64) -> Box:
        """Return rows and columns around positions (..., 2), metres east and north; empty beyond the grid."""
        east, north = places.reshape(-1, 2).T
        ends = self.index(np.array([east.min(), east.max()]), np.array([north.max(), north.min()]))
        rows, cols = (
            slice(int(np.clip(a, 0, n)), int(np.clip(b + 1, 0, n))) for (a, b), n in zip(ends, self.shape, strict=True)
        )
        return rows, cols

    def coarser(self, factor: int) -> Grid:
        """Return the grid of cells `factor` times as wide; its last row and column may reach beyond this grid."""
        shift = 0.5 * (factor - 1) * self.cell
        rows, cols = -(-self.rows // factor), -(-self.cols // factor)
        return Grid(self.east + shift, self.north - shift, self.cell * factor, rows, cols)

    def finer(self, factor: int) -> Grid:
        """Return the grid of the same extent with `factor` x `factor` cells in each cell of this grid."""
        pixel = self.cell / factor
        shift = 0.5 * (self.cell - pixel)
        return Grid(self.east - shift, self.north + shift, pixel, self.rows * factor, self.cols * factor)

    @property
    def transform(self) -> tuple[float, float, float, float, float, float]:
        """Affine coefficients (a, b, c, d, e, f) from (column, row) of cell corners to world metres, as in GeoTIFF."""
        c = self.cell
        return c, 0.0, self.east - c / 2, 0.0, -c, self.north + c / 2


def box_of(mask: NDArray[np.bool_]) -> Box:
    """Return the smallest box of rows and columns around all True cells of a mask (R, C); empty if no cell is True."""
    rows, cols = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        return slice(0, 0), slice(0, 0)
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(cols[0]), int(cols[-1]) + 1)


def plane_on(xs: F64, ys: F64, plane: F64, about: F64) -> NDArray[np.float32]:
    """Compute the heights of a plane, (R, C) metres, at positions east `xs` (C,) and north `ys` (R,), metres.

    `plane`: (3,) height in metres at `about` (2,), slope towards east, slope towards north.
    """
    up = plane[0] + plane[1] * (xs - about[0])[None, :] + plane[2] * (ys - about[1])[:, None]
    return np.asarray(up, dtype=np.float32)


def ground_projection(world_from_cam: Pose) -> tuple[F64, F64]:
    """Return `H` (3, 3) and `b` (3,) so that a world point (x, y, z) is `H @ (x, y, 1) + z * b` in the camera frame."""
    cam_from_world = world_from_cam.inverse
    R, t = cam_from_world.rotation, cam_from_world.translation
    return np.column_stack([R[:, 0], R[:, 1], t]), R[:, 2].copy()
