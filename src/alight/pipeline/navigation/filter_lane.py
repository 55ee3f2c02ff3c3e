"""Tracker and filter, and the smoother at the end of a recording.

Two halves may run at the same time and give the same bits for any schedule: while the filter takes one exposure, the
next one is tracked. So every exposure is predicted from the filter's state after the last exposure but one, even if the
last one is done; the IMU propagates that state. There is no thread here: `feed` calls the halves one after the other,
and a caller with two threads calls them itself.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

from alight.motion import MotionFilter
from alight.motion.ekf.filter import LEAST_EXPOSURES
from alight.motion.ekf.keyframe_posterior import rigid_posterior
from alight.motion.ekf.prediction import MotionPredictor
from alight.motion.imu_buffer import ImuBuffer
from alight.pipeline.map_frame import MapFrame
from alight.pipeline.navigation.lane import Navigation, Progress, Trajectory, sparse
from alight.records import Event, Frame, ImuSample, Motion, MotionState, NavSample, Rig, Tracks
from alight.settings import StageSettings
from alight.tracks import Tracker

_STAMPS = 256  # of exposures that are remembered, to find repeated ones
_MOST_ROWS = 1000  # rows that wait for an exposure; 5 s of them
_IMU_NS = 2_000_000_000  # ns of inertial measurements that the next prediction may need
Row = NavSample | ImuSample


@dataclass(frozen=True, eq=False)
class FrameBatch:
    """One exposure and the rows that came before it; without an exposure if none has come for long."""

    frame: Frame | None
    rows: tuple[Row, ...]

    def after(self, dropped: FrameBatch) -> FrameBatch:
        """This batch when an earlier one is left out: its picture is lost, its rows are not."""
        return replace(self, rows=dropped.rows + self.rows)


@dataclass(frozen=True, eq=False)
class TrackedFrame:
    """An exposure and its tracked features."""

    frame: Frame
    tracks: Tracks


class EventBatcher:
    """Gather events into batches in the order of arrival; memory is bounded, whichever stream stops.

    Of exposures with one stamp the first is taken, as the log's reader does: the times of the others are not known.
    """

    def __init__(self) -> None:
        self.repeated = 0  # exposures left out
        self._rows: deque[Row] = deque()
        self._stamps: deque[int] = deque(maxlen=_STAMPS)

    def take(self, event: Event) -> FrameBatch | None:
        """Take an event; an exposure makes a batch, and so do many rows without one."""
        if not isinstance(event, Frame):
            self._rows.append(event)
            return self.rest() if len(self._rows) > _MOST_ROWS else None
        if event.t_ns in self._stamps:
            self.repeated += 1
            return None
        self._stamps.append(event.t_ns)
        return replace(self.rest(), frame=event)

    def rest(self) -> FrameBatch:
        """The rows that wait for an exposure."""
        rows, self._rows = tuple(self._rows), deque()
        return FrameBatch(None, rows)


class Handover(Protocol):
    """Queue of predictions from the filter to the tracker, in order; between threads `get` waits for one."""

    def put(self, item: MotionPredictor | None) -> None:
        """Add a prediction."""

    def get(self) -> MotionPredictor | None:
        """Take the oldest one."""


class HandoverInTurn:
    """The handover of one thread: nothing waits."""

    def __init__(self) -> None:
        self._items: deque[MotionPredictor | None] = deque()

    def put(self, item: MotionPredictor | None) -> None:
        """Add a prediction."""
        self._items.append(item)

    def get(self) -> MotionPredictor | None:
        """Take the oldest one."""
        return self._items.popleft()


def prediction_for(exposure: int) -> int:
    """Number of the prediction for an exposure (from 0): 0 is made before the first exposure, k after the k-th."""
    return exposure if exposure < 2 else exposure - 1


class TrackingHalf:
    """The tracker, the inertial measurements that it predicts by, and the predictions that it gets."""

    def __init__(self, rig: Rig, settings: StageSettings, handover: Handover) -> None:
        self._tracker = Tracker(rig, settings.tracks)
        self._imu = ImuBuffer()
        self._handover = handover
        self._prediction: MotionPredictor | None = None
        self._known, self._exposure = -1, 0  # number of that prediction, and of the next exposure

    def track(self, batch: FrameBatch) -> TrackedFrame | None:
        """Follow the features into the exposure of a batch."""
        for row in batch.rows:
            if isinstance(row, ImuSample):
                self._imu.append(row)
        if len(self._imu):
            oldest = self._imu.last_ns - _IMU_NS
            self._imu.forget_before(min(oldest, self._prediction.t_ns) if self._prediction else oldest)
        if batch.frame is None:
            return None
        while self._known < prediction_for(self._exposure):
            self._prediction, self._known = self._handover.get(), self._known + 1
        self._exposure += 1
        p = self._prediction
        expected = p.cameras(batch.frame.t_ns, self._tracker.last_ns, self._imu) if p else None
        if expected is not None and not expected.is_finite:
            expected = None
        return TrackedFrame(batch.frame, self._tracker.feed(batch.frame, expected))


def _left_out(count: int, what: str) -> str:
    return f"motion: {count} exposures or GPS/INS rows {what} and are left out"


class FilterLane:
    """Feature tracks and the structure-from-motion filter (docs/method/motion.md).

    Args:
        history: keep the data for the end of a recording; without it memory does not grow with the flight, and
            nothing is smoothed.
        handover: queue of predictions from the filter to the tracker, where the halves run on two threads.
        frame_id: of the first motion; a lane that replaces another one goes on with its `next_frame`.
        photos: the exposures are photos with tags of a gimbal, not a flight.
    """

    def __init__(
        self,
        rig: Rig,
        settings: StageSettings,
        history: bool = True,
        handover: Handover | None = None,
        frame_id: int = 0,
        photos: bool = False,
    ) -> None:
        noise = settings.motion.filter if history else settings.motion.filter.model_copy(update={"smooth": False})
        if noise.mounting_sigma is None and not photos:
            noise = noise.model_copy(update={"mounting_sigma": 0.0})
        self._rig, self._settings, self._handover = rig, noise, handover or HandoverInTurn()
        self.batcher, self.tracking = EventBatcher(), TrackingHalf(rig, settings, self._handover)
        self._filter = MotionFilter(rig, noise, frame_id)
        self._begun = self._attitude = False  # the first exposure has come; an attitude was measured
        self._motions: deque[Motion] = deque(maxlen=None if history else 1)
        self._given = self._lost = 0  # exposures
        self.next_frame = frame_id  # the first frame number that no motion has had

    def feed(self, event: Event) -> Navigation | None:
        """Take one event; an exposure gives its motion and the clones."""
        batch = self.batcher.take(event)
        return None if batch is None else self.take(batch)

    def take(self, batch: FrameBatch) -> Navigation | None:
        """Take an exposure with the rows before it: on two threads, `tracking` on one and the rest on the other."""
        self.take_rows(batch)
        tracked = self.tracking.track(batch)
        return None if tracked is None else self.update(tracked)

    def take_rows(self, batch: FrameBatch) -> None:
        """Give the filter the rows of a batch, before or while its exposure is tracked."""
        for row in batch.rows:
            if isinstance(row, NavSample):
                self._filter.feed_nav(row)
                self._attitude = self._attitude or row.world_from_body is not None
            else:
                self._filter.feed_imu(row)
        if batch.frame is not None and not self._begun:
            self._begun = True
            self._handover.put(self._filter.predictor())

    def update(self, tracked: TrackedFrame) -> Navigation | None:
        """Give the filter the features of an exposure; return its motion, and the clones."""
        motion = self._filter.feed_tracks(tracked.tracks)
        self._handover.put(self._filter.predictor())
        if motion is None:
            return None
        self._motions.append(motion)
        self.next_frame = max(self.next_frame, motion.frame_id + 1)
        self._given, self._lost = self._given + 1, self._lost + (motion.state is MotionState.LOST)
        return Navigation(tracked.frame, motion, self._filter.clone_window(), self._attitude)

    def finish(self, progress: Progress) -> Trajectory:
        """The smoothed motions; a warning where the filter was lost."""
        self.take_rows(self.batcher.rest())
        refined = self._filter.refined()
        smoothed = bool(refined.motions)
        motions = refined.motions or tuple(self._online())
        joint = refined.joint or rigid_posterior(sparse(motions))
        repeated = self.batcher.repeated
        warnings = [_left_out(repeated, "have the stamp of an earlier one")] if repeated else []
        warnings += self.warnings(motions, smoothed)
        note = "structure-from-motion filter" + (", smoothed" if smoothed else ", as it was in flight")
        return Trajectory(motions, self._rig, tuple(warnings), {"motion": note}, joint, attitude=self._attitude)

    def _online(self) -> list[Motion]:
        """The motions as they were given out, in order of time; each frame in the world by its newest offset."""
        newest = {m.frame_id: MapFrame.of(m) for m in self._motions}
        return sorted((newest[m.frame_id].motion(m) for m in self._motions), key=lambda m: m.t_ns)

    def warnings(self, motions: Sequence[Motion], smoothed: bool) -> list[str]:
        """Warnings on the motion, in sentences."""
        out = []
        if self._filter.too_late:
            out.append(_left_out(self._filter.too_late, "came late"))
        if self._lost:
            out.append(f"motion: lost in {self._lost} of {self._given} exposures, which are not used for the map")
        if (state := self._filter.state) is not None and state.refused:
            out.append(f"motion: {state.refused} measurements led to no update (a singular matrix) and are left out")
        if anew := max((m.frame_id for m in motions), default=0):
            out.append(f"motion: began anew {anew} times; the parts are tied together by GPS alone")
        if self._settings.smooth and motions and not smoothed:
            cause = "they are too few" if len(motions) < LEAST_EXPOSURES else "their equations have no solution"
            out.append(
                f"motion: the exposures could not be refined together ({cause}); the poses are those of the flight"
            )
        return out
