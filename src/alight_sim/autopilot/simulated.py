"""The simulated autopilot: MAVLink bytes in and out, with its own clock, estimate and vehicle."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from alight.arrays import F64
from alight.geometry import LocalFrame
from alight.records import Event
from alight_sim.autopilot.dialects import DIALECTS, Dialect, Doing
from alight_sim.autopilot.estimate import Estimate, EstimateError
from alight_sim.autopilot.estimator import Estimator
from alight_sim.autopilot.flight_logic import FlightLogic
from alight_sim.autopilot.memory import AutopilotMemory
from alight_sim.autopilot.reports import Reports
from alight_sim.point_mass import PointMass, Wanted

_START_UP = 3.0  # s from boot until it may be armed
_IGNORE_POSITION = (
    mavlink.POSITION_TARGET_TYPEMASK_X_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_Y_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_Z_IGNORE
)
_IGNORE_VELOCITY = (
    mavlink.POSITION_TARGET_TYPEMASK_VX_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_VY_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_VZ_IGNORE
)


class TrueVehicle(Protocol):
    """Interface of the true vehicle, in metres east, north, up; `PointMass` describes its members."""

    @property
    def body(self) -> PointMass: ...
    @property
    def wind_world(self) -> F64: ...
    @property
    def imu(self) -> tuple[F64, F64] | None: ...
    @property
    def battery(self) -> float: ...
    def step(self, dt: float, wanted: Wanted | None) -> Sequence[Event]: ...


@dataclass(frozen=True)
class SimulatedHome:
    """Home of the autopilot on Earth: the origin of its vehicle's coordinates."""

    latitude: float = 47.6
    longitude: float = 13.4
    altitude_msl: float = 500.0
    separation: float = 46.0  # metres, ellipsoidal height minus altitude above sea level

    @classmethod
    def at(cls, origin: LocalFrame) -> SimulatedHome:
        """Return the home at the origin of a local frame."""
        return cls(origin.latitude, origin.longitude, origin.height - cls.separation)

    def degrees(self, enu: F64) -> tuple[float, float, float]:
        """Convert (3,) metres from the home to latitude, longitude (degrees) and altitude above sea level (m)."""
        meridian, parallel = self._radii()
        return (
            self.latitude + math.degrees(float(enu[1]) / meridian),
            self.longitude + math.degrees(float(enu[0]) / parallel),
            self.altitude_msl + float(enu[2]),
        )

    def metres(self, latitude: float, longitude: float, altitude_msl: float) -> F64:
        """Convert latitude, longitude (degrees) and altitude above sea level (m) to (3,) metres from the home."""
        meridian, parallel = self._radii()
        north = math.radians(latitude - self.latitude) * meridian
        east = math.radians(longitude - self.longitude) * parallel
        return np.array([east, north, altitude_msl - self.altitude_msl])

    def _radii(self) -> tuple[float, float]:
        """Return radii of the meridian and of the parallel, metres, at the home's height above the WGS84 ellipsoid."""
        a, e2 = 6378137.0, 0.00669437999014
        height, s = self.altitude_msl + self.separation, math.sin(math.radians(self.latitude))
        w = math.sqrt(1 - e2 * s * s)
        return a * (1 - e2) / w**3 + height, (a / w + height) * math.cos(math.radians(self.latitude))


class SimulatedAutopilot:
    """One autopilot with its vehicle. Call `receive` with bytes, `step` with time, and send the `pending` datagrams.

    It streams only its heartbeat and the requested messages, and forgets the requests at a reboot. It stamps messages
    with its own clock.

    Args:
        drift: relative error of its clock's rate.
        kind: MAV_TYPE.
        key: signs what is sent, and what is not signed with it is ignored; None: nothing is signed.
    """

    def __init__(
        self,
        dialect: Dialect = DIALECTS["ardupilot"],
        vehicle: TrueVehicle | None = None,
        home: SimulatedHome | None = None,
        estimate: Estimate | None = None,
        drift: float = 0.0,
        system: int = 1,
        kind: int = mavlink.MAV_TYPE_QUADROTOR,
        key: bytes | None = None,
    ) -> None:
        self.dialect, self.kind, self._drift, self._system = dialect, kind, drift, system
        self.vehicle: TrueVehicle = vehicle or PointMass()
        self.home = home or SimulatedHome()
        self.estimate: Estimate = estimate or EstimateError()
        self.healthy = self.checks = True  # checks: whether the checks before arming are switched on
        self._mavlink = mavlink.MAVLink(None, srcSystem=system, srcComponent=mavlink.MAV_COMP_ID_AUTOPILOT1)
        self._mavlink.robust_parsing = True
        self._mavlink.signing.secret_key, self._mavlink.signing.sign_outgoing = key, key is not None
        self._out: list[bytes] = []
        self.memory = AutopilotMemory(dialect.firmware, self.send)
        self.reboot()

    def reboot(self) -> None:
        """Boot again: motors off, clock at 0, requested streams forgotten."""
        self.boot: float = 0.0  # s, its own clock
        self.middle: float = 0.0  # s, the middle of the interval of the inertial measurements
        self._refuses_until = 0.0  # s
        self.logic: FlightLogic = FlightLogic(
            self.dialect, interlock=False if self.kind == mavlink.MAV_TYPE_HELICOPTER else None
        )
        self.reports: Reports = Reports(self.dialect.lacks)
        self.estimator: Estimator = Estimator(self.dialect, self.estimate, self.memory.parameters)
        self._lost_for = 0.0  # s without a position
        self._mavlink.seq = 0

    @property
    def boot_ms(self) -> int:
        """Time since boot on the autopilot's own clock, ms."""
        return round(self.boot * 1e3)

    @property
    def ready(self) -> bool:
        """Whether the autopilot may be armed."""
        return self.located and self.boot > _START_UP and (self.logic.armed or not self.logic.interlock)

    @property
    def located(self) -> bool:
        """Whether an absolute position is known."""
        return self.healthy and self.estimator.is_located(self.boot)

    @property
    def fixed(self) -> bool:
        """Whether the receiver has a fix; the fix is lost after half a second without a position."""
        return self.healthy and self.estimate.now.blind < 0.5

    @property
    def estimated(self) -> F64:
        """Estimated position, (3,) metres from the home."""
        return self.vehicle.body.position + self.estimator.error

    @property
    def received(self) -> F64:
        """Position by the receiver of GPS alone, (3,) metres from the home."""
        return self.vehicle.body.position + self.estimate.now.position

    @property
    def velocity(self) -> F64:
        """Estimated velocity, (3,) m/s east, north, up."""
        return self.vehicle.body.velocity + self.estimator.velocity_error

    @property
    def attitude(self) -> F64:
        """Estimated attitude, (3, 3) rotation, world from body."""
        errors = self.estimate.now
        return np.asarray(errors.heading @ self.vehicle.body.world_from_body.rotation @ errors.attitude)

    def hover(self, doing: Doing = Doing.HOLD) -> None:
        """Set the state after a take-off to the present position: armed, in flight, in mode `doing`."""
        self.boot = _START_UP + 1.0
        self.logic.step(self.boot, self.estimated, False)  # before it is armed: it did not lift off just now
        self.logic.armed = True
        self.logic.doing = Doing.TAKE_OFF
        self.logic.enter(doing, self.boot)

    def refuse_modes(self, seconds: float) -> None:
        """Refuse all commands that change the mode for the next `seconds`."""
        self._refuses_until = self.boot + seconds

    def fail_safe(self, doing: Doing, *texts: str) -> None:
        """Change the mode to `doing` as a failsafe of the autopilot does: in a critical state, with its texts."""
        self.logic.failsafe = True
        self.logic.texts += texts
        self.logic.enter(doing, self.boot)

    def pilot(self, doing: Doing = Doing.PILOT) -> None:
        """Change the mode to `doing` as a pilot does, not by a command over the link."""
        self.logic.enter(doing, self.boot)

    def pending(self) -> list[bytes]:
        """Remove and return the datagrams to send."""
        out, self._out = self._out, []
        return out

    def step(self, dt: float) -> Sequence[Event]:
        """Advance by `dt` seconds of true time; return the events of the vehicle."""
        self.middle = self.boot + 0.5 * dt * (1 + self._drift)
        self.boot += dt * (1 + self._drift)
        self.estimate.step(dt)
        self.estimator.step(self.boot, dt, self.vehicle.body.position, self.vehicle.body.velocity)
        self._keep_position(dt)
        wanted = self.logic.step(self.boot, self.estimated, self.vehicle.body.stands)
        if wanted is not None:
            wanted = self._true(wanted)
        events = self.vehicle.step(dt, wanted)
        self.reports.step(self.boot, self)
        return events

    def _true(self, wanted: Wanted) -> Wanted:
        """Return where and how fast the vehicle really flies as its estimate follows a set-point."""
        if self.estimator.takes_odometry:
            along = np.zeros(3) if wanted.velocity is None else wanted.velocity
            wanted = replace(wanted, velocity=along - self.estimator.velocity_error * (1.0, 1.0, 0.0))
        return wanted if wanted.position is None else replace(wanted, position=wanted.position - self.estimator.error)

    def _keep_position(self, dt: float) -> None:
        """Land by the failsafe of an estimator with external navigation that has had no position for 0.6 s."""
        flies = self.logic.armed and not self.vehicle.body.stands and self.estimator.takes_odometry
        self._lost_for = self._lost_for + dt if flies and not self.located else 0.0
        if self._lost_for > 0.6 and self.logic.doing not in (Doing.LAND, Doing.PILOT):
            self.fail_safe(Doing.LAND, "EKF Failsafe: changed to LAND Mode")

    def send(self, message: Any) -> None:
        """Encode a MAVLink message and add it to the pending datagrams."""
        self._out.append(bytes(message.pack(self._mavlink)))
        self._mavlink.seq = (self._mavlink.seq + 1) % 256

    def receive(self, data: bytes) -> None:
        """Receive a datagram and handle its messages."""
        for m in self._mavlink.parse_buffer(data) or ():
            if getattr(m, "target_system", self._system) in (0, self._system):
                self._on_message(m)

    def _on_message(self, m: Any) -> None:
        name = m.get_type()
        if name == "COMMAND_LONG":
            result = self.execute(m.command, (m.param1, m.param2, m.param3, m.param4, m.param5, m.param6, m.param7))
            sender = m.get_srcSystem(), m.get_srcComponent()
            self.send(mavlink.MAVLink_command_ack_message(m.command, result, 0, 0, *sender))
        elif name == "TIMESYNC" and m.tc1 == 0:
            self.send(mavlink.MAVLink_timesync_message(round(self.boot * 1e9), m.ts1))
        elif name == "TIMESYNC":
            self.estimator.on_timesync(m.ts1 * 1e-9, m.tc1 * 1e-9, self.boot)
        elif name == "ODOMETRY":
            self.estimator.on_odometry(m, self.boot)
        elif name == "SET_POSITION_TARGET_GLOBAL_INT":
            self._guide(m, self.home.metres(m.lat_int * 1e-7, m.lon_int * 1e-7, m.alt))
        elif name == "SET_POSITION_TARGET_LOCAL_NED":
            self._guide(m, np.array([m.y, m.x, -m.z]))
        elif name in ("PARAM_REQUEST_READ", "MISSION_REQUEST_LIST", "MISSION_REQUEST_INT"):
            self.memory.on_message(m)
        elif name == "LANDING_TARGET" and m.position_valid and m.frame == mavlink.MAV_FRAME_BODY_FRD:
            self._on_landing_target(m)

    def _guide(self, m: Any, position: F64) -> None:
        mask = m.type_mask
        velocity = np.array([m.vy, m.vx, -m.vz])
        wanted = Wanted(
            None if mask & _IGNORE_POSITION == _IGNORE_POSITION else position,
            None if mask & _IGNORE_VELOCITY == _IGNORE_VELOCITY else velocity,
            None if mask & mavlink.POSITION_TARGET_TYPEMASK_YAW_IGNORE else m.yaw,
        )
        self.logic.guide(wanted, self.boot)

    def _on_landing_target(self, m: Any) -> None:
        """Handle a LANDING_TARGET message `m` in body axes; ignore it if its angles contradict its position."""
        angles = np.tan([m.angle_x, m.angle_y]) * m.z - [m.y, -m.x]
        if np.abs(angles).max() <= 0.05 * max(m.distance, 1.0):
            self.logic.aim_landing(self.estimated + self.attitude @ np.array([m.x, -m.y, -m.z]), self.boot)

    def _may_start(self, arms: bool) -> bool:
        high = arms and self.dialect.arms_with_throttle_down and self.reports.sticks[2] > 1150
        if high:
            self.logic.texts.append("Arm: Throttle (RC3) is not neutral")
        return not high

    def execute(self, command: int, p: tuple[float, ...]) -> int:
        """Execute a MAV_CMD with its seven parameters; return its MAV_RESULT."""
        denied, failed, logic = mavlink.MAV_RESULT_DENIED, mavlink.MAV_RESULT_FAILED, self.logic
        done: bool
        if command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
            done, failed = self.reports.request(round(p[0]), p[1]), denied
        elif command == mavlink.MAV_CMD_DO_SET_MODE:
            doing = self.dialect.doing(p) if self.boot >= self._refuses_until else None
            if doing is Doing.HOLD and not self.located:
                logic.texts.append("Mode change to BRAKE failed: requires position")
                doing = None
            done = doing is not None and logic.enter(doing, self.boot)
        elif command == mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
            if p[0] > 0.5 and not self.ready:
                return int(mavlink.MAV_RESULT_TEMPORARILY_REJECTED)
            done = self._may_start(p[0] > 0.5) and logic.arm(p[0] > 0.5)
        elif command == mavlink.MAV_CMD_NAV_TAKEOFF:
            done = logic.take_off(p[6] - (self.home.altitude_msl if self.dialect.needs_setpoints else 0))
        elif command == mavlink.MAV_CMD_DO_CHANGE_SPEED:
            done = logic.limit(p[0], p[1])
        elif command == mavlink.MAV_CMD_SET_EKF_SOURCE_SET:
            done, failed = self.estimator.select(p[0]), denied
        elif command == mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN:
            done = True
            self.reboot()
        else:
            return int(mavlink.MAV_RESULT_UNSUPPORTED)
        return int(mavlink.MAV_RESULT_ACCEPTED if done else failed)
