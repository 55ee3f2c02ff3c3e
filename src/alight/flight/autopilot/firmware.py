"""ArduPilot and PX4 behind one interface: the modes, streams and commands of each."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np

from alight.arrays import F64
from alight.flight.autopilot import border
from alight.flight.autopilot.pymavlink_dialect import message
from alight.records import FlightMode, Telemetry

ARDUPILOT, PX4 = 3, 12  # MAV_AUTOPILOT
HOVERS = frozenset({2, 3, 4, 13, 14, 15, 29, 35})  # MAV_TYPE: multirotors, and 4, the helicopter
_CUSTOM_MODE = 1.0  # MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
_AHEAD = 0.5  # s of flight until the autopilot has the next set-point, and a margin
_BODY_FRD = 12  # MAV_FRAME
_NAN = float("nan")
# Copter's modes in order of their numbers
_COPTER = """
STABILIZE ACRO ALT_HOLD AUTO GUIDED LOITER RTL CIRCLE POSITION LAND OF_LOITER DRIFT 12 SPORT FLIP AUTOTUNE POSHOLD BRAKE
THROW AVOID_ADSB GUIDED_NOGPS SMART_RTL FLOWHOLD FOLLOW ZIGZAG SYSTEMID AUTOROTATE AUTO_RTL TURTLE RATE_ACRO
"""
_RATES: Mapping[str, float] = {  # Hz, of few kinds: ArduPilot keeps ten different intervals a link, the next is rounded
    "ATTITUDE_QUATERNION": 20.0,
    "GLOBAL_POSITION_INT": 10.0,
    "GPS_RAW_INT": 5.0,
    "RC_CHANNELS": 5.0,
    "EXTENDED_SYS_STATE": 5.0,
    "SYS_STATUS": 2.0,
    "HOME_POSITION": 1.0,
}


class Firmware(Protocol):
    """Modes, streams and messages of one kind of autopilot."""

    name: str
    rates: Mapping[str, float]  # Hz of the messages to ask for
    repeats_setpoints: bool  # whether a set-point must be sent again and again
    takes_speeds: bool  # as commands; else the distance to a set-point is its speed
    natural: frozenset[tuple[FlightMode, FlightMode]]  # changes of mode that it makes by itself at the end of a task
    natural_on_ground: frozenset[tuple[FlightMode, FlightMode]]  # those of them that in the air are a takeover
    high_site: float  # metres above its home, from which its LAND comes down fast

    def mode(self, custom_mode: int) -> tuple[FlightMode, str]:
        """Return the mode that a heartbeat's custom mode stands for, and the autopilot's own name for it."""

    def mode_parameters(self, mode: FlightMode) -> tuple[float, ...]:
        """Parameters of MAV_CMD_DO_SET_MODE."""

    def take_off_parameters(self, height: float, telemetry: Telemetry) -> tuple[float, ...]:
        """Parameters of MAV_CMD_NAV_TAKEOFF to a height in metres above the home."""

    def reach(self, speed: float, upright: bool) -> float:
        """Distance in metres of a set-point at which it still flies at a speed (m/s), over the ground or upright."""

    def landing_target(self, t_ns: int, target_world: F64, world_from_body: F64) -> Any | None:
        """Make a LANDING_TARGET.

        Args:
            t_ns: instant at which this held, our clock.
            target_world: (3,) metres from the vehicle to the target, world axes.
            world_from_body: (3, 3) attitude of that instant.

        Returns:
            The message; None: this autopilot uses none.
        """


class ArduPilotFirmware:
    """ArduPilot's Copter, helicopters included."""

    name = "ArduPilot"
    rates: Mapping[str, float] = {**_RATES, "EKF_STATUS_REPORT": 2.0, "WIND": 1.0}
    repeats_setpoints = False
    takes_speeds = True
    natural: frozenset[tuple[FlightMode, FlightMode]] = frozenset()
    natural_on_ground = natural
    high_site = 8.0  # LAND_ALT_LOW is 10 m, and home may lie lower than its estimate
    _names = tuple(_COPTER.split())
    _meanings: Mapping[str, FlightMode] = {
        "AUTO": FlightMode.MISSION,
        "GUIDED": FlightMode.GUIDED,
        "LAND": FlightMode.LAND,
        "BRAKE": FlightMode.HOLD,
        "RTL": FlightMode.RETURN,
        "SMART_RTL": FlightMode.RETURN,
        "AUTO_RTL": FlightMode.RETURN,
        **dict.fromkeys(("STABILIZE", "ACRO", "ALT_HOLD", "LOITER", "DRIFT", "SPORT", "POSHOLD"), FlightMode.PILOT),
    }
    _numbers: Mapping[FlightMode, float] = {
        FlightMode.GUIDED: 4.0,
        FlightMode.TAKE_OFF: 4.0,
        FlightMode.RETURN: 6.0,
        FlightMode.LAND: 9.0,
        FlightMode.HOLD: 17.0,
    }

    def mode(self, custom_mode: int) -> tuple[FlightMode, str]:
        """Look up Copter's number; a number that is not known is `OTHER`."""
        name = self._names[custom_mode] if custom_mode < len(self._names) else str(custom_mode)
        return self._meanings.get(name, FlightMode.OTHER), name

    def mode_parameters(self, mode: FlightMode) -> tuple[float, ...]:
        """Base mode and Copter's number."""
        return (_CUSTOM_MODE, self._numbers[mode])

    def take_off_parameters(self, height: float, telemetry: Telemetry) -> tuple[float, ...]:
        """Parameters with the altitude above the home."""
        return (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, height)

    def reach(self, speed: float, upright: bool) -> float:
        """Its position controller (of all releases so far) brakes with half of the acceleration, with a margin here.

        v = sqrt(a (d - a / 4)), and v = d (gain 1/s) near the target.
        """
        braking = 1.0 if upright else 2.5  # m/s^2: WPNAV_ACCEL_Z, WPNAV_ACCEL
        return speed**2 / braking + braking / 4 + _AHEAD * speed

    def landing_target(self, t_ns: int, target_world: F64, world_from_body: F64) -> Any | None:
        """Make it with angles and position in body axes, not levelled: ArduPilot applies its own attitude."""
        x, y, z = (float(v) for v in border.frd(world_from_body.T @ target_world))
        distance = float(np.linalg.norm(target_world))
        return message(
            "LANDING_TARGET", time_usec=t_ns // 1000, target_num=0, frame=_BODY_FRD, angle_x=math.atan2(y, z),
            angle_y=math.atan2(-x, z), distance=distance, size_x=0.0, size_y=0.0, x=x, y=y, z=z,
            q=[1.0, 0.0, 0.0, 0.0], type=2, position_valid=1,
        )  # fmt: skip


class Px4Firmware:
    """PX4's multicopter."""

    name = "PX4"
    rates: Mapping[str, float] = {**_RATES, "ESTIMATOR_STATUS": 2.0, "WIND_COV": 1.0}
    repeats_setpoints = True
    takes_speeds = False
    natural = frozenset({(FlightMode.TAKE_OFF, FlightMode.HOLD), (FlightMode.LAND, FlightMode.HOLD)})
    natural_on_ground = frozenset({(FlightMode.LAND, FlightMode.HOLD)})
    high_site = 4.0  # it slows down from MPC_LAND_ALT1, 10 m, to MPC_LAND_ALT2, 5 m
    _main = ("0", "MANUAL", "ALTCTL", "POSCTL", "AUTO", "ACRO", "OFFBOARD", "STABILIZED", "RATTITUDE")
    _auto = ("0", "READY", "TAKEOFF", "LOITER", "MISSION", "RTL", "LAND", "7", "FOLLOW", "PRECLAND")
    _meanings: Mapping[str, FlightMode] = {
        "OFFBOARD": FlightMode.GUIDED,
        "AUTO.MISSION": FlightMode.MISSION,
        "AUTO.TAKEOFF": FlightMode.TAKE_OFF,
        "AUTO.LAND": FlightMode.LAND,
        "AUTO.PRECLAND": FlightMode.LAND,
        "AUTO.LOITER": FlightMode.HOLD,
        "AUTO.RTL": FlightMode.RETURN,
        **dict.fromkeys(("MANUAL", "ALTCTL", "POSCTL", "ACRO", "STABILIZED", "RATTITUDE"), FlightMode.PILOT),
    }
    _numbers: Mapping[FlightMode, tuple[float, float]] = {
        FlightMode.GUIDED: (6.0, 0.0),
        FlightMode.TAKE_OFF: (4.0, 2.0),
        FlightMode.HOLD: (4.0, 3.0),
        FlightMode.RETURN: (4.0, 5.0),
        FlightMode.LAND: (4.0, 6.0),  # not its precision landing, which climbs and searches where reports stop
    }

    def mode(self, custom_mode: int) -> tuple[FlightMode, str]:
        """Main mode in the third byte, sub-mode in the fourth."""
        main, sub = custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF
        name = self._main[main] if main < len(self._main) else str(main)
        if name == "AUTO":
            name += "." + (self._auto[sub] if sub < len(self._auto) else str(sub))
        return self._meanings.get(name, FlightMode.OTHER), name

    def mode_parameters(self, mode: FlightMode) -> tuple[float, ...]:
        """Base mode, main mode, sub-mode."""
        return (_CUSTOM_MODE, *self._numbers[mode])

    def take_off_parameters(self, height: float, telemetry: Telemetry) -> tuple[float, ...]:
        """Parameters with the altitude above sea level; NaN keeps the place and the heading of the vehicle."""
        home = telemetry.home or telemetry.place
        sea = _NAN if home is None else home.altitude_msl + height
        return (0.0, 0.0, 0.0, _NAN, _NAN, _NAN, sea)

    def reach(self, speed: float, upright: bool) -> float:
        """Its speed is the distance times MPC_XY_P; that of the height, MPC_Z_P, is 1.0."""
        return speed / 0.95

    def landing_target(self, t_ns: int, target_world: F64, world_from_body: F64) -> Any | None:
        """None: LAND is AUTO.LAND, which uses no target."""
        return None


def firmware_of(autopilot: int) -> Firmware | None:
    """Return the firmware of a heartbeat's MAV_AUTOPILOT number; None: it is not supported."""
    if autopilot == ARDUPILOT:
        return ArduPilotFirmware()
    return Px4Firmware() if autopilot == PX4 else None
