"""Messages that the simulated autopilot sends: its heartbeat, and the requested streams."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from scipy.constants import g
from scipy.spatial.transform import Rotation

from alight.arrays import F64
from alight.geometry import quaternion_from_matrix

if TYPE_CHECKING:
    from alight_sim.autopilot.simulated import SimulatedAutopilot

# flags of the estimator: all good; without GPS it assumes that it is at rest
_NO_POSITION = (
    mavlink.ESTIMATOR_ATTITUDE
    | mavlink.ESTIMATOR_VELOCITY_VERT
    | mavlink.ESTIMATOR_POS_VERT_ABS
    | mavlink.ESTIMATOR_CONST_POS_MODE
)
_GOOD_ESTIMATE = (
    mavlink.ESTIMATOR_ATTITUDE
    | mavlink.ESTIMATOR_VELOCITY_HORIZ
    | mavlink.ESTIMATOR_VELOCITY_VERT
    | mavlink.ESTIMATOR_POS_HORIZ_REL
    | mavlink.ESTIMATOR_POS_HORIZ_ABS
    | mavlink.ESTIMATOR_POS_VERT_ABS
    | mavlink.ESTIMATOR_PRED_POS_HORIZ_REL
    | mavlink.ESTIMATOR_PRED_POS_HORIZ_ABS
)
_SWAP = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # NED from ENU
_FLIP = np.diag([1.0, -1.0, -1.0])  # FLU from FRD
_PRE_ARM = mavlink.MAV_SYS_STATUS_PREARM_CHECK

Maker = Callable[["SimulatedAutopilot"], Any]  # maker of a message; None: there is nothing to send


class Reports:
    """Message streams of the autopilot, from one boot to the next."""

    def __init__(self, lacks: Iterable[str]) -> None:
        self.intervals: dict[str, float] = {}  # s, by message
        self._due: dict[str, float] = {}
        self._heartbeat, self._mode = 0.0, 0  # s, when the next heartbeat is due; custom mode of the last one
        self.sticks = [1500, 1500, 1100, 1500]
        self.measures_wind = True  # False: like a Copter without EK3_DRAG_..., whose WIND is always 0
        self.lacks = set(lacks)  # messages that this build cannot send
        self.silent: set[str] = set()  # messages that it could send, but for which it has no data
        self.makers: dict[str, Maker] = dict(MAKERS)

    def request(self, message: int, interval_us: float) -> bool:
        """Send a message, by number, every `interval_us` microseconds; return false if the message is not supported."""
        kind = mavlink.mavlink_map.get(message)
        name = "" if kind is None else str(kind.msgname)
        if name not in self.makers or name in self.lacks:
            return False
        self.intervals[name] = interval_us * 1e-6
        self._due.setdefault(name, 0.0)
        return True

    def step(self, t: float, now: SimulatedAutopilot) -> None:
        """Send the messages that are due at time `t` (s since boot), with the present state `now` of the autopilot."""
        mode = now.dialect.number(now.logic.doing)
        if t >= self._heartbeat or (now.dialect.reports_changes and mode != self._mode):
            self._heartbeat, self._mode = t + 1.0, mode
            now.send(_heartbeat(now))
        for name, interval in self.intervals.items():
            if name not in self.silent and interval > 0 and t >= self._due[name] - 1e-9:
                self._due[name] = max(self._due[name] + interval, t)
                if (made := self.makers[name](now)) is not None:
                    now.send(made)
        severity = mavlink.MAV_SEVERITY_WARNING if now.logic.failsafe else mavlink.MAV_SEVERITY_INFO
        for text in now.logic.texts:
            now.send(mavlink.MAVLink_statustext_message(severity, text.encode()))
        now.logic.texts.clear()


def _heartbeat(now: SimulatedAutopilot) -> Any:
    base = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | (mavlink.MAV_MODE_FLAG_SAFETY_ARMED if now.logic.armed else 0)
    mode = now.dialect.number(now.logic.doing)
    status = mavlink.MAV_STATE_CRITICAL if now.logic.failsafe else mavlink.MAV_STATE_ACTIVE
    return mavlink.MAVLink_heartbeat_message(now.kind, now.dialect.autopilot, base, mode, status, 3)


def _sys_status(now: SimulatedAutopilot) -> Any:
    healthy = _PRE_ARM if now.checks and (now.ready or now.logic.armed) else 0
    battery = now.vehicle.battery
    return mavlink.MAVLink_sys_status_message(
        _PRE_ARM, _PRE_ARM if now.checks else 0, healthy, 300, round((10.5 + 2.1 * battery) * 1e3), 900,
        round(100 * battery), 0, 0, 0, 0, 0, 0,
    )  # fmt: skip


def _gps_raw_int(now: SimulatedAutopilot) -> Any:
    lat, lon, msl = now.home.degrees(now.received)
    east, north, up = now.estimate.now.sigma
    fix = 3 if now.fixed and (now.ready or now.estimator.by_odometry) else 1
    return mavlink.MAVLink_gps_raw_int_message(
        round(now.boot * 1e6), fix, round(lat * 1e7), round(lon * 1e7),
        round(msl * 1e3), 90, 130, 0, 0, 14, alt_ellipsoid=round((msl + now.home.separation) * 1e3),
        h_acc=round(1e3 * float(max(east, north))), v_acc=round(1e3 * float(up)), vel_acc=150,
    )  # fmt: skip


def _imu_values(now: SimulatedAutopilot) -> tuple[F64, F64] | None:
    """Return specific force (m/s^2) and angular rates (rad/s) in FRD; None: the IMU is silent."""
    imu = now.vehicle.imu
    return None if imu is None else (_FLIP @ imu[1], _FLIP @ imu[0])


def _rates(now: SimulatedAutopilot) -> F64:
    """Return the (3,) angular rates in FRD, rad/s; 0 while the IMU is silent."""
    values = _imu_values(now)
    return np.zeros(3) if values is None else values[1]


def _milli_imu(now: SimulatedAutopilot) -> list[int] | None:
    """Return specific force in mg and angular rates in mrad/s, as integers; None: the IMU is silent."""
    values = _imu_values(now)
    return None if values is None else [*(round(v / g * 1e3) for v in values[0]), *(round(v * 1e3) for v in values[1])]


def _scaled_imu(now: SimulatedAutopilot) -> Any:
    milli = _milli_imu(now)
    return None if milli is None else mavlink.MAVLink_scaled_imu_message(now.boot_ms, *milli, 0, 0, 0)


def _raw_imu(now: SimulatedAutopilot) -> Any:
    milli = _milli_imu(now)
    return None if milli is None else mavlink.MAVLink_raw_imu_message(round(now.middle * 1e6), *milli, 0, 0, 0)


def _highres_imu(now: SimulatedAutopilot) -> Any:
    if (values := _imu_values(now)) is None:
        return None
    t_us = round(now.middle * 1e6)
    return mavlink.MAVLink_highres_imu_message(t_us, *values[0], *values[1], 0, 0, 0, 950, 0, 500, 20, 63)


def _ned_from_frd(now: SimulatedAutopilot) -> F64:
    return np.asarray(_SWAP @ now.attitude @ _FLIP)


def _attitude(now: SimulatedAutopilot) -> Any:
    yaw, pitch, roll = Rotation.from_matrix(_ned_from_frd(now)).as_euler("ZYX")
    return mavlink.MAVLink_attitude_message(now.boot_ms, roll, pitch, yaw, *_rates(now))


def _attitude_quaternion(now: SimulatedAutopilot) -> Any:
    quaternion = quaternion_from_matrix(_ned_from_frd(now))
    return mavlink.MAVLink_attitude_quaternion_message(now.boot_ms, *quaternion, *_rates(now))


def _local_position_ned(now: SimulatedAutopilot) -> Any:
    return mavlink.MAVLink_local_position_ned_message(now.boot_ms, *(_SWAP @ now.estimated), *(_SWAP @ now.velocity))


def _global_position_int(now: SimulatedAutopilot) -> Any:
    lat, lon, msl = now.home.degrees(now.estimated)
    north, east, down = (round(100 * v) for v in _SWAP @ now.velocity)
    ahead = now.attitude[:, 0]
    heading = round(math.degrees(math.atan2(ahead[0], ahead[1])) % 360 * 100)
    return mavlink.MAVLink_global_position_int_message(
        now.boot_ms, round(lat * 1e7), round(lon * 1e7), round(msl * 1e3), round(now.estimated[2] * 1e3), north, east,
        down, heading,
    )  # fmt: skip


def _home_position(now: SimulatedAutopilot) -> Any:
    lat, lon, msl = round(now.home.latitude * 1e7), round(now.home.longitude * 1e7), round(now.home.altitude_msl * 1e3)
    return mavlink.MAVLink_home_position_message(lat, lon, msl, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0)


def _flags(now: SimulatedAutopilot) -> int:
    return int(_GOOD_ESTIMATE if now.ready else _NO_POSITION)


def _estimator_status(now: SimulatedAutopilot) -> Any:
    t_us, at_rest = round(now.boot * 1e6), now.logic.landed_state == mavlink.MAV_LANDED_STATE_ON_GROUND
    flags = _flags(now) | (mavlink.ESTIMATOR_CONST_POS_MODE if at_rest else 0)  # as PX4 does since 1.16
    return mavlink.MAVLink_estimator_status_message(t_us, flags, 0.1, 0.1, 0.1, 0.1, 0, 0, 0.4, 0.6)


def _wind(now: SimulatedAutopilot) -> Any:
    if not now.reports.measures_wind:
        return mavlink.MAVLink_wind_message(-180.0, 0.0, 0.0)
    north, east, down = _SWAP @ now.vehicle.wind_world
    return mavlink.MAVLink_wind_message(math.degrees(math.atan2(-east, -north)), math.hypot(north, east), down)


def _wind_cov(now: SimulatedAutopilot) -> Any:
    return mavlink.MAVLink_wind_cov_message(round(now.boot * 1e6), *(_SWAP @ now.vehicle.wind_world), 1, 1, 0, 1, 1)


MAKERS: Mapping[str, Maker] = {
    "SYS_STATUS": _sys_status,
    "TIMESYNC": lambda now: mavlink.MAVLink_timesync_message(0, round(now.boot * 1e9)),
    "SYSTEM_TIME": lambda now: mavlink.MAVLink_system_time_message(0, now.boot_ms),
    "GPS_RAW_INT": _gps_raw_int,
    "SCALED_IMU": _scaled_imu,
    "RAW_IMU": _raw_imu,
    "ATTITUDE": _attitude,
    "ATTITUDE_QUATERNION": _attitude_quaternion,
    "LOCAL_POSITION_NED": _local_position_ned,
    "GLOBAL_POSITION_INT": _global_position_int,
    "RC_CHANNELS": lambda now: mavlink.MAVLink_rc_channels_message(
        now.boot_ms, 4, *now.reports.sticks, *([0xFFFF] * 14), 200
    ),
    "HIGHRES_IMU": _highres_imu,
    "HOME_POSITION": _home_position,
    "EXTENDED_SYS_STATE": lambda now: mavlink.MAVLink_extended_sys_state_message(0, now.logic.landed_state),
    "EKF_STATUS_REPORT": lambda now: mavlink.MAVLink_ekf_status_report_message(_flags(now), 0.1, 0.1, 0.1, 0.1, 0.0),
    "ESTIMATOR_STATUS": _estimator_status,
    "WIND": _wind,
    "WIND_COV": _wind_cov,
}
