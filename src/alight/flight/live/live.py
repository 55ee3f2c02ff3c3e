"""A live run: each lane in a process of its own, fed through mailboxes that hold few items.

A lane that is too slow leaves out the oldest exposures; a lane that raises or hangs is replaced, and begins anew. The
exposures that each lane used are the `schedule`. A `Pipeline` with the same events and that schedule does the same in
turn and gives the same bits. Memory does not grow with the flight unless the whole schedule is kept.
"""

from __future__ import annotations

import logging
import os
import tempfile
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from threading import Thread
from typing import Any, NamedTuple

from alight import terrain
from alight.arrays import F64
from alight.flight.live import lanes as processes
from alight.flight.live.health import POSE, STEP, VERDICT, FlightHealth, Watch
from alight.flight.live.interface import IN_FLIGHT, SILENT, Capacity, Diary, Listener, NoDiary
from alight.flight.live.lanes import Post, RemoteJudging, RemoteMapping, RemoteNavigation
from alight.flight.live.mailbox import Closed, Mailbox
from alight.flight.live.nursery import Nursery
from alight.flight.live.schedule_log import ScheduleLog
from alight.flight.live.stream_clock import Clocks
from alight.flight.live.worker import LaneLost, Spec
from alight.pipeline import Decision, FlightPolicy
from alight.pipeline.decision import conclude
from alight.pipeline.mapping import MapSnapshot
from alight.pipeline.navigation import FrameBatch, Navigation
from alight.pipeline.navigation.filter_lane import EventBatcher
from alight.pipeline.timing import Timings
from alight.records import AlightError, Event, Frame, Motion, Rig, Schedule, SettingsError
from alight.settings import ImuNoise, Settings

log = logging.getLogger(__name__)

NAVIGATION, MAPPING, JUDGING = LANES = ("navigation", "mapping", "judging")
PATIENCE = {NAVIGATION: 0.9, MAPPING: 15.0, JUDGING: 30.0}  # s without an answer, after which a process is lost
NICENESS = {NAVIGATION: 0, MAPPING: 5, JUDGING: 6}  # navigation never waits for mapping, nor mapping for judging
AT_END = 120.0  # s that the last judgement may take, of the map of the whole flight
SPARE = 2  # processors that mapping leaves to the other lanes


class _Shown(NamedTuple):
    """A map on its way to the judging lane."""

    t_ns: int  # of the newest exposure that it holds
    seen: MapSnapshot
    about: F64 | None  # (2,) metres in the map's frame, the place that it shows as well


class Live:
    """The three lanes as processes. Feed events in the order of arrival, `finish` at the end.

    Args:
        listener: called with motions and verdicts as soon as they exist.
        capacity: number of items that may wait, and whether the oldest is left out then.
        folder: for tiles of the map that the vehicle has left behind; None: the system's temporary folder.
        appearance: model of the appearance of ground; None: none.
        imu: noise that is stated for the IMU.
        diary: log of the run; None: none.
        clocks: find late events and clocks that jump, by the arrival of the events; None: stamps are right.
        nursery: process that forks the lanes; None: one of its own, which ends with the flight.
        makers: of lanes that replace the usual ones, by the lane's name.
        policy: of the mapping and judging lanes; None: one by `sites.every`.

    Raises:
        SettingsError: the settings are for recordings only.
        AlightError: a lane cannot be started.
    """

    def __init__(
        self,
        rig: Rig,
        settings: Settings,
        listener: Listener = SILENT,
        capacity: Capacity = IN_FLIGHT,
        folder: Path | None = None,
        appearance: terrain.Model | None = None,
        imu: ImuNoise | None = None,
        diary: Diary | None = None,
        clocks: Callable[[Callable[[str], None]], Clocks] | None = None,
        nursery: Nursery | None = None,
        makers: Mapping[str, Callable[..., Any]] | None = None,
        policy: FlightPolicy | None = None,
    ) -> None:
        if settings.motion.method == "bundle":
            raise SettingsError("motion.method: a flight needs the filter; bundle is for recordings")
        self._listener, self._capacity = listener, capacity
        self._diary: Diary = diary or NoDiary()
        self.watch, self.warnings = Watch(LANES), list[str]()
        self._clocks = clocks(self._warn) if clocks else None
        self._batcher, self._used = EventBatcher(), ScheduleLog(capacity.schedule, self._diary)
        drop = capacity.drop
        self._batches = Mailbox[FrameBatch](capacity.tracking, self._later_batch if drop else None)
        self._exposures = Mailbox[Navigation](capacity.mapping, self._later_exposure if drop else None)
        self._maps = Mailbox[_Shown](1, (lambda old, new: new) if drop else None)
        self.policy, self._judge_waits = policy or FlightPolicy(settings.sites.every), threading.Event()
        self._newest: Motion | None = None
        self._failed: list[BaseException] = []
        self._cores = max(1, (os.cpu_count() or 1) - SPARE)
        self._own_nursery = None if nursery is not None else Nursery(self._cores)
        self._nursery = nursery or self._own_nursery
        self._start_lanes(rig, settings, folder or Path(tempfile.gettempdir()), appearance, imu, makers or {})
        self.threads = self._start_threads()

    # -- the start

    def _start_lanes(
        self, rig: Rig, settings: Settings, folder: Path, appearance: terrain.Model | None, imu: ImuNoise | None,
        makers: Mapping[str, Callable[..., Any]],
    ) -> None:  # fmt: skip
        self._settings, nursery = (stages := settings.stages(imu)), self._nursery
        assert nursery is not None
        navigation, judging = self._navigation, self._judging = RemoteNavigation(), RemoteJudging()
        usual: dict[str, tuple[Any, Callable[[], tuple[Any, ...]]]] = {
            NAVIGATION: (processes.NavigationProcess, lambda: (rig, stages, navigation.next_frame)),
            MAPPING: (processes.MappingProcess, lambda: (rig, stages, folder)),
            JUDGING: (processes.JudgingProcess, lambda: (stages, appearance, judging.memory)),
        }

        def post(name: str) -> Post:
            make, given = usual[name]
            make, threads = makers.get(name, make), self._cores if name == MAPPING else 1
            return Post(nursery, lambda: Spec(name, make, given(), NICENESS[name], threads), PATIENCE[name], self._lost)

        self.posts = {name: post(name) for name in LANES}
        navigation.post, judging.post = self.posts[NAVIGATION], self.posts[JUDGING]
        self._mapping = RemoteMapping(self.posts[MAPPING])

    def _start_threads(self) -> list[Thread]:
        """A thread for each lane; at its end the mailbox that it feeds is closed."""
        steps: Sequence[tuple[Callable[[], None], tuple[Mailbox[Any], ...]]] = (
            (self._navigate, (self._batches, self._exposures)),
            (self._map, (self._exposures, self._maps)),
            (self._judge, (self._maps,)),
        )
        threads = [Thread(target=self._guarded, args=s, daemon=True) for s in steps]
        for t in threads:
            t.start()
        return threads

    # -- from outside

    @property
    def schedule(self) -> Schedule:
        """The exposures that each lane has used so far; complete after `finish`, where all of it was kept."""
        return self._used.schedule

    @property
    def health(self) -> FlightHealth:
        """State, rates and counts of the lanes at this moment."""
        effort = self.policy.effort_control.effort
        return self.watch.health(effort, self._newest.frame_id if self._newest is not None else None)

    @property
    def counts(self) -> dict[str, int]:
        """Exposures used and left out, by lane and reason; restarts of each lane; loops compiled in flight."""
        late = self._clocks.late if self._clocks else {}
        self.watch.counts |= {f"{name} that came late": n for name, n in late.items() if n}
        restarts = {f"{name}: restarted": n for name, n in self.watch.restarts.items()}
        return {**dict(sorted(self.watch.counts.items())), **restarts, "loops compiled in flight": len(self.compiled)}

    @property
    def compiled(self) -> list[str]:
        """Names of the loops that were compiled in flight; they should be none."""
        return sorted(set[str]().union(*(p.compiled for p in self.posts.values())))

    def feed(self, event: Event) -> None:
        """Take an event; motions and verdicts come by themselves.

        Raises:
            AlightError: the navigation lane cannot be started again.
        """
        self._raise()
        arrival = time.perf_counter()
        stamped = event if self._clocks is None else self._clocks.stamped(event, arrival)
        if stamped is None:
            return
        self._diary.event(stamped)
        if isinstance(stamped, Frame):
            self.watch.arrived(stamped.t_ns)
            self.watch.counts["frames"] += 1
        batch = self._batcher.take(stamped)
        if batch is not None:
            self._batches.put(batch)

    def finish(self) -> Decision:
        """Wait until all is done, and judge the map as it is then; the lanes end.

        Raises:
            AlightError: the navigation lane could not be started again.
        """
        try:
            self._batches.put(self._batcher.rest())
            self._batches.close()
            for t in self.threads:
                t.join()
            self._raise()
            for p in self.posts.values():
                p.patience = AT_END
            return self._said(conclude(self._navigation, self._mapping, self._judging, self._settings, Timings()))
        except LaneLost as e:
            raise AlightError(f"a lane was lost when the flight was over: {e}; the recording can be replayed") from e
        finally:
            self.close()

    def timings(self) -> dict[str, Sequence[float]]:
        """Seconds of the last steps, by stage."""
        return dict(self.watch.times)

    def close(self) -> None:
        """End all lanes, whatever they do; `finish` does it as well."""
        for box in (self._batches, self._exposures, self._maps):
            box.close()
        self._judge_waits.set()
        for p in self.posts.values():
            p.close()
        for t in self.threads:
            t.join(5.0)
        if self._own_nursery is not None:
            self._own_nursery.close()

    def _said(self, decision: Decision) -> Decision:
        repeated = self._batcher.repeated
        same = [f"motion: {repeated} exposures have the stamp of an earlier one and are left out"] if repeated else []
        names = self.compiled
        slow = [f"live: {len(names)} loops were compiled in flight ({', '.join(names)}); run alight warmup before"]
        return replace(decision, warnings=[*same, *(slow if names else []), *self.warnings, *decision.warnings])

    # -- the threads

    def _raise(self) -> None:
        if self._failed:
            raise self._failed[0]

    def _warn(self, sentence: str) -> None:
        self.warnings.append(sentence)
        self._diary.note("clocks", sentence)

    def _lost(self, lane: str, why: str) -> None:
        """Report that a process is lost; the flight goes on."""
        self.watch.restarts[lane] += 1
        if self.posts[lane].given_up:
            self.watch.gave_up(lane)
        log.warning("the %s lane was lost: %s; it begins anew", lane, why)
        if (count := self.watch.restarts[lane]) <= 3:
            self.warnings.append(f"live: the {lane} lane was lost and began anew ({why})")
        elif count == 4:
            self.warnings.append(f"live: the {lane} lane was lost more than 3 times; the counts say how often")
        self._diary.note(lane, why)
        self._listener.lost(lane, why)

    def _stepped(self, seconds: float) -> None:
        """Adapt the effort of the next step of the map to the time of this one."""
        self.watch.took(STEP, seconds)
        control = self.policy.effort_control
        if control.took(seconds):
            self.watch.counts[f"mapping: effort {control.effort}, times chosen"] += 1
            self._diary.note(MAPPING, f"effort {control.effort} after a step of {seconds:.2f} s")

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
        unheard, anew = FrameBatch(None, ()), False
        while True:
            batch = self._batches.get().after(unheard)
            t_ns = None if batch.frame is None else batch.frame.t_ns
            try:
                with self.watch.work(NAVIGATION):
                    found = self._navigation.take(batch)
            except LaneLost as e:
                if self.posts[NAVIGATION].given_up:
                    raise AlightError(f"the navigation lane is lost: {self.posts[NAVIGATION].given_up}") from e
                self.watch.counts["navigation: exposures left out, lane lost"] += t_ns is not None
                unheard, anew = replace(batch, frame=None), True
                continue
            unheard = FrameBatch(None, ())
            if t_ns is None:
                continue
            if anew:
                self._used.anew(NAVIGATION, t_ns)
                anew = False
            self._used.tracked(t_ns)
            self.watch.counts["frames used"] += 1
            if found is not None:
                self._exposures.put(found)
                if found.motion is not None:
                    self.watch.known(POSE, t_ns)
                    self._newest = found.motion
                    self._listener.motion(found.motion)

    def _map(self) -> None:
        anew = False
        while True:
            navigation = self._exposures.get()
            t_ns = navigation.frame.t_ns
            try:
                with self.watch.work(MAPPING):
                    begin = time.perf_counter()
                    effort = self.policy.effort(navigation)
                    update = self._mapping.feed(navigation, effort)
                    if update is not None:
                        self._stepped(time.perf_counter() - begin)
            except LaneLost:
                self.watch.counts["mapping: exposures left out, lane lost"] += 1
                anew = True
                if self.posts[MAPPING].given_up:
                    raise Closed from None
                continue
            if anew:
                self._used.anew(MAPPING, t_ns)
            self._used.mapped(t_ns, effort)
            due = self.policy.due_verdict(navigation, update, self._judge_waits.is_set() or not self._capacity.drop)
            anew = due is not None and not self._hand_to_judge(navigation, due.about)

    def _hand_to_judge(self, navigation: Navigation, about: F64 | None) -> bool:
        """Pass the map on to be judged; False: the mapping lane was lost."""
        try:
            seen = self._mapping.snapshot(about)
        except LaneLost:
            return False
        if seen is not None:
            self._judge_waits.clear()
            self._maps.put(_Shown(navigation.frame.t_ns, seen, about))
        return True

    def _judge(self) -> None:
        while True:
            self._judge_waits.set()
            shown = self._maps.get()
            try:
                with self.watch.work(JUDGING, "verdict"):
                    verdict = self._judging.judge(shown.seen)
            except LaneLost:
                if self.posts[JUDGING].given_up:
                    raise Closed from None
                continue
            self._used.judged(shown.t_ns, shown.about)
            self.watch.known(VERDICT, shown.t_ns)
            self._listener.verdict(verdict, shown.t_ns)
