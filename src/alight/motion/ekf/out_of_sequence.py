"""Events that come late: the filter goes back to before them and takes in again what came since."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from alight.motion.ekf.filter import MotionFilter, Snapshot
from alight.motion.ekf.prediction import MotionPredictor
from alight.records import ImuSample, KeyframePosterior, Motion, NavSample, Prediction, Rig, Tracks
from alight.settings import FilterSettings

_AHEAD_NS = 3_000_000  # ns of an exposure after its stamp that are worth waiting for the IMU


@dataclass(frozen=True, eq=False)
class _Done:
    """An event that was taken, and the filter as it was before."""

    t_ns: int
    event: NavSample | Tracks
    before: Snapshot
    imu_ns: int  # the last inertial measurement then


class RollbackFilter:
    """A `MotionFilter` for events that are rightly stamped and not in order of time, as radio links deliver them.

    What was given out before a late event stays as it was; what comes after knows of it.
    """

    def __init__(self, rig: Rig, settings: FilterSettings) -> None:
        self._filter = MotionFilter(rig, settings)
        self._reach_ns = round(settings.lateness * 1e9)
        self._done: deque[_Done] = deque()
        self.too_late = 0  # events left out

    def feed_imu(self, sample: ImuSample) -> None:
        """Take one inertial measurement."""
        self._filter.feed_imu(sample)

    def feed_nav(self, sample: NavSample) -> None:
        """Take one row of the GPS/INS solution."""
        self._feed(sample)

    def feed_tracks(self, tracks: Tracks) -> Motion | None:
        """Take the features of one exposure and return its motion; None: no GPS/INS row yet, or too late."""
        return self._feed(tracks)

    def _feed(self, event: NavSample | Tracks) -> Motion | None:
        self._retake()
        t, again = self._filter.time_of(event), list[_Done]()
        if t < self._filter.time_ns:
            while self._done and self._done[-1].t_ns > t:
                again.append(self._done.pop())
            if not again or again[-1].before.t_ns > t:
                self._done.extend(reversed(again))
                self.too_late += 1
                return None
            self._filter.restore(again[-1].before)
        motion = self._take(event)
        for e in reversed(again):
            self._take(e.event)
        return motion

    def _retake(self) -> None:
        """Take the last exposure again if it was, by its time offset, when the IMU had not been heard of yet."""
        last = self._done[-1] if self._done else None
        if last is None or not isinstance(last.event, Tracks) or last.t_ns - last.event.t_ns < _AHEAD_NS:
            return
        imu = self._filter.imu
        if imu and last.imu_ns < last.t_ns <= imu[-1].t_ns:
            self._filter.restore(self._done.pop().before)
            self._take(last.event)

    def _take(self, event: NavSample | Tracks) -> Motion | None:
        if self._reach_ns:
            imu_ns = self._filter.imu[-1].t_ns if self._filter.imu else 0
            self._done.append(_Done(self._filter.time_of(event), event, self._filter.snapshot(), imu_ns))
            while self._done[0].t_ns < self._done[-1].t_ns - self._reach_ns:
                self._done.popleft()
        if isinstance(event, Tracks):
            return self._filter.feed_tracks(event)
        self._filter.feed_nav(event)
        return None

    def predict(self, stamp_ns: int, before_ns: int | None = None) -> Prediction | None:
        """Where the cameras were or will be at an exposure, as seen from that at `before_ns`; None: no GPS/INS row."""
        for e in reversed(self._done):
            if self._filter.time_ns <= stamp_ns:
                break
            if e.before.t_ns <= stamp_ns and e.before.state is not None:
                return self._filter.forecast_of(e.before.state).cameras(stamp_ns, before_ns, self._filter.imu)
        return self._filter.predict(stamp_ns, before_ns)

    def forecast(self) -> MotionPredictor | None:
        """What can be said of later exposures now; None before the first GPS/INS row."""
        return self._filter.forecast()

    def posterior(self) -> KeyframePosterior:
        """The keyframes held, oldest first, refined together: consistent with each other."""
        return self._filter.posterior()

    def smoothed(self) -> list[Motion]:
        """The motions of all exposures so far, refined together."""
        return self._filter.smoothed()
