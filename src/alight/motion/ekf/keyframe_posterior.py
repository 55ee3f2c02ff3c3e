"""The poses held, refined together with every sight that the state has not used yet (M23)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from alight.geometry import Pose, so3_exp
from alight.motion.ekf.observations import (
    PoseConstraint,
    WindowObservations,
    WindowPoses,
    marginalise_points,
    triangulate_window,
)
from alight.motion.ekf.state import OFFSET, FilterState
from alight.motion.robust import Mask, agree_on_poses
from alight.motion.rotations import skews
from alight.records import F64
from alight.settings import FilterSettings

_ITERATIONS = 2


@dataclass(frozen=True, eq=False)
class RefinedPoses:
    """K rig poses from one posterior."""

    R: F64  # (K, 3, 3) world_from_rig
    p: F64  # (K, 3) m
    covariance: F64  # (6K, 6K) joint, (rotation, position) a pose
    offset_cross: F64  # (6K, 3) with the map's offset


def refine(
    state: FilterState, sights: WindowObservations, cams: Sequence[Pose], settings: FilterSettings
) -> RefinedPoses:
    """Gauss-Newton over the poses held: the state's joint covariance as the prior, and the sights that wait (M23).

    What is claimed of the poses as seen from each other is no better than the sights agree, and `pixel_repeat` of them
    say one thing: trees, grass in the wind and water are wrong for many features alike, exposure after exposure.
    """
    held, P = WindowPoses.of(state.clones), state.P[np.ix_(state.clone_columns(), state.clone_columns())]
    error, poses, gain, missed = np.zeros(len(P)), held, np.asarray(np.eye(len(P))), 0.0
    sights = sights.rows(sights.where.sum(axis=1) >= 2)
    for _ in range(_ITERATIONS if len(sights.ids) else 0):
        x = triangulate_window(sights, poses, cams)
        found = marginalise_points(sights, poses, cams, x)
        weight, missed = agree_on_poses(found, P, clear(found, x, poses, settings.vague_share), error)
        A, b = found.information(weight)
        gain = np.asarray(np.linalg.inv(np.eye(len(P)) + A @ P))
        error = P @ gain @ (b + A @ error)
        poses = _moved(held, error)
    wide = _wider(poses.p, max(1.0, settings.pixel_repeat * missed))
    cross = gain.T @ state.P[state.clone_columns(), OFFSET]
    return RefinedPoses(poses.R, poses.p, wide @ P @ gain @ wide.T, wide @ cross)


def clear(found: PoseConstraint, x: F64, poses: WindowPoses, share: float) -> Mask:
    """(N,) features whose depth is known to a share of their distance."""
    distance = np.linalg.norm(x - poses.p[-1], axis=1)
    known = np.sqrt(np.linalg.eigvalsh(found.point_covariance)[:, -1]) < share * distance
    return np.asarray(known & (found.freedom > 0))


def _wider(p: F64, times: float) -> F64:
    """(6K, 6K) what makes the variance of poses as seen from the last one `times` as large, and leaves that one."""
    root, k = np.sqrt(times), len(p)
    follow = np.tile(np.eye(6), (k, 1, 1))  # how a pose follows when the last one turns and moves
    follow[:, 3:, :3] = -skews(p - p[-1])
    out = root * np.eye(6 * k)
    out[:, -6:] += (1.0 - root) * follow.reshape(6 * k, 6)
    return np.asarray(out)


def _moved(poses: WindowPoses, error: F64) -> WindowPoses:
    e = error.reshape(-1, 6)
    R = np.array([so3_exp(a[:3]) @ R for a, R in zip(e, poses.R, strict=True)])
    return replace(poses, R=R, p=poses.p + e[:, 3:])
