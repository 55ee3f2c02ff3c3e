"""The displacement of a vehicle by the autopilot's own estimate, and positions that are impossible."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from alight.arrays import F64
from alight.flight.autopilot import RemoteVehicle
from alight.geometry import LocalFrame

FASTEST, SLACK = 25.0, 5.0  # m/s, and metres on top: a way beyond that was not flown


class OwnWay(NamedTuple):
    """The vehicle's displacement by the autopilot's own estimate."""

    way: F64 | None  # (3,) metres; None: unknown, as its positions are late or have jumped
    jumped: bool = False  # they contradict each other


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
