"""Where to fly while no place is known."""

from __future__ import annotations

import math
from collections.abc import Iterator

from alight.arrays import F64


def square_spiral(centre: F64, side: float, lane: float) -> Iterator[tuple[float, float]]:
    """Corners of a square spiral outwards, to the rim of a square: what is near the start comes first.

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
