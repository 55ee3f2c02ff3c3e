"""Where the vehicle's disc must stay, by the autopilot's fence and the user's zones: places, ways, and ways around."""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np
from scipy.sparse import csgraph, csr_matrix
from scipy.spatial import KDTree

from alight.arrays import F64, I64
from alight.geometry.zones import EVERYWHERE, Region
from alight.records.executive import MapVerdict
from alight.records.zones import NO_ZONES, ZonesOnPlane
from alight.settings import StageSettings

CELLS = 161  # along each side of the square in which ways around are planned
TOUCHDOWN = -math.inf  # metres up, below every floor of a zone


class Bounds:
    """Keeps the vehicle's disc in a region. Positions are (2,) or (3,) metres in the map frame.

    The disc keeps `tuning.executive.fence_margin` from the border at the end of every way, and half of it on the way,
    as no vehicle flies exactly straight. A keep-out zone may be crossed from half the margin above its floor. So there
    is one region for each range of heights between floors, and one for touchdowns. Ways around are planned over the
    cells of a grid.

    Args:
        settings: settings of the landing.
        fence: region of the autopilot's fence, in a plane of its own; `shift` leads there from the map frame.
        start: (2,) metres in that plane, where the vehicle begins.
        zones: the user's zones, in that plane.
    """

    def __init__(
        self, settings: StageSettings, fence: Region = EVERYWHERE, start: F64 | None = None,
        zones: ZonesOnPlane = NO_ZONES,
    ) -> None:  # fmt: skip
        self._start = np.zeros(2) if start is None else start
        self._disc, margin = settings.lander.reach, settings.executive.fence_margin
        self._on_way, self._at_end = self._disc + 0.5 * margin, self._disc + margin  # m of room
        self.search_height = settings.executive.search_height  # metres above the ground, of the present search
        # m: the lowest search, and over what is in doubt; maps seek trees half as high
        self.lowest = max(2.0 * settings.mapping.trees, settings.executive.commit_height)
        self._arrived = settings.executive.arrived
        self._reach = 2.0 * settings.executive.search_side
        self._fence, self._zones = fence, zones.around(self._start, self._reach)
        self._looks = Region(tuple(z for z in self._zones.limits(TOUCHDOWN, self._start) if z.keeps_in))
        floors = {z.floor for z in self._zones.of("keep-out")} - {0.0}
        self._floors = np.array([0.0, *sorted(floors)])  # m
        self._layers: dict[float, _Layer] = {}
        self._seen: tuple[int, float, float] | None = None  # newest verdict: number, highest ground, ground
        self.shift = np.zeros(2)  # m

    def observe(self, seen: MapVerdict | None) -> None:
        """Take heights above the ground from a verdict; None: the ground is not known, and no floor is flown over."""
        if seen is None or self._seen is None or self._seen[0] != seen.number:
            self._seen = None
            if seen is not None:
                heights = seen.elevation.height[seen.elevation.trusted] if len(self._floors) > 1 else np.zeros(0)
                highest = max(seen.ground, float(np.percentile(heights, 95))) if heights.size else seen.ground
                self._seen = seen.number, highest, seen.ground

    def _layer(self, up: float) -> _Layer:
        """Return the layer of ways at the height `up`, metres; TOUCHDOWN: of touchdowns."""
        floor = up
        if up != TOUCHDOWN:
            above = -math.inf if self._seen is None else up - self._seen[1] - (self._on_way - self._disc)
            floor = float(self._floors[max(int(np.searchsorted(self._floors, above, "right")) - 1, 0)])
        if floor not in self._layers:
            limits = self._zones.limits(floor, self._start)
            region = Region((*self._fence.zones, *limits))
            self._layers[floor] = _Layer(region, self._start, self._reach, self._on_way, self._at_end)
        return self._layers[floor]

    @property
    def _search(self) -> _Layer:
        """The layer of the height of the search; the vehicle may fly a little lower."""
        return self._layer(0.0 if self._seen is None else self._level - self._arrived)

    @property
    def _level(self) -> float:
        """Height of the search, metres up; minus infinity: the ground is not known."""
        return -math.inf if self._seen is None else self._seen[2] + self.search_height

    # -- places and straight ways

    def is_inside(self, point: F64) -> bool:
        """Whether the vehicle can fly to a point, (3,) metres, and keeps the whole margin there."""
        return self._can_fly(point, self._layer(float(point[2])))

    def allows_site(self, place: F64) -> bool:
        """Whether the vehicle can fly to a place and land there, with the whole margin."""
        return self._can_fly(place, self._layer(TOUCHDOWN))

    def _can_fly(self, to: F64, layer: _Layer) -> bool:
        at, search = to[:2] + self.shift, self._search
        roomy = all(region.has_room(at, at, self._at_end) for region in (layer.region, self._looks))
        return roomy and (not search.region.zones or search.reaches(at))

    def is_free(self, start: F64, to: F64) -> bool:
        """Whether the vehicle keeps half the margin on the whole straight way from `start` to `to`, (3,) metres."""
        layer = self._layer(min(float(start[2]), float(to[2])))
        return layer.region.has_room(start[:2] + self.shift, to[:2] + self.shift, self._on_way)

    def has_disc(self, place: F64) -> bool:
        """Whether the vehicle's disc may touch down at a place, with or without a margin."""
        return self._layer(TOUCHDOWN).region.has_room(place[:2] + self.shift, place[:2] + self.shift, self._disc)

    def limit(self, place: F64) -> str:
        """Return the name of the zone that leaves a touchdown at a place the least room."""
        return self._layer(TOUCHDOWN).region.limit(place[:2] + self.shift)

    def objection(self, place: F64) -> str:
        """Return why the vehicle cannot land at a place, in words; empty: it can."""
        far = math.dist(place[:2] + self.shift, self._start)
        if far > self._reach:
            return f"{far:.0f} m away, more than twice executive.search_side"
        return "" if self.allows_site(place) else f"outside the {self.name} ({self.limit(place)})"

    @property
    def name(self) -> str:
        """What the bounds are made of, in words."""
        return "fence" if not self._zones.zones else "fence and zones" if self._fence.zones else "zones"

    def nearest(self, place: F64) -> F64:
        """Return the place, (2,) metres, or the nearest one above which the vehicle can search."""
        cells = self._searched
        if self._can_fly(place, self._search) or not len(cells):
            return place[:2]
        return np.asarray(cells[np.linalg.norm(cells - (place[:2] + self.shift), axis=1).argmin()] - self.shift)

    def share(self, side: float) -> float:
        """Return the share of the square about the start, of the given side in metres, that the vehicle can search."""
        if not (self._search.region.zones or self._looks.zones):
            return 1.0
        within = (np.abs(self._searched - self._start).max(axis=1, initial=0.0) <= 0.5 * side).sum()
        return min(1.0, float(within) / (2 * int(0.5 * side / self._search.cell) + 1) ** 2)

    @property
    def _searched(self) -> F64:
        """Cells, (N, 2) metres in the plane of the fence, from which the vehicle can look for places."""
        cells = self._search.cells
        return cells[self._looks.with_room(cells, self._at_end)]

    # -- ways around

    def next_point(self, position: F64, to: F64) -> F64:
        """Return `to`, (3,) metres, or the next point on a way there to which a straight way is free.

        Where the floor of a zone forbids the straight way, the way around is flown as low. If there is none, the
        vehicle climbs to at least the height of the search, and comes down when it is above `to`.
        """
        if self.is_free(position, to):
            return to
        at, goal = position[:2] + self.shift, to[:2] + self.shift
        level = max(float(position[2]), float(to[2]), self._level)
        low, high = self._layer(min(float(position[2]), float(to[2]))), self._layer(level - self._arrived)
        if low is not high and not (low.reaches(at) and low.reaches(goal)):
            if position[2] < level - self._arrived:
                return np.array([*position[:2], level])
            low, to = high, np.array([*to[:2], level])
            if high.region.has_room(at, goal, self._on_way):
                return to
        corner = low.corner(at, goal)
        return to if corner is None else np.array([*(corner - self.shift), to[2]])


class _Layer:
    """A region, and the ways around in it, over cells that can be reached from a start.

    Args:
        region: the region.
        start: (2,) metres.
        reach: metres to each side of the start in which ways are planned.
        on_way, at_end: room that the disc needs on a way and at its end, metres.
    """

    def __init__(self, region: Region, start: F64, reach: float, on_way: float, at_end: float) -> None:
        self.region, self._start, self._reach, self._on_way, self._at_end = region, start, reach, on_way, at_end
        self.cell = 2.0 * reach / (CELLS - 1)  # metres
        self._onward: tuple[int, I64] = -1, np.zeros(0, np.int64)  # a goal, and the next cell there from each cell

    def reaches(self, at: F64) -> bool:
        """Whether a short straight way leads from a place, (2,) metres, to one of the cells."""
        away, cell = self._tree.query(at)
        return away <= 2.0 * self.cell and self.region.has_room(self.cells[cell], at, self._on_way)

    def corner(self, at: F64, goal: F64) -> F64 | None:
        """Return the farthest point to which a straight way is free on the shortest way; None: there is no way.

        `at`, `goal`: (2,) metres; without a cell there, the nearest cell is taken.
        """
        if not len(self.cells):
            return None
        begin, end = (int(self._tree.query(p)[1]) for p in (at, goal))
        if self._onward[0] != end:
            found = csgraph.dijkstra(self._graph, directed=False, indices=end, return_predecessors=True)
            self._onward = end, found[1]
        way = [begin]
        while way[-1] != end:
            way.append(int(self._onward[1][way[-1]]))
        corners = self.cells[way[::-1]]
        return np.asarray(next((c for c in corners if self.region.has_room(at, c, self._on_way)), corners[-1]))

    @cached_property
    def cells(self) -> F64:
        """Cells, (N, 2) metres, that the vehicle can reach over neighbouring cells."""
        along = np.linspace(-self._reach, self._reach, CELLS)
        cells = (self._start + np.stack(np.meshgrid(along, along), axis=-1)).reshape(-1, 2)
        room = max(self._at_end, self._on_way + math.sqrt(0.5) * self.cell)  # the way between two neighbours has less
        roomy = cells[self.region.with_room(cells, room)]
        if not len(roomy):
            return roomy
        _, parts = csgraph.connected_components(_neighbours(roomy, self.cell), directed=False)
        begin = np.linalg.norm(roomy - self._start, axis=1).argmin()
        return np.asarray(roomy[parts == parts[begin]])

    @cached_property
    def _tree(self) -> KDTree:
        return KDTree(self.cells)

    @cached_property
    def _graph(self) -> csr_matrix:
        return _neighbours(self.cells, self.cell)


def _neighbours(cells: F64, cell: float) -> csr_matrix:
    """Return the distances, metres, between each of the cells, (N, 2), and its eight neighbours as an (N, N) matrix."""
    tree = KDTree(cells)
    return csr_matrix(tree.sparse_distance_matrix(tree, 1.5 * cell, output_type="coo_matrix"))
