"""An autopilot of ours and a simulated one on a link of virtual time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from alight.flight.autopilot import Autopilot, RemoteVehicle, TelemetryEvents
from alight.flight.autopilot.signing import SigningKey
from alight.flight.autopilot.vehicle_state import VehicleState
from alight.geometry import LocalFrame
from alight.records import FlightMode, Notice, NoticeKind, Telemetry
from alight.records.telemetry import FirmwareName
from alight_sim.autopilot import DIALECTS, LossyChannel, SimulatedAutopilot, SimulatedHome
from alight_sim.autopilot.memory import EXTERNAL_NAVIGATION

START = 1_700_000_000.0  # s, of our clock: nothing may depend on where it starts
HOME = SimulatedHome()
LOCAL = LocalFrame(HOME.latitude, HOME.longitude, HOME.altitude_msl + HOME.separation)


class Rig:
    """Both ends, stepped together; `link` holds the keywords of both directions' `LossyChannel`."""

    def __init__(
        self, dialect: FirmwareName = "ardupilot", seed: int = 0, link: dict[str, float] | None = None,
        step: float = 0.05, rates: dict[str, float] | None = None, key: bytes | None = None, odometry: bool = False,
        **simulated: Any,
    ) -> None:  # fmt: skip
        self.sim = SimulatedAutopilot(DIALECTS[dialect], key=key, **simulated)
        if odometry:
            self.sim.memory.parameters |= EXTERNAL_NAVIGATION[dialect]
        signing = None if key is None else SigningKey(key, 0)
        self.ours = Autopilot(rates, TelemetryEvents(LOCAL), key=signing, odometry=odometry)
        self.up = LossyChannel(seed=seed, **(link or {}))
        self.down = LossyChannel(seed=seed + 1, **(link or {}))
        self.t, self.dt = START, step
        self.heard: list[Notice] = []
        self.samples: list[Any] = []
        self.each_step: Callable[[], None] = lambda: None
        self.is_lost: Callable[[bytes], bool] = lambda data: False  # of a datagram of ours

    @property
    def now_ns(self) -> int:
        return round(self.t * 1e9)

    @property
    def vehicle(self) -> RemoteVehicle:
        assert self.ours.vehicle is not None
        return self.ours.vehicle

    @property
    def telemetry(self) -> Telemetry:
        assert self.ours.telemetry is not None
        return self.ours.telemetry

    def step(self) -> None:
        self.t += self.dt
        for data in self.up.get(self.t):
            self.sim.receive(data)
        self.sim.step(self.dt)
        for data in self.sim.pending():
            self.down.put(data, self.t)
        for data in self.down.get(self.t):
            self.ours.receive(data, self.now_ns)
        self.ours.tick(self.now_ns)
        self.each_step()
        for data in self.ours.pending():
            if not self.is_lost(data):
                self.up.put(data, self.t)
        self.heard += self.ours.notices()
        self.samples += self.ours.samples()

    def run(self, seconds: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Step until the condition holds; False: it never did."""
        end = self.t + seconds
        while self.t < end:
            self.step()
            if until():
                return True
        return False

    def lose(self, kind: str, when: Callable[[Any], bool]) -> None:
        """From now on, lose our messages of a kind for which a condition holds."""
        reader = mavlink.MAVLink(None)
        self.is_lost = lambda data: any(m.get_type() == kind and when(m) for m in reader.parse_buffer(data) or ())

    def of(self, kind: NoticeKind) -> list[Notice]:
        return [n for n in self.heard if n.kind is kind]

    def answered(self, ticket: int, seconds: float = 20.0, kind: NoticeKind = NoticeKind.COMMAND) -> Notice:
        """Wait for the answer to an order, and return it."""
        found = lambda: [n for n in self.of(kind) if n.ticket == ticket]  # noqa: E731
        assert found() or self.run(seconds, lambda: bool(found())), f"no answer; heard {self.heard}"
        return found()[0]

    def ready(self) -> Rig:
        """Wait until it may be armed."""
        assert self.run(30, lambda: self.ours.telemetry is not None and self.ours.telemetry.ready)
        return self

    def up_and_flying(self, height: float = 20.0) -> None:
        """Wait until it is ready, arm, take off, and reach the height."""
        self.ready()
        self.answered(self.vehicle.set_mode(FlightMode.GUIDED))
        assert self.answered(self.vehicle.arm()).ok
        if self.vehicle.helicopter:
            self.sim.logic.interlock = True
        self.answered(self.vehicle.take_off(height))  # refused in the air, if it was the first answer that was lost
        assert self.run(60, lambda: self.sim.estimated[2] > height - 0.5)
        self.answered(self.vehicle.set_mode(FlightMode.GUIDED))

    def truth(self) -> np.ndarray:
        """True position, (3,) metres in our world."""
        return LOCAL.to_enu(*geodetic(self.sim.vehicle.position))


def geodetic(metres: np.ndarray) -> tuple[float, float, float]:
    """Latitude, longitude and height above the ellipsoid of metres from the simulated home."""
    latitude, longitude, msl = HOME.degrees(metres)
    return latitude, longitude, msl + HOME.separation


HERE = (476_000_000, 134_000_000, 530_000, 30_000)  # a place as GLOBAL_POSITION_INT has it


def report(boot_ms: int, numbers: tuple[int, int, int, int], velocity: tuple[int, int, int] = (0, 0, 0)) -> Any:
    """A GLOBAL_POSITION_INT."""
    return mavlink.MAVLink_global_position_int_message(boot_ms, *numbers, *velocity, 0)


def accepted(state: VehicleState, *messages: Any) -> list[bool]:
    """Which of the messages are accepted, one after the other."""
    return [state.on_message(m.get_type(), m, 0) for m in messages]
