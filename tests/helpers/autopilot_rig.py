"""An autopilot of ours and a simulated one on a link of virtual time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from alight.flight.autopilot import Autopilot, RemoteVehicle, TelemetryEvents
from alight.geometry import LocalFrame
from alight.records import FlightMode, Notice, NoticeKind
from alight_sim.autopilot import LossyChannel, SimulatedAutopilot, SimulatedHome, SpokenArduPilot, SpokenPx4

DIALECTS = {"ardupilot": SpokenArduPilot, "px4": SpokenPx4}
START = 1_700_000_000.0  # s, of our clock: nothing may depend on where it starts
HOME = SimulatedHome()
LOCAL = LocalFrame(HOME.latitude, HOME.longitude, HOME.altitude_msl + HOME.separation)


class Rig:
    """Both ends, stepped together; `link` holds the keywords of both directions' `LossyChannel`."""

    def __init__(
        self, dialect: str = "ardupilot", seed: int = 0, link: dict[str, float] | None = None, step: float = 0.04,
        rates: dict[str, float] | None = None, **simulated: Any,
    ) -> None:  # fmt: skip
        self.sim = SimulatedAutopilot(DIALECTS[dialect](), **simulated)
        self.events = TelemetryEvents(LOCAL)
        self.ours = Autopilot(rates, self.events)
        self.up = LossyChannel(seed=seed, **(link or {}))
        self.down = LossyChannel(seed=seed + 1, **(link or {}))
        self.t, self.dt = START, step
        self.heard: list[Notice] = []
        self.samples: list[Any] = []
        self.each_step: Callable[[], None] = lambda: None

    @property
    def now_ns(self) -> int:
        return round(self.t * 1e9)

    @property
    def vehicle(self) -> RemoteVehicle:
        assert self.ours.vehicle is not None
        return self.ours.vehicle

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

    def of(self, kind: NoticeKind) -> list[Notice]:
        return [n for n in self.heard if n.kind is kind]

    def answered(self, ticket: int, seconds: float = 20.0, kind: NoticeKind = NoticeKind.COMMAND) -> Notice:
        """Wait for the answer to an order, and return it."""
        found = lambda: [n for n in self.of(kind) if n.ticket == ticket]  # noqa: E731
        assert found() or self.run(seconds, lambda: bool(found())), f"no answer; heard {self.heard}"
        return found()[0]

    def up_and_flying(self, height: float = 20.0) -> None:
        """Wait until it is ready, arm, take off, and reach the height."""
        assert self.run(30, lambda: self.ours.telemetry is not None and self.ours.telemetry.ready)
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
