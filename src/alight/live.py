"""A flight as it comes: tracker and filter on a thread each, fed through mailboxes that hold little.

What was used is written down (`consumed`): fed again, those events alone give the same motions bit for bit. Nothing
here grows with the flight unless all of it is to be kept.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable
from threading import Condition, Thread
from typing import Generic, TypeVar

from alight.motion.ekf.prediction import MotionPredictor
from alight.pipeline.side_by_side import Desk, FilterStep, Heard, Job, TrackingStep, forecast_for
from alight.records import Event, Motion, Rig, Tracks
from alight.settings import ImuNoise, Settings

log = logging.getLogger(__name__)

T = TypeVar("T")


class Closed(Exception):  # noqa: N818  (not an error: the end of a mailbox)
    """Nothing more will come."""


class Mailbox(Generic[T]):
    """At most `size` items between two threads; where it is full, the sender waits, or the oldest two become one."""

    def __init__(self, size: int, merge: Callable[[T, T], T] | None = None) -> None:
        self._items, self._size, self._merge = deque[T](), size, merge
        self._changed, self._closed = Condition(), False

    def put(self, item: T) -> None:
        """Add an item; after `close` it is thrown away."""
        with self._changed:
            while self._merge is None and len(self._items) >= self._size and not self._closed:
                self._changed.wait()
            self._items.append(item)
            if self._merge is not None and len(self._items) > self._size:
                oldest = self._items.popleft()
                self._items[0] = self._merge(oldest, self._items[0])
            self._changed.notify_all()

    def get(self) -> T:
        """Wait for an item and take it.

        Raises:
            Closed: it is empty and will stay so.
        """
        with self._changed:
            while not self._items and not self._closed:
                self._changed.wait()
            if not self._items:
                raise Closed
            item = self._items.popleft()
            self._changed.notify_all()
            return item

    def close(self) -> None:
        """Nothing more will be put in; what is in it can still be taken."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()


class SideBySide:
    """Tracking and filtering on two threads. Feed events in the order of arrival, `finish` at the end.

    Args:
        size: exposures that may wait to be tracked.
        drop: with the mailbox full, drop the oldest exposure (flight) instead of waiting (recordings).
        tell: called with every motion on the filter's thread, as soon as it is known.
        keep: last motions, and stamps of the last exposures, that are kept; None: all of them.
        imu: noise that is stated for the IMU.
    """

    def __init__(
        self,
        rig: Rig,
        settings: Settings,
        size: int = 2,
        drop: bool = True,
        tell: Callable[[Motion], None] = lambda motion: None,
        keep: int | None = 1000,
        imu: ImuNoise | None = None,
    ) -> None:
        self.consumed: deque[int] = deque(maxlen=keep)  # stamps of the exposures that were tracked
        self.motions: deque[Motion] = deque(maxlen=keep)
        self._desk, self._tell = Desk(), tell
        stages = settings.stages(imu)
        self._tracking, self._filtering = TrackingStep(rig, stages), FilterStep(rig, stages)
        self._jobs = Mailbox[Job](size, (lambda old, new: new.after(old)) if drop else None)
        self._work = Mailbox[tuple[Heard, ...] | Tracks](4)  # two for the exposure in work, two for the next
        self._forecasts = Mailbox[MotionPredictor | None](4)
        self._failed: list[BaseException] = []
        self._threads = [Thread(target=self._guarded, args=(f,), daemon=True) for f in (self._track, self._filter)]
        for t in self._threads:
            t.start()

    def feed(self, event: Event) -> None:
        """Take an event; the motions come by themselves.

        Raises:
            Exception: what a thread has failed with.
        """
        self._raise()
        job = self._desk.take(event)
        if job is not None:
            self._jobs.put(job)

    def finish(self) -> list[Motion]:
        """Wait until all is done; the motions that are kept, in the order in which they became known.

        Raises:
            Exception: what a thread has failed with.
        """
        self._jobs.close()
        for t in self._threads:
            t.join()
        self._raise()
        return list(self.motions)

    def _raise(self) -> None:
        if self._failed:
            raise self._failed[0]

    def _guarded(self, work: Callable[[], None]) -> None:
        try:
            work()
        except Closed:
            pass
        except BaseException as e:
            log.exception("a thread of the navigation lane has failed")
            self._failed.append(e)
        finally:  # whoever waits for this thread is let go
            for box in (self._jobs, self._work, self._forecasts):
                box.close()

    def _track(self) -> None:
        forecast: MotionPredictor | None = None
        known, exposure = -1, 0  # number of that forecast, and of the exposure
        while True:
            job = self._jobs.get()
            self._tracking.hear(job.before)
            self._work.put(job.before)
            if job.frame is None:
                continue
            while known < forecast_for(exposure):
                forecast, known = self._forecasts.get(), known + 1
            self.consumed.append(job.frame.t_ns)
            exposure += 1
            self._work.put(self._tracking.run(job.frame, forecast))

    def _filter(self) -> None:
        self._forecasts.put(self._filtering.hear(self._heard()))
        while True:
            work = self._work.get()
            if isinstance(work, Tracks):
                motion, forecast = self._filtering.see(work)
                self._forecasts.put(forecast)
                if motion is not None:
                    self.motions.append(motion)
                    self._tell(motion)
            else:
                self._filtering.hear(work)

    def _heard(self) -> tuple[Heard, ...]:
        """What was heard before the first exposure."""
        first = self._work.get()
        return () if isinstance(first, Tracks) else first
