"""The navigation lane: frames and GPS/INS -> motions, in one of three ways that all give the same records."""

from __future__ import annotations

import bisect
from collections import deque
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from alight.geometry import Pose
from alight.motion import RollbackFilter
from alight.motion.bundle.adjust import adjust
from alight.motion.bundle.matching import colmap
from alight.records import Event, Frame, ImuSample, KeyframePosterior, Motion, MotionState, NavSample, Rig
from alight.settings import MotionSettings, StageSettings
from alight.tracks import Tracker

Progress = Callable[[float], None]
TimedPoses = tuple[NDArray[np.int64], list[Pose]]  # world_from_body
GIVEN_SIGMA = 1e-3  # metres and radians, claimed of poses that are taken as they are
_STAMPS = 256  # of exposures that are remembered, to find those that come twice
LONGEST_GAP_NS = 1_000_000_000  # between given poses that are interpolated


class Lane(Protocol):
    """What the pipeline asks of a way to find the motion."""

    rig: Rig
    warnings: list[str]
    notes: dict[str, Any]

    def feed(self, event: Event) -> Motion | None:
        """Take one event; an exposure gives its motion as soon as it can be known."""

    def posterior(self) -> KeyframePosterior | None:
        """What is known of the last keyframes' poses, for a refinement with the map; None: take them as given out."""

    def finish(self, progress: Progress) -> list[Motion]:
        """All motions, refined with everything that came."""


class FilterLane:
    """Feature tracks and the structure-from-motion filter, smoothed at the end of a recording.

    Without `history` nothing is kept for that end: memory does not grow with the flight.
    """

    def __init__(self, rig: Rig, settings: StageSettings, history: bool = True) -> None:
        self.rig, self.warnings, self.notes = rig, list[str](), dict[str, Any]()
        self._tracker = Tracker(rig, settings.tracks)
        self._settings = settings.motion.filter
        if not history:
            self._settings = self._settings.model_copy(update={"smooth": False})
        self._filter = RollbackFilter(rig, self._settings)
        self._motions: deque[Motion] = deque(maxlen=None if history else 1)
        self._stamps: deque[int] = deque(maxlen=_STAMPS)
        self._repeated = self._given = self._lost = 0  # exposures

    def feed(self, event: Event) -> Motion | None:
        """Track, predict, update (docs/method-motion.md)."""
        if isinstance(event, NavSample):
            self._filter.feed_nav(event)
        elif isinstance(event, ImuSample):
            self._filter.feed_imu(event)
        elif event.t_ns in self._stamps:  # nobody knows when it was; the first one is taken, as the log's reader does
            self._repeated += 1
        else:
            self._stamps.append(event.t_ns)
            return self._see(event)
        return None

    def _see(self, frame: Frame) -> Motion | None:
        tracks = self._tracker.feed(frame, self._filter.predict(frame.t_ns, self._tracker.last_ns))
        motion = self._filter.feed_tracks(tracks)
        if motion is not None:
            self._motions.append(motion)
            self._given, self._lost = self._given + 1, self._lost + (motion.state is MotionState.LOST)
        return motion

    def finish(self, progress: Progress) -> list[Motion]:
        """The smoothed motions; a warning where the filter was lost."""
        smoothed = self._filter.smoothed()
        motions = smoothed or sorted(self._motions, key=lambda m: m.t_ns)
        for count, what in ((self._repeated, "have the stamp of an earlier one"), (self._filter.too_late, "came late")):
            if count:
                self.warnings.append(f"motion: {count} exposures or GPS/INS rows {what} and are left out")
        if self._lost:
            what = f"lost in {self._lost} of {self._given} exposures, which are not used for the map"
            self.warnings.append(f"motion: {what}")
        if anew := max((m.map for m in motions), default=0):
            self.warnings.append(f"motion: began anew {anew} times; the parts are tied together by GPS alone")
        if self._settings.smooth and motions and not smoothed:
            self.warnings.append(
                "motion: the exposures could not be refined together; the poses are those of the flight"
            )
        self.notes["motion"] = "structure-from-motion filter" + (", smoothed" if smoothed else ", as it was in flight")
        return motions

    def posterior(self) -> KeyframePosterior:
        """The ring with the joint covariance of its poses: what a refinement with the map starts from."""
        return self._filter.posterior()


class GivenLane:
    """Poses from outside, for evaluation; each has errors of its own as large as the settings say, or none."""

    def __init__(self, rig: Rig, poses: TimedPoses, settings: MotionSettings, history: bool = True) -> None:
        self.rig, self.warnings, self.notes = rig, list[str](), dict[str, Any]()
        sigma = np.repeat([settings.given_position_sigma, settings.given_attitude_sigma], 3)
        self._covariance, self._exact = np.diag(np.maximum(sigma, GIVEN_SIGMA) ** 2), not sigma.any()
        self._t, self._poses = [int(t) for t in poses[0]], poses[1]
        self._motions: deque[Motion] = deque(maxlen=None if history else 1)
        self._missed = 0

    def _at(self, t_ns: int) -> Pose | None:
        k = bisect.bisect_left(self._t, t_ns)
        if k < len(self._t) and self._t[k] == t_ns:
            return self._poses[k]
        if 0 < k < len(self._t) and self._t[k] - self._t[k - 1] <= LONGEST_GAP_NS:
            return self._poses[k - 1].interpolate(
                self._poses[k], (t_ns - self._t[k - 1]) / (self._t[k] - self._t[k - 1])
            )
        return None

    def feed(self, event: Event) -> Motion | None:
        """The given pose at an exposure, interpolated; None where there is none."""
        if not isinstance(event, Frame):
            return None
        pose = self._at(event.t_ns)
        if pose is None:
            self._missed += 1
            return None
        cams = tuple(pose @ c.body_from_cam for c in self.rig.cameras)
        self._motions.append(Motion(event.t_ns, pose, cams, self._covariance))
        return self._motions[-1]

    def posterior(self) -> KeyframePosterior | None:
        """The last pose by itself."""
        return None if self._exact or not self._motions else KeyframePosterior((self._motions[-1],), self._covariance)

    def finish(self, progress: Progress) -> list[Motion]:
        """The motions given out before."""
        if self._missed:
            self.warnings.append(f"poses: none for {self._missed} exposures, which are not used")
        self.notes["motion"] = "given poses, not estimated"
        return list(self._motions)


class BundleLane:
    """Bundle adjustment of all photos at the end."""

    def __init__(self, rig: Rig, settings: StageSettings) -> None:
        colmap()  # missing? say so before the photos are read
        self.rig, self.warnings, self.notes = rig, list[str](), dict[str, Any]()
        self._settings = settings.motion.bundle
        self._frames: list[Frame] = []
        self._nav: list[NavSample | None] = []
        self._last: NavSample | None = None

    def feed(self, event: Event) -> Motion | None:
        """Keep the photo and the navigation sample of its time."""
        if isinstance(event, NavSample):
            self._last = event
        elif isinstance(event, Frame):
            self._frames.append(event)
            self._nav.append(self._last if self._last is not None and self._last.t_ns == event.t_ns else None)
        return None

    def posterior(self) -> KeyframePosterior | None:
        """None: all poses come at the end."""
        return None

    def finish(self, progress: Progress) -> list[Motion]:
        """Adjust; the photos that could not be registered are in the warnings."""
        found = adjust(self._frames, self._nav, self.rig, self._settings, progress)
        self.rig = found.rig
        self.warnings.extend(found.warnings)
        self.notes.update(found.notes)
        return [m for m in found.motions if m is not None]
