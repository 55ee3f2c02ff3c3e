"""A flight as it comes: each lane on a thread of its own, fed through mailboxes that hold little.

Navigation has two threads, one for tracking and one for filtering. A lane that is too slow leaves out the oldest
exposures; what each lane did use is the `schedule`. A `Pipeline` that is given the same events and that schedule does
the same in turn and gives the same bits. Nothing here grows with the flight unless the whole schedule is to be kept.
"""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from threading import Thread
from typing import Any

from alight import terrain
from alight.elevation import TileStore
from alight.motion.ekf.prediction import MotionPredictor
from alight.pipeline import Decision, Pipeline, Schedule, Verdict
from alight.pipeline.mapping import MapSnapshot
from alight.pipeline.navigation import FilterLane, FrameBatch, Navigation
from alight.records import Event, Motion, Rig, SettingsError
from alight.runner.mailbox import Closed, Mailbox
from alight.settings import ImuNoise, Settings

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Listener:
    """Who is told of results as soon as they are known, each on its lane's thread."""

    motion: Callable[[Motion], None] = lambda motion: None
    verdict: Callable[[Verdict], None] = lambda verdict: None


@dataclass(frozen=True)
class Capacity:
    """What waits for a busy lane.

    `drop`: with a mailbox full, leave out the oldest exposure (flight) instead of waiting (recordings).
    """

    tracking: int = 2  # exposures
    mapping: int = 2  # exposures
    drop: bool = True
    schedule: int | None = 1000  # last entries of the schedule that are kept; None: all of them


def newest(old: MapSnapshot, new: MapSnapshot) -> MapSnapshot:
    """Of two maps that wait to be judged the newer one."""
    return new


def newest_exposure(old: Navigation, new: Navigation) -> Navigation:
    """Of two exposures that wait to be mapped the newer one."""
    return new


class Live:
    """The three lanes on threads. Feed events in the order of arrival, `finish` at the end.

    Args:
        listener: is told of motions and verdicts as they become known.
        capacity: how much may wait, and what happens then.
        far: where the map puts what the vehicle has left behind.
        appearance: what ground looks like.
        imu: noise that is stated for the IMU.

    Raises:
        SettingsError: the settings ask for what only a recording allows.
    """

    def __init__(
        self,
        rig: Rig,
        settings: Settings,
        listener: Listener = Listener(),
        capacity: Capacity = Capacity(),
        far: TileStore | None = None,
        appearance: terrain.Model | None = None,
        imu: ImuNoise | None = None,
    ) -> None:
        if settings.motion.method == "bundle":
            raise SettingsError("motion.method: a flight needs the filter; bundle is for recordings")
        drop, self._listener = capacity.drop, listener
        self._predictions = Mailbox[MotionPredictor | None](4)
        self._batches = Mailbox[FrameBatch](capacity.tracking, (lambda old, new: new.after(old)) if drop else None)
        self._filtering = Mailbox[Callable[[], Navigation | None]](4)  # two for the exposure in work, two for the next
        self._exposures = Mailbox[Navigation](capacity.mapping, newest_exposure if drop else None)
        self._maps = Mailbox[MapSnapshot](1, newest if drop else None)
        self._navigation = FilterLane(rig, settings.stages(imu), history=False, handover=self._predictions)
        self.pipeline = Pipeline(
            rig, "flight", settings, clock=time.perf_counter, far=far, history=False, appearance=appearance, imu=imu,
            navigation=self._navigation,
        )  # fmt: skip
        self._tracked, self._mapped, self._judged = (deque[int](maxlen=capacity.schedule) for _ in range(3))
        self._failed: list[BaseException] = []
        self.threads = self._start()

    def _start(self) -> list[Thread]:
        """A thread for each step; at its end the mailboxes that it feeds are closed."""
        steps: Sequence[tuple[Callable[[], None], tuple[Mailbox[Any], ...]]] = (
            (self._track, (self._batches, self._filtering, self._predictions)),
            (self._filter, (self._filtering, self._predictions, self._exposures)),
            (self._map, (self._exposures, self._maps)),
            (self._judge, (self._maps,)),
        )
        threads = [Thread(target=self._guarded, args=s, daemon=True) for s in steps]
        for t in threads:
            t.start()
        return threads

    @property
    def schedule(self) -> Schedule:
        """What each lane has used so far; complete after `finish`, where all of it was kept."""
        return Schedule(tuple(self._tracked), tuple(self._mapped), tuple(self._judged))

    def feed(self, event: Event) -> None:
        """Take an event; motions and verdicts come by themselves.

        Raises:
            Exception: what a thread has failed with.
        """
        self._raise()
        batch = self._navigation.batch(event)
        if batch is not None:
            self._batches.put(batch)

    def finish(self) -> Decision:
        """Wait until all is done, and judge the map as it is then.

        Raises:
            Exception: what a thread has failed with.
        """
        self._batches.close()
        for t in self.threads:
            t.join()
        self._raise()
        return self.pipeline.finish()

    def _raise(self) -> None:
        if self._failed:
            raise self._failed[0]

    def _guarded(self, work: Callable[[], None], boxes: tuple[Mailbox[Any], ...]) -> None:
        try:
            work()
        except Closed:
            pass
        except BaseException as e:
            log.exception("a lane has failed")
            self._failed.append(e)
            boxes = (self._batches, self._filtering, self._predictions, self._exposures, self._maps)
        finally:  # whoever waits for this thread is let go
            for box in boxes:
                box.close()

    def _track(self) -> None:
        while True:
            batch = self._batches.get()
            self._filtering.put(partial(self._navigation.hear, batch))
            if batch.frame is not None:
                self._tracked.append(batch.frame.t_ns)
            tracked = self._navigation.track(batch)
            if tracked is not None:
                self._filtering.put(partial(self._navigation.update, tracked))

    def _filter(self) -> None:
        while True:
            navigation = self._filtering.get()()
            if navigation is not None:
                self._exposures.put(navigation)
                if navigation.motion is not None:
                    self._listener.motion(navigation.motion)

    def _map(self) -> None:
        while True:
            navigation = self._exposures.get()
            self._mapped.append(navigation.frame.t_ns)
            seen = self.pipeline.map(navigation)
            if seen is not None:
                self._maps.put(seen)

    def _judge(self) -> None:
        while True:
            seen = self._maps.get()
            self._judged.append(seen.step)
            self._listener.verdict(self.pipeline.judge(seen))
