"""Windows of a large raster, and the cells around each that count for it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from alight.geometry import Grid
from alight.geometry.grid import Box
from alight.settings import StageSettings

SIDE = 1024  # cells, side of a window; judging one takes 0.2 GB


class Wider(NamedTuple):
    """A window with cells around it."""

    box: Box  # rows and columns in the raster
    core: Box  # the window, within the box


@dataclass(frozen=True)
class Windows:
    """Division of a raster into windows."""

    shape: tuple[int, int]  # rows and columns of the raster
    around: int  # cells around a window that are judged with it
    farthest: int  # cells up to which the clearance is measured
    side: int = SIDE  # of a window, cells; even

    @classmethod
    def of(cls, grid: Grid, stages: StageSettings, side: int = SIDE) -> Windows:
        """Return the windows of a raster."""
        wide = 16.0 if stages.hazards.smoothed else 0.0  # metres, reach of the widest mean of `hazards.evidence.Discs`
        reach = 2 * stages.lander.reach + wide
        around = 2 * math.ceil(0.5 * reach / grid.cell) + 8  # even, as features are computed on 2 x 2 cells
        room = max(stages.sites.roomy, stages.sites.margin)
        return cls(grid.shape, around, max(SIDE // 8, math.ceil(room / grid.cell) + 2), side)

    @cached_property
    def cores(self) -> list[Box]:
        """Rows and columns of each window."""
        (rows, cols), side = self.shape, self.side
        return [
            (slice(row, min(row + side, rows)), slice(col, min(col + side, cols)))
            for row in range(0, rows, side)
            for col in range(0, cols, side)
        ]

    @property
    def every(self) -> int:
        """Every so many-th row and column is enough for a picture of the raster."""
        return every_of(math.prod(self.shape))

    def wider(self, core: Box, cells: int) -> Wider:
        """Return a window with so many cells more on each side, as far as the raster has them."""
        rows, cols = (
            slice(max(s.start - cells, 0), min(s.stop + cells, n)) for s, n in zip(core, self.shape, strict=True)
        )
        within = [slice(s.start - b.start, s.stop - b.start) for s, b in zip(core, (rows, cols), strict=True)]
        return Wider((rows, cols), (within[0], within[1]))


def every_of(cells: int) -> int:
    """Return n, so that every n-th row and column of so many cells have no more cells than a window."""
    return math.ceil(math.sqrt(cells) / SIDE)


class Overview:
    """Every n-th row and column of a raster."""

    def __init__(self, grid: Grid, every: int) -> None:
        rows, cols = (-(-n // every) for n in grid.shape)
        self.grid, self._every = replace(grid, cell=grid.cell * every, rows=rows, cols=cols), every
        self.fields: dict[str, Any] = {}  # (R, C) arrays

    def add(self, core: Box, fields: dict[str, Any]) -> None:
        """Keep every n-th row and column of the arrays among the fields of a window."""
        n = self._every
        to = tuple(slice(-(-s.start // n), -(-s.stop // n)) for s in core)
        chosen = tuple(slice(-s.start % n, None, n) for s in core)
        for name, values in fields.items():
            if isinstance(values, np.ndarray):
                whole = self.fields.setdefault(name, np.zeros(self.grid.shape, values.dtype))
                whole[to] = values[chosen]
