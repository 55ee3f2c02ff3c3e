"""Joint posterior of the clones, refined by all observations that the state has not used yet (M23)."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from alight.arrays import F64
from alight.geometry import Pose, skew, so3_exp
from alight.motion.ekf.state import AT, CLONE, POSITION_FIRST, FilterState, moment_in_world
from alight.motion.observations import Clones, WindowObservations
from alight.motion.points import marginalise_points
from alight.motion.robust import robust_pose_weights
from alight.records import KeyframePosterior, Motion
from alight.settings import FilterSettings
from alight.spread import contradicts

log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class CloneWindow:
    """Copy of the clones after one exposure, and of the observations that the state has not used yet.

    The posterior follows from this record alone; it is computed only for the few exposures that become keyframes.
    """

    clones: Clones  # K clones
    P: F64  # (6K, 6K) joint covariance of the clones, (rotation, position) per pose
    offset_cross: F64  # (6K, 3) cross covariance of the clones with the offset of the map
    offset: F64  # (3,) m
    offset_covariance: F64  # (3, 3)
    mount: F64  # (3,) rad, mounting correction of the cameras
    observations: WindowObservations
    cams: tuple[Pose, ...]  # rig_from_cam
    frame_id: int
    settings: FilterSettings

    @classmethod
    def of(
        cls, state: FilterState, unused: WindowObservations, cams: Sequence[Pose], settings: FilterSettings,
        frame_id: int = 0,
    ) -> CloneWindow:  # fmt: skip
        """Copy the clones, mounting and map offset of a state, with its `unused` observations; `cams`: rig_from_cam."""
        rows, at, core = state.clone_rows, AT.offset, state.core
        joint, cross, offset = (state.P[r, c].copy() for r, c in ((rows, rows), (rows, at), (at, at)))
        return cls(
            state.clones, joint, cross, core[at].copy(), offset, core[AT.mount].copy(), unused, tuple(cams), frame_id,
            settings,
        )  # fmt: skip

    def refined(self) -> CloneWindow:
        """Return the window after Gauss-Newton on the unused observations, with the clones' joint covariance as prior.

        The covariance of the poses relative to the last one is inflated by the median residual and by `pixel_repeat`,
        because tracking errors are correlated between features and in time. If the observations as a whole contradict
        the prior, the window is returned unchanged.
        """
        P, clones, median = self.P, self.clones, 0.0
        error, gain = np.zeros(len(P)), np.asarray(np.eye(len(P)))
        observations = self.observations.select(self.observations.observed.sum(axis=1) >= 2)
        for _ in range(2 if len(observations.ids) else 0):
            constraint = marginalise_points(observations, clones, self.cams)
            used = constraint.well_known(clones.p[-1], self.settings.vague_share) & (constraint.freedom > 0)
            weight, median = robust_pose_weights(constraint, P, used, error)
            A, b = constraint.information(weight)
            gain = np.asarray(np.linalg.inv(np.eye(len(P)) + A @ P))
            whitened = gain @ (b + A @ error)  # P^-1 error
            error = P @ whitened
            if contradicts(float(whitened @ error), len(P)):
                log.info("observations of %d features contradict the poses, which stay as they were", used.sum())
                return self
            clones = self.clones.moved(error)
        inflation = relative_inflation(clones.p, max(1.0, self.settings.pixel_repeat * median))
        cross = inflation @ (gain.T @ self.offset_cross)
        return replace(self, clones=clones, P=inflation @ P @ gain @ inflation.T, offset_cross=cross)

    def posterior(self) -> KeyframePosterior:
        """Return the joint posterior of the clones, oldest first (M23).

        The covariance of each motion is in the world. The joint covariance is in the map frame, whose offset from the
        world (`offset_world`) cameras cannot observe.
        """
        refined = self.refined()
        order = (CLONE * np.arange(len(self.clones))[:, None] + POSITION_FIRST).ravel()
        motions = tuple(refined.keyframe(i) for i in range(len(self.clones)))
        return KeyframePosterior(motions, refined.P[np.ix_(order, order)])

    def keyframe(self, i: int) -> Motion:
        """Return the clone of index `i` as a motion."""
        rows, R, p = CLONE * i + POSITION_FIRST, self.clones.R[i], self.clones.p[i]
        rig, body = Pose(R, p), Pose(R @ so3_exp(self.mount).T, p)
        covariance = moment_in_world(
            self.P[np.ix_(rows, rows)], self.offset_cross[rows], self.offset, self.offset_covariance
        )
        return Motion(
            self.clones.stamps[i], body, tuple(rig @ c for c in self.cams), covariance, offset_world=self.offset,
            frame_id=self.frame_id,
        )  # fmt: skip


def rigid_posterior(motions: Sequence[Motion]) -> KeyframePosterior | None:
    """Return the joint posterior of poses that move rigidly with the error of the last pose; None without poses."""
    # for motions that were returned one by one, which loses the covariance of the poses relative to each other
    if not motions:
        return None
    p = np.array([m.world_from_body.translation for m in motions])
    by_last = np.tile(np.eye(CLONE), (len(motions), 1, 1))  # (position, rotation): derivative of each pose by the last
    by_last[:, :3, 3:] = -skew(p - p[-1])
    F = by_last.reshape(-1, CLONE)
    return KeyframePosterior(tuple(motions), F @ motions[-1].covariance @ F.T)


def relative_inflation(p: F64, factor: float, reference: int = -1) -> F64:
    """Return the matrix F (6K, 6K): F P F' inflates the covariance P of poses relative to the reference by `factor`.

    Args:
        p: (K, 3) positions, metres; the error of a pose is ordered (rotation, position).
        reference: index of the pose that keeps its covariance.
    """
    root, k = np.sqrt(factor), len(p)
    reference %= k
    by_reference = np.tile(np.eye(CLONE), (k, 1, 1))  # derivative of each pose by the reference, all being rigid
    by_reference[:, 3:, :3] = -skew(p - p[reference])
    out = root * np.eye(CLONE * k)
    columns = slice(CLONE * reference, CLONE * (reference + 1))
    out[:, columns] += (1.0 - root) * by_reference.reshape(CLONE * k, CLONE)
    return np.asarray(out)
