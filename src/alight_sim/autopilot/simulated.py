"""The simulated autopilot: MAVLink bytes in and out, its own clock, its own estimate, its own vehicle."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from alight.arrays import F64
from alight.geometry import Pose
from alight_sim.autopilot.dialects import Dialect, Doing, SpokenArduPilot
from alight_sim.autopilot.estimate import Estimate, EstimateError
from alight_sim.autopilot.flight_logic import FlightLogic
from alight_sim.autopilot.reports import Reports, SimulatedState
from alight_sim.point_mass import PointMass, Wanted

_START_UP = 3.0  # s from a start until it may be armed
_NO_FIX = 0.5  # s without a position, after which the receiver reports no fix
_ACCEPTED, _FOR_NOW, _DENIED, _UNSUPPORTED, _FAILED = 0, 1, 2, 3, 4
_IGNORE_POSITION, _IGNORE_VELOCITY, _IGNORE_YAW = 7, 56, 1024
_RELATIVE_FRAMES, _BODY_FRD = (3, 6), 12
_HELICOPTER = 4  # MAV_TYPE


class TrueVehicle(Protocol):
    """Interface of the vehicle: a point with limits, or a flight over a scene. ENU, metres; see `PointMass`."""

    @property
    def position(self) -> F64: ...
    @property
    def velocity(self) -> F64: ...
    @property
    def wind_world(self) -> F64: ...
    @property
    def stands(self) -> bool: ...
    @property
    def world_from_body(self) -> Pose: ...
    @property
    def imu(self) -> tuple[F64, F64] | None: ...
    @property
    def battery(self) -> float: ...
    def step(self, dt: float, wanted: Wanted | None) -> None: ...


@dataclass(frozen=True)
class SimulatedHome:
    """Home of the autopilot on Earth: the origin of its vehicle's metres."""

    latitude: float = 47.6
    longitude: float = 13.4
    altitude_msl: float = 500.0
    separation: float = 46.0  # metres, ellipsoid above sea level

    def degrees(self, enu: F64) -> tuple[float, float, float]:
        """Latitude, longitude and altitude above sea level of (3,) metres from the home."""
        meridian, parallel = self._radii()
        return (
            self.latitude + math.degrees(float(enu[1]) / meridian),
            self.longitude + math.degrees(float(enu[0]) / parallel),
            self.altitude_msl + float(enu[2]),
        )

    def metres(self, latitude: float, longitude: float, altitude_msl: float) -> F64:
        """(3,) metres from the home, of latitude and longitude in degrees and altitude above sea level."""
        meridian, parallel = self._radii()
        north = math.radians(latitude - self.latitude) * meridian
        east = math.radians(longitude - self.longitude) * parallel
        return np.array([east, north, altitude_msl - self.altitude_msl])

    def _radii(self) -> tuple[float, float]:
        """Radii along the meridian and of the parallel, metres, at the home's height above the WGS84 ellipsoid."""
        a, e2 = 6378137.0, 0.00669437999014
        height, s = self.altitude_msl + self.separation, math.sin(math.radians(self.latitude))
        w = math.sqrt(1 - e2 * s * s)
        return a * (1 - e2) / w**3 + height, (a / w + height) * math.cos(math.radians(self.latitude))


class SimulatedAutopilot:
    """One autopilot with its vehicle. `receive` bytes, `step` time, send the `pending` datagrams.

    It streams its heartbeat and the requested messages alone, and forgets the requests at a reboot. It stamps messages
    with its own clock; `drift` is the relative error of that clock's rate. `kind`: MAV_TYPE.
    """

    def __init__(
        self,
        dialect: Dialect | None = None,
        vehicle: TrueVehicle | None = None,
        home: SimulatedHome | None = None,
        estimate: Estimate | None = None,
        drift: float = 0.0,
        system: int = 1,
        kind: int = 2,
    ) -> None:
        self.dialect = dialect or SpokenArduPilot()
        self.vehicle: TrueVehicle = vehicle or PointMass()
        self.home = home or SimulatedHome()
        self.estimate: Estimate = estimate or EstimateError()
        self.healthy = self.checks = True  # checks: before arming, switched on
        self._drift, self._system, self._kind = drift, system, kind
        self._mavlink = mavlink.MAVLink(None, srcSystem=system, srcComponent=1)
        self._mavlink.robust_parsing = True
        self._out: list[bytes] = []
        self._start()

    def _start(self) -> None:
        self._boot = self._middle = self._refuses_until = 0.0  # s, of its own clock
        self.logic = FlightLogic(self.dialect, interlock=False if self._kind == _HELICOPTER else None)
        self.reports = Reports(self.dialect, self._send, self._kind)
        self._mavlink.seq = 0

    @property
    def boot_ns(self) -> int:
        """Its own clock, ns since boot."""
        return round(self._boot * 1e9)

    @property
    def ready(self) -> bool:
        """True if it may be armed."""
        return self.located and self._boot > _START_UP and (self.logic.armed or not self.logic.interlock)

    @property
    def located(self) -> bool:
        """True while it has an absolute position, for some time after the last one of its receiver as well."""
        return self.healthy and self.estimate.blind < self.dialect.dead_reckoning

    @property
    def estimated(self) -> F64:
        """(3,) metres: its estimate of its position."""
        return self.vehicle.position + self.estimate.error

    def reboot(self) -> None:
        """Start again: motors off, clock at 0, streams forgotten."""
        self._start()

    def hover(self, doing: Doing = Doing.HOLD) -> None:
        """Put it in the air at the vehicle's position, armed, as after a take-off."""
        self.logic.armed, self._boot = True, _START_UP + 1.0
        self.logic.step(self._boot, self.estimated, False)
        self.logic.doing = Doing.TAKE_OFF
        self.logic.enter(doing, self._boot)

    def refuse_modes(self, seconds: float) -> None:
        """Refuse all commands that change the mode for some time."""
        self._refuses_until = self._boot + seconds

    def pilot(self, doing: Doing = Doing.PILOT) -> None:
        """Change the mode as a pilot does."""
        self.logic.enter(doing, self._boot)

    def pending(self) -> list[bytes]:
        """Remove and return the datagrams to send."""
        out, self._out = self._out, []
        return out

    def step(self, dt: float) -> None:
        """Advance by `dt` seconds of true time."""
        self._middle = self._boot + 0.5 * dt * (1 + self._drift)
        self._boot += dt * (1 + self._drift)
        self.estimate.step(dt)
        wanted = self.logic.step(self._boot, self.estimated, self.vehicle.stands)
        self.vehicle.step(dt, None if wanted is None else self._in_truth(wanted))
        self.reports.step(self._boot, self._snapshot())

    def _in_truth(self, wanted: Wanted) -> Wanted:
        """The set-point in true coordinates: it steers by its estimate, so the vehicle is off by the error."""
        position = None if wanted.position is None else wanted.position - self.estimate.error
        return replace(wanted, position=position)

    def _snapshot(self) -> SimulatedState:
        estimated, estimate = self.estimated, self.estimate
        return SimulatedState(
            self.logic, self.vehicle, self.home.degrees(estimated), estimated,
            self.vehicle.velocity + estimate.velocity_error, estimate.attitude(self.vehicle.world_from_body.rotation),
            self.home, self.ready, self.healthy and estimate.blind < _NO_FIX, estimate.accuracy,
            self._boot, self._middle, self.checks,
        )  # fmt: skip

    def _send(self, message: Any) -> None:
        self._out.append(bytes(message.pack(self._mavlink)))
        self._mavlink.seq = (self._mavlink.seq + 1) % 256

    def receive(self, data: bytes) -> None:
        """Take a datagram and handle its messages."""
        for m in self._mavlink.parse_buffer(data) or ():
            handler = getattr(self, f"_on_{m.get_type().lower()}", None)
            if handler is not None and getattr(m, "target_system", self._system) in (0, self._system):
                handler(m, (m.get_srcSystem(), m.get_srcComponent()))

    def _on_timesync(self, m: Any, sender: tuple[int, int]) -> None:
        if m.tc1 == 0:
            self._send(mavlink.MAVLink_timesync_message(self.boot_ns, m.ts1))

    def _on_set_position_target_global_int(self, m: Any, sender: tuple[int, int]) -> None:
        altitude = m.alt + self.home.altitude_msl if m.coordinate_frame in _RELATIVE_FRAMES else m.alt
        self._guide(m, self.home.metres(m.lat_int * 1e-7, m.lon_int * 1e-7, altitude))

    def _on_set_position_target_local_ned(self, m: Any, sender: tuple[int, int]) -> None:
        self._guide(m, np.array([m.y, m.x, -m.z]))

    def _guide(self, m: Any, position: F64) -> None:
        mask = m.type_mask
        velocity = np.array([m.vy, m.vx, -m.vz])
        wanted = Wanted(
            None if mask & _IGNORE_POSITION == _IGNORE_POSITION else position,
            None if mask & _IGNORE_VELOCITY == _IGNORE_VELOCITY else velocity,
            None if mask & _IGNORE_YAW else m.yaw,
        )
        self.logic.guide(wanted, self._boot)

    def _on_landing_target(self, m: Any, sender: tuple[int, int]) -> None:
        if not m.position_valid:
            return
        if m.frame == _BODY_FRD:
            line = np.array([m.x, -m.y, -m.z])
            angles = np.tan([m.angle_x, m.angle_y]) * m.z - [m.y, -m.x]
            if np.abs(angles).max() > 0.05 * max(m.distance, 1.0):
                return  # angles and position contradict each other
            target = self.estimated + self.estimate.attitude(self.vehicle.world_from_body.rotation) @ line
        else:
            target = np.array([m.y, m.x, -m.z])
        self.logic.aim_landing(target, self._boot)

    def _on_command_long(self, m: Any, sender: tuple[int, int]) -> None:
        parameters = (m.param1, m.param2, m.param3, m.param4, m.param5, m.param6, m.param7)
        result = self._command(m.command, parameters)
        self._send(mavlink.MAVLink_command_ack_message(m.command, result, 0, 0, *sender))

    def _command(self, command: int, p: tuple[float, ...]) -> int:
        if command == 511:
            return _ACCEPTED if self.reports.ask(round(p[0]), p[1]) else _DENIED
        if command == 176:
            doing = self.dialect.doing(p) if self._boot >= self._refuses_until else None
            return _ACCEPTED if doing is not None and self.logic.enter(doing, self._boot) else _FAILED
        if command == 400:
            refused = p[0] > 0.5 and not self.ready
            return _FOR_NOW if refused else self._said(self.logic.arm(p[0] > 0.5))
        if command == 22:
            return self._said(
                self.logic.take_off(p[6] - (self.home.altitude_msl if self.dialect.needs_setpoints else 0))
            )
        if command == 178:
            return self._said(self.logic.limit(p[0], p[1]))
        if command == 115 and not self.dialect.needs_setpoints:
            self.logic.face(math.radians(p[0]))
            return _ACCEPTED
        if command == 246:
            self.reboot()
            return _ACCEPTED
        return _UNSUPPORTED

    def _said(self, done: bool) -> int:
        return _ACCEPTED if done else _FAILED
