"""Lanes to fly while no place is known."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from alight.arrays import F64
from alight.settings import ExecutiveSettings

ASPECT = 0.75  # shorter side of the ground in a picture, over the height


class SearchLanes:
    """The lanes of a search, one after the other.

    The outermost lies so far inside that its pictures reach the rim of the searched square.

    Args:
        home: (3,) metres, the middle of the square; at the search height above the ground, as far as known.
    """

    def __init__(self, home: F64, keys: ExecutiveSettings) -> None:
        shown = keys.search_height * ASPECT
        self._corners = square_spiral(home, max(keys.search_side - shown, 0.0), keys.lane * shown)
        self._arrived = keys.arrived
        self._height, self._ground = keys.search_height, float(home[2]) - keys.search_height
        self._corner = next(self._corners)
        self.over = False  # True: all was searched

    def end(self, ground: float | None) -> F64:
        """(3,) metres, the end of this lane, at the search height above the known ground."""
        return np.array([*self._corner, (self._ground if ground is None else ground) + self._height])

    def fly(self, position: F64 | None, ground: float | None) -> None:
        """Begin the next lane where the end of this one is reached, or end the search.

        The end counts from above it as well: a tall obstacle may stand beside it.

        Args:
            position: (3,) metres, of the vehicle; None: not known.
            ground: metres up, as far as known.
        """
        if position is None:
            return
        left, near = self.end(ground) - position, self._arrived
        if math.hypot(left[0], left[1]) < near and left[2] < near:
            corner = next(self._corners, None)
            self._corner, self.over = corner or self._corner, corner is None


def square_spiral(centre: F64, side: float, lane: float) -> Iterator[tuple[float, float]]:
    """Corners of a square spiral outwards, to the rim of a square: ground near the start comes first.

    Args:
        centre: (2,) or (3,) metres, of the square.
        side: metres, of the square.
        lane: metres between neighbouring turns, at most: they are spread evenly.
    """
    turns = max(1, math.ceil(side / lane - 1e-9))
    lane = side / turns
    begin = -0.5 * lane if turns % 2 else 0.0  # an odd number of turns ends half a lane off its beginning
    east, north = float(centre[0]) + begin, float(centre[1]) + begin
    yield east, north
    steps = [(0.0, 1.0), (1.0, 0.0), (0.0, -1.0), (-1.0, 0.0)]
    for k, length in enumerate([lane * n for n in range(1, turns + 1) for _ in range(2)] + [side]):
        east, north = east + steps[k % 4][0] * length, north + steps[k % 4][1] * length
        yield east, north
