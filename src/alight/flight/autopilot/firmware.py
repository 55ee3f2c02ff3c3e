"""ArduPilot and PX4 behind one interface: the modes, streams and commands of each."""

from __future__ import annotations

import math
import struct
from abc import ABC, abstractmethod
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from alight.arrays import F64
from alight.flight.autopilot import border
from alight.flight.autopilot.dialect import mavlink
from alight.records import FlightMode, Telemetry

_RATES: Mapping[str, float] = {  # Hz, few values: ArduPilot keeps ten different intervals per link, and rounds others
    "ATTITUDE_QUATERNION": 20.0,
    "GLOBAL_POSITION_INT": 10.0,
    "GPS_RAW_INT": 5.0,
    "RC_CHANNELS": 5.0,
    "EXTENDED_SYS_STATE": 5.0,
    "SYS_STATUS": 2.0,
    "HOME_POSITION": 1.0,
}


# Copter's modes in order of their numbers
_COPTER = """
STABILIZE ACRO ALT_HOLD AUTO GUIDED LOITER RTL CIRCLE POSITION LAND OF_LOITER DRIFT 12 SPORT FLIP AUTOTUNE POSHOLD BRAKE
THROW AVOID_ADSB GUIDED_NOGPS SMART_RTL FLOWHOLD FOLLOW ZIGZAG SYSTEMID AUTOROTATE AUTO_RTL TURTLE RATE_ACRO
"""


class Firmware(ABC):
    """Modes, streams and messages of one kind of autopilot."""

    name: str
    rates: Mapping[str, float]  # Hz of the messages to request
    repeats_setpoints: bool  # whether a set-point must be sent repeatedly
    takes_speeds: bool  # whether speeds are commands; else the distance to a set-point sets the speed
    takes_targets: bool  # whether LAND comes down on the reported target, else straight down
    natural: Mapping[tuple[FlightMode, FlightMode], bool] = MappingProxyType({})  # changes of mode that it makes by
    # itself at the end of a task; True: on the ground only, as in the air they are a takeover
    fence_parameters: tuple[str, ...] = ()  # parameters that decide how its fence is meant
    high_site: float  # metres above home from which its LAND descends fast
    odometry_frame: int  # MAV_FRAME of ODOMETRY with axes north, east, down
    odometry_by_our_clock: bool  # whether it converts the stamps of ODOMETRY itself, by TIMESYNC requests of its own
    odometry_rates: Mapping[str, float] = MappingProxyType({"LOCAL_POSITION_NED": 10.0})  # Hz, of further messages
    position_sources: Mapping[bool, int] = MappingProxyType({})  # its set of sources with odometry (True), with GPS;
    # empty: it fuses both, and takes no command
    modes: Mapping[str, FlightMode]  # by the autopilot's names; other names are OTHER
    parameters: Mapping[FlightMode, tuple[float, ...]]  # of MAV_CMD_DO_SET_MODE, after the base mode

    @abstractmethod
    def mode_name(self, custom_mode: int) -> str:
        """Return the autopilot's name of a heartbeat's custom mode."""

    @abstractmethod
    def take_off_altitude(self, height: float, telemetry: Telemetry) -> tuple[float, ...]:
        """Return parameters 4 to 7 of MAV_CMD_NAV_TAKEOFF for a climb to `height` metres above home.

        `telemetry`: newest telemetry, which holds the altitude of home.
        """

    @abstractmethod
    def unites_inclusions(self, parameters: Mapping[str, float]) -> bool:
        """Whether the vehicle must stay in any zone of the fence that keeps it in, instead of in each.

        `parameters`: values of `fence_parameters` that were read.
        """

    def parameter_value(self, value: float, kind: int) -> float:
        """Return the value of a PARAM_VALUE; `kind` is its MAV_PARAM_TYPE."""
        return value

    @abstractmethod
    def reach(self, speed: float, upright: bool) -> float:
        """Return the distance, m, to a set-point at which the vehicle still flies at `speed`, m/s.

        A nearer set-point slows the vehicle down. `upright`: whether the distance is vertical, else level.
        """

    def ahead(self, way: F64, speed: float, velocity: F64, drift: F64) -> F64:
        """Return the vector, (2,) metres east and north, from the vehicle to the set-point to send now.

        Args:
            way: (2,) metres east and north, from the vehicle to its target.
            speed: ordered, m/s.
            velocity: (2,) m/s, of the vehicle; NaN: unknown.
            drift: (2,) m/s, of which that velocity is known to be wrong.
        """
        return way * min(1.0, self.reach(speed, False) / max(math.hypot(*way), 1e-6))

    def landing_target(self, t_ns: int, target_world: F64, world_from_body: F64) -> Any | None:
        """Return the LANDING_TARGET message of a target; None: this firmware uses no targets.

        Args:
            t_ns: instant of the relative position and attitude, our clock.
            target_world: (3,) metres from the vehicle to the target, world axes.
            world_from_body: (3, 3) attitude at that instant.
        """
        return None

    def mode(self, custom_mode: int) -> tuple[FlightMode, str]:
        """Return the mode of a heartbeat's custom mode, and the autopilot's name of it."""
        name = self.mode_name(custom_mode)
        return self.modes.get(name, FlightMode.OTHER), name

    def is_natural(self, before: FlightMode, after: FlightMode, on_ground: bool) -> bool:
        """Whether the autopilot makes this change of mode by itself at the end of a task, in the air or `on_ground`."""
        ground_only = self.natural.get((before, after))
        return ground_only is not None and (on_ground or not ground_only)


class ArduPilotFirmware(Firmware):
    """ArduPilot's Copter, including helicopters."""

    name = "ArduPilot"
    rates: Mapping[str, float] = {**_RATES, "EKF_STATUS_REPORT": 2.0, "WIND": 1.0}
    repeats_setpoints = False
    takes_speeds = takes_targets = True
    fence_parameters = ("FENCE_OPTIONS",)
    high_site = 8.0  # LAND_ALT_LOW is 10 m, and home may lie lower than its estimate
    odometry_frame = mavlink.MAV_FRAME_LOCAL_FRD  # the only one that it accepts
    odometry_by_our_clock = False
    position_sources: Mapping[bool, int] = {False: 1, True: 2}
    modes: Mapping[str, FlightMode] = {
        "AUTO": FlightMode.MISSION,
        "GUIDED": FlightMode.GUIDED,
        "LAND": FlightMode.LAND,
        "BRAKE": FlightMode.HOLD,
        "RTL": FlightMode.RETURN,
        "SMART_RTL": FlightMode.RETURN,
        "AUTO_RTL": FlightMode.RETURN,
        **dict.fromkeys(("STABILIZE", "ACRO", "ALT_HOLD", "LOITER", "DRIFT", "SPORT", "POSHOLD"), FlightMode.PILOT),
    }
    parameters: Mapping[FlightMode, tuple[float, ...]] = {
        FlightMode.GUIDED: (mavlink.COPTER_MODE_GUIDED,),
        FlightMode.TAKE_OFF: (mavlink.COPTER_MODE_GUIDED,),
        FlightMode.RETURN: (mavlink.COPTER_MODE_RTL,),
        FlightMode.LAND: (mavlink.COPTER_MODE_LAND,),
        FlightMode.HOLD: (mavlink.COPTER_MODE_BRAKE,),
    }

    def mode_name(self, custom_mode: int) -> str:
        """Return Copter's name of the mode; the number if it has no name."""
        names = _COPTER.split()
        return names[custom_mode] if custom_mode < len(names) else str(custom_mode)

    def take_off_altitude(self, height: float, telemetry: Telemetry) -> tuple[float, ...]:
        """Return parameters 4 to 7 of MAV_CMD_NAV_TAKEOFF: zeros, and the height above home."""
        return (0.0, 0.0, 0.0, height)

    def unites_inclusions(self, parameters: Mapping[str, float]) -> bool:
        """Return bit 1 of FENCE_OPTIONS; see `Firmware.unites_inclusions`."""
        return bool(int(parameters.get("FENCE_OPTIONS", 0.0)) & 2)

    def reach(self, speed: float, upright: bool) -> float:
        """Return the distance, m, that a set-point needs for flight at `speed`, m/s; see `Firmware.reach`.

        Copter's position controller (of all releases so far) brakes with half of its acceleration a, so that
        v = sqrt(a (d - a / 4)) at the distance d, and v = d (gain 1/s) near the target. The result includes 0.5 s of
        flight until the next set-point.
        """
        braking = 1.0 if upright else 2.5  # m/s^2: WPNAV_ACCEL_Z, WPNAV_ACCEL
        return speed**2 / braking + braking / 4 + 0.5 * speed

    def landing_target(self, t_ns: int, target_world: F64, world_from_body: F64) -> Any | None:
        """Return LANDING_TARGET in body axes, as ArduPilot applies its own attitude; see `Firmware.landing_target`."""
        x, y, z = (float(v) for v in border.frd(world_from_body.T @ target_world))
        return mavlink.MAVLink_landing_target_message(
            time_usec=t_ns // 1000, target_num=0, frame=mavlink.MAV_FRAME_BODY_FRD, angle_x=math.atan2(y, z),
            angle_y=math.atan2(-x, z), distance=float(np.linalg.norm(target_world)), size_x=0.0, size_y=0.0,
            x=x, y=y, z=z, q=[1.0, 0.0, 0.0, 0.0], type=mavlink.LANDING_TARGET_TYPE_VISION_FIDUCIAL, position_valid=1,
        )  # fmt: skip


class Px4Firmware(Firmware):
    """PX4's multicopter. LAND is AUTO.LAND, as AUTO.PRECLAND climbs and searches if no target is reported."""

    name = "PX4"
    rates: Mapping[str, float] = {**_RATES, "ESTIMATOR_STATUS": 2.0, "WIND_COV": 1.0}
    repeats_setpoints = True
    takes_speeds = takes_targets = False
    natural: Mapping[tuple[FlightMode, FlightMode], bool] = {
        (FlightMode.TAKE_OFF, FlightMode.HOLD): False,
        (FlightMode.LAND, FlightMode.HOLD): True,
    }
    high_site = 4.0  # LAND slows down from MPC_LAND_ALT1, 10 m, to MPC_LAND_ALT2, 5 m
    odometry_frame = mavlink.MAV_FRAME_LOCAL_NED  # in LOCAL_FRD it would turn the position by its own error of heading
    odometry_by_our_clock = True  # without TIMESYNC from it to us it takes the time of arrival
    odometry_rates: Mapping[str, float] = {"LOCAL_POSITION_NED": 10.0, "TIMESYNC": 10.0}
    modes: Mapping[str, FlightMode] = {
        "OFFBOARD": FlightMode.GUIDED,
        "AUTO.MISSION": FlightMode.MISSION,
        "AUTO.TAKEOFF": FlightMode.TAKE_OFF,
        "AUTO.LAND": FlightMode.LAND,
        "AUTO.PRECLAND": FlightMode.LAND,
        "AUTO.LOITER": FlightMode.HOLD,
        "AUTO.RTL": FlightMode.RETURN,
        **dict.fromkeys(("MANUAL", "ALTCTL", "POSCTL", "ACRO", "STABILIZED", "RATTITUDE"), FlightMode.PILOT),
    }
    parameters: Mapping[FlightMode, tuple[float, ...]] = {
        FlightMode.GUIDED: (6.0, 0.0),
        FlightMode.TAKE_OFF: (4.0, 2.0),
        FlightMode.HOLD: (4.0, 3.0),
        FlightMode.RETURN: (4.0, 5.0),
        FlightMode.LAND: (4.0, 6.0),
    }
    _gain = 0.95  # 1/s: MPC_XY_P; the vertical gain, MPC_Z_P, is 1.0
    _main = ("0", "MANUAL", "ALTCTL", "POSCTL", "AUTO", "ACRO", "OFFBOARD", "STABILIZED", "RATTITUDE")
    _auto = ("0", "READY", "TAKEOFF", "LOITER", "MISSION", "RTL", "LAND", "7", "FOLLOW", "PRECLAND")

    def mode_name(self, custom_mode: int) -> str:
        """Return PX4's name of the mode: main mode in the third byte of `custom_mode`, sub-mode in the fourth."""
        main, sub = custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF
        name = self._main[main] if main < len(self._main) else str(main)
        return f"AUTO.{self._auto[sub] if sub < len(self._auto) else sub}" if name == "AUTO" else name

    def take_off_altitude(self, height: float, telemetry: Telemetry) -> tuple[float, ...]:
        """Return parameters 4 to 7 of MAV_CMD_NAV_TAKEOFF: NaN (keep heading and position), altitude above the sea."""
        home = telemetry.home or telemetry.place
        return (math.nan, math.nan, math.nan, math.nan if home is None else home.altitude_msl + height)

    def unites_inclusions(self, parameters: Mapping[str, float]) -> bool:
        """Return True: PX4 has no other way; see `Firmware.unites_inclusions`."""
        return True

    def parameter_value(self, value: float, kind: int) -> float:
        """Return the value; the bytes of an integer come in the place of those of the float."""
        is_integer = kind <= mavlink.MAV_PARAM_TYPE_INT32
        return float(struct.unpack("<i", struct.pack("<f", value))[0]) if is_integer else value

    def reach(self, speed: float, upright: bool) -> float:
        """Return the distance, m, to a set-point for flight at `speed`, by the position gain; see `Firmware.reach`."""
        return speed / self._gain

    def ahead(self, way: F64, speed: float, velocity: F64, drift: F64) -> F64:
        """Return the vector to the set-point that changes the velocity by at most 1 m/s; see `Firmware.ahead`.

        PX4 flies at the velocity v = gain * distance, and accelerates by 1.8 / s (MPC_XY_VEL_P_ACC) times the change of
        v without any other limit than MPC_TILTMAX_AIR. So 1 m/s is a tilt of 10 degrees. The vehicle brakes at 1.2
        m/s^2, by the law of ArduPilot's controller.
        """
        away, braking = math.hypot(*way), 1.2
        near = braking / self._gain**2
        law = self._gain * away if away < near else math.sqrt(2 * braking * (away - near / 2))
        wanted = way * (min(speed, law) / max(away, 1e-6)) + drift
        change = wanted - velocity
        if not np.isfinite(change).all():
            return wanted / self._gain
        return (velocity + change * min(1.0, 1.0 / max(math.hypot(*change), 1e-6))) / self._gain


FIRMWARES: Mapping[int, type[Firmware]] = {
    mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: ArduPilotFirmware,
    mavlink.MAV_AUTOPILOT_PX4: Px4Firmware,
}
HOVERS = frozenset(
    {
        mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_TYPE_COAXIAL, mavlink.MAV_TYPE_HELICOPTER, mavlink.MAV_TYPE_HEXAROTOR,
        mavlink.MAV_TYPE_OCTOROTOR, mavlink.MAV_TYPE_TRICOPTER, mavlink.MAV_TYPE_DODECAROTOR,
        mavlink.MAV_TYPE_DECAROTOR,
    }
)  # fmt: skip
