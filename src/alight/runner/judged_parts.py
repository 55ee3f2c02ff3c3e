"""A judged raster whose parts are read from its files, so that sites are searched with bounded memory."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from alight.arrays import F32
from alight.geometry import Grid
from alight.geometry.grid import Box
from alight.jobs import InTurn, Task
from alight.landing.search import Cell, Part, R
from alight.landing.zones import MapZones
from alight.outputs.rasters import SAFE_BANDS
from alight.outputs.tiles import read_box
from alight.outputs.verdict import MEASURES
from alight.raster import clearance_of
from alight.records import HazardMap
from alight.runner.windows import Windows
from alight.settings import StageSettings
from alight.sources.raster import GroundParts

SCORED = ("p_safe", "clearance", "quality")  # measures that the search of sites needs


@dataclass(frozen=True, eq=False)
class JudgedParts:
    """The raster, its windows, and its files of the judgement."""

    ground: GroundParts
    windows: Windows
    stages: StageSettings
    limits: MapZones
    judged: int  # number of cells with a P(safe)
    folder: Path  # of safe.tif, hazards.tif and reasons.tif

    @property
    def grid(self) -> Grid:
        """Grid of the raster."""
        return self.ground.grid

    @property
    def zoned(self) -> bool:
        """Whether zones are against touchdowns."""
        return bool(self.limits.plane.zones)

    @property
    def preferring(self) -> bool:
        """Whether the sites of a zone rank higher."""
        return bool(self.limits.plane.of("prefer"))

    @property
    def cores(self) -> Sequence[Box]:
        """Rows and columns of each part."""
        return self.windows.cores

    def of_parts(self, do: Callable[[Part], R], numbers: Iterable[int]) -> Iterable[R]:
        """Yield the result of `do` for each part that is named by its number; parts are read side by side."""

        def done(core: Box) -> R:
            return do(self._part(core, SCORED))

        return InTurn().run((Task(str(n), done, (self.cores[n],)) for n in numbers), at_once=True)

    def about(self, cell: Cell) -> Part:
        """Return the part around a cell, with all that a site is reported with."""
        row, col = cell
        return self._part((slice(row, row + 1), slice(col, col + 1)), (*SAFE_BANDS, *MEASURES), with_heights=True)

    def _part(self, core: Box, names: Sequence[str], with_heights: bool = False) -> Part:
        """Read the named measures of a part; others are NaN."""
        s, (box, within) = self.stages, self.windows.wider(core, self.windows.farthest)
        grid = self.grid.part(box)
        nothing = np.broadcast_to(np.float32(np.nan), grid.shape)
        found: dict[str, Any] = dict.fromkeys((*SAFE_BANDS, *MEASURES, "settles_at"), nothing)
        for file, bands in (("safe.tif", SAFE_BANDS), ("hazards.tif", MEASURES)):
            chosen = [name for name in bands if name in names]
            values = read_box(self.folder / file, box, [bands.index(name) + 1 for name in chosen])
            found |= dict(zip(chosen, values, strict=True))
        hazards = HazardMap(grid, reasons=read_box(self.folder / "reasons.tif", box, [1])[0], **found)
        hazards = replace(self.limits.judged(hazards), clearance=hazards.clearance)
        elevation = self.ground.part(box) if with_heights else None
        farthest = farthest_of(self.windows, grid)
        first = box[0].start, box[1].start
        return Part(hazards, None, elevation, s.sites, s.lander, None, first, within, farthest)


def farthest_of(windows: Windows, grid: Grid) -> float:
    """Return the clearance beyond which it is not measured, metres."""
    return (windows.farthest - 0.5) * grid.cell


def clearance_in(reasons: Path, core: Box, windows: Windows, grid: Grid) -> F32:
    """Return the clearance of the safe touchdowns of a window, (R, C) metres, up to `farthest_of`."""
    box, within = windows.wider(core, windows.farthest)
    free = read_box(reasons, box, [1])[0] == 0
    found = clearance_of(free, grid.cell)[within]
    return np.minimum(found, np.float32(farthest_of(windows, grid)))
