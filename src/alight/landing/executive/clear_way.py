"""How high a way must be flown so that nothing stands in it."""

from __future__ import annotations

import math

from alight.arrays import F64
from alight.landing.route import Obstructions, way_below
from alight.records.executive import Seen
from alight.settings import StageSettings


class ClearWay:
    """Heights of ways over the newest map.

    A long way is flown at the height of the search over ground that is not all mapped, and where something stands whose
    height is in doubt: of a tree 10 m high most of the map said 3 m, and a landing flew into it.
    """

    def __init__(self, settings: StageSettings) -> None:
        self._keys, self._clearance = settings.executive, settings.route.clearance
        self._number = -1  # of the verdict
        self._obstructions: Obstructions | None = None  # on its map

    def level(self, start: F64, to: F64, seen: Seen) -> float:
        """Metres up at which the way from above one point (3,) to above another is clear."""
        if self._obstructions is None or seen.number != self._number:
            self._number, self._obstructions = seen.number, Obstructions.of(seen.elevation)
        grid, k = seen.elevation.grid, self._keys
        below = way_below(start, to, grid, self._obstructions, self._clearance, k.rise)
        is_long = math.hypot(to[0] - start[0], to[1] - start[1]) > k.long_way
        untold = below.unmapped > k.unmapped or below.doubtful > k.risen
        return max(below.clear, seen.ground + k.search_height) if is_long and untold else below.clear
