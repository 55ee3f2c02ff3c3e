"""Where to fly while no place is known."""

from __future__ import annotations

from collections.abc import Iterator

from alight.arrays import F64


def square_spiral(centre: F64, side: float, lane: float) -> Iterator[tuple[float, float]]:
    """Corners of a square spiral outwards, until it has covered a square: what is near the start comes first.

    Args:
        centre: (2,) or (3,) metres.
        side: metres, of the square.
        lane: metres between neighbouring turns.
    """
    east, north = float(centre[0]), float(centre[1])
    yield east, north
    length, steps = lane, [(0.0, 1.0), (1.0, 0.0), (0.0, -1.0), (-1.0, 0.0)]
    k = 0
    while length <= side + lane / 2:
        for _ in range(2):
            east, north = east + steps[k % 4][0] * length, north + steps[k % 4][1] * length
            yield east, north
            k += 1
        length += lane
    yield east + steps[k % 4][0] * (length - lane), north + steps[k % 4][1] * (length - lane)
