"""A live run: each lane in a process of its own, fed through mailboxes that hold few items.

A lane that is too slow drops the oldest exposures; a lane that raises or hangs is replaced and begins anew. The
exposures that each lane used are the `schedule`. A `Pipeline` with the same events and schedule runs the lanes in turn
and gives the same bits. Memory does not grow with the flight unless the whole schedule is kept.
"""

from __future__ import annotations

import logging
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from threading import Thread
from typing import Any

from alight import terrain
from alight.arrays import F64
from alight.flight.live.health import POSE, STEP, LaneState, Watch
from alight.flight.live.lane_process import LaneLost, LaneProcess, LaneSpec
from alight.flight.live.lanes import NavigationProcess, make_judging, make_mapping
from alight.flight.live.mailbox import Closed, Mailbox
from alight.flight.live.stream_clocks import StreamClocks
from alight.landing.zones import MapZones
from alight.outputs.recorder import Recorder
from alight.pipeline import Decision, FlightPolicy, Verdict
from alight.pipeline.judging import JudgingMemory
from alight.pipeline.lanes import conclude
from alight.pipeline.mapping import MapSnapshot
from alight.pipeline.navigation import Navigation
from alight.pipeline.navigation.filter_lane import EventBatcher, FrameBatch
from alight.pipeline.timing import Timings
from alight.records import AlightError, Event, Frame, Motion, Rig, Schedule, SettingsError
from alight.settings import ImuNoise, Settings

log = logging.getLogger(__name__)

NAVIGATION, MAPPING, JUDGING = LANES = ("navigation", "mapping", "judging")


@dataclass(frozen=True)
class Listener:
    """Functions that are called with results as soon as they exist, each on the thread of its lane."""

    motion: Callable[[Motion], None] = lambda motion: None
    verdict: Callable[[Verdict, int], None] = lambda verdict, t_ns: None  # with the stamp of its newest exposure
    lost: Callable[[str, str], None] = lambda lane, why: None  # with the name of the lane and the reason


@dataclass(frozen=True, eq=False)
class LiveOptions:
    """Options of a live run. `drop`: whether a busy lane drops the oldest exposure (flight), else the sender waits."""

    listener: Listener = field(default_factory=Listener)
    recorder: Recorder | None = None
    drop: bool = True
    waiting: int = 1  # exposures that may wait for the navigation lane, a delay each; in flight six times for mapping
    schedule: int | None = 1000  # number of last entries of the schedule that are kept; None: all entries
    folder: Path | None = None  # for tiles that the vehicle has left behind; None: the system's temporary folder
    appearance: terrain.Model | None = None
    imu: ImuNoise | None = None  # noise stated for the IMU
    real_time: bool = False  # whether to find late events and clock jumps by the arrival of the events
    makers: Mapping[str, Callable[..., Any]] = field(default_factory=dict)  # non-default makers of lanes
    policy: FlightPolicy | None = None  # policy of the mapping and judging lanes; None: by `sites.every`
    zones: MapZones | None = None  # zones of the user, in the world


class Live:
    """The three lanes as processes. Feed events in order of arrival, and call `finish` at the end.

    Raises:
        SettingsError: the settings are for recordings only.
        AlightError: a lane cannot be started.
    """

    def __init__(self, rig: Rig, settings: Settings, options: LiveOptions | None = None) -> None:
        if settings.motion.method == "bundle":
            raise SettingsError("motion.method: a flight needs the filter; bundle is for recordings")
        self._options = options = options or LiveOptions()
        self.watch, self.warnings = Watch(LANES), list[str]()
        self._clocks = StreamClocks(self._warn_of_clock) if options.real_time else None
        self._batcher = EventBatcher()
        self._used = {kind: deque[Any](maxlen=options.schedule) for kind in Schedule.__dataclass_fields__}
        drop, waiting = options.drop, options.waiting
        self._batches = Mailbox[FrameBatch](waiting, self._later_batch if drop else None)
        # many exposures are no keyframes, and cost the mapping lane little
        self._exposures = Mailbox[Navigation](6 * waiting if drop else waiting, self._later_exposure if drop else None)
        # newest exposure in a map, the map, and a location that it must show, (2,) metres in its frame
        self._maps = Mailbox[tuple[int, MapSnapshot, F64 | None]](1, (lambda old, new: new) if drop else None)
        self.policy, self._judge_waits = options.policy or FlightPolicy(settings.sites.every), threading.Event()
        self._failed: list[BaseException] = []
        self._settings = stages = settings.stages(options.imu)
        folder = options.folder or Path(tempfile.gettempdir())
        # navigation never waits for mapping, nor mapping for judging: the last arguments are the niceness
        specs = (
            LaneSpec(NAVIGATION, NavigationProcess, (rig, stages), 0.9, "next_frame", 0, 0),
            LaneSpec(MAPPING, make_mapping, (rig, stages, folder), 15.0, "", None, 5),
            LaneSpec(
                JUDGING, make_judging, (stages, options.appearance, options.zones), 30.0, "memory", JudgingMemory(), 6
            ),
        )
        self.lanes = {
            s.name: LaneProcess(replace(s, make=options.makers.get(s.name, s.make)), self._replaced) for s in specs
        }
        steps: Sequence[tuple[Callable[[], None], tuple[Mailbox[Any], ...]]] = (  # and mailboxes to close after each
            (self._navigate, (self._batches, self._exposures)),
            (self._map, (self._exposures, self._maps)),
            (self._judge, (self._maps,)),
        )
        self.threads = [Thread(target=self._guarded, args=s, daemon=True) for s in steps]
        for t in self.threads:
            t.start()

    # -- from outside

    @property
    def schedule(self) -> Schedule:
        """Exposures that each lane has used so far; complete after `finish` if the whole schedule is kept."""
        return Schedule(**{kind: tuple(entries) for kind, entries in self._used.items()})

    @property
    def health(self) -> str:
        """Newest verdict with its age, and present states, rates and counts of the lanes, as one line."""
        return self.watch.line(self.policy.effort_control.effort)

    @property
    def counts(self) -> dict[str, int]:
        """Exposures used and dropped, by lane and reason; restarts of each lane; loops compiled in flight."""
        late = self._clocks.late if self._clocks else {}
        self.watch.counts |= {f"{name} that came late": n for name, n in late.items() if n}
        restarts = {f"{name}: restarted": n for name, n in self.watch.restarts.items()}
        return {**dict(sorted(self.watch.counts.items())), **restarts, "loops compiled in flight": len(self.compiled)}

    @property
    def compiled(self) -> list[str]:
        """Names of the loops that were compiled in flight; empty after a complete warm-up."""
        return sorted(set[str]().union(*(lane.compiled for lane in self.lanes.values())))

    def wait_until_ready(self) -> None:
        """Wait until the navigation lane is made; the other lanes may take longer.

        Raises:
            AlightError: the navigation lane cannot be made.
        """
        try:
            self.lanes[NAVIGATION].wait_until_ready()
        except LaneLost as e:
            raise AlightError(f"the navigation lane is lost: it cannot be started: {e}") from e

    def feed(self, event: Event) -> None:
        """Process an event; motions and verdicts go to the listener.

        Raises:
            AlightError: the navigation lane cannot be restarted.
        """
        self._raise()
        stamped = event if self._clocks is None else self._clocks.stamped(event, time.perf_counter())
        if stamped is None:
            return
        if self._options.recorder is not None:
            self._options.recorder.event(stamped)
        if isinstance(stamped, Frame):
            self.watch.arrived(stamped.t_ns)
            self.watch.counts["frames"] += 1
        batch = self._batcher.take(stamped)
        if batch is not None:
            self._batches.put(batch)

    def finish(self) -> Decision:
        """Wait until all events are processed, judge the final map, and end the lanes.

        Raises:
            AlightError: the navigation lane could not be restarted, or a lane was lost at the end.
        """
        try:
            self._batches.put(self._batcher.rest())
            self._batches.close()
            for t in self.threads:
                t.join()
            self._raise()
            for lane in self.lanes.values():
                lane.patience = 120.0  # the last judgement is of the map of the whole flight
            navigation, mapping, judging = list[Any](self.lanes.values())
            decision = conclude(navigation, mapping, judging, self._settings, Timings(), zones=self._options.zones)
            return self._with_warnings(decision)
        except LaneLost as e:
            raise AlightError(f"a lane was lost when the flight was over: {e}; the recording can be replayed") from e
        finally:
            self.close()

    def close(self) -> None:
        """End all lanes, even busy lanes; `finish` calls this too."""
        for box in (self._batches, self._exposures, self._maps):
            box.close()
        self._judge_waits.set()
        for lane in self.lanes.values():
            lane.close()
        for t in self.threads:
            t.join(5.0)

    def _with_warnings(self, decision: Decision) -> Decision:
        repeated = self._batcher.repeated
        same = [f"motion: {repeated} exposures have the stamp of an earlier one and are left out"] if repeated else []
        names = self.compiled
        slow = [f"live: {len(names)} loops were compiled in flight ({', '.join(names)}); run alight warmup before"]
        return replace(decision, warnings=[*same, *(slow if names else []), *self.warnings, *decision.warnings])

    # -- the threads

    def _use(self, kind: str, t_ns: int, **value: Any) -> None:
        """Add an exposure's stamp to the list `kind` of the schedule, and each `value` to the list of its name."""
        self._used[kind].append(t_ns)
        for name, v in value.items():
            self._used[name].append(v)
        if self._options.recorder is not None:
            self._options.recorder.entry(kind, t_ns, value.get("effort", 0), value.get("about"))

    def _raise(self) -> None:
        if self._failed:
            raise self._failed[0]

    def _note(self, lane: str, words: str) -> None:
        if self._options.recorder is not None:
            self._options.recorder.note(lane, words)

    def _warn_of_clock(self, sentence: str) -> None:
        self.warnings.append(sentence)
        self._note("clocks", sentence)

    def _replaced(self, lane: str, why: str) -> None:
        self.watch.restarts[lane] += 1
        if self.lanes[lane].given_up:
            self.watch.enter(lane, LaneState.LOST)
        log.warning("the %s lane was lost: %s; it begins anew", lane, why)
        if (count := self.watch.restarts[lane]) <= 3:
            self.warnings.append(f"live: the {lane} lane was lost and began anew ({why})")
        elif count == 4:
            self.warnings.append(f"live: the {lane} lane was lost more than 3 times; the counts give the number")
        self._note(lane, why)
        self._options.listener.lost(lane, why)

    def _later_batch(self, old: FrameBatch, new: FrameBatch) -> FrameBatch:
        if old.frame is not None:
            self.watch.counts["navigation: exposures left out, busy"] += 1
        return new.after(old)

    def _later_exposure(self, old: Navigation, new: Navigation) -> Navigation:
        self.watch.counts["mapping: exposures left out, busy"] += 1
        return new

    def _guarded(self, work: Callable[[], None], boxes: tuple[Mailbox[Any], ...]) -> None:
        try:
            work()
        except Closed:
            pass
        except BaseException as e:
            if not isinstance(e, AlightError):
                log.exception("a thread of the flight has failed")
            self._failed.append(e)
            boxes = (self._batches, self._exposures, self._maps)
        finally:  # release the threads that wait for this one
            for box in boxes:
                box.close()
            self._judge_waits.set()

    def _navigate(self) -> None:
        lane, recorder = self.lanes[NAVIGATION], self._options.recorder
        lost_rows, anew = FrameBatch(None, ()), False
        while True:
            batch = self._batches.get().after(lost_rows)
            try:
                with self.watch.work(NAVIGATION):
                    found: Navigation | None = lane.call("take", batch)
            except LaneLost as e:
                if lane.given_up:
                    raise AlightError(f"the navigation lane is lost: {lane.given_up}") from e
                self.watch.counts["navigation: exposures left out, lane lost"] += batch.frame is not None
                lost_rows, anew = replace(batch, frame=None), True
                continue
            lost_rows = FrameBatch(None, ())
            if batch.frame is None:
                continue
            t_ns = batch.frame.t_ns
            if anew:
                self._use("navigation_anew", t_ns)
                anew = False
            self._use("tracked", t_ns)
            self.watch.counts["frames used"] += 1
            if found is None:
                continue
            self._exposures.put(replace(found, frame=batch.frame))
            if found.motion is not None:
                self.watch.reached(POSE, t_ns)
                if recorder is not None:
                    recorder.motion(found.motion)
                self._options.listener.motion(found.motion)

    def _map(self) -> None:
        lane, control, anew = self.lanes[MAPPING], self.policy.effort_control, False
        while True:
            navigation = self._exposures.get()
            t_ns = navigation.frame.t_ns
            try:
                with self.watch.work(MAPPING):
                    begin = time.perf_counter()
                    effort = self.policy.effort(navigation)
                    keyframes: int = lane.call("feed", navigation, effort)
                    if keyframes:
                        self.watch.timings.add(STEP, seconds := time.perf_counter() - begin)
                        if control.took(seconds):  # the effort of the next step follows the time of this one
                            self.watch.counts[f"mapping: effort {control.effort}, times chosen"] += 1
                            self._note(MAPPING, f"effort {control.effort} after a step of {seconds:.2f} s")
            except LaneLost:
                self.watch.counts["mapping: exposures left out, lane lost"] += 1
                anew = True
                if lane.given_up:
                    raise Closed from None
                continue
            if anew:
                self._use("mapping_anew", t_ns)
            self._use("mapped", t_ns, effort=effort)
            due = self.policy.due_verdict(navigation, keyframes, self._judge_waits.is_set() or not self._options.drop)
            anew = due is not None and not self._pass_to_judging(navigation, due.about)

    def _pass_to_judging(self, navigation: Navigation, about: F64 | None) -> bool:
        try:
            seen = self.lanes[MAPPING].call("snapshot", about)
        except LaneLost:
            return False
        if seen is not None:
            self._judge_waits.clear()
            self._maps.put((navigation.frame.t_ns, seen, about))
        return True

    def _judge(self) -> None:
        lane, recorder = self.lanes[JUDGING], self._options.recorder
        while True:
            self._judge_waits.set()
            t_ns, seen, about = self._maps.get()
            try:
                with self.watch.work(JUDGING, "verdict"):
                    verdict: Verdict = lane.call("judge", seen)
            except LaneLost:
                if lane.given_up:
                    raise Closed from None
                continue
            self._use("judged", t_ns, about=None if about is None else (float(about[0]), float(about[1])))
            world = verdict.in_world()
            self.watch.judged(t_ns, world.sites)
            if recorder is not None:
                recorder.verdict(t_ns, world)
            self._options.listener.verdict(verdict, t_ns)
