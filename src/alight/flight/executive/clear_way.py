"""Ways free of obstacles: the height of a level way, and a leg across a place low down."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from alight.arrays import F64
from alight.flight.executive.look_leg import LookLeg
from alight.landing.route import Obstructions, along_way, way_below
from alight.records import Site
from alight.records.executive import MapVerdict
from alight.settings import StageSettings

TURNS = tuple(math.radians(angle) for angle in (0, 45, -45, 90, -90, 135, -135, 180))  # of a look leg, tried in turn
WIDE = 2.0  # times the vehicle's radius, least distance from its middle to an obstacle beside it
ROOMY = 2.0  # times that distance, preferred if some leg has it: a gust carries the vehicle metres off its way
LOW = 0.5  # of its height: most clearance of a look leg above obstacles beside it


class ClearWay:
    """Ways over the newest map.

    A way over obstacles of doubtful height is flown at the height of the search: the map had 3 m for most of a tree
    of 10 m, and a landing flew into it. So is a long way over ground that is not all mapped. A place is not crossed
    low down beside anything tall, whatever its height in the map.
    """

    def __init__(self, settings: StageSettings) -> None:
        self._keys, self._clearance, lander = settings.executive, settings.route.clearance, settings.lander
        self._beside = max(self._clearance, WIDE * max(lander.radius, lander.rotor_radius or 0.0))
        self._number = -1  # of the verdict
        self._obstructions: Obstructions | None = None  # on its map

    def level(self, start: F64, to: F64, seen: MapVerdict, at_a_place: bool = False) -> float:
        """Metres up at which the way from above one point (3,) to above another is clear.

        `at_a_place`: it leads from one look at a place to the next, and only mapped obstacles count.
        """
        grid, k = seen.elevation.grid, self._keys
        below = way_below(start, to, grid, self._obstructions_of(seen), self._clearance, self._beside, k.rise)
        is_long = math.hypot(to[0] - start[0], to[1] - start[1]) > k.long_way
        untold = below.doubtful > k.risen or (is_long and below.unmapped > k.unmapped)
        return max(below.clear, seen.ground + k.search_height) if untold and not at_a_place else below.clear

    def turned(self, leg: LookLeg, ground: float, seen: MapVerdict) -> LookLeg | None:
        """Turn a leg as little as possible, so that no obstacle stands beside it, at `ROOMY` times that if possible.

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

    def is_open(self, leg: LookLeg, ground: float, seen: MapVerdict, times: float = 1.0) -> bool:
        """True if a leg is free from end to end, wherever the vehicle joins it; arguments as of `is_free`."""
        return self.is_free(2 * leg.place - leg.end, leg.end, ground, seen, times)

    def is_free(self, start: F64, to: F64, ground: float, seen: MapVerdict, times: float = 1.0) -> bool:
        """True if a level way (3,) near a place may be flown: no obstacle beside it is tall, or reaches up to the way.

        "Tall" means a rise by more than `executive.rise`. "Beside" means within `route.clearance`, or twice the
        lander's radius if that is more, times `times`.
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

    def is_free_down(self, place: Site, seen: MapVerdict) -> bool:
        """True if nothing tall stands beside the way down on a place, as beside the lowest look at it."""
        above = np.array([place.east, place.north, place.up + self._keys.commit_height])
        return self.is_free(above, above, place.up, seen)

    def _obstructions_of(self, seen: MapVerdict) -> Obstructions:
        if self._obstructions is None or seen.number != self._number:
            self._number, self._obstructions = seen.number, Obstructions.of(seen.elevation)
        return self._obstructions
