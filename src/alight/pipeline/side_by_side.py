"""Tracking beside filtering: two steps that may run at the same time, and give the same however they are scheduled.

While the filter takes in one exposure the next one is tracked. The tracker predicts from the filter's last exposure but
one, carried on by the IMU: always from that one, whether or not the last is done, so that what comes out depends on the
events alone. No thread here: `alight.live` runs the steps on two.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

from alight.motion import RollbackFilter
from alight.motion.ekf.prediction import MotionPredictor
from alight.records import Event, Frame, ImuSample, Motion, NavSample, Rig, Tracks
from alight.settings import StageSettings
from alight.tracks import Tracker

_MOST = 1000  # rows that wait for an exposure; 5 s of them
_IMU_NS = 2_000_000_000  # ns of inertial measurements that a prediction may need
Heard = NavSample | ImuSample


@dataclass(frozen=True, eq=False)
class Job:
    """One exposure, and what was heard before it; without exposure where none has come for long."""

    frame: Frame | None
    before: tuple[Heard, ...]

    def after(self, dropped: Job) -> Job:
        """This job when an earlier one is left out: its picture is lost, what was heard is not."""
        return replace(self, before=dropped.before + self.before)


class Desk:
    """Gathers events into jobs, in the order of arrival; it holds little, whatever fails to come."""

    def __init__(self) -> None:
        self._before: deque[Heard] = deque()
        self._begun = False

    def take(self, event: Event) -> Job | None:
        """Take an event; an exposure makes a job, and so do many rows without one. Before the first, old rows go."""
        if isinstance(event, Frame):
            self._begun = True
            return self._job(event)
        self._before.append(event)
        if len(self._before) <= _MOST:
            return None
        if self._begun:
            return self._job(None)
        self._before.popleft()
        return None

    def _job(self, frame: Frame | None) -> Job:
        before, self._before = tuple(self._before), deque()
        return Job(frame, before)


def forecast_for(exposure: int) -> int:
    """Which forecast an exposure (from 0) is tracked by: 0 before the first, k after the k-th has been taken in."""
    return exposure if exposure < 2 else exposure - 1


class TrackingStep:
    """The tracker, and the inertial measurements that it predicts by."""

    def __init__(self, rig: Rig, settings: StageSettings) -> None:
        self._tracker = Tracker(rig, settings.tracks)
        self._imu: deque[ImuSample] = deque()

    def hear(self, events: Sequence[Heard]) -> None:
        """Take what came before an exposure."""
        self._imu.extend(e for e in events if isinstance(e, ImuSample))
        while self._imu and self._imu[0].t_ns < self._imu[-1].t_ns - _IMU_NS:
            self._imu.popleft()

    def run(self, frame: Frame, forecast: MotionPredictor | None) -> Tracks:
        """Follow the features into one exposure."""
        expected = forecast.cameras(frame.t_ns, self._tracker.last_ns, self._imu) if forecast else None
        return self._tracker.feed(frame, expected)


class FilterStep:
    """The filter, and what it lets expect. It never smooths: that would keep the whole flight."""

    def __init__(self, rig: Rig, settings: StageSettings) -> None:
        self.filter = RollbackFilter(rig, settings.motion.filter.model_copy(update={"smooth": False}))

    def hear(self, events: Sequence[Heard]) -> MotionPredictor | None:
        """Take what came before an exposure."""
        for e in events:
            if isinstance(e, NavSample):
                self.filter.feed_nav(e)
            else:
                self.filter.feed_imu(e)
        return self.filter.forecast()

    def see(self, tracks: Tracks) -> tuple[Motion | None, MotionPredictor | None]:
        """Take the features of an exposure."""
        return self.filter.feed_tracks(tracks), self.filter.forecast()
