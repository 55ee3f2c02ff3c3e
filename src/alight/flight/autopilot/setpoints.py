"""Guided flight: set-points and speeds in the autopilot's coordinates."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from alight.arrays import F64
from alight.flight.autopilot.border import METRES_PER_DEGREE, EstimateTie, metres_per_degree_east, ned
from alight.flight.autopilot.commands import CommandQueue
from alight.flight.autopilot.dialect import mavlink
from alight.flight.autopilot.firmware import Firmware
from alight.records import Place

CLIMB = 3.0  # m/s upwards: set-points have no climb speed
_SPEED_AGAIN_NS = 2_000_000_000  # until the speeds are sent again


@dataclass(frozen=True, eq=False)
class Setpoint:
    """A position or a velocity in our world that the vehicle is to reach; None: left to the autopilot."""

    position_world: F64 | None = None  # (3,) metres
    velocity_world: F64 | None = None  # (3,) m/s; with a position: the velocity there
    heading: float | None = None  # rad, clockwise from north; None: ArduPilot turns the nose towards its flight
    speed: float = math.inf  # m/s over the ground on the way to a position; inf: the autopilot's own
    sink: float = math.inf  # m/s downwards on the way to a position


@dataclass(frozen=True, eq=False)
class Target:
    """A set-point in the autopilot's coordinates, units as in `Setpoint`; it can be sent again without a new tie."""

    place: Place | None
    velocity_ned: F64 | None = None
    heading: float | None = None
    speed: float = math.inf
    sink: float = math.inf

    @classmethod
    def of(cls, setpoint: Setpoint, tie: EstimateTie | None) -> Target:
        """Convert a set-point to the autopilot's coordinates.

        Raises:
            ValueError: it has no position and no velocity, a value is not finite, a speed is not above 0, or a position
                has no tie.
        """
        position, velocity = setpoint.position_world, setpoint.velocity_world
        given = [v for v in (position, velocity) if v is not None]
        if not given or not np.isfinite([*np.concatenate(given), setpoint.heading or 0.0]).all():
            raise ValueError("a set-point needs a position or a velocity, of finite numbers")
        if not min(setpoint.speed, setpoint.sink) > 0:
            raise ValueError("a set-point needs speeds above 0")
        velocity_ned = None if velocity is None else ned(velocity)
        if position is None:
            return cls(None, velocity_ned, setpoint.heading)
        if tie is None:
            raise ValueError("a position needs our position and the autopilot's of one instant")
        return cls(tie.place_of(position), velocity_ned, setpoint.heading, setpoint.speed, setpoint.sink)

    def near(self, here: Place, velocity: F64, drift: F64, firmware: Firmware) -> Target:
        """Return the set-point to send now: near the vehicle, but so far ahead that the vehicle does not slow down.

        An autopilot flies on to its last set-point after a takeover by the sticks, a lost link, or the end of this
        program. So the set-point is near.

        Args:
            here: position of the vehicle.
            velocity: (3,) m/s, of the vehicle; NaN: unknown.
            drift: (3,) m/s, of which the autopilot's velocity is wrong: it is flown in addition.
            firmware: decides how far ahead the set-point is.
        """
        if self.place is None:
            return self if self.velocity_ned is None else replace(self, velocity_ned=self.velocity_ned + ned(drift))
        degree = np.array([metres_per_degree_east(here), METRES_PER_DEGREE])
        east = math.remainder(self.place.longitude - here.longitude, 360.0)
        way = np.array([east, self.place.latitude - here.latitude]) * degree
        east, north = firmware.ahead(way, self.speed, velocity[:2], drift[:2]) / degree
        up = self.place.altitude_msl - here.altitude_msl
        higher = min(max(up, -firmware.reach(self.sink, True)), firmware.reach(CLIMB, True)) - up  # than the target
        return replace(self, place=Place(
            here.latitude + north,
            here.longitude + east,
            self.place.altitude_msl + higher,
            self.place.above_home + higher,
        ))  # fmt: skip

    def message(self, t_ns: int, system: int, component: int) -> Any:
        """Return the MAVLink message: a position above sea level, or a velocity in the local frame.

        Args:
            t_ns: stamp of the message, our clock.
            system, component: address of the vehicle.
        """
        ignored = ["AX", "AY", "AZ", "YAW_RATE"]
        ignored += [] if self.place is not None else ["X", "Y", "Z"]
        ignored += [] if self.velocity_ned is not None else ["VX", "VY", "VZ"]
        ignored += [] if self.heading is not None else ["YAW"]
        mask = sum(getattr(mavlink, f"POSITION_TARGET_TYPEMASK_{field}_IGNORE") for field in ignored)
        velocity = [0.0] * 3 if self.velocity_ned is None else [float(v) for v in self.velocity_ned]
        yaw = math.remainder(self.heading or 0.0, 2 * math.pi)
        head, tail = (t_ns // 1_000_000 % 2**32, system, component), (*velocity, 0.0, 0.0, 0.0, yaw, 0.0)
        if self.place is None:
            kind, frame = mavlink.MAVLink_set_position_target_local_ned_message, mavlink.MAV_FRAME_LOCAL_NED
            return kind(*head, frame, mask, 0.0, 0.0, 0.0, *tail)
        kind, frame = mavlink.MAVLink_set_position_target_global_int_message, mavlink.MAV_FRAME_GLOBAL_INT
        at = (round(self.place.latitude * 1e7), round(self.place.longitude * 1e7), self.place.altitude_msl)
        return kind(*head, frame, mask, *at, *tail)


class Guidance:
    """Sends set-points that lead to a target, and the target's speeds as commands if the firmware needs them.

    ArduPilot resets its speeds whenever its guided controller restarts (a change of mode, the end of a take-off, a
    position after a velocity), and does not report this. So the speeds are sent every two seconds.
    """

    def __init__(
        self, firmware: Firmware, address: tuple[int, int], send: Callable[[Any], None], commands: CommandQueue
    ) -> None:
        self._firmware, self._address, self._send, self._commands = firmware, address, send, commands
        self.target: Target | None = None
        self._ahead: Target | None = None  # set-point sent last, on the way to the target
        self._sent_ns = self.since_ns = 0  # newest set-point; since when they are sent without a pause
        self._speeds, self._speeds_ns = (math.inf, math.inf), -_SPEED_AGAIN_NS
        self._tickets: set[int] = set()  # tickets of the commands of speeds
        self._refused = False

    def aim(self, target: Target, here: Place | None, velocity: F64, drift: F64, now_ns: int) -> None:
        """Send a set-point towards a target, near the vehicle.

        Args:
            target: position or velocity to reach in the end.
            here: position of the vehicle; None: unknown; then the last set-point or, without one, the target is sent.
            velocity, drift: see `Target.near`.
        """
        if self.target is None:
            self.since_ns, self._ahead = now_ns, None
        elif (target.place is None) is not (self.target.place is None):
            self.forget_speeds()  # ArduPilot changes its controller
        self.target, self._sent_ns = target, now_ns
        if here is not None:
            self._ahead = target.near(here, velocity, drift, self._firmware)
        elif target.place is None or self._ahead is None or self._ahead.place is None:
            self._ahead = target  # else the last one again while the position is unknown: the target is too far
        self._send(self._ahead.message(now_ns, *self._address))

    def is_due(self, now_ns: int) -> bool:
        """Whether the set-point must be sent again: at 5 Hz if the firmware needs that."""
        repeated = self.target is not None and self._firmware.repeats_setpoints
        return repeated and now_ns - self._sent_ns >= 200_000_000

    def forget_speeds(self) -> None:
        """Send the speeds again with the next set-point, as the controller was restarted."""
        self._speeds_ns = -_SPEED_AGAIN_NS

    def keep_speeds(self, t_ns: int) -> None:
        """Send the speeds of the target if they are new or were sent 2 s ago; infinite speeds are not sent."""
        if self.target is None or not self._firmware.takes_speeds:
            return
        speeds, number = (self.target.speed, self.target.sink), mavlink.MAV_CMD_DO_CHANGE_SPEED
        same = all(math.isclose(a, b, abs_tol=0.1) for a, b in zip(speeds, self._speeds, strict=True))
        if (same and t_ns - self._speeds_ns < _SPEED_AGAIN_NS) or self._commands.waiting(number):
            return
        self._speeds, self._speeds_ns = speeds, t_ns
        kinds = mavlink.SPEED_TYPE_GROUNDSPEED, mavlink.SPEED_TYPE_DESCENT_SPEED
        for kind, speed in zip(kinds, speeds, strict=True):
            if math.isfinite(speed):
                self._tickets.add(self._commands.submit("speed", number, (kind, speed, -1.0), t_ns))

    def is_quiet(self, ticket: int, ok: bool) -> bool:
        """Process the answer to the command with this ticket; return whether it needs no notice to the pilot.

        This holds for speed commands that are accepted (`ok`), or refused like the previous speed command.
        """
        if ticket not in self._tickets:
            return False
        self._tickets.discard(ticket)
        reported, self._refused = self._refused, not ok
        return ok or reported
