"""Visual update of the EKF by landmarks in every exposure, and by other tracks once when they end (MSCKF; M11-M17)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import gammaincinv

from alight.arrays import F64, I64
from alight.geometry import Camera, Pose
from alight.motion.dynamics import MAX_RATE_AGE
from alight.motion.ekf.health import MAX_REJECTIONS, GateCounts
from alight.motion.ekf.keyframe_posterior import CloneWindow
from alight.motion.ekf.landmark_kernels import (
    gate_distances,
    innovation_of,
    linearise_points,
    project_covariance,
)
from alight.motion.ekf.state import AT, CLONE, LANDMARK, FilterState, Landmarks
from alight.motion.observations import WindowObservations, cameras_at, observation_sigma, positions
from alight.motion.points import MIN_POSES, NEAR, marginalise_points, unit_noise_rows
from alight.motion.robust import median_of, median_residual, robust_pose_weights, robust_weights
from alight.records import Tracks
from alight.settings import FilterSettings

_MIN_FREEDOM = 2  # degrees of freedom of a track that becomes a landmark: enough to check its observations
_MAX_LINEARISATION_ERROR = 0.04  # rad between a clone and its first estimate; above it Jacobians are no longer valid
_RESIDUAL_GAIN = 0.3  # weight of the last exposure in a landmark's running mean residual
_MAX_MEAN_RESIDUAL = 9.0  # squared mean residual over its expectation by chance; above it a landmark moves
_MAX_INITIAL_MISFIT = 2.0  # in medians; tracks with a larger residual do not become landmarks


def gate_limits(rows: I64, probability: float) -> F64:
    """Return the (N,) largest squared Mahalanobis distances that pass a gate, for `rows` (N,) degrees of freedom."""
    return np.asarray(2.0 * gammaincinv(0.5 * rows, probability))


class VisualUpdate:
    """Visual update of the state by the tracks of each exposure; holds the observations not used yet.

    Attributes are replaced, never changed in place, so that `copy.copy` gives an independent copy.
    """

    def __init__(self, camera: Camera, cams: Sequence[Pose], settings: FilterSettings) -> None:
        self._camera, self._cams, self._settings = camera, tuple(cams), settings
        self._unused = WindowObservations.empty(len(cams))

    def reset(self, state: FilterState) -> None:
        """Drop all clones, landmarks and unused observations; the motion stays as it is."""
        state.drop(range(len(state.clones)), range(len(state.landmarks)))
        self._unused = WindowObservations.empty(len(self._cams))

    def window(self, state: FilterState, exposure_ns: int, frame_id: int) -> CloneWindow:
        """Return the clones with the unused observations, from which their posterior follows (M23).

        Without clones, as after a reset, the window holds only the present pose, stamped `exposure_ns`.
        """
        if not len(state.clones):
            state = state.copy()
            state.add_clone(exposure_ns)
        return CloneWindow.of(state, self._unused, self._cams, self._settings, frame_id)

    def on_exposure(self, state: FilterState, tracks: Tracks) -> GateCounts:
        """Process one exposure: use ended tracks, clone the pose, update landmarks and initialise new ones."""
        order = np.argsort(tracks.ids)
        ids, normalised = tracks.ids[order], tracks.normalised[order]
        sigma = observation_sigma(tracks, self._camera, self._settings)[order]
        self._relinearise_if_stale(state, tracks.t_ns)
        dropped = self._clone_to_drop(state)
        counts = self._update_from_lost_tracks(state, ids, dropped)
        lost = (state.landmarks.rejections >= MAX_REJECTIONS) | (positions(ids, state.landmarks.ids) < 0)
        state.drop(clones=dropped, landmarks=np.flatnonzero(lost))
        state.add_clone(tracks.t_ns)
        counts += self._update_landmarks(state, ids, normalised, sigma)
        seen = positions(ids, state.landmarks.ids)
        free = np.delete(np.arange(len(ids)), seen[seen >= 0])
        self._unused = self._unused.without_poses(dropped).with_pose(ids[free], normalised[free], sigma[free])
        return counts + self._initialise_landmarks(state)

    def _relinearise_if_stale(self, state: FilterState, t_ns: int) -> None:
        """Reset if the oldest clone's attitude left its first estimate; between photos, renew the first estimates."""
        w, q, least = state.clones, state.landmarks, 1.0 + 2.0 * np.cos(_MAX_LINEARISATION_ERROR)
        stale = len(w) > 0 and float((w.R[0] * w.first_R[0]).sum()) < least
        if stale and (t_ns - w.stamps[-1]) * 1e-9 > MAX_RATE_AGE:
            state.clones, state.landmarks = replace(w, first_R=w.R, first_p=w.p), replace(q, first_x=q.x)
        elif stale:
            self.reset(state)

    def _clone_to_drop(self, state: FilterState) -> list[int]:
        """Return the clone to drop: the last if near its predecessor, the first if there are too many; else none."""
        p, off = state.clones.p, state.landmarks.x - state.core[AT.pos]
        distance = float(np.sqrt(median_of((off * off).sum(axis=1)))) if len(off) else 0.0  # m, of the landmarks
        if len(p) >= 3 and np.linalg.norm(p[-1] - p[-2]) < self._settings.clone_baseline * distance:
            return [len(p) - 1]
        return [0] if len(p) >= self._settings.clones else []

    def _update_from_lost_tracks(self, state: FilterState, ids: I64, dropped: list[int]) -> GateCounts:
        """Update the poses by tracks that ended.

        A track ends if its id is not among the exposure's `ids`, or if its first clone is in `dropped` (indices).
        """
        unused = self._unused
        if not len(unused.ids):
            return GateCounts()
        ended = positions(ids, unused.ids) < 0
        if dropped == [0]:
            ended |= unused.observed[:, 0]
        self._unused = unused.select(~ended)
        return self._update_poses(state, unused.select(ended & (unused.observed.sum(axis=1) >= MIN_POSES)))

    def _update_poses(self, state: FilterState, observations: WindowObservations) -> GateCounts:
        """Update the clones by tracks whose points are eliminated (MSCKF update)."""
        if not len(observations.ids):
            return GateCounts()
        columns = state.clone_rows
        constraint = marginalise_points(observations, state.clones, self._cams)
        well_known = constraint.well_known(state.core[AT.pos], self._settings.vague_share) & (constraint.freedom > 0)
        P, freedom = state.P[columns, columns], np.maximum(constraint.freedom, 1)
        distance = constraint.mahalanobis(P)
        passed = well_known & (distance <= gate_limits(freedom, self._settings.gate))
        if passed.any():
            weight, _ = robust_pose_weights(constraint, P, passed, np.zeros(len(P)))
            state.correct(*unit_noise_rows(*constraint.information(weight)), columns)
        return GateCounts.of(well_known, passed, distance, freedom)

    def _update_landmarks(self, state: FilterState, ids: I64, normalised: F64, sigma: F64) -> GateCounts:
        """Update the state by the landmarks among the exposure's features (M11).

        `ids`: (M,) ascending. `normalised`: (M, C, 2) coordinates in C cameras, NaN = not observed. `sigma`: (M,).
        """
        column = positions(ids, state.landmarks.ids)
        index = np.flatnonzero(column >= 0)
        if not len(index):
            return GateCounts()
        column, n, m, w, q = column[index], len(index), 2 * len(self._cams), state.clones, state.landmarks
        poses = ((w.R, w.p), (w.first_R, w.first_p))
        (R, p), (first_R, first_p) = (cameras_at(a[-1:], b[-1:], self._cams) for a, b in poses)
        residual, by_pose, by_point = np.empty((n, m)), np.empty((n, m, CLONE)), np.empty((n, m, LANDMARK))
        count, HP, distance = np.empty(n, np.int64), np.empty((n, m, len(state.P))), np.empty(n)
        linearise_points(
            q.x[index], q.first_x[index], normalised[column], sigma[column], R[0], p[0], first_R[0], first_p[0],
            w.first_p[-1], NEAR, residual, by_pose, by_point, count,
        )  # fmt: skip
        pose, points = state.landmark_start - CLONE, state.landmark_start + LANDMARK * index  # their rows in `P`
        project_covariance(state.P, pose, points, by_pose, by_point, HP)
        rows = HP, pose, points, by_pose, by_point, residual
        gate_distances(*rows, distance)
        tried = count > 0
        passed = tried & (distance <= gate_limits(count, self._settings.gate))
        rejections = q.rejections.copy()
        rejections[index] = np.where(tried & ~passed, rejections[index] + 1, 0)
        state.landmarks = replace(q, rejections=rejections)
        if passed.any():
            misfit = distance / np.maximum(count, 1)
            weight = passed * robust_weights(misfit, median_residual(misfit[tried]))
            state.landmarks = reject_moving(state.landmarks, index[tried], residual[tried])
            used = np.argwhere((weight > 0)[:, None] & by_point.any(axis=2))  # rows that are not observed are zero
            innovation, S = np.empty(len(used)), np.empty((len(used), len(used)))
            used_HP = np.empty((len(used), len(state.P)))
            innovation_of(*rows, used, np.sqrt(weight), used_HP, S, innovation)
            state.correct_by(innovation, used_HP, S)
        return GateCounts.of(tried, passed, distance, count)

    def _initialise_landmarks(self, state: FilterState) -> GateCounts:
        """Turn tracks whose observations agree into landmarks while there is room, the longest tracks first (M17)."""
        # delayed initialisation: of two independent parts of the observations, one does not depend on the point and
        # measures the poses; the other gives the point, its covariance, and its exact cross covariance with the state
        s, unused = self._settings, self._unused
        free, length = s.points - len(state.landmarks), unused.observed.sum(axis=1)
        ready = np.flatnonzero((length >= MIN_POSES) & unused.observed[:, -1])
        if free <= 0 or not len(ready):
            return GateCounts()
        ready = ready[np.argsort(-length[ready], kind="stable")][: 2 * free]
        constraint = marginalise_points(unused.select(ready), state.clones, self._cams)
        well_known = constraint.well_known(state.core[AT.pos], s.depth_share)
        tried = np.flatnonzero(well_known & (constraint.freedom >= _MIN_FREEDOM))[:free]
        if not len(tried):
            return GateCounts()
        chosen, constraint, columns = ready[tried], constraint.select(tried), state.clone_rows
        P = state.P[columns]
        passed = constraint.mahalanobis(P[:, columns]) <= gate_limits(constraint.freedom, s.gate)
        misfit = constraint.misfit / np.maximum(constraint.freedom, 1)
        passed &= misfit <= _MAX_INITIAL_MISFIT * median_residual(misfit)
        if passed.any():
            constraint = constraint.select(passed)
            G = constraint.point_by_poses().reshape(-1, len(P))  # negated
            cross = G @ P
            covariance = cross[:, columns] @ G.T
            for i, given_poses in enumerate(constraint.point_covariance):
                at = slice(LANDMARK * i, LANDMARK * (i + 1))
                covariance[at, at] += given_poses
            x, ids = constraint.x, unused.ids[chosen[passed]]
            landmarks = Landmarks.new(ids, x + constraint.step, x, 2 * len(self._cams))  # Jacobians were taken at x
            state.insert(len(state.P), -cross, covariance)
            state.landmarks = state.landmarks.joined(landmarks)
            state.correct(*unit_noise_rows(*constraint.information(np.ones(len(x)))), columns)
        kept = np.ones(len(unused.ids), bool)
        kept[chosen[passed]] = False
        self._unused = unused.select(kept)
        return GateCounts(int(passed.sum()), int((~passed).sum()), 1.0)


def reject_moving(landmarks: Landmarks, index: I64, residual: F64) -> Landmarks:
    """Return the landmarks, with slowly moving ones marked: their residual keeps its sign from exposure to exposure.

    Args:
        landmarks: landmarks; a moving one is returned with `rejections` set to `MAX_REJECTIONS`.
        index: (N,) landmarks observed in this exposure.
        residual: (N, m) their residuals in this exposure, in sigmas.
    """
    mean, square = landmarks.mean_residual.copy(), landmarks.mean_square.copy()
    rejections = landmarks.rejections.copy()
    mean[index] += _RESIDUAL_GAIN * (residual - mean[index])
    square[index] += _RESIDUAL_GAIN * ((residual * residual).sum(axis=1) - square[index])
    by_chance = _RESIDUAL_GAIN / (2.0 - _RESIDUAL_GAIN)  # variance of the running mean of white residuals
    limit = _MAX_MEAN_RESIDUAL * by_chance * median_residual(square[index])
    rejections[index[(mean[index] ** 2).sum(axis=1) > limit]] = MAX_REJECTIONS
    return replace(landmarks, mean_residual=mean, mean_square=square, rejections=rejections)
