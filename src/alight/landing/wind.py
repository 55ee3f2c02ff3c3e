"""Wind along the legs of a landing: speed over the ground, and direction of approach."""

from __future__ import annotations

import math

import numpy as np

from alight.arrays import F64

SLOWEST = 0.5  # m/s over the ground, least speed in any wind, so that the vehicle arrives


def ground_speed(way: F64, wind: F64 | None, wanted: float, most_air_speed: float) -> float:
    """Return the speed over the ground along a leg that keeps the air speed within its limit.

    Args:
        way: (2,) or (3,) displacement along the leg, metres, world; only its horizontal part is used.
        wind: (2,) or (3,) velocity of the air, m/s, world; None: unknown.
        wanted: speed over the ground without wind, m/s.
        most_air_speed: largest speed through the air, m/s.

    Returns:
        Speed in m/s: at most `wanted`, and at least `SLOWEST` even if the wind then exceeds the limit.
    """
    along, across = _parts(way, wind)
    left = most_air_speed**2 - across**2
    most = along + math.sqrt(left) if left > 0.0 else 0.0
    return min(wanted, max(most, SLOWEST))


def is_from_behind(way: F64, wind: F64 | None, calm: float) -> bool:
    """Whether the wind along the leg `way` is a tail wind of more than `calm` m/s, in which no descent is flown."""
    return _parts(way, wind)[0] > calm


def downwind(wind: F64 | None, calm: float) -> F64 | None:
    """Return the unit vector (2,) along the wind; None if the wind is unknown or at most `calm` m/s."""
    if wind is None:
        return None
    speed = math.hypot(float(wind[0]), float(wind[1]))
    return np.asarray(wind[:2] / speed, np.float64) if speed > calm else None


def _parts(way: F64, wind: F64 | None) -> tuple[float, float]:
    """Return the wind along the leg `way` (tail wind positive) and the wind speed across it, m/s; 0 if unknown."""
    length = math.hypot(float(way[0]), float(way[1]))
    if wind is None or length < 1e-6:
        return 0.0, 0.0
    east, north = float(way[0]) / length, float(way[1]) / length
    return east * float(wind[0]) + north * float(wind[1]), abs(east * float(wind[1]) - north * float(wind[0]))
