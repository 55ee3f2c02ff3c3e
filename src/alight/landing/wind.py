"""Wind on the ways of a landing: speed over the ground, and the side from which to come."""

from __future__ import annotations

import math

import numpy as np

from alight.arrays import F64

SLOWEST = 0.5  # m/s over the ground, however strong the wind, so that the vehicle arrives


def ground_speed(way: F64, wind: F64 | None, wanted: float, most_air_speed: float) -> float:
    """Speed over the ground along a way that keeps the speed through the air within its limit.

    Args:
        way: (2,) or (3,) metres, world; its level part counts.
        wind: (2,) or (3,) m/s, where the air goes; None: not known.
        wanted: m/s over the ground without wind.
        most_air_speed: m/s.

    Returns:
        m/s, at most `wanted`; `SLOWEST` where the wind leaves no more.
    """
    along, across = _parts(way, wind)
    left = most_air_speed**2 - across**2
    most = along + math.sqrt(left) if left > 0.0 else 0.0
    return min(wanted, max(most, SLOWEST))


def is_from_behind(way: F64, wind: F64 | None, calm: float) -> bool:
    """True if the wind along a way comes from behind, by more than `calm` m/s: no way to descend on."""
    return _parts(way, wind)[0] > calm


def downwind(wind: F64 | None, calm: float) -> F64 | None:
    """(2,) unit vector, where the air goes; None where the wind is not known or weaker than `calm` m/s."""
    if wind is None:
        return None
    speed = math.hypot(float(wind[0]), float(wind[1]))
    return np.asarray(wind[:2] / speed, np.float64) if speed > calm else None


def _parts(way: F64, wind: F64 | None) -> tuple[float, float]:
    """The wind along a way, from behind positive, and across it, m/s."""
    length = math.hypot(float(way[0]), float(way[1]))
    if wind is None or length < 1e-6:
        return 0.0, 0.0
    east, north = float(way[0]) / length, float(way[1]) / length
    return east * float(wind[0]) + north * float(wind[1]), abs(east * float(wind[1]) - north * float(wind[0]))
