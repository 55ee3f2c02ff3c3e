"""Where things drive or walk: paved ground is remembered for a while after something moved across it.

A road between two cars looks as level and empty as a yard. `Flag.MOVING` tells that something moves there now, and the
next map has forgotten it. What moves where plants or water are is those; on paved ground it is traffic. Bare ground
does not count: dry grass is called so, and it sways.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np

from alight.arrays import F64, I64, U16, Mask
from alight.geometry import Grid
from alight.records import Flag, Terrain, TerrainMap

CELL = 0.5  # metres, of what is remembered
SHARE = 0.5  # of such a cell that moves
LEAST_AREA = 2.0  # m^2 side by side, for less is noise: a car with its rim covers 8 to 15


@dataclass(frozen=True, eq=False)
class Passed:
    """Cells that something moved across, and when, by value; in the frame of a map."""

    cells: I64 = field(default_factory=lambda: np.zeros((0, 2), np.int64))  # (N, 2) east, north over `CELL`
    t_ns: I64 = field(default_factory=lambda: np.zeros(0, np.int64))  # (N,) the last time

    def with_seen(self, grid: Grid, flags: U16, t_ns: int) -> Passed:
        """These, and what moves at `t_ns` by the flags (R, C) of a grid."""
        now = _moving(grid, flags)
        kept = ~np.isin(_keys(self.cells), _keys(now))
        times = np.concatenate([self.t_ns[kept], np.full(len(now), t_ns)])
        return Passed(np.concatenate([self.cells[kept], now]), times)

    def since(self, t_ns: int) -> Passed:
        """Those that something moved across at `t_ns` or later."""
        kept = self.t_ns >= t_ns
        return Passed(self.cells[kept], self.t_ns[kept])

    def moved(self, shift: F64) -> Passed:
        """The same in a frame where positions are larger by `shift`, metres."""
        return Passed(self.cells + np.rint(shift[:2] / CELL).astype(np.int64), self.t_ns)

    def on(self, grid: Grid, cover: TerrainMap | None) -> Mask:
        """The cells (R, C) of a grid that something moved across: of paved ground; all, if no land cover is known."""
        if not len(self.cells):
            return np.zeros(grid.shape, np.bool_)
        columns, rows = _numbers(grid)
        low = np.minimum(self.cells.min(axis=0), [columns.min(), rows.min()])
        high = np.maximum(self.cells.max(axis=0), [columns.max(), rows.max()])
        seen = np.zeros(high - low + 1, np.bool_)
        seen[tuple((self.cells - low).T)] = True
        out = seen[np.ix_(columns - low[0], rows - low[1])].T
        return out if cover is None else out & (cover.label == Terrain.PAVED)


NOWHERE = Passed()


def _numbers(grid: Grid) -> tuple[I64, I64]:
    """East of the columns (C,) and north of the rows (R,) of a grid, in cells of `CELL`."""
    east, north = (np.floor(v / CELL).astype(np.int64).ravel() for v in grid.xy())
    return east, north


def _moving(grid: Grid, flags: U16) -> I64:
    """Cells (N, 2) of `CELL` of which a good part moves, with enough of them side by side."""
    moves = (flags & np.uint16(Flag.MOVING)) != 0
    if not moves.any():
        return np.zeros((0, 2), np.int64)
    columns, rows = _numbers(grid)
    low = np.array([columns.min(), rows.min()])
    shape = columns.max() - low[0] + 1, rows.max() - low[1] + 1
    at = ((columns - low[0])[None, :] * shape[1] + (rows - low[1])[:, None]).ravel()
    count, moving = (np.bincount(at, weights=w, minlength=shape[0] * shape[1]) for w in (None, moves.ravel()))
    there = (moving >= SHARE * np.maximum(count, 1)).reshape(shape)
    _, label, about, _ = cv2.connectedComponentsWithStats(there.astype(np.uint8), connectivity=4)
    large = about[:, cv2.CC_STAT_AREA] * CELL**2 >= LEAST_AREA
    return np.asarray(np.argwhere(there & large[label]) + low, np.int64)


def _keys(cells: I64) -> I64:
    """One number a cell."""
    return np.asarray(cells[:, 0] * (1 << 32) + cells[:, 1], np.int64)
