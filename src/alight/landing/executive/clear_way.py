"""Ways that nothing stands in: how high one must be flown, and how a place can be crossed low down."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from alight.arrays import F64
from alight.landing.executive.look_leg import LookLeg
from alight.landing.route import Obstructions, along_way, way_below
from alight.records.executive import Seen
from alight.settings import StageSettings

TURNS = tuple(math.radians(angle) for angle in (0, 45, -45, 90, -90, 135, -135, 180))  # of a look leg, tried in turn
WIDE = 2.0  # times the vehicle's radius, from its middle to what stands beside it, at least
ROOMY = 2.0  # times that distance, where some leg leaves so much: a gust carries the vehicle metres off its way
LOW = 0.5  # of its height, at the most: the clearance of a look leg above what stands beside it


class ClearWay:
    """Ways over the newest map.

    A way is flown at the height of the search where something stands whose height is in doubt: of a tree 10 m high most
    of the map said 3 m, and a landing flew into it. A long one is so, too, over ground that is not all mapped. Nor is a
    place crossed low down beside anything tall, however high the map says that it is.
    """

    def __init__(self, settings: StageSettings) -> None:
        self._keys, self._clearance, lander = settings.executive, settings.route.clearance, settings.lander
        self._beside = max(self._clearance, WIDE * max(lander.radius, lander.rotor_radius or 0.0))
        self._number = -1  # of the verdict
        self._obstructions: Obstructions | None = None  # on its map

    def level(self, start: F64, to: F64, seen: Seen, at_a_place: bool = False) -> float:
        """Metres up at which the way from above one point (3,) to above another is clear.

        `at_a_place`: it leads from one look at a place to the next, and only what is mapped counts.
        """
        grid, k = seen.elevation.grid, self._keys
        below = way_below(start, to, grid, self._obstructions_of(seen), self._clearance, self._beside, k.rise)
        is_long = math.hypot(to[0] - start[0], to[1] - start[1]) > k.long_way
        untold = below.doubtful > k.risen or (is_long and below.unmapped > k.unmapped)
        return max(below.clear, seen.ground + k.search_height) if untold and not at_a_place else below.clear

    def turned(self, leg: LookLeg, ground: float, seen: Seen) -> LookLeg | None:
        """Turn a leg as little as it takes for nothing to stand beside it, nor `ROOMY` times as far where it can be.

        None: something stands beside it, whichever way it is turned.

        Args:
            leg: across a place.
            ground: metres up, of the place.
            seen: the newest verdict.
        """
        free: LookLeg | None = None
        for turned in (replace(leg, turned=turn) for turn in TURNS):
            if self.is_open(turned, ground, seen, ROOMY):
                return turned
            if free is None and self.is_open(turned, ground, seen):
                free = turned
        return free

    def is_open(self, leg: LookLeg, ground: float, seen: Seen, times: float = 1.0) -> bool:
        """Whether a leg is free from end to end, wherever on it the vehicle joins it; arguments as of `is_free`."""
        return self.is_free(2 * leg.place - leg.end, leg.end, ground, seen, times)

    def is_free(self, start: F64, to: F64, ground: float, seen: Seen, times: float = 1.0) -> bool:
        """Whether a level way (3,) near a place may be flown: beside it nothing is tall, or reaches up to the way.

        Tall is what rises by more than `executive.rise`; beside the way is within `route.clearance`, or twice the
        lander's radius if that is more; or `times` that.
        """
        grid, width = seen.elevation.grid, times * self._beside
        reach = width + 0.5 * math.hypot(to[0] - start[0], to[1] - start[1])
        middle = 0.5 * (start + to)
        row, col = (float(i) for i in grid.index(middle[0], middle[1]))
        k = math.ceil(reach / grid.cell) + 1
        rows, cols = (
            slice(max(int(row) - k, 0), max(int(row) + k + 1, 0)),
            slice(max(int(col) - k, 0), max(int(col) + k + 1, 0)),
        )
        top = self._obstructions_of(seen).top[rows, cols]
        _, near = along_way(start, to, grid.window(rows.start, cols.start, *top.shape), width)
        spare = min(self._clearance, LOW * (float(start[2]) - ground))
        highest = float(np.max(top[near & np.isfinite(top)], initial=-math.inf))
        return highest <= min(ground + self._keys.rise, float(start[2]) - spare)

    def _obstructions_of(self, seen: Seen) -> Obstructions:
        if self._obstructions is None or seen.number != self._number:
            self._number, self._obstructions = seen.number, Obstructions.of(seen.elevation)
        return self._obstructions
