"""Limits of an order: near targets on the way to far ones, and positions that are impossible."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from alight.arrays import F64
from alight.flight.autopilot import RemoteVehicle
from alight.geometry import LocalFrame

BRAKING, BRAKING_UP = 2.5, 1.0  # m/s^2, over the ground and upwards: ArduPilot's WPNAV_ACCEL and WPNAV_ACCEL_Z
CLIMB = 3.0  # m/s upwards, which no order contains
AHEAD = 0.5  # s of flight until the autopilot has the next target, and a margin
FASTEST, SLACK = 25.0, 5.0  # m/s, and metres on top: a way beyond that was not flown


class OwnWay(NamedTuple):
    """The vehicle's displacement by the autopilot's own estimate."""

    way: F64 | None  # (3,) metres; None: unknown, as its positions are late or have jumped
    jumped: bool = False  # they contradict each other


def near_way(way: F64, speed: float, sink: float) -> F64:
    """Return the part (3,) of a way to the next target: short, but so long that the vehicle does not slow down.

    ArduPilot has no time-out for positions. After a takeover by the sticks, a lost link or the end of this program it
    flies on to the last one, so the target is near.

    Args:
        way: (3,) metres, from the vehicle to the far target.
        speed: m/s over the ground.
        sink: m/s downwards.
    """
    share = min(1.0, _reach(speed, BRAKING) / max(math.hypot(way[0], way[1]), 1e-9))
    up = min(max(float(way[2]), -_reach(sink, BRAKING_UP)), _reach(CLIMB, BRAKING_UP))
    return np.array([share * way[0], share * way[1], up])


def _reach(speed: float, braking: float) -> float:
    """Distance in metres at which ArduPilot still flies at a speed, with a margin.

    Its position controller (of all releases so far) brakes with half of the acceleration: v = sqrt(a (d - a / 4)), and
    near the target by v = d (gain 1/s).
    """
    return speed**2 / braking + braking / 4 + AHEAD * speed


def own_way(vehicle: RemoteVehicle, local: LocalFrame, since_ns: int, now_ns: int) -> OwnWay:
    """Return the displacement between two instants of our clock, by the autopilot's own estimate.

    Args:
        vehicle: the autopilot's reports.
        local: the world, for the axes.
        since_ns: the earlier instant.
        now_ns: the later one.
    """
    if vehicle.doubts_place:
        return OwnWay(None, jumped=True)
    then, now = vehicle.place_at(since_ns), vehicle.place_at(now_ns)
    if then is None or now is None:
        return OwnWay(None)
    a, b = (local.to_enu(p.latitude, p.longitude, p.altitude_msl) for p in (then, now))
    way = np.asarray(b - a)
    jumped = not float(np.linalg.norm(way)) <= SLACK + FASTEST * (now_ns - since_ns) * 1e-9
    return OwnWay(None if jumped else way, jumped)
