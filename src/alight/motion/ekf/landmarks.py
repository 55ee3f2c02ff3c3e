"""Landmarks in the state: measured in every exposure, initialised from the window when well known (M11-M13, M17)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from alight.arrays import F64, I64, Mask
from alight.geometry import Pose
from alight.motion.ekf.health import GateCounts
from alight.motion.ekf.state import CLONE, LANDMARK, Clone, FilterState, Landmark
from alight.motion.elimination import PoseConstraint, unit_noise_rows
from alight.motion.projection import depths, jacobians, project
from alight.motion.robust import median_residual, robust_weights
from alight.motion.triangulation import NEAR

MAX_REJECTIONS = 3  # exposures in a row outside its gate after which a landmark is dropped: it moves
_RESIDUAL_GAIN = 0.3  # of the last exposure in a landmark's running mean residual
_MAX_MEAN_RESIDUAL = 9.0  # squared mean residual, in units of what chance makes of it; above it a landmark moves
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
            self._limits = np.append(0.0, chi2.ppf(self._probability, np.arange(1, most + 16)))
        return np.asarray(self._limits[rows])

    def limit(self, rows: int) -> float:
        """Return the largest squared distance that passes (chi-square)."""
        return float(self.limits(np.array([rows]))[0])

    def passes(self, residual: F64, S: F64) -> bool:
        """Whether a residual with covariance `S` is inside the gate."""
        return bool(residual @ np.linalg.solve(S, residual) <= self.limit(len(residual)))


@dataclass(frozen=True, eq=False)
class LandmarkRows:
    """Linearised observations of N landmarks from one clone, 2 rows a camera, in sigmas; unobserved rows are zero."""

    residual: F64  # (N, m)
    by_clone: F64  # (N, m, 6)
    by_landmark: F64  # (N, m, 3)
    observed: Mask  # (N, m)

    def select(self, which: Mask) -> LandmarkRows:
        """Return the rows of some landmarks."""
        return LandmarkRows(self.residual[which], self.by_clone[which], self.by_landmark[which], self.observed[which])

    def scaled(self, factor: F64) -> LandmarkRows:
        """Return all rows of each landmark times its (N,) factor."""
        return LandmarkRows(
            self.residual * factor[:, None],
            self.by_clone * factor[:, None, None],
            self.by_landmark * factor[:, None, None],
            self.observed,
        )


def linearise_landmarks(
    clone: Clone, x: F64, first_x: F64, normalised: F64, cams: Sequence[Pose], sigma: F64
) -> LandmarkRows:
    """Residuals at the estimates, Jacobians at the first estimates (M11; Huang et al. 2008).

    Args:
        clone: pose of the rig.
        x, first_x: (N, 3) landmarks, world.
        normalised: (N, cameras, 2) observations, NaN = not observed.
        cams: rig_from_cam.
        sigma: (N,) of a normalised coordinate.
    """
    n, m = len(x), 2 * len(cams)
    residual, observed = np.zeros((n, m)), np.zeros((n, m), bool)
    by_clone, by_landmark = np.zeros((n, m, CLONE)), np.zeros((n, m, LANDMARK))
    for i, cam in enumerate(cams):
        rows = slice(2 * i, 2 * i + 2)
        ok = np.isfinite(normalised[:, i, 0]) & (depths(clone.R, clone.p, cam, x) > NEAR)
        ok &= depths(clone.first_R, clone.first_p, cam, first_x) > NEAR
        residual[ok, rows] = normalised[ok, i] - project(clone.R, clone.p, cam, x[ok])
        by_clone[ok, rows], by_landmark[ok, rows] = jacobians(clone.first_R, clone.first_p, cam, first_x[ok])
        observed[ok, rows] = True
    unit = 1.0 / sigma[:, None]
    return LandmarkRows(residual * unit, by_clone * unit[..., None], by_landmark * unit[..., None], observed)


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
    held = np.array([x.id for x in state.landmarks], dtype=np.int64)
    index, column = _common(held, ids)
    if not len(index):
        return GateCounts()
    landmarks, clone = [state.landmarks[i] for i in index], len(state.clones) - 1
    x, first_x = np.array([q.x for q in landmarks]), np.array([q.first_x for q in landmarks])
    rows = linearise_landmarks(state.clones[clone], x, first_x, normalised[column], cams, sigma[column])
    tried, distance = np.asarray(rows.observed.any(axis=1)), _mahalanobis(state, clone, index, rows)
    count = rows.observed.sum(axis=1)
    passed = tried & (distance <= gate.limits(count))
    for q, failed in zip(landmarks, tried & ~passed, strict=True):
        q.rejections = q.rejections + 1 if failed else 0
    if passed.any():
        misfit = distance / np.maximum(count, 1)
        weight = robust_weights(misfit, median_residual(misfit[tried]))
        reject_moving([q for q, ok in zip(landmarks, tried, strict=True) if ok], rows.residual[tried])
        _correct(state, clone, index[passed], rows.scaled(np.sqrt(weight)).select(passed))
    mean = float(distance[passed].sum() / max(count[passed].sum(), 1))
    return GateCounts(int(passed.sum()), int((tried & ~passed).sum()), mean)


def reject_moving(landmarks: Sequence[Landmark], residual: F64) -> None:
    """Mark landmarks whose residual keeps its sign, exposure after exposure: they move slowly.

    Args:
        landmarks: N of them; `rejections` is set to `MAX_REJECTIONS` where they move.
        residual: (N, m) of this exposure, in sigmas.
    """
    for q, r in zip(landmarks, residual, strict=True):
        q.mean_residual = q.mean_residual + _RESIDUAL_GAIN * (r - q.mean_residual)
        q.mean_square = q.mean_square + _RESIDUAL_GAIN * (float(r @ r) - q.mean_square)
    by_chance = _RESIDUAL_GAIN / (2.0 - _RESIDUAL_GAIN)  # variance of the running mean of white residuals
    limit = _MAX_MEAN_RESIDUAL * by_chance * median_residual(np.array([q.mean_square for q in landmarks]))
    for q in landmarks:
        q.rejections = MAX_REJECTIONS if q.mean_residual @ q.mean_residual > limit else q.rejections


def _common(held: I64, ids: I64) -> tuple[I64, I64]:
    """Return which of the landmarks held are among sorted ids: (index of the landmark, index in ids)."""
    i = np.searchsorted(ids, held)
    present = (i < len(ids)) & (ids[np.minimum(i, len(ids) - 1)] == held) if len(ids) else np.zeros(len(held), bool)
    return np.flatnonzero(present), i[present]


def _mahalanobis(state: FilterState, clone: int, index: I64, rows: LandmarkRows) -> F64:
    """Squared Mahalanobis distance of every landmark by the covariance of its own rows."""
    pose = np.arange(len(state.P))[state.clone_slice(clone)]
    columns = np.hstack([np.broadcast_to(pose, (len(index), len(pose))), state.landmark_rows(index)])  # (N, 9)
    H = np.concatenate([rows.by_clone, rows.by_landmark], axis=2)
    S = H @ state.P[columns[:, :, None], columns[:, None, :]] @ H.transpose(0, 2, 1)
    S += np.eye(S.shape[1])
    return np.asarray((rows.residual * np.linalg.solve(S, rows.residual[..., None])[..., 0]).sum(axis=1))


def _correct(state: FilterState, clone: int, index: I64, rows: LandmarkRows) -> None:
    """Update the state by the rows of landmarks seen from one clone."""
    n, m = rows.residual.shape
    pose = np.arange(len(state.P))[state.clone_slice(clone)]
    columns = np.concatenate([pose, state.landmark_rows(index).ravel()])
    H = np.zeros((n, m, len(columns)))
    H[:, :, :CLONE] = rows.by_clone
    k = np.arange(n)
    for j in range(LANDMARK):
        H[k, :, CLONE + LANDMARK * k + j] = rows.by_landmark[:, :, j]
    observed = rows.observed.ravel()
    state.correct(rows.residual.ravel()[observed], H.reshape(n * m, -1)[observed], columns)


def initialise_landmarks(state: FilterState, ids: I64, x: F64, constraint: PoseConstraint, gate: Gate) -> Mask:
    """Move N tracks from the window into the state, if their observations agree (M17); (N,) which were moved.

    Delayed initialisation: the observations of a track are split into two independent parts. The part that does not
    depend on the point measures the poses; it is gated and used. The other part gives the point with its covariance
    and its exact cross covariance with the state. No observation is used twice.

    Args:
        state: changed in place.
        ids, x: (N,), (N, 3) the tracks and their triangulated points.
        constraint: of these tracks, linearised at `x`.
        gate: of one track.
    """
    columns = state.clone_rows()
    P = state.P[columns]
    passed = constraint.mahalanobis(P[:, columns]) <= gate.limits(constraint.freedom)
    misfit = constraint.misfit / np.maximum(constraint.freedom, 1)
    passed &= misfit <= _MAX_INITIAL_MISFIT * median_residual(misfit)
    if not passed.any():
        return passed
    constraint, x = constraint.select(passed), x[passed]
    G = constraint.point_by_poses().reshape(-1, len(columns))  # negated
    covariance = G @ P[:, columns] @ G.T
    for i, given_poses in enumerate(constraint.point_covariance):
        at = slice(LANDMARK * i, LANDMARK * (i + 1))
        covariance[at, at] += given_poses
    best = x + constraint.step
    landmarks = [Landmark(int(k), best[i], x[i]) for i, k in enumerate(ids[passed])]  # Jacobians were taken at x
    state.add_landmarks(landmarks, -G @ P, covariance)
    state.correct(*unit_noise_rows(*constraint.information(np.ones(len(x)))), columns)
    return passed
