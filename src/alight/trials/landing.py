"""One landing in virtual time: the pilot of real flights, over a simulated autopilot and simulated pictures.

All parts of `alight fly` are used except sockets, threads and processes: telemetry and orders are MAVLink in two byte
queues, the clocks are tied by TIMESYNC, and the three lanes run in turn.
"""

from __future__ import annotations

import heapq
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from alight import memory, terrain
from alight.checks.result import Judged
from alight.flight.autopilot import Autopilot, TelemetryEvents
from alight.flight.executive.table import ENDS
from alight.flight.live.sight import SightNavigation
from alight.flight.session.pilot import LandingPilot, SessionLog
from alight.flight.session.preflight import judge_motion
from alight.landing.zones import MapZones
from alight.outputs.recorder import Recorder
from alight.pipeline import Decision, FlightPolicy, Pipeline, PipelineOptions, Verdict
from alight.pipeline.mapping import MapSnapshot
from alight.pipeline.navigation import Navigation
from alight.pipeline.timing import Timings
from alight.records import NO_ZONES, Event, Frame, ZonesOnPlane
from alight.records.executive import FlightDiary, FlightState
from alight.records.telemetry import FirmwareName
from alight.settings import Settings
from alight_sim.autopilot import DIALECTS, SimulatedAutopilot, SimulatedHome
from alight_sim.autopilot.dialects import Doing
from alight_sim.autopilot.memory import EXTERNAL_NAVIGATION
from alight_sim.steered import FlownEstimate, SteeredFlight
from alight_sim.steered.flight import IMU_RATE_HZ

STEP, STEPS = 1.0 / IMU_RATE_HZ, 5  # s per step of the vehicle, and such steps per step of the pilot
MOTION_NS, VERDICT_NS = 100_000_000, 500_000_000  # from the arrival of an exposure to its motion, its verdict
READY = 30.0  # s, longest wait for the autopilot and the motion before the landing begins
LONGEST = 1.5  # times the time budget, after which the trial ends


@dataclass
class Landing:
    """The end of one landing in closed loop, with its diary."""

    state: FlightState = FlightState.SEARCH
    diary: FlightDiary = field(default_factory=FlightDiary)
    seconds: float = 0.0  # since the landing began
    p_at_commit: float | None = None  # P(safe) when the commit began; None: no commit
    verdicts: int = 0  # number of verdicts
    decision: Decision | None = None  # decision on the whole flight, if requested
    timings: Mapping[str, Sequence[float]] = field(default_factory=dict)  # seconds of every step, by stage
    cpu_of: Mapping[str, float] = field(default_factory=dict)  # s of CPU: simulator, navigation, mapping, judging, link


def fly_landing(
    vehicle: SteeredFlight,
    settings: Settings,
    appearance: terrain.Model | None = None,
    happening: Callable[[Trial], None] = lambda trial: None,
    firmware: FirmwareName = "ardupilot",
    zones: ZonesOnPlane = NO_ZONES,
    odometry: bool = False,
) -> Landing:
    """Search, look, look from lower, and land or give up; return the end of the landing.

    Args:
        vehicle: the simulated vehicle, in the air.
        settings: all settings; the map is always built recursively.
        appearance: model of the appearance of ground; None: no model.
        happening: called before every decision; it may act on the vehicle, the autopilot and the link.
        firmware: firmware of the simulated autopilot.
        zones: zones of the user, in the world of the vehicle.
        odometry: whether odometry is sent, and the autopilot flies by it where GPS fails.
    """
    trial = Trial(vehicle, settings, appearance, firmware, zones, odometry=odometry)
    trial.fly(happening)
    return trial.result()


class _MeasuredPipeline(Pipeline):
    """A pipeline that adds the durations of mapping and judging to `costs`."""

    costs: Timings

    def map(self, navigation: Navigation) -> MapSnapshot | None:
        with self.costs.of("mapping"):
            return super().map(navigation)

    def judge(self, seen: MapSnapshot) -> Verdict:
        with self.costs.of("judging"):
            return super().judge(seen)


class TrialLink:
    """The link between pilot and autopilot: bytes in both directions, without delay."""

    def __init__(self, ours: Autopilot, theirs: SimulatedAutopilot) -> None:
        self._ours, self._theirs = ours, theirs
        self._now_ns = self._cut_until_ns = 0

    def cut(self, seconds: float) -> None:
        """Drop all bytes of the next `seconds`."""
        self._cut_until_ns = self._now_ns + round(seconds * 1e9)

    def carry(self, now_ns: int) -> None:
        """Deliver the pending bytes of both sides, and the autopilot's answers to them."""
        self._now_ns = now_ns
        self._inward()
        self._ours.tick(now_ns)
        for data in self._ours.pending():
            if now_ns >= self._cut_until_ns:
                self._theirs.receive(data)
        self._inward()

    def _inward(self) -> None:
        data = b"".join(self._theirs.pending())
        if data and self._now_ns >= self._cut_until_ns:
            self._ours.receive(data, self._now_ns)


class Trial:
    """One landing in closed loop, step by step.

    Args:
        vehicle, settings, appearance, firmware, zones, odometry: see `fly_landing`.
        recorder: of the landing; None: it is not recorded.
    """

    def __init__(
        self, vehicle: SteeredFlight, settings: Settings, appearance: terrain.Model | None = None,
        firmware: FirmwareName = "ardupilot", zones: ZonesOnPlane = NO_ZONES, recorder: Recorder | None = None,
        odometry: bool = False,
    ) -> None:  # fmt: skip
        recursive = settings.parallax.model_copy(update={"method": "recursive"})
        self._vehicle, self._settings = vehicle, settings.model_copy(update={"parallax": recursive})
        self._costs = Timings(time.process_time)
        policy = FlightPolicy(every=0)  # judged when the executive needs it
        on_maps = MapZones(zones, settings.lander.reach) if zones.zones else None
        options = PipelineOptions(
            appearance=appearance, imu=vehicle.imu_noise, policy=policy, on_verdict=self._judged,
            clock=time.perf_counter, history=False, zones=on_maps,
        )  # fmt: skip
        self._pipeline = _MeasuredPipeline(vehicle.rig, "flight", self._settings, options)
        self._pipeline.costs = self._costs
        local = vehicle.local
        home = SimulatedHome.at(local)
        self.autopilot = SimulatedAutopilot(DIALECTS[firmware], vehicle, home, FlownEstimate(vehicle))
        self.autopilot.hover(Doing.PILOT)
        if odometry:
            self.autopilot.memory.parameters |= EXTERNAL_NAVIGATION[firmware]
        self._ours = Autopilot({"HIGHRES_IMU": IMU_RATE_HZ}, TelemetryEvents(local), odometry=odometry)
        self.link = TrialLink(self._ours, self.autopilot)
        while self._ours.vehicle is None:  # the autopilot sends its first heartbeat
            self.autopilot.step(STEP)
            self.link.carry(vehicle.time_ns)
        self._recorder, log = recorder, SessionLog(lambda line: None)
        log.recorder = recorder
        self._pilot = LandingPilot(self._settings, local, self._ours.vehicle, self._ours.vehicle, policy, log, zones)
        if odometry:
            self._pilot.sight = SightNavigation(self._ours.vehicle, self._ours.vehicle, log.note)
        self._later: list[tuple[int, int, Callable[[], None]]] = []  # due, number, call
        self._start_ns = vehicle.time_ns
        self._begin_ns: int | None = None
        self._numbers = self._verdicts = 0

    @property
    def begun(self) -> bool:
        """Whether the landing has begun."""
        return self._begin_ns is not None

    @property
    def t(self) -> float:
        """Seconds since the landing began; 0 before."""
        return 0.0 if self._begin_ns is None else (self._vehicle.time_ns - self._begin_ns) * 1e-9

    @property
    def state(self) -> FlightState:
        """State of the executive."""
        return self._pilot.state

    @property
    def over(self) -> bool:
        """Whether the vehicle has landed, the landing is given up, or it has taken too long."""
        return self.state in ENDS or self.t > LONGEST * self._settings.executive.time_budget

    def fly(self, happening: Callable[[Trial], None]) -> None:
        """Fly to the end; `happening` is called before every decision."""
        memory.keep_pages()
        while not self.over:
            if self.begun:
                happening(self)
            self.step()

    def step(self) -> None:
        """Let the vehicle fly for one step of the pilot, process what has arrived, and decide."""
        with self._costs.of("simulator"):
            flown = [event for _ in range(STEPS) for event in self.autopilot.step(STEP)]
        now_ns = self._vehicle.time_ns
        with self._costs.of("link"):
            self.link.carry(now_ns)
            events: list[Event] = [*self._ours.samples(), *(e for e in flown if isinstance(e, Frame))]
        for event in sorted(events, key=lambda e: (e.t_ns, isinstance(e, Frame))):
            self._feed(event)
        while self._later and self._later[0][0] <= now_ns:
            heapq.heappop(self._later)[2]()
        with self._costs.of("link"):
            self._fly(now_ns)

    def _fly(self, now_ns: int) -> None:
        for notice in self._ours.notices():
            self._pilot.on_notice(notice)
        if self._begin_ns is None and self._is_ready(now_ns):
            self._begin_ns = now_ns
            self._pilot.begin(now_ns)
        if self._begin_ns is not None:
            self._pilot.tick(now_ns)

    def _is_ready(self, now_ns: int) -> bool:
        """Whether the motion and the autopilot's position are known, or the time to wait for them is over."""
        m, vehicle = self._pilot.inputs.motion, self._ours.vehicle
        assert vehicle is not None
        known = m is not None and judge_motion(m, (now_ns - m.t_ns) * 1e-9).verdict is not Judged.BAD
        return (known and vehicle.telemetry.has_position) or (now_ns - self._start_ns) * 1e-9 > READY

    def _feed(self, event: Event) -> None:
        fresh = self._pilot.inputs.add_frame(event, self._vehicle.time_ns) if isinstance(event, Frame) else event
        if fresh is None:
            return
        if self._recorder is not None:
            self._recorder.event(fresh)
        with self._costs.of("pipeline"):
            motion = self._pipeline.feed(fresh)
        if motion is not None:
            if self._recorder is not None:
                self._recorder.motion(motion)
            self._after(MOTION_NS, lambda: self._pilot.on_motion(motion, self._vehicle.time_ns))

    def _judged(self, verdict: Verdict, t_ns: int) -> None:
        self._verdicts += 1
        if self._recorder is not None:
            self._recorder.verdict(t_ns, verdict.in_world())
        self._after(VERDICT_NS, lambda: self._pilot.inputs.add_verdict(verdict, t_ns))

    def _after(self, delay_ns: int, call: Callable[[], None]) -> None:
        self._numbers += 1
        heapq.heappush(self._later, (self._vehicle.time_ns + delay_ns, self._numbers, call))

    def result(self, map_all: bool = False) -> Landing:
        """Return the landing as it is now; with `map_all`, including the decision on the map of the whole flight."""
        d = self._pilot.diary
        commits = [x for x in d.transitions if x.after is FlightState.COMMIT]
        return Landing(
            self.state, d, self.t, commits[-1].p_safe if commits else None, self._verdicts,
            self._pipeline.finish() if map_all else None, self._pipeline.timings, self._cpu_of(),
        )  # fmt: skip

    def _cpu_of(self) -> dict[str, float]:
        spent = {name: sum(steps) for name, steps in self._costs.stages.items()}
        found = {name: spent.get(name, 0.0) for name in ("simulator", "link", "mapping", "judging")}
        return {**found, "navigation": spent.get("pipeline", 0.0) - found["mapping"] - found["judging"]}
