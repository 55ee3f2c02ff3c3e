"""The navigation lane: frames and GPS/INS -> motions, in one of three ways that all give the same records."""

from __future__ import annotations

import bisect
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from alight.geometry import Pose
from alight.motion import MotionFilter
from alight.motion.bundle import adjust
from alight.motion.bundle_match import colmap
from alight.records import Event, Frame, ImuSample, Motion, MotionState, NavSample, PoseRing, Rig
from alight.settings import Settings
from alight.tracks import Tracker

Progress = Callable[[float], None]
TimedPoses = tuple[NDArray[np.int64], list[Pose]]  # world_from_body
GIVEN_SIGMA = 1e-3  # metres and radians: poses from outside are taken as they are
LONGEST_GAP_NS = 1_000_000_000  # between given poses that are interpolated


class Lane(Protocol):
    """What the pipeline asks of a way to find the motion."""

    rig: Rig
    warnings: list[str]
    notes: dict[str, Any]

    def feed(self, event: Event) -> Motion | None:
        """Take one event; an exposure gives its motion as soon as it can be known."""

    def finish(self, progress: Progress) -> list[Motion]:
        """All motions, refined with everything that came."""


class FilterLane:
    """Feature tracks and the structure-from-motion filter, smoothed at the end of a recording."""

    def __init__(self, rig: Rig, settings: Settings) -> None:
        self.rig, self.warnings, self.notes = rig, list[str](), dict[str, Any]()
        self._tracker = Tracker(rig, settings.tracks)
        self._settings = settings.motion.filter
        self._filter = MotionFilter(rig, self._settings)
        self._motions: list[Motion] = []

    def feed(self, event: Event) -> Motion | None:
        """Track, predict, update (docs/method-motion.md)."""
        if isinstance(event, NavSample):
            self._filter.feed_nav(event)
        elif isinstance(event, ImuSample):
            self._filter.feed_imu(event)
        else:
            tracks = self._tracker.feed(event, self._filter.predict(event.t_ns))
            motion = self._filter.feed_tracks(tracks)
            if motion is not None:
                self._motions.append(motion)
            return motion
        return None

    def finish(self, progress: Progress) -> list[Motion]:
        """The smoothed motions; a warning where the filter was lost."""
        motions = self._filter.smoothed() or self._motions
        lost = sum(m.state is MotionState.LOST for m in motions)
        if lost:
            self.warnings.append(f"motion: lost in {lost} of {len(motions)} exposures, which are not used for the map")
        maps = len({m.map for m in motions})
        if maps > 1:
            self.warnings.append(f"motion: began anew {maps - 1} times; the parts are tied together by GPS alone")
        smoothed = self._settings.smooth
        self.notes["motion"] = "structure-from-motion filter" + (", smoothed" if smoothed else ", as it was in flight")
        return motions

    def ring(self) -> tuple[Motion, ...]:
        """The last keyframes from one posterior: for the recursive map, whose views must agree with each other."""
        return self._filter.ring()

    def posterior(self) -> PoseRing:
        """The ring with the joint covariance of its poses: what a refinement with the map starts from."""
        return self._filter.posterior()


class GivenLane:
    """Poses from outside, for evaluation."""

    def __init__(self, rig: Rig, poses: TimedPoses) -> None:
        self.rig, self.warnings, self.notes = rig, list[str](), dict[str, Any]()
        self._t, self._poses = [int(t) for t in poses[0]], poses[1]
        self._motions: list[Motion] = []
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
        self._motions.append(Motion(event.t_ns, pose, cams, np.eye(6) * GIVEN_SIGMA**2))
        return self._motions[-1]

    def finish(self, progress: Progress) -> list[Motion]:
        """The motions given out before."""
        if self._missed:
            self.warnings.append(f"poses: none for {self._missed} exposures, which are not used")
        self.notes["motion"] = "given poses, not estimated"
        return self._motions


class BundleLane:
    """Bundle adjustment of all photos at the end."""

    def __init__(self, rig: Rig, settings: Settings) -> None:
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

    def finish(self, progress: Progress) -> list[Motion]:
        """Adjust; the photos that could not be registered are in the warnings."""
        found = adjust(self._frames, self._nav, self.rig, self._settings, progress)
        self.rig = found.rig
        self.warnings.extend(found.warnings)
        self.notes.update(found.notes)
        return [m for m in found.motions if m is not None]
