"""One map of the ground in levels with cells of `cell * 2**level` metres.

A coarse level holds the means of the finer levels where these have heights. A finer level is initialised from the
coarser one. So each level is the best map at its cell size, except where the ground was only seen coarsely.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from alight.elevation.levels import double_fields, halve_fields
from alight.elevation.tiles import FIELDS, Fields, TileLayer, TileStore, is_seen
from alight.geometry import Grid, box_of
from alight.records import ElevationMap, Heights, is_trusted
from alight.settings.tuning import ElevationTuning


def better(new: Fields, old: Fields) -> NDArray[np.bool_]:
    """Return the mask of cells whose new height replaces the old one.

    A seen height replaces an unseen one, and a trusted height replaces a refused one. Otherwise the smaller sigma wins.
    """
    new_ok, old_ok = is_trusted(new["flags"]), is_trusted(old["flags"])
    smaller = ~(np.nan_to_num(new["sigma"], nan=np.inf) >= np.nan_to_num(old["sigma"], nan=np.inf))
    fresh = ~is_seen(old["flags"])
    return np.asarray(is_seen(new["flags"]) & (fresh | (new_ok & ~old_ok) | ((new_ok == old_ok) & smaller)))


class TiledElevation:
    """Elevation map of several levels; a level is created when it is first used.

    Args:
        cell: cell size of level 0, metres.
        side: side of a tile, cells.
        far: store for packed tiles far from the vehicle; None: a dict.
        tuning: constants for the fusion of heights of different cell sizes; None: the defaults.
    """

    def __init__(
        self, cell: float, side: int, far: TileStore | None = None, tuning: ElevationTuning | None = None
    ) -> None:
        self.cell, self.side, self._tuning = cell, side, tuning or ElevationTuning()
        self._far: TileStore = {} if far is None else far
        self.layers = {0: TileLayer(0, cell, side, self._far)}

    # -- rasters

    def cell_at(self, level: int) -> float:
        """Return the cell size of a level, metres."""
        return math.ldexp(self.cell, level)

    def layer(self, level: int = 0) -> TileLayer:
        """Return the layer of a level; create it, and the layers between it and the existing ones, if missing."""
        while level < (finest := min(self.layers)):
            self._open(finest - 1)
        while level > (coarsest := max(self.layers)):
            self._open(coarsest + 1)
            below = self.layers[coarsest]
            for key in (*below.near, *below.packed):
                self._pass_on(below, below.tile_grid(key))
        return self.layers[level]

    def _open(self, level: int) -> None:
        self.layers[level] = TileLayer(level, self.cell_at(level), self.side, self._far)

    def _layer_of(self, grid: Grid) -> TileLayer:
        return self.layer(round(math.log2(grid.cell / self.cell)))

    # -- content

    def add(self, heights: Heights, replace_all: bool = False) -> None:
        """Fuse one step: each cell keeps the better height (see `better`), or any new seen height if `replace_all`."""
        layer, new = self._layer_of(heights.grid), {k: getattr(heights, k) for k in FIELDS}
        seen = is_seen(new["flags"])
        take = seen if replace_all else better(new, self._known(layer, heights.grid, self._tuning.less_sure))
        box = box_of(take)
        if take[box].size:
            grid = heights.grid.part(box)
            layer.write(grid, {k: v[box] for k, v in new.items()}, take[box])
            while layer.level < max(self.layers):
                grid = self._pass_on(layer, grid)
                layer = self.layers[layer.level + 1]

    def _pass_on(self, layer: TileLayer, grid: Grid) -> Grid:
        """Write 2 x 2 means of a layer's cells on a grid into the next coarser layer; return the coarse grid."""
        south, north, west, east = (n // 2 for n in layer.numbers(grid))
        means = halve_fields(layer.read(layer.cells(2 * south, 2 * north + 1, 2 * west, 2 * east + 1)))
        coarser = self.layers[layer.level + 1]
        above = coarser.cells(south, north, west, east)
        coarser.write(above, means, is_seen(means["flags"]))
        return above

    def _known(self, layer: TileLayer, grid: Grid, inflation: float) -> Fields:
        """Return the layer's fields on a grid; unseen cells come from coarser layers, with sigma times `inflation`.

        The factor is applied once per level.
        """
        out = layer.read(grid)
        seen = is_seen(out["flags"])
        coarser = self.layers.get(layer.level + 1)
        if coarser is None or seen.all():
            return out
        south, north, west, east = layer.numbers(grid)
        around = south // 2 - 1, north // 2 + 1, west // 2 - 1, east // 2 + 1
        coarse = self._known(coarser, coarser.cells(*around), inflation)
        if not is_seen(coarse["flags"]).any():
            return out
        r, c = 2 * around[1] + 1 - north, west - 2 * around[2]
        for k, v in double_fields(coarse, np.float32(inflation)).items():
            out[k][~seen] = v[r : r + grid.rows, c : c + grid.cols][~seen]
        return out

    def add_plane(self, plane: NDArray[np.float64], about: NDArray[np.float64]) -> None:
        """Add a plane to the heights of all tiles in memory; see `plane_on` for `plane` (3,) and `about` (2,)."""
        for layer in self.layers.values():
            layer.add_plane(plane, about)

    def read(self, grid: Grid) -> ElevationMap:
        """Return a copy of the best heights on a grid of whole cells of any level."""
        return ElevationMap(grid, **self._known(self._layer_of(grid), grid, 1.0))  # type: ignore[arg-type]

    def start(self, grid: Grid) -> ElevationMap:
        """Return the heights from which a parallax step starts: `read`, with inflated sigma from coarser levels."""
        inflated = self._known(self._layer_of(grid), grid, self._tuning.less_sure)
        return ElevationMap(grid, **inflated)  # type: ignore[arg-type]

    def roll(self, centre: tuple[float, float], radius: float) -> None:
        """Pack the tiles farther than `radius` metres from `centre` (east, north), so that memory stays bounded."""
        for layer in self.layers.values():
            layer.roll(centre, radius)

    def snapshot(self, most_cells: int | None = None) -> ElevationMap | None:
        """Return the map of all seen ground, with even numbers of rows and columns; None if nothing was seen.

        The level is the finest one with at least `least_share` of the largest seen area. It is a coarser level if the
        map would otherwise have more than `most_cells` cells.
        """
        boxes = {level: box for level, layer in self.layers.items() if (box := layer.box())}
        if not boxes:
            return None
        area = {level: self.layers[level].count() * 4.0**level for level in boxes}
        level = min(k for k in boxes if area[k] >= self._tuning.least_share * max(area.values()))
        while most_cells and _size(at := _about(boxes, level)) > most_cells and min(at[1] - at[0], at[3] - at[2]) > 1:
            level += 1
        return self.read(self.layer(level).cells(*_about(boxes, level)))


def _about(boxes: dict[int, tuple[int, int, int, int]], level: int) -> tuple[int, int, int, int]:
    """Return the rectangle around boxes of several levels, in cell numbers of `level`, with even rows and columns.

    `boxes`: by level, as from `TileLayer.box`.
    """
    scale = {k: 2.0 ** (k - level) for k in boxes}
    south, west = (min(math.floor(b[i] * scale[k]) for k, b in boxes.items()) for i in (0, 2))
    north, east = (max(math.ceil((b[i] + 1) * scale[k]) - 1 for k, b in boxes.items()) for i in (1, 3))
    return south & ~1, north | 1, west & ~1, east | 1  # even, as land cover is estimated on cells of twice the size


def _size(box: tuple[int, int, int, int]) -> int:
    return (box[1] - box[0] + 1) * (box[3] - box[2] + 1)
