"""Navigation lane of feature tracker and filter, with the smoother at the end of a recording."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from alight.motion import MotionFilter
from alight.motion.ekf.keyframe_posterior import rigid_posterior
from alight.motion.ekf.prediction import MotionPredictor
from alight.motion.imu_buffer import ImuBuffer
from alight.motion.points import MIN_POSES
from alight.pipeline.navigation import Navigation, Trajectory, sparse
from alight.pipeline.timing import Progress
from alight.records import (
    Event,
    Frame,
    GpsState,
    ImuSample,
    Motion,
    MotionState,
    MovingBody,
    NavSample,
    Rig,
    Tracks,
    View,
)
from alight.records.map_frame import in_world
from alight.settings import StageSettings
from alight.tracks import MovingWatch, Tracker

Row = NavSample | ImuSample


@dataclass(frozen=True, eq=False)
class FrameBatch:
    """One exposure and the rows received before it; rows only, if no exposure came for a long time."""

    frame: Frame | None
    rows: tuple[Row, ...]

    def after(self, dropped: FrameBatch) -> FrameBatch:
        """Return this batch with the rows of an earlier, dropped batch prepended; the dropped picture is lost."""
        return replace(self, rows=dropped.rows + self.rows)


class EventBatcher:
    """Collector of events into batches, in the order of arrival; memory is bounded, even if one stream stops.

    Of several exposures with one time stamp, only the first is used, as the times of the others are unknown.
    """

    def __init__(self) -> None:
        self.repeated = 0  # exposures dropped for a repeated time stamp
        self._rows: deque[Row] = deque()
        self._stamps: deque[int] = deque(maxlen=256)

    def take(self, event: Event) -> FrameBatch | None:
        """Add an event; return a batch for an exposure, or for many rows without one, else None."""
        if not isinstance(event, Frame):
            self._rows.append(event)
            return self.rest() if len(self._rows) > 1000 else None  # rows of 5 s
        if event.t_ns in self._stamps:
            self.repeated += 1
            return None
        self._stamps.append(event.t_ns)
        return replace(self.rest(), frame=event)

    def rest(self) -> FrameBatch:
        """Return a batch of the waiting rows, without an exposure, and clear them."""
        rows, self._rows = tuple(self._rows), deque()
        return FrameBatch(None, rows)


def _left_out(count: int, what: str) -> str:
    return f"motion: {count} exposures or GPS/INS rows {what} and are left out"


class FilterLane:
    """Feature tracks and the structure-from-motion filter (docs/method/motion.md).

    Every exposure is predicted from the filter's state after the last exposure but one, propagated with the IMU.

    Args:
        history: whether data are kept for the end of a recording; False: memory stays bounded, and nothing is smoothed.
        frame_id: map number of the first motion; a lane that replaces another continues with its `next_frame`.
        photos: whether the exposures are photos with tags of a gimbal, not a flight.
        anew: times of the exposures before which the lane is restarted, as after a loss in flight.
    """

    def __init__(
        self, rig: Rig, settings: StageSettings, history: bool = True, frame_id: int = 0, photos: bool = False,
        anew: Collection[int] = (),
    ) -> None:  # fmt: skip
        noise = settings.motion.filter if history else settings.motion.filter.model_copy(update={"smooth": False})
        if noise.mounting_sigma is None and not photos:
            noise = noise.model_copy(update={"mounting_sigma": 0.0})
        self._photos = photos
        self._rig, self._tracks, self._settings, self._anew = rig, settings.tracks, noise, set(anew)
        self._most = None if history else 1  # number of motions that are kept
        self._batcher = EventBatcher()
        self.next_frame = frame_id  # first unused map number
        self._begin()

    def _begin(self) -> None:
        self._tracker, self._imu = Tracker(self._rig, self._tracks), ImuBuffer()
        self._filter = MotionFilter(self._rig, self._settings, self.next_frame)
        self._predictors: deque[MotionPredictor | None] = deque(maxlen=2)  # predictors after the last two exposures
        self._predicted_from: MotionPredictor | None = None  # predictor of the last exposure
        self._watch, self._watched_frame = MovingWatch(), self.next_frame
        self._attitude = False  # whether an attitude was measured
        self._motions: deque[Motion] = deque(maxlen=self._most)
        self._given = self._lost = self._led = 0  # numbers of exposures; led: while GPS drifted

    def feed(self, event: Event) -> Navigation | None:
        """Process one event; return the motion and posterior of an exposure, else None."""
        if isinstance(event, Frame) and event.t_ns in self._anew:
            self._anew.remove(event.t_ns)
            self._begin()
        batch = self._batcher.take(event)
        return None if batch is None else self.take(batch)

    def take(self, batch: FrameBatch) -> Navigation | None:
        """Process an exposure with the rows before it; return its motion and posterior, else None."""
        self._take_rows(batch)
        if batch.frame is None:
            return None
        motion = self._filter.feed(self._track(batch.frame))
        self._predictors.append(self._filter.predictor())
        if motion is None:
            return None
        motion = replace(motion, movers=self._movers(batch.frame, motion))
        self._motions.append(motion)
        self.next_frame = max(self.next_frame, motion.frame_id + 1)
        self._given, self._lost = self._given + 1, self._lost + (motion.state is MotionState.LOST)
        self._led += motion.odometry is not None and motion.odometry.gps is GpsState.DRIFTS
        window = self._filter.clone_window()
        return Navigation(batch.frame, motion, None if window is None else window.posterior, self._attitude)

    def _movers(self, frame: Frame, motion: Motion) -> tuple[MovingBody, ...]:
        """Return who moves, by the first camera that looks down and has a picture. The landmarks are the ground."""
        state = self._filter.state
        if self._photos or state is None or not len(state.landmarks):
            return ()
        if motion.frame_id != self._watched_frame:
            self._watch, self._watched_frame = MovingWatch(), motion.frame_id
        for image, cam, pose in zip(frame.images, self._rig.cameras, motion.world_from_cams, strict=True):
            if image is not None and -pose.rotation[2, 2] > 0.5:  # within 60 degrees
                ground = float(np.median(state.landmarks.x[:, 2]))
                return self._watch.feed(View(frame.t_ns, 0, image, cam.camera, pose), ground)
        return ()

    def _take_rows(self, batch: FrameBatch) -> None:
        for row in batch.rows:
            self._filter.feed(row)
            if isinstance(row, NavSample):
                self._attitude = self._attitude or row.world_from_body is not None
            else:
                self._imu.append(row)
        if len(self._imu):  # the next prediction may need two seconds of IMU rows
            oldest, used = self._imu.last_ns - 2_000_000_000, self._predicted_from
            self._imu.forget_before(min(oldest, used.t_ns) if used else oldest)

    def _track(self, frame: Frame) -> Tracks:
        self._predicted_from = before = self._predictors[0] if self._predictors else self._filter.predictor()
        expected = before.cameras(frame.t_ns, self._tracker.last_ns, self._imu) if before else None
        return self._tracker.feed(frame, expected if expected is not None and expected.is_finite else None)

    def finish(self, progress: Progress) -> Trajectory:
        """Return the smoothed motions, or the motions of the flight with a warning if smoothing failed."""
        self._take_rows(self._batcher.rest())
        refined = self._filter.refined()
        smoothed = bool(refined.motions)
        motions = refined.motions or tuple(sorted(in_world(self._motions), key=lambda m: m.t_ns))
        joint = refined.joint or rigid_posterior(sparse(motions))
        repeated = self._batcher.repeated
        warnings = [_left_out(repeated, "have the stamp of an earlier one")] if repeated else []
        warnings += self.warnings(motions, smoothed)
        note = "structure-from-motion filter" + (", smoothed" if smoothed else ", as it was in flight")
        return Trajectory(motions, self._rig, tuple(warnings), {"motion": note}, joint, attitude=self._attitude)

    def warnings(self, motions: Sequence[Motion], smoothed: bool) -> list[str]:
        """Return warnings on the motion, in sentences."""
        out = []
        if self._filter.too_late:
            out.append(_left_out(self._filter.too_late, "came late"))
        if self._lost:
            out.append(f"motion: lost in {self._lost} of {self._given} exposures, which are not used for the map")
        if self._led:
            out.append(
                f"motion: GPS drifted against the pictures in {self._led} of {self._given} exposures, and is unused"
            )
        if (state := self._filter.state) is not None and state.refused:
            out.append(f"motion: {state.refused} measurements led to no update (a singular matrix) and are left out")
        if anew := max((m.frame_id for m in motions), default=0):
            out.append(f"motion: began anew {anew} times; the parts are tied together by GPS alone")
        if self._settings.smooth and motions and not smoothed:
            cause = "they are too few" if len(motions) < MIN_POSES else "their equations have no solution"
            out.append(
                f"motion: the exposures could not be refined together ({cause}); the poses are those of the flight"
            )
        return out
