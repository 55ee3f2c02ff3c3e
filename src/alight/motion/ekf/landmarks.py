"""Landmarks in the state: measured in every exposure, initialised from the window when well known (M11-M13, M17)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import gammaincinv

from alight.arrays import F64, I64, Mask
from alight.geometry import Pose
from alight.motion.ekf.health import GateCounts
from alight.motion.ekf.landmark_kernels import (
    gate_distances,
    innovation_of,
    linearise_points,
    project_covariance,
)
from alight.motion.ekf.state import CLONE, LANDMARK, FilterState, Landmarks
from alight.motion.observations import cameras_at, positions
from alight.motion.points import NEAR, PoseConstraint, unit_noise_rows
from alight.motion.robust import median_residual, robust_weights

MAX_REJECTIONS = 3  # exposures in a row outside its gate after which a landmark is dropped: it moves
_RESIDUAL_GAIN = 0.3  # of the last exposure in a landmark's running mean residual
_MAX_MEAN_RESIDUAL = 9.0  # squared mean residual over its expectation by chance; above it a landmark moves
_MAX_INITIAL_MISFIT = 2.0  # in medians; tracks with a larger residual do not become landmarks


class Gate:
    """Mahalanobis gate at one probability for any number of rows."""

    def __init__(self, probability: float) -> None:
        self._probability = probability
        self._limits = np.zeros(1)

    def limits(self, rows: I64) -> F64:
        """Return the largest squared distances that pass (chi-square)."""
        most = int(rows.max(initial=0))
        if most >= len(self._limits):
            self._limits = np.append(0.0, 2.0 * gammaincinv(0.5 * np.arange(1, most + 16), self._probability))
        return np.asarray(self._limits[rows])


@dataclass(frozen=True, eq=False)
class LandmarkRows:
    """Linearised observations of N landmarks from the last clone, m = 2 rows a camera, in sigmas.

    Rows that are not observed are zero.
    """

    pose: int  # first row of the clone in `P`
    points: I64  # (N,) first row of each landmark
    residual: F64  # (N, m)
    by_pose: F64  # (N, m, 6)
    by_point: F64  # (N, m, 3)
    count: I64  # (N,) rows observed
    HP: F64  # (N, m, n) their covariance with all errors

    def distances(self) -> F64:
        """Return the (N,) squared Mahalanobis distances."""
        out = np.empty(len(self.count))
        gate_distances(self.HP, self.pose, self.points, self.by_pose, self.by_point, self.residual, out)
        return out

    def correct(self, state: FilterState, weight: F64) -> None:
        """Update the state by the landmarks with a (N,) weight above zero."""
        used = np.argwhere((weight > 0)[:, None] & self.by_point.any(axis=2))
        innovation, S = np.empty(len(used)), np.empty((len(used), len(used)))
        rows = np.empty((len(used), self.HP.shape[2]))
        given = self.HP, self.pose, self.points, self.by_pose, self.by_point, self.residual
        innovation_of(*given, used, np.sqrt(weight), rows, S, innovation)
        state.correct_by(innovation, rows, S)


def linearise_landmarks(
    state: FilterState, index: I64, normalised: F64, sigma: F64, cams: Sequence[Pose]
) -> LandmarkRows:
    """Residuals at the estimates, Jacobians at the first estimates (M11; Huang et al. 2008).

    Args:
        state: with the clone of this exposure as the last one.
        index: (N,) of the landmarks.
        normalised: (N, cameras, 2) observations, NaN = not observed.
        sigma: (N,) of a normalised coordinate.
        cams: rig_from_cam.
    """
    n, m = len(index), 2 * len(cams)
    w, q = state.clones, state.landmarks
    (R, p), (first_R, first_p) = (cameras_at(a[-1:], b[-1:], cams) for a, b in ((w.R, w.p), (w.first_R, w.first_p)))
    residual, by_pose, by_point = np.empty((n, m)), np.empty((n, m, CLONE)), np.empty((n, m, LANDMARK))
    count, HP = np.empty(n, np.int64), np.empty((n, m, len(state.P)))
    linearise_points(
        q.x[index], q.first_x[index], normalised, sigma, R[0], p[0], first_R[0], first_p[0], w.first_p[-1], NEAR,
        residual, by_pose, by_point, count,
    )  # fmt: skip
    pose, points = state.landmark_start - CLONE, state.landmark_start + LANDMARK * index
    project_covariance(state.P, pose, points, by_pose, by_point, HP)
    return LandmarkRows(pose, points, residual, by_pose, by_point, count, HP)


def update_landmarks(
    state: FilterState, ids: I64, normalised: F64, sigma: F64, cams: Sequence[Pose], gate: Gate
) -> GateCounts:
    """Update the state by the landmarks observed at its last clone.

    Args:
        state: corrected in place.
        ids, normalised, sigma: (N,) sorted, (N, cameras, 2), (N,) observations of the exposure.
        cams: rig_from_cam.
        gate: of one landmark.
    """
    column = positions(ids, state.landmarks.ids)
    index = np.flatnonzero(column >= 0)
    if not len(index):
        return GateCounts()
    column = column[index]
    rows = linearise_landmarks(state, index, normalised[column], sigma[column], cams)
    tried, distance = rows.count > 0, rows.distances()
    passed = tried & (distance <= gate.limits(rows.count))
    rejections = state.landmarks.rejections.copy()
    rejections[index] = np.where(tried & ~passed, rejections[index] + 1, 0)
    state.landmarks = replace(state.landmarks, rejections=rejections)
    if passed.any():
        misfit = distance / np.maximum(rows.count, 1)
        weight = passed * robust_weights(misfit, median_residual(misfit[tried]))
        state.landmarks = reject_moving(state.landmarks, index[tried], rows.residual[tried])
        rows.correct(state, weight)
    mean = float(distance[passed].sum() / max(rows.count[passed].sum(), 1))
    return GateCounts(int(passed.sum()), int((tried & ~passed).sum()), mean)


def reject_moving(landmarks: Landmarks, index: I64, residual: F64) -> Landmarks:
    """Mark landmarks whose residual keeps its sign, exposure after exposure: they move slowly.

    Args:
        landmarks: `rejections` is set to `MAX_REJECTIONS` where they move.
        index: (N,) of those observed in this exposure.
        residual: (N, m) of this exposure, in sigmas.
    """
    mean, square = landmarks.mean_residual.copy(), landmarks.mean_square.copy()
    rejections = landmarks.rejections.copy()
    mean[index] += _RESIDUAL_GAIN * (residual - mean[index])
    square[index] += _RESIDUAL_GAIN * ((residual * residual).sum(axis=1) - square[index])
    by_chance = _RESIDUAL_GAIN / (2.0 - _RESIDUAL_GAIN)  # variance of the running mean of white residuals
    limit = _MAX_MEAN_RESIDUAL * by_chance * median_residual(square[index])
    rejections[index[(mean[index] ** 2).sum(axis=1) > limit]] = MAX_REJECTIONS
    return replace(landmarks, mean_residual=mean, mean_square=square, rejections=rejections)


def initialise_landmarks(state: FilterState, ids: I64, constraint: PoseConstraint, gate: Gate, rows: int) -> Mask:
    """Move N tracks from the window into the state, if their observations agree (M17); (N,) which were moved.

    Delayed initialisation: the observations of a track are split into two independent parts. The part that does not
    depend on the point measures the poses; it is gated and used. The other part gives the point with its covariance
    and its exact cross covariance with the state. No observation is used twice.

    Args:
        state: changed in place.
        ids: (N,) the tracks.
        constraint: of these tracks, linearised at their triangulated points.
        gate: of one track.
        rows: of one exposure's observations of a point.
    """
    columns = state.clone_rows
    P = state.P[columns]
    passed = constraint.mahalanobis(P[:, columns]) <= gate.limits(constraint.freedom)
    misfit = constraint.misfit / np.maximum(constraint.freedom, 1)
    passed &= misfit <= _MAX_INITIAL_MISFIT * median_residual(misfit)
    if not passed.any():
        return passed
    constraint = constraint.select(passed)
    x = constraint.x
    G = constraint.point_by_poses().reshape(-1, len(P))  # negated
    cross = G @ P
    covariance = cross[:, columns] @ G.T
    for i, given_poses in enumerate(constraint.point_covariance):
        at = slice(LANDMARK * i, LANDMARK * (i + 1))
        covariance[at, at] += given_poses
    landmarks = Landmarks.new(ids[passed], x + constraint.step, x, rows)  # Jacobians were taken at x
    state.add_landmarks(landmarks, -cross, covariance)
    state.correct(*unit_noise_rows(*constraint.information(np.ones(len(x)))), columns)
    return passed
