"""One landing in closed loop: a vehicle that can be steered, the three lanes in turn, and the executive."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from alight import terrain
from alight.arrays import F64
from alight.flight.executive import ENDS, Executive
from alight.flight.session.pictures import PictureWatch
from alight.flight.session.verdicts import for_executive, look_picture
from alight.pipeline import Decision, FlightPolicy, Pipeline, Verdict
from alight.pipeline.mapping import MapSnapshot
from alight.pipeline.navigation import Navigation
from alight.pipeline.timing import Timings
from alight.records import Frame, Motion, MotionState, NavSample
from alight.records.executive import FlightDiary, FlightState, MapVerdict, Order, Situation
from alight.settings import Settings
from alight.trials.mean_tie import MeanTie
from alight_sim.steered import SteeredFlight, Wanted

TICK = 0.1  # s between two orders
LATENCY = 0.5  # s from a map to its verdict, which the loop may not use before
LONGEST = 1.5  # times the budget of time, after which the loop gives up
SILENT_NS = 2_000_000_000  # without a position, after which the autopilot cannot hold its place
BELOW = 1.0  # m below the site, where the set-point of a touchdown lies


@dataclass
class Landing:
    """The end of one landing in closed loop, with its diary."""

    state: FlightState = FlightState.SEARCH
    diary: FlightDiary = field(default_factory=FlightDiary)
    seconds: float = 0.0
    p_at_commit: float | None = None
    verdicts: int = 0
    decision: Decision | None = None  # of the whole flight, if requested
    timings: Mapping[str, Sequence[float]] = field(default_factory=dict)  # seconds of every step, by stage
    cpu_of: Mapping[str, float] = field(default_factory=dict)  # s of CPU: simulator, navigation, mapping, judging


def fly_landing(
    vehicle: SteeredFlight,
    settings: Settings,
    appearance: terrain.Model | None = None,
    happening: Callable[[float, FlightState], None] = lambda t, state: None,
    keep_pictures: bool = False,
    map_all: bool = False,
) -> Landing:
    """Search, look, look again, and land or give up.

    Args:
        vehicle: the simulated vehicle that is steered.
        settings: all settings; the map is always built recursively.
        appearance: model of the appearance of ground; None: there is none.
        happening: called with the time (s) and the state before every order; it may act on the vehicle.
        keep_pictures: keep a picture of the ground at every look.
        map_all: make and judge the map of the whole flight at its end.
    """
    loop = _Loop(vehicle, settings, appearance, keep_pictures)
    while not loop.over:
        happening(loop.t, loop.executive.state)
        loop.step()
    return loop.result(map_all)


class _MeasuredPipeline(Pipeline):
    """The pipeline of a vehicle, which adds the time that mapping and judging take to `costs`."""

    def __init__(
        self, vehicle: SteeredFlight, settings: Settings, appearance: terrain.Model | None, costs: Timings,
        policy: FlightPolicy, on_verdict: Callable[[Verdict, int], None],
    ) -> None:  # fmt: skip
        super().__init__(
            vehicle.rig, "flight", settings, clock=time.perf_counter, history=False, appearance=appearance,
            policy=policy, on_verdict=on_verdict, imu=vehicle.imu_noise,
        )  # fmt: skip
        self._costs = costs

    def map(self, navigation: Navigation) -> MapSnapshot | None:
        """As `Pipeline.map`, measured."""
        with self._costs.of("mapping"):
            return super().map(navigation)

    def judge(self, seen: MapSnapshot) -> Verdict:
        """As `Pipeline.judge`, measured."""
        with self._costs.of("judging"):
            return super().judge(seen)


class _Loop:
    def __init__(
        self,
        vehicle: SteeredFlight,
        settings: Settings,
        appearance: terrain.Model | None,
        keep_pictures: bool,
    ) -> None:
        self._vehicle, self._keep = vehicle, keep_pictures
        self._settings = settings.model_copy(
            update={"parallax": settings.parallax.model_copy(update={"method": "ring"})}
        )
        self._costs = Timings(time.process_time)
        self._policy = FlightPolicy(every=0)  # judged when the executive needs it
        self._pipeline = _MeasuredPipeline(
            vehicle, self._settings, appearance, self._costs, self._policy, self._judged
        )  # fmt: skip
        self.executive = Executive(settings.stages())
        self._begin = vehicle.time_ns
        self._motion: Motion | None = None
        self._pictures = PictureWatch()
        self._seen: MapVerdict | None = None
        self._pending: tuple[float, MapVerdict] | None = None  # and when it is known
        self._number, self._most = 0, LONGEST * settings.executive.time_budget
        self._landing = Landing()
        self._rows: deque[tuple[int, F64]] = deque(maxlen=40)  # GPS/INS, ns and metres
        self._tie = MeanTie()
        self._held: F64 | None = None
        self._wanted = Wanted()

    @property
    def t(self) -> float:
        """Seconds of the flight."""
        return (self._vehicle.time_ns - self._begin) * 1e-9

    @property
    def over(self) -> bool:
        """True once the vehicle has landed, the landing is given up, or it has taken too long."""
        return self.executive.state in ENDS or self.t > self._most

    def step(self) -> None:
        """Let the vehicle fly for `TICK` seconds, process its events, and set the next order."""
        with self._costs.of("simulator"):
            events = self._vehicle.step(TICK, self._wanted)
        for event in events:
            if isinstance(event, NavSample) and event.position_world is not None:
                self._rows.append((event.t_ns, event.position_world))
            fresh = self._pictures.fresh(event, self._vehicle.time_ns) if isinstance(event, Frame) else event
            with self._costs.of("pipeline"):
                motion = None if fresh is None else self._pipeline.feed(fresh)
            if motion is not None:
                self._motion = motion
                self._tie_to_autopilot(motion)
        if self._motion is None:  # there is no motion before the first exposure
            return
        if self._pending is not None and self.t >= self._pending[0]:
            _, self._seen = self._pending
            self._pending = None
        diary = self.executive.diary
        before = len(diary.looks)
        order = self.executive.tick(self._situation())
        self._policy.need = None if self._pending is not None else self.executive.need
        if self._keep and len(diary.looks) > before and self._seen is not None:
            diary.pictures.append(look_picture(diary.looks[-1], self._seen))
        self._obey(order)

    def _situation(self) -> Situation:
        m = self._motion
        assert m is not None
        lost = m.state in (MotionState.LOST, MotionState.INITIALISING)
        return Situation(
            self.t, None if lost else m.world_from_body.translation, m.state, m.frame_id, self._seen,
            self._pictures.age(self._vehicle.time_ns), self._pictures.frozen > 0,
            standing=self._vehicle.landed, battery=self._vehicle.battery, wind=self._vehicle.learned_wind,
            holds=bool(self._rows) and self._vehicle.time_ns - self._rows[-1][0] < SILENT_NS,
        )  # fmt: skip

    def _judged(self, verdict: Verdict, t_ns: int) -> None:
        """Take a verdict, which is used `LATENCY` seconds later; none is needed until then."""
        self._number += 1
        self._landing.verdicts += 1
        self._pending = (self.t + LATENCY, for_executive(verdict, self._number, (t_ns - self._begin) * 1e-9))
        self._policy.need = None

    def _tie_to_autopilot(self, motion: Motion) -> None:
        """Tie commands to the autopilot's own estimate of the same instant: the error of GPS cancels."""
        if len(self._rows) < 2 or motion.state in (MotionState.LOST, MotionState.INITIALISING):
            return
        t = np.array([r[0] for r in self._rows], np.float64)
        own = np.array([np.interp(motion.t_ns, t, axis) for axis in np.array([r[1] for r in self._rows]).T])
        self._tie.add(own - motion.world_from_body.translation, motion.frame_id)

    def _obey(self, order: Order) -> None:
        m = self._motion
        assert m is not None
        if order.what in ("fly", "land") and order.position is not None and self._tie.frame_id == m.frame_id:
            to = order.position
            if order.what == "land":
                kept = m.world_from_body.translation[2] if order.height is None else order.height
                to = np.array([*to[:2], to[2] - BELOW if order.down else kept])
            target = to + self._tie.mean
            self._wanted = Wanted(target, speed=order.speed, sink=order.sink)
            self._held = None
        elif order.what == "land" and order.position is None and self._rows:
            if self._held is None:
                self._held = self._rows[-1][1].copy()
            below = np.array([*self._held[:2], self._rows[-1][1][2] - BELOW])
            self._wanted = Wanted(below, speed=order.speed, sink=order.sink)
        elif order.what != "nothing":
            if self._held is None and self._rows:
                self._held = self._rows[-1][1].copy()
            self._wanted = Wanted(self._held, speed=1.0)

    def result(self, map_all: bool) -> Landing:
        """The landing as it is now; `map_all`: with the decision on the map of the whole flight."""
        d = self.executive.diary
        commits = [x for x in d.transitions if x.after is FlightState.COMMIT]
        p = commits[-1].p_safe if commits else None
        cpu_of = self._cpu_of()  # of the flight alone
        decision = self._pipeline.finish() if map_all else None
        return replace(
            self._landing, state=self.executive.state, diary=d, seconds=self.t, p_at_commit=p, decision=decision,
            timings=self._pipeline.timings, cpu_of=cpu_of,
        )  # fmt: skip

    def _cpu_of(self) -> dict[str, float]:
        spent = {name: sum(steps) for name, steps in self._costs.stages.items()}
        mapping, judging, pipeline = (spent.get(k, 0.0) for k in ("mapping", "judging", "pipeline"))
        return {
            "simulator": spent.get("simulator", 0.0), "navigation": pipeline - mapping - judging, "mapping": mapping,
            "judging": judging,
        }  # fmt: skip
