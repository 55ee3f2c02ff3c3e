"""Navigation lane of given poses, for evaluation."""

from __future__ import annotations

import bisect
from collections import deque
from functools import partial

import numpy as np
from scipy.linalg import block_diag

from alight.geometry import Pose
from alight.pipeline.navigation import Navigation, TimedPoses, Trajectory, sparse
from alight.pipeline.timing import Progress
from alight.records import Event, Frame, KeyframePosterior, Motion, Rig
from alight.settings import MotionSettings

GIVEN_SIGMA = 1e-3  # metres and radians, 1-sigma of poses treated as exact
LONGEST_GAP_NS = 1_000_000_000  # ns, longest gap between given poses that is interpolated


class GivenLane:
    """Given poses, interpolated; their errors are independent, with the sigmas of the settings, or zero.

    Args:
        poses: times in ns, ascending, and `world_from_body` at each time.
        history: whether motions are kept for the end; False: memory stays bounded.
    """

    def __init__(self, rig: Rig, poses: TimedPoses, settings: MotionSettings, history: bool = True) -> None:
        self._rig = rig
        sigma = np.repeat([settings.given_position_sigma, settings.given_attitude_sigma], 3)
        self._covariance, self._exact = np.diag(np.maximum(sigma, GIVEN_SIGMA) ** 2), not sigma.any()
        self._t, self._poses = [int(t) for t in poses[0]], poses[1]
        self._motions: deque[Motion] = deque(maxlen=None if history else 1)
        self._missed = 0  # number of exposures

    def _at(self, t_ns: int) -> Pose | None:
        k = bisect.bisect_left(self._t, t_ns)
        if k < len(self._t) and self._t[k] == t_ns:
            return self._poses[k]
        if 0 < k < len(self._t) and self._t[k] - self._t[k - 1] <= LONGEST_GAP_NS:
            share = (t_ns - self._t[k - 1]) / (self._t[k] - self._t[k - 1])
            return self._poses[k - 1].interpolate(self._poses[k], share)
        return None

    def feed(self, event: Event) -> Navigation | None:
        """Return the given pose at an exposure; None for other events and exposures without a pose."""
        if not isinstance(event, Frame):
            return None
        pose = self._at(event.t_ns)
        if pose is None:
            self._missed += 1
            return None
        cams = tuple(pose @ c.body_from_cam for c in self._rig.cameras)
        motion = Motion(event.t_ns, pose, cams, self._covariance)
        self._motions.append(motion)
        keyframes = None if self._exact else partial(KeyframePosterior, (motion,), motion.covariance)
        return Navigation(event, motion, keyframes)

    def finish(self, progress: Progress) -> Trajectory:
        """Return all motions, with independent errors."""
        warnings = (f"poses: none for {self._missed} exposures, which are not used",) if self._missed else ()
        motions, notes, joint = tuple(self._motions), {"motion": "given poses, not estimated"}, None
        if motions and not self._exact:
            some = sparse(motions)
            joint = KeyframePosterior(some, block_diag(*(m.covariance for m in some)))
        return Trajectory(motions, self._rig, warnings, notes, joint)
