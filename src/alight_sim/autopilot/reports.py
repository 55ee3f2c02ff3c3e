"""Messages that the simulated autopilot sends: its heartbeat, and the streams that were requested."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from scipy.spatial.transform import Rotation

from alight.arrays import F64
from alight.geometry import quaternion_from_matrix
from alight_sim.autopilot.dialects import Dialect
from alight_sim.autopilot.flight_logic import FlightLogic

if TYPE_CHECKING:
    from alight_sim.autopilot.simulated import SimulatedHome, TrueVehicle

_PRE_ARM = 0x10000000
_GOOD_ESTIMATE, _NO_POSITION = 831, 165  # flags of the estimator; without GPS it assumes that it stands still
_SWAP = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # NED from ENU
_FLIP = np.diag([1.0, -1.0, -1.0])  # FLU from FRD


@dataclass(frozen=True, eq=False)
class SimulatedState:
    """State of the autopilot at one instant."""

    logic: FlightLogic
    vehicle: TrueVehicle
    degrees: tuple[float, float, float]  # its estimate: latitude, longitude, metres above sea level
    metres: F64  # its estimate: (3,) from the home
    velocity: F64  # its estimate: (3,) m/s
    world_from_body: F64  # its estimate: (3, 3)
    home: SimulatedHome
    ready: bool
    fixed: bool  # its receiver has a fix
    accuracy: tuple[float, float]  # metres, that its receiver claims: over the ground, in height
    boot: float  # s
    middle: float  # s, middle of the interval of the inertial measurements
    checks: bool = True  # whether it checks itself before arming

    @property
    def boot_ms(self) -> int:
        """Its own clock, ms since boot."""
        return round(self.boot * 1e3)

    @property
    def ned_from_frd(self) -> F64:
        """(3, 3) attitude: rotation of FRD axes into NED."""
        return np.asarray(_SWAP @ self.world_from_body @ _FLIP)


class Reports:
    """Message streams of the autopilot from one boot to the next."""

    def __init__(self, dialect: Dialect, send: Callable[[Any], None], kind: int) -> None:
        self._dialect, self._send, self._kind = dialect, send, kind
        self._interval: dict[int, float] = {}
        self._due: dict[int, float] = {}
        self._heartbeat = 0.0
        self.sticks = [1500, 1500, 1100, 1500]
        self.lacks: set[int] = set()  # messages that this build cannot send
        self.silent: set[int] = set()  # messages that it could send but has no data for
        self._make: dict[int, Callable[[SimulatedState], Any]] = {
            1: self._sys_status, 2: self._system_time, 24: self._gps, 26: self._imu, 27: self._raw_imu,
            30: self._attitude, 31: self._quaternion, 32: self._local, 33: self._position,
            65: self._sticks, 105: self._highres_imu, 242: self._home, 245: self._extended,
            dialect.estimator_message: self._estimator, dialect.wind_message: self._wind,
        }  # fmt: skip

    def ask(self, message: int, interval_us: float) -> bool:
        """Handle SET_MESSAGE_INTERVAL, microseconds; False: there is no such message."""
        if message not in self._make or message in self.lacks:
            return False
        self._interval[message] = interval_us * 1e-6
        self._due.setdefault(message, 0.0)
        return True

    def step(self, t: float, now: SimulatedState) -> None:
        """Send the messages that are due at time `t`, seconds."""
        if t >= self._heartbeat:
            self._heartbeat = t + 1.0
            base = 1 | (128 if now.logic.armed else 0)
            number = self._dialect.number(now.logic.doing)
            self._send(mavlink.MAVLink_heartbeat_message(self._kind, self._dialect.autopilot, base, number, 4, 3))
        for message, interval in self._interval.items():
            if message not in self.silent and interval > 0 and t >= self._due[message] - 1e-9:
                self._due[message] = max(self._due[message] + interval, t)
                if (made := self._make[message](now)) is not None:
                    self._send(made)
        self._events(now)

    def _events(self, now: SimulatedState) -> None:
        for text in now.logic.spoken:
            self._send(mavlink.MAVLink_statustext_message(6, text.encode()))
        now.logic.spoken.clear()

    def _sys_status(self, now: SimulatedState) -> Any:
        bits = _PRE_ARM if now.checks and (now.ready or now.logic.armed) else 0
        enabled = _PRE_ARM if now.checks else 0
        battery = now.vehicle.battery
        volts = round((10.5 + 2.1 * battery) * 1e3)
        return mavlink.MAVLink_sys_status_message(
            _PRE_ARM, enabled, bits, 300, volts, 900, round(100 * battery), 0, 0, 0, 0, 0, 0
        )

    def _system_time(self, now: SimulatedState) -> Any:
        return mavlink.MAVLink_system_time_message(0, now.boot_ms)

    def _gps(self, now: SimulatedState) -> Any:
        lat, lon, msl = now.degrees
        fix, (over, up) = 3 if now.fixed and now.ready else 1, now.accuracy
        return mavlink.MAVLink_gps_raw_int_message(
            round(now.boot * 1e6), fix, round(lat * 1e7), round(lon * 1e7), round(msl * 1e3), 90, 130, 0, 0, 14,
            alt_ellipsoid=round((msl + now.home.separation) * 1e3), h_acc=round(1e3 * over), v_acc=round(1e3 * up),
            vel_acc=150,
        )  # fmt: skip

    def _imu_values(self, now: SimulatedState) -> tuple[F64, F64] | None:
        """Specific force and turn rates in FRD; None: the IMU is silent."""
        imu = now.vehicle.imu
        return None if imu is None else (_FLIP @ imu[1], _FLIP @ imu[0])

    def _rates(self, now: SimulatedState) -> F64:
        """(3,) rad/s in FRD; 0 while the IMU is silent."""
        values = self._imu_values(now)
        return np.zeros(3) if values is None else values[1]

    def _milli(self, now: SimulatedState) -> list[int] | None:
        """Specific force in mg and turn rates in mrad/s, as integers."""
        values = self._imu_values(now)
        if values is None:
            return None
        return [*(round(v / 9.80665 * 1e3) for v in values[0]), *(round(v * 1e3) for v in values[1])]

    def _imu(self, now: SimulatedState) -> Any:
        milli = self._milli(now)
        return None if milli is None else mavlink.MAVLink_scaled_imu_message(now.boot_ms, *milli, 0, 0, 0)

    def _raw_imu(self, now: SimulatedState) -> Any:
        milli = self._milli(now)
        return None if milli is None else mavlink.MAVLink_raw_imu_message(round(now.middle * 1e6), *milli, 0, 0, 0)

    def _highres_imu(self, now: SimulatedState) -> Any:
        values = self._imu_values(now)
        if values is None:
            return None
        return mavlink.MAVLink_highres_imu_message(
            round(now.middle * 1e6), *values[0], *values[1], 0, 0, 0, 950, 0, 500, 20, 63
        )

    def _attitude(self, now: SimulatedState) -> Any:
        yaw, pitch, roll = Rotation.from_matrix(now.ned_from_frd).as_euler("ZYX")
        return mavlink.MAVLink_attitude_message(now.boot_ms, roll, pitch, yaw, *self._rates(now))

    def _quaternion(self, now: SimulatedState) -> Any:
        return mavlink.MAVLink_attitude_quaternion_message(
            now.boot_ms, *quaternion_from_matrix(now.ned_from_frd), *self._rates(now)
        )

    def _local(self, now: SimulatedState) -> Any:
        return mavlink.MAVLink_local_position_ned_message(now.boot_ms, *(_SWAP @ now.metres), *(_SWAP @ now.velocity))

    def _position(self, now: SimulatedState) -> Any:
        lat, lon, msl = now.degrees
        north, east, down = (round(100 * v) for v in _SWAP @ now.velocity)
        ahead = now.world_from_body[:, 0]
        heading = round(math.degrees(math.atan2(ahead[0], ahead[1])) % 360 * 100)
        return mavlink.MAVLink_global_position_int_message(
            now.boot_ms, round(lat * 1e7), round(lon * 1e7), round(msl * 1e3), round(now.metres[2] * 1e3), north, east,
            down, heading,
        )  # fmt: skip

    def _sticks(self, now: SimulatedState) -> Any:
        return mavlink.MAVLink_rc_channels_message(now.boot_ms, 4, *self.sticks, *([0xFFFF] * 14), 200)

    def _home(self, now: SimulatedState) -> Any:
        home = now.home
        return mavlink.MAVLink_home_position_message(
            round(home.latitude * 1e7), round(home.longitude * 1e7), round(home.altitude_msl * 1e3), 0, 0, 0,
            [1, 0, 0, 0], 0, 0, 0,
        )  # fmt: skip

    def _extended(self, now: SimulatedState) -> Any:
        return mavlink.MAVLink_extended_sys_state_message(0, now.logic.landed_state)

    def _estimator(self, now: SimulatedState) -> Any:
        flags = _GOOD_ESTIMATE if now.ready else _NO_POSITION
        if self._dialect.estimator_message == 193:
            return mavlink.MAVLink_ekf_status_report_message(flags, 0.1, 0.1, 0.1, 0.1, 0.0)
        return mavlink.MAVLink_estimator_status_message(
            round(now.boot * 1e6), flags, 0.1, 0.1, 0.1, 0.1, 0, 0, 0.4, 0.6
        )

    def _wind(self, now: SimulatedState) -> Any:
        north, east, down = _SWAP @ now.vehicle.wind_world
        if self._dialect.wind_message == 168:
            comes_from = math.degrees(math.atan2(-east, -north))
            return mavlink.MAVLink_wind_message(comes_from, math.hypot(north, east), down)
        return mavlink.MAVLink_wind_cov_message(round(now.boot * 1e6), north, east, down, 1, 1, 0, 1, 1)
