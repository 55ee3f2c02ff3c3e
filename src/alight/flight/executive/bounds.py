"""The region in which the vehicle's disc must stay, such as the autopilot's fence: places, ways, and ways around."""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np
from scipy.sparse import csgraph, csr_matrix
from scipy.spatial import KDTree

from alight.arrays import F64, I64
from alight.geometry.zones import EVERYWHERE, Region
from alight.settings import StageSettings

CELLS = 161  # along each side of the square in which ways around are planned


class Bounds:
    """Keeps the vehicle's disc in a region. Positions are (2,) or (3,) metres in the map frame.

    The disc keeps `tuning.executive.fence_margin` from the border at the end of every way, and half of it on the way,
    as no vehicle flies exactly straight. Ways around are planned over the cells of a grid that the vehicle can reach
    from its start.

    Args:
        settings: settings of the landing.
        region: the region, in a plane of its own; `shift` leads there from the map frame.
        start: (2,) metres in that plane, where the vehicle begins.
    """

    def __init__(self, settings: StageSettings, region: Region = EVERYWHERE, start: F64 | None = None) -> None:
        self._region, self._start = region, np.zeros(2) if start is None else start
        self._disc, margin = settings.lander.reach, settings.executive.fence_margin
        self._on_way, self._at_end = self._disc + 0.5 * margin, self._disc + margin  # m of room
        self._reach = 2.0 * settings.executive.search_side
        self._cell = 2.0 * self._reach / (CELLS - 1)
        self.shift = np.zeros(2)  # m
        self._onward: tuple[int, I64] = -1, np.zeros(0, np.int64)  # a goal, and the next cell there from each cell

    # -- places and straight ways

    def is_inside(self, place: F64) -> bool:
        """Whether the vehicle can fly to a place and keeps the whole margin there."""
        at = place[:2] + self.shift
        if not self._region.zones or not self._region.has_room(at, at, self._at_end):
            return not self._region.zones
        away, cell = self._tree.query(at)
        return away <= 2.0 * self._cell and self._region.has_room(self._cells[cell], at, self._on_way)

    def is_free(self, start: F64, to: F64) -> bool:
        """Whether the vehicle keeps half the margin on the whole straight way from `start` to `to`."""
        return self._region.has_room(start[:2] + self.shift, to[:2] + self.shift, self._on_way)

    def has_disc(self, place: F64) -> bool:
        """Whether the vehicle's disc is in the region at a place, with or without a margin."""
        return self._region.has_room(place[:2] + self.shift, place[:2] + self.shift, self._disc)

    def limit(self, place: F64) -> str:
        """Return the name of the zone that leaves a place the least room."""
        return self._region.limit(place[:2] + self.shift)

    def objection(self, place: F64) -> str:
        """Return why the vehicle cannot fly to a place, in words; empty: it can."""
        far = math.dist(place[:2] + self.shift, self._start)
        if far > self._reach:
            return f"{far:.0f} m away, more than twice executive.search_side"
        return "" if self.is_inside(place) else f"outside the fence ({self.limit(place)})"

    def nearest(self, place: F64) -> F64:
        """Return the place, (2,) metres, or the nearest one that the vehicle can fly to."""
        if self.is_inside(place) or not len(self._cells):
            return place[:2]
        return np.asarray(self._cells[self._tree.query(place[:2] + self.shift)[1]] - self.shift)

    def share(self, side: float) -> float:
        """Return the share of the square about the start, of the given side in metres, that the vehicle can fly to."""
        within = (np.abs(self._cells - self._start).max(axis=1, initial=0.0) <= 0.5 * side).sum()
        return min(1.0, float(within) / (2 * int(0.5 * side / self._cell) + 1) ** 2) if self._region.zones else 1.0

    # -- ways around

    def next_point(self, position: F64, to: F64) -> F64:
        """Return `to`, (3,) metres, or the farthest point on the shortest way there to which a straight way is free."""
        if self.is_free(position, to) or not len(self._cells):
            return to
        begin, goal = (int(self._tree.query(p[:2] + self.shift)[1]) for p in (position, to))
        if self._onward[0] != goal:
            found = csgraph.dijkstra(self._graph, directed=False, indices=goal, return_predecessors=True)
            self._onward = goal, found[1]
        way = [begin]
        while way[-1] != goal:
            way.append(int(self._onward[1][way[-1]]))
        corners = [np.array([*(self._cells[i] - self.shift), to[2]]) for i in reversed(way)]
        return next((c for c in corners if self.is_free(position, c)), corners[-1])

    @cached_property
    def _cells(self) -> F64:
        """Cells, (N, 2) metres in the plane of the region, that the vehicle can reach over neighbouring cells."""
        along = np.linspace(-self._reach, self._reach, CELLS)
        rows = self._start + np.stack(np.meshgrid(along, along), axis=-1)
        room = max(self._at_end, self._on_way + math.sqrt(0.5) * self._cell)  # the way between two neighbours has less
        roomy = np.concatenate([row[self._region.room(row) >= room] for row in rows])
        if not len(roomy):
            return roomy
        _, parts = csgraph.connected_components(_neighbours(roomy, self._cell), directed=False)
        begin = np.linalg.norm(roomy - self._start, axis=1).argmin()
        return np.asarray(roomy[parts == parts[begin]])

    @cached_property
    def _tree(self) -> KDTree:
        return KDTree(self._cells)

    @cached_property
    def _graph(self) -> csr_matrix:
        return _neighbours(self._cells, self._cell)


def _neighbours(cells: F64, cell: float) -> csr_matrix:
    """Return the distances, metres, between each of the cells, (N, 2), and its eight neighbours as an (N, N) matrix."""
    tree = KDTree(cells)
    return csr_matrix(tree.sparse_distance_matrix(tree, 1.5 * cell, output_type="coo_matrix"))
