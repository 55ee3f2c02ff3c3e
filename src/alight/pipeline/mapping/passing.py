"""Memory of traffic: ground is remembered for a while after something moved across it, or came to stand on it.

A road between two cars looks as level and empty as a yard. `Flag.MOVING` marks motion of the moment, and the
next map has forgotten it. On plants or water these move themselves; on paved ground it is traffic. Bare ground
does not count: dry grass is often classified so, and it sways.
"""

from __future__ import annotations

import numpy as np

from alight.arrays import I64, U16, Mask
from alight.geometry import Grid
from alight.pipeline.remembered import CELL, Remembered, cells_at, shown
from alight.raster import without_specks
from alight.records import Flag, Terrain, TerrainMap

LEAST_AREA = 2.0  # m^2 side by side, less is noise: a car with its rim covers 8 to 15
LEAST_CAME = 0.08  # m^2 side by side: the shoulders of a person, seen from above


def what_moves(grid: Grid, flags: U16, anew: Mask | None = None) -> I64:
    """Cells (N, 2) of `CELL` to remember: `SHARE` of each is MOVING by the flags (R, C), with enough side by side.

    `anew`: (R, C), of the cells whose flags are new; the others were remembered before.
    """
    moves = (flags & np.uint16(Flag.MOVING)) != 0
    if not moves.any():
        return np.zeros((0, 2), np.int64)
    there, low = shown(grid, moves)
    there = without_specks(there, CELL, LEAST_AREA, neighbours=4)
    if anew is not None:
        there &= shown(grid, anew)[0]
    return np.asarray(np.argwhere(there) + low, np.int64)


def who_came(grid: Grid, came: Mask) -> I64:
    """Cells (N, 2) of `CELL` to remember, touched by patches, large enough, of a mask (R, C) of where somebody came."""
    return cells_at(grid, without_specks(came, grid.cell, LEAST_CAME))


def traffic(passed: Remembered, grid: Grid, cover: TerrainMap | None) -> Mask:
    """The cells (R, C) of a grid that something moved across: of paved ground; all, if no land cover is known."""
    out = passed.on(grid)
    return out if cover is None else out & (cover.label == Terrain.PAVED)
