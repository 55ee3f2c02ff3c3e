"""Out-of-sequence measurements: roll the filter back to before such an event and process the later ones again."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from alight.motion.ekf.filter import MotionFilter
from alight.motion.ekf.memory import Snapshot
from alight.records import Motion, NavSample, Rig, Tracks
from alight.settings import FilterSettings

_MIN_AHEAD_NS = 3_000_000  # ns by which an exposure must lie after its stamp for the IMU to be waited for


@dataclass(frozen=True, eq=False)
class _Processed:
    """An event that was processed, and the filter before it."""

    t_ns: int
    event: NavSample | Tracks
    before: Snapshot
    imu_ns: int  # stamp of the last inertial measurement at that time


class RollbackFilter(MotionFilter):
    """A `MotionFilter` for events that are stamped correctly but arrive out of sequence, as over radio links.

    Motions returned before such an event are not changed; later ones include it.
    """

    def __init__(self, rig: Rig, settings: FilterSettings, map_number: int = 0) -> None:
        super().__init__(rig, settings, map_number)
        self._reach_ns = round(settings.lateness * 1e9)
        self._processed: deque[_Processed] = deque()
        self.too_late = 0  # events left out because they came later than `lateness`

    def feed_nav(self, sample: NavSample) -> None:
        """Take one row of the GPS/INS solution."""
        self._feed(sample)

    def feed_tracks(self, tracks: Tracks) -> Motion | None:
        """Take the features of one exposure and return its motion; None: no GPS/INS row yet, or too late."""
        return self._feed(tracks)

    def _feed(self, event: NavSample | Tracks) -> Motion | None:
        self._repeat_last_exposure()
        t, later = self.time_of(event), list[_Processed]()
        if t < self.time_ns:
            while self._processed and self._processed[-1].t_ns > t:
                later.append(self._processed.pop())
            if not later or later[-1].before.t_ns > t:
                self._processed.extend(reversed(later))
                self.too_late += 1
                return None
            self.restore(later[-1].before)
        motion = self._take(event)
        for e in reversed(later):
            self._take(e.event)
        return motion

    def _repeat_last_exposure(self) -> None:
        """Process the last exposure again if, by its time offset, it lies after the IMU that was known at the time."""
        last = self._processed[-1] if self._processed else None
        if last is None or not isinstance(last.event, Tracks) or last.t_ns - last.event.t_ns < _MIN_AHEAD_NS:
            return
        imu = self.imu
        if len(imu) and last.imu_ns < last.t_ns <= imu.last_ns:
            self.restore(self._processed.pop().before)
            self._take(last.event)

    def _take(self, event: NavSample | Tracks) -> Motion | None:
        if self._reach_ns:
            imu_ns = self.imu.last_ns if len(self.imu) else 0
            self._processed.append(_Processed(self.time_of(event), event, self.snapshot(), imu_ns))
            while self._processed[0].t_ns < self._processed[-1].t_ns - self._reach_ns:
                self._processed.popleft()
        if isinstance(event, Tracks):
            return super().feed_tracks(event)
        super().feed_nav(event)
        return None
