"""Out-of-sequence measurements: roll the filter back to before such an event and process the later ones again."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from alight.motion.ekf.filter import MotionFilter
from alight.motion.ekf.keyframe_posterior import CloneWindow
from alight.motion.ekf.memory import Snapshot
from alight.motion.ekf.prediction import MotionPredictor
from alight.motion.ekf.state import FilterState
from alight.records import ImuSample, Motion, NavSample, Prediction, RefinedMotions, Rig, Tracks
from alight.settings import FilterSettings

_MIN_AHEAD_NS = 3_000_000  # ns by which an exposure must lie after its stamp for the IMU to be waited for


@dataclass(frozen=True, eq=False)
class _Processed:
    """An event that was processed, and the filter before it."""

    t_ns: int
    event: NavSample | Tracks
    before: Snapshot
    imu_ns: int  # stamp of the last inertial measurement at that time


class RollbackFilter:
    """A `MotionFilter` for events that are stamped correctly but arrive out of sequence, as over radio links.

    Motions returned before such an event are not changed; later ones include it.
    """

    def __init__(self, rig: Rig, settings: FilterSettings, map_number: int = 0) -> None:
        self._filter = MotionFilter(rig, settings, map_number)
        self._reach_ns = round(settings.lateness * 1e9)
        self._processed: deque[_Processed] = deque()
        self.too_late = 0  # events left out because they came later than `lateness`

    @property
    def state(self) -> FilterState | None:
        """A copy of the state, to be inspected; None before the first GPS/INS row."""
        return self._filter.state

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
        self._repeat_last_exposure()
        t, later = self._filter.time_of(event), list[_Processed]()
        if t < self._filter.time_ns:
            while self._processed and self._processed[-1].t_ns > t:
                later.append(self._processed.pop())
            if not later or later[-1].before.t_ns > t:
                self._processed.extend(reversed(later))
                self.too_late += 1
                return None
            self._filter.restore(later[-1].before)
        motion = self._take(event)
        for e in reversed(later):
            self._take(e.event)
        return motion

    def _repeat_last_exposure(self) -> None:
        """Process the last exposure again if, by its time offset, it lies after the IMU that was known at the time."""
        last = self._processed[-1] if self._processed else None
        if last is None or not isinstance(last.event, Tracks) or last.t_ns - last.event.t_ns < _MIN_AHEAD_NS:
            return
        imu = self._filter.imu
        if len(imu) and last.imu_ns < last.t_ns <= imu.last_ns:
            self._filter.restore(self._processed.pop().before)
            self._take(last.event)

    def _take(self, event: NavSample | Tracks) -> Motion | None:
        if self._reach_ns:
            imu_ns = self._filter.imu.last_ns if len(self._filter.imu) else 0
            self._processed.append(_Processed(self._filter.time_of(event), event, self._filter.snapshot(), imu_ns))
            while self._processed[0].t_ns < self._processed[-1].t_ns - self._reach_ns:
                self._processed.popleft()
        if isinstance(event, Tracks):
            return self._filter.feed_tracks(event)
        self._filter.feed_nav(event)
        return None

    def predict(self, stamp_ns: int, before_ns: int | None = None) -> Prediction | None:
        """Return the camera poses at an exposure, relative to that at `before_ns`; None: no GPS/INS row yet."""
        for e in reversed(self._processed):
            if self._filter.time_ns <= stamp_ns:
                break
            if e.before.t_ns <= stamp_ns and e.before.state is not None:
                return self._filter.predictor_of(e.before.state).cameras(stamp_ns, before_ns, self._filter.imu)
        return self._filter.predict(stamp_ns, before_ns)

    def predictor(self) -> MotionPredictor | None:
        """Return the predictor of later exposures; None before the first GPS/INS row."""
        return self._filter.predictor()

    def clone_window(self) -> CloneWindow | None:
        """Return the clones by value (M23); None before any exposure."""
        return self._filter.clone_window()

    def smoothed(self) -> list[Motion]:
        """Return the motions of all exposures so far, smoothed together (M18-M22)."""
        return self._filter.smoothed()

    def refined(self) -> RefinedMotions:
        """Return the smoothed motions with their joint covariance (M22b)."""
        return self._filter.refined()
