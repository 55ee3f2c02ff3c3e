"""Joint posterior of the keyframe window: the clones, refined with all observations not used by the state yet (M23)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from alight.arrays import F64, Mask
from alight.geometry import Pose, skew, so3_exp
from alight.motion.ekf.state import CLONE, OFFSET, FilterState
from alight.motion.elimination import PoseConstraint, marginalise_points
from alight.motion.observations import WindowObservations, WindowPoses
from alight.motion.robust import robust_pose_weights
from alight.motion.triangulation import triangulate_window
from alight.records import KeyframePosterior, Motion
from alight.settings import FilterSettings

_ITERATIONS = 2


@dataclass(frozen=True, eq=False)
class RefinedPoses:
    """K rig poses of one joint posterior."""

    R: F64  # (K, 3, 3) world_from_rig
    p: F64  # (K, 3) m
    covariance: F64  # (6K, 6K) joint, (rotation, position) a pose
    offset_cross: F64  # (6K, 3) cross covariance with the offset of the map


def refine_keyframes(
    state: FilterState, observations: WindowObservations, cams: Sequence[Pose], settings: FilterSettings
) -> RefinedPoses:
    """Gauss-Newton over the clones: prior is the joint covariance of the state, data are the unused observations.

    The covariance of the poses relative to the last one is inflated by the median residual and by `pixel_repeat`:
    errors of trees, grass in the wind and water are correlated, from feature to feature and in time.
    """
    clones, rows = state.window_poses(), state.clone_rows()
    P = state.P[np.ix_(rows, rows)]
    error, poses, gain, median = np.zeros(len(P)), clones, np.asarray(np.eye(len(P))), 0.0
    observations = observations.select(observations.observed.sum(axis=1) >= 2)
    for _ in range(_ITERATIONS if len(observations.ids) else 0):
        x = triangulate_window(observations, poses, cams)
        constraint = marginalise_points(observations, poses, cams, x)
        used = _well_known(constraint, x, poses, settings.vague_share)
        weight, median = robust_pose_weights(constraint, P, used, error)
        A, b = constraint.information(weight)
        gain = np.asarray(np.linalg.inv(np.eye(len(P)) + A @ P))
        error = P @ gain @ (b + A @ error)
        poses = _moved(clones, error)
    inflation = relative_inflation(poses.p, max(1.0, settings.pixel_repeat * median))
    cross = gain.T @ state.P[rows, OFFSET]
    return RefinedPoses(poses.R, poses.p, inflation @ P @ gain @ inflation.T, inflation @ cross)


def rigid_posterior(motions: Sequence[Motion]) -> KeyframePosterior | None:
    """Joint posterior of poses that are off together as one rigid body, as far as the last one claims; None of none.

    For motions that were given out one by one: the covariance of the poses relative to each other is lost.
    """
    if not motions:
        return None
    p = np.array([m.world_from_body.translation for m in motions])
    by_last = np.tile(np.eye(CLONE), (len(motions), 1, 1))  # (position, rotation): how each pose moves with the last
    by_last[:, :3, 3:] = -skew(p - p[-1])
    F = by_last.reshape(-1, CLONE)
    return KeyframePosterior(tuple(motions), F @ motions[-1].covariance @ F.T)


def _well_known(constraint: PoseConstraint, x: F64, poses: WindowPoses, share: float) -> Mask:
    """(N,) features whose largest sigma is less than a share of their distance from the last pose."""
    distance = np.linalg.norm(x - poses.p[-1], axis=1)
    well_known = np.sqrt(np.linalg.eigvalsh(constraint.point_covariance)[:, -1]) < share * distance
    return np.asarray(well_known & (constraint.freedom > 0))


def relative_inflation(p: F64, factor: float, reference: int = -1) -> F64:
    """Return the (6K, 6K) map that multiplies the variance of poses relative to the reference, which it leaves.

    Args:
        p: (K, 3) metres, positions; each pose is (rotation, position).
        reference: index of the pose that keeps its covariance.
    """
    root, k = np.sqrt(factor), len(p)
    reference %= k
    by_reference = np.tile(np.eye(CLONE), (k, 1, 1))  # how each pose moves when that one moves and all are rigid
    by_reference[:, 3:, :3] = -skew(p - p[reference])
    out = root * np.eye(CLONE * k)
    columns = slice(CLONE * reference, CLONE * (reference + 1))
    out[:, columns] += (1.0 - root) * by_reference.reshape(CLONE * k, CLONE)
    return np.asarray(out)


def _moved(poses: WindowPoses, error: F64) -> WindowPoses:
    """Return the poses with (6K,) errors added."""
    e = error.reshape(-1, CLONE)
    return replace(poses, R=so3_exp(e[:, :3]) @ poses.R, p=poses.p + e[:, 3:])
