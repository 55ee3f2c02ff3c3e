"""Guided set-points in the autopilot's coordinates."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from alight.arrays import F64
from alight.flight.autopilot.border import EstimateTie, metres_between, ned, scaled_degrees, signed_angle
from alight.flight.autopilot.pymavlink_dialect import message
from alight.records import Place

_GLOBAL_MSL, _LOCAL_NED = 5, 1  # MAV_FRAME_GLOBAL_INT, MAV_FRAME_LOCAL_NED
CLIMB = 3.0  # m/s upwards, which no set-point contains
Reach = Callable[[float, bool], float]  # metres, of a speed in m/s, over the ground or upright
_NO_POSITION, _NO_VELOCITY, _NO_ACCELERATION, _NO_YAW, _NO_YAW_RATE = 7, 56, 448, 1024, 2048


@dataclass(frozen=True, eq=False)
class Setpoint:
    """A position or a velocity that the vehicle is to reach, in our world; None: left to the autopilot."""

    position_world: F64 | None = None  # (3,) metres
    velocity_world: F64 | None = None  # (3,) m/s; with a position: the speed there
    heading: float | None = None  # rad, clockwise from north; None: ArduPilot turns the nose towards its flight
    speed: float = math.inf  # m/s over the ground on the way to a position; inf: the autopilot's own
    sink: float = math.inf  # m/s downwards on the way to a position


@dataclass(frozen=True, eq=False)
class Target:
    """A set-point in the autopilot's own estimate of position: it can be sent again and means the same."""

    place: Place | None
    velocity_ned: F64 | None
    heading: float | None
    speed: float = math.inf
    sink: float = math.inf

    def near(self, here: Place, reach: Reach) -> Target:
        """The set-point of now on the way to the same place: short, but so far that the vehicle does not slow down.

        An autopilot flies on to its last position after a takeover by the sticks, a lost link, or the end of this
        program, so that one is near.

        Args:
            here: the vehicle.
            reach: distance at which the autopilot still flies at a speed.
        """
        if self.place is None:
            return self
        away = metres_between(here, replace(self.place, altitude_msl=here.altitude_msl))
        share = min(1.0, reach(self.speed, False) / max(away, 1e-6))
        way = self.place.altitude_msl - here.altitude_msl
        higher = min(max(way, -reach(self.sink, True)), reach(CLIMB, True)) - way  # than the place, for now
        return replace(self, place=Place(
            here.latitude + share * (self.place.latitude - here.latitude),
            here.longitude + share * (self.place.longitude - here.longitude),
            self.place.altitude_msl + higher,
            self.place.above_home + higher,
        ))  # fmt: skip

    def message(self, t_ns: int, system: int, component: int) -> Any:
        """Make the message: a place above sea level, or a velocity in the local frame.

        Args:
            t_ns: now, our clock.
            system, component: of the vehicle.
        """
        mask = _NO_ACCELERATION | _NO_YAW_RATE
        mask |= (_NO_VELOCITY if self.velocity_ned is None else 0) | (_NO_YAW if self.heading is None else 0)
        vx, vy, vz = (float(v) for v in (np.zeros(3) if self.velocity_ned is None else self.velocity_ned))
        common = {
            "time_boot_ms": t_ns // 1_000_000 % 2**32, "target_system": system, "target_component": component,
            "vx": vx, "vy": vy, "vz": vz, "afx": 0.0, "afy": 0.0, "afz": 0.0,
            "yaw": 0.0 if self.heading is None else signed_angle(self.heading), "yaw_rate": 0.0,
        }  # fmt: skip
        if self.place is None:
            return message(
                "SET_POSITION_TARGET_LOCAL_NED", coordinate_frame=_LOCAL_NED, type_mask=mask | _NO_POSITION,
                x=0.0, y=0.0, z=0.0, **common,
            )  # fmt: skip
        return message(
            "SET_POSITION_TARGET_GLOBAL_INT", coordinate_frame=_GLOBAL_MSL, type_mask=mask,
            lat_int=scaled_degrees(self.place.latitude), lon_int=scaled_degrees(self.place.longitude),
            alt=self.place.altitude_msl, **common,
        )  # fmt: skip


def target_of(setpoint: Setpoint, tie: EstimateTie | None) -> Target:
    """Tie a set-point to the autopilot's estimate.

    Raises:
        ValueError: it has neither position nor velocity, or a number is not finite, or a position has no tie.
    """
    position, velocity, heading = setpoint.position_world, setpoint.velocity_world, setpoint.heading
    given = [v for v in (position, velocity) if v is not None]
    limits = setpoint.speed, setpoint.sink
    if not given or not all(np.isfinite(v).all() for v in given) or not math.isfinite(heading or 0.0):
        raise ValueError("a set-point needs a position or a velocity, of finite numbers")
    if not min(limits) > 0:
        raise ValueError("a set-point needs speeds above 0")
    if position is None:
        return Target(None, ned(given[0]), heading)
    if tie is None:
        raise ValueError("a position needs our position and the autopilot's of one instant")
    return Target(tie.place_of(position), None if velocity is None else ned(velocity), heading, *limits)


def hold_at(place: Place) -> Target:
    """Return the set-point that keeps the vehicle at a place, with any heading."""
    return Target(place, None, None)
