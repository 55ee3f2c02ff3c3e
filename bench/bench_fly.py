"""A landing through the protocol, with pictures: the simulated autopilot and our pilot in turn, in virtual time.

    python bench/bench_fly.py meadow --width 320 --seed 0

Everything of `alight fly` is in the loop except its threads and processes: telemetry and set-points as MAVLink, the
clock by TIMESYNC, an estimate of the autopilot with offset and drift, pictures of the scene, and the three lanes.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from alight.flight.autopilot import Autopilot, TelemetryEvents
from alight.flight.session.pilot import LandingPilot
from alight.pipeline import FlightPolicy, Pipeline, Verdict
from alight.records import Event, Frame
from alight.records.executive import FlightState, LookRecord, Transition
from alight.settings import load_settings
from alight_sim.autopilot import EstimateError, SimulatedAutopilot, SimulatedHome
from alight_sim.autopilot.dialects import Doing
from alight_sim.oracle import OracleLander
from alight_sim.steered import SteeredFlight
from alight_sim.steered.flown import FlownVehicle
from alight_sim.steered.touchdown import judge_contact

STEP = 0.01  # s
MOTION, VERDICT = 100_000_000, 500_000_000  # ns from an exposure until each is known
BEGIN = 6.0  # s until the landing begins
LONGEST = 600.0  # s


@dataclass
class Loop:
    """One landing."""

    scene: str
    seed: int
    width: int
    assignments: list[str]
    later: list[tuple[int, Callable[[], None]]] = field(default_factory=list)
    pilot: LandingPilot | None = None

    def __post_init__(self) -> None:
        size = (self.width, self.width * 3 // 4)
        self.flight = SteeredFlight(
            self.scene, self.seed, size=size, start=(-20.0, -12.0, 25.0), steered_by="truth", rate_hz=5.0
        )
        local, self.vehicle = self.flight.local, FlownVehicle(self.flight)
        home = SimulatedHome(local.latitude, local.longitude, local.height - 46.0, 46.0)
        wrong = EstimateError((2.0, -1.5, 0.8), walk=0.05, seed=self.seed)
        self.sim = SimulatedAutopilot(vehicle=self.vehicle, home=home, estimate=wrong)
        self.sim.hover(Doing.PILOT)
        self.ours = Autopilot({"HIGHRES_IMU": 100.0}, TelemetryEvents(local))
        self.settings = load_settings("", self.assignments)
        self.policy = FlightPolicy(every=0)  # judged as the executive needs it
        self.pipeline = Pipeline(
            self.flight.rig, "flight", self.settings, history=False, policy=self.policy, on_verdict=self._judged,
            imu=self.flight.imu_noise,
        )  # fmt: skip

    def run(self) -> None:
        """Fly until it is over."""
        for k in range(1, round(LONGEST / STEP)):
            self._step(k)
            if self.pilot is not None and self.pilot.over:
                return

    def _step(self, k: int) -> None:
        self.sim.step(STEP)
        now = self.flight.time_ns
        for data in self.sim.pending():
            self.ours.receive(data, now)
        self.ours.tick(now)
        events: list[Event] = [*self.ours.samples(), *self.vehicle.take()]
        if self.pilot is None and (vehicle := self.ours.vehicle) is not None:
            self.pilot = LandingPilot(self.settings, self.flight.local, vehicle, vehicle, self.policy, self)
        for event in sorted(events, key=lambda e: (e.t_ns, isinstance(e, Frame))):
            self._feed(event, now)
        for due in [x for x in self.later if x[0] <= now]:
            self.later.remove(due)
            due[1]()
        if self.pilot is not None:
            self._fly(self.pilot, k, now)
        for data in self.ours.pending():
            self.sim.receive(data)
        for data in self.sim.pending():  # answers, TIMESYNC among them, without a step between
            self.ours.receive(data, now)

    def _fly(self, pilot: LandingPilot, k: int, now: int) -> None:
        if k == round(BEGIN / STEP):
            pilot.begin(now)
        if k >= round(BEGIN / STEP) and k % 5 == 0:
            for notice in self.ours.notices():
                pilot.noticed(notice)
            pilot.tick(now)

    def _feed(self, event: Event, now: int) -> None:
        pilot = self.pilot
        if pilot is not None and isinstance(event, Frame) and pilot.saw(event, now) is None:
            return
        motion = self.pipeline.feed(event)
        if pilot is None or motion is None or not isinstance(event, Frame):
            return
        self.later.append((now + MOTION, lambda: pilot.moved(motion)))

    def _judged(self, verdict: Verdict, t_ns: int) -> None:
        if (pilot := self.pilot) is not None:
            self.later.append((self.flight.time_ns + VERDICT, lambda: pilot.judged(verdict, t_ns)))

    def order(self, t_ns: int, state: str, words: str) -> None:
        """Print nothing: there are many orders."""

    def landing(self, t_ns: int, entry: Transition | LookRecord) -> None:
        """Print an entry of the diary."""
        print(entry.line, flush=True)

    def note(self, lane: str, words: str) -> None:
        """Print a note."""
        print(f"{lane}: {words}", flush=True)


def main() -> None:
    """Fly one landing and judge its touchdown."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("scene")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--width", type=int, default=320)
    parser.add_argument("--set", action="append", default=[])
    given = parser.parse_args()
    begin, loop = time.process_time(), Loop(given.scene, given.seed, given.width, given.set)
    loop.run()
    state = FlightState.SEARCH if loop.pilot is None else loop.pilot.state
    print(f"{state.value} after {loop.flight.seconds:.0f} s, {time.process_time() - begin:.0f} s of CPU")
    contact = loop.flight.contact
    if contact is not None:
        print(judge_contact(loop.flight, contact, OracleLander()))


if __name__ == "__main__":
    main()
