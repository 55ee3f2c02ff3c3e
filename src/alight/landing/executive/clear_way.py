"""How high a way must be flown so that nothing stands in it."""

from __future__ import annotations

import math

import numpy as np

from alight.arrays import F64
from alight.landing.route import lowest_clear, standing
from alight.records.executive import Seen
from alight.settings import StageSettings


class ClearWay:
    """Heights of ways over the newest map.

    A long way over ground that is not all mapped is flown at the height of the search.
    """

    def __init__(self, settings: StageSettings) -> None:
        self._keys, self._clearance = settings.executive, settings.route.clearance
        self._number = -1  # of the verdict
        self._top: F64 = np.empty((0, 0))  # (R, C) metres: what stands on its map

    def level(self, start: F64, to: F64, seen: Seen) -> float:
        """Metres up at which the way from above one point (3,) to above another is clear."""
        if seen.number != self._number:
            self._number, self._top = seen.number, standing(seen.elevation)
        least, unknown = lowest_clear(start, to, seen.elevation.grid, self._top, self._clearance)
        is_long = math.hypot(to[0] - start[0], to[1] - start[1]) > self._keys.long_way
        if is_long and unknown > self._keys.unmapped:
            least = max(least, seen.ground + self._keys.search_height)
        return least
