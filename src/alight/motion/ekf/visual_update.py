"""Visual update of the EKF: landmarks are measured directly, other tracks once when they end (MSCKF; M11-M17)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from alight.arrays import I64
from alight.geometry import Camera, Pose
from alight.motion.dynamics import MAX_RATE_AGE
from alight.motion.ekf.health import GateCounts
from alight.motion.ekf.keyframe_posterior import CloneWindow
from alight.motion.ekf.landmarks import MAX_REJECTIONS, Gate, initialise_landmarks, update_landmarks
from alight.motion.ekf.state import AT, FilterState
from alight.motion.observations import WindowObservations, observation_sigma, positions
from alight.motion.points import marginalise_points, unit_noise_rows
from alight.motion.robust import median_of, robust_pose_weights
from alight.records import Tracks
from alight.settings import FilterSettings

_MIN_POSES = 3  # that must have observed a track before it is used
_MIN_FREEDOM = 2  # degrees of freedom of a track that becomes a landmark: enough to check its observations
_MAX_LINEARISATION_ERROR = 0.04  # rad between a clone and its first estimate; above it Jacobians are no longer valid


class VisualUpdate:
    """Visual update of the state by the tracks of each exposure; it keeps the observations not used yet.

    Attributes are replaced, never changed in place, so that `copy.copy` gives an independent copy.
    """

    def __init__(self, camera: Camera, cams: Sequence[Pose], settings: FilterSettings) -> None:
        self._camera, self._cams, self._settings = camera, tuple(cams), settings
        self._gate = Gate(settings.gate)
        self._unused = WindowObservations.empty(len(cams))

    def reset(self, state: FilterState) -> None:
        """Drop all clones, landmarks and unused observations; the motion stays as it is."""
        state.drop(range(len(state.clones)), range(len(state.landmarks)))
        self._unused = WindowObservations.empty(len(self._cams))

    def window(self, state: FilterState, exposure_ns: int, frame_id: int) -> CloneWindow:
        """Return the clones with the unused observations, from which their posterior follows (M23).

        Without clones, as after a reset, the window has the present pose alone, as that of the exposure.
        """
        if not len(state.clones):
            state = state.copy()
            state.add_clone(exposure_ns)
        return CloneWindow.of(state, self._unused, self._cams, self._settings, frame_id)

    def on_exposure(self, state: FilterState, tracks: Tracks) -> GateCounts:
        """Take one exposure: use ended tracks, clone the pose, update landmarks, initialise new ones."""
        order = np.argsort(tracks.ids)
        ids, normalised = tracks.ids[order], tracks.normalised[order]
        sigma = observation_sigma(tracks, self._camera, self._settings)[order]
        self._relinearise_if_stale(state, tracks.t_ns)
        dropped = self._clone_to_drop(state)
        counts = self._update_from_lost_tracks(state, ids, dropped)
        lost = (state.landmarks.rejections >= MAX_REJECTIONS) | (positions(ids, state.landmarks.ids) < 0)
        state.drop(clones=dropped, landmarks=np.flatnonzero(lost))
        state.add_clone(tracks.t_ns)
        counts += update_landmarks(state, ids, normalised, sigma, self._cams, self._gate)
        seen = positions(ids, state.landmarks.ids)
        free = np.delete(np.arange(len(ids)), seen[seen >= 0])
        self._unused = self._unused.without_poses(dropped).with_pose(ids[free], normalised[free], sigma[free])
        return counts + self._initialise_landmarks(state)

    def _relinearise_if_stale(self, state: FilterState, t_ns: int) -> None:
        """Take Jacobians anew after a start with a wrong heading: between photos in place, else from scratch."""
        if not _is_stale(state):
            return
        if (t_ns - state.clones.stamps[-1]) * 1e-9 > MAX_RATE_AGE:
            state.relinearise()
        else:
            self.reset(state)

    def _clone_to_drop(self, state: FilterState) -> list[int]:
        """Return the index of the last clone if the one before is near, else of the oldest if there are too many."""
        p, baseline = state.clones.p, self._settings.clone_baseline
        if len(p) >= 3 and np.linalg.norm(p[-1] - p[-2]) < baseline * self._median_distance(state):
            return [len(p) - 1]
        return [0] if len(p) >= self._settings.clones else []

    @staticmethod
    def _median_distance(state: FilterState) -> float:
        """Median distance of the landmarks, metres; 0 without any."""
        if not len(state.landmarks):
            return 0.0
        off = state.landmarks.x - state.core[AT.pos]
        return float(np.sqrt(median_of((off * off).sum(axis=1))))

    def _update_from_lost_tracks(self, state: FilterState, ids: I64, dropped: list[int]) -> GateCounts:
        """Update the poses by tracks that are no longer observed, or whose first pose is about to be dropped."""
        unused = self._unused
        if not len(unused.ids):
            return GateCounts()
        ended = positions(ids, unused.ids) < 0
        if dropped == [0]:
            ended |= unused.observed[:, 0]
        self._unused = unused.select(~ended)
        return self._update_poses(state, unused.select(ended & (unused.observed.sum(axis=1) >= _MIN_POSES)))

    def _update_poses(self, state: FilterState, observations: WindowObservations) -> GateCounts:
        """Update the clones by tracks whose points are eliminated (MSCKF update)."""
        if not len(observations.ids):
            return GateCounts()
        columns = state.clone_rows
        constraint = marginalise_points(observations, state.clones, self._cams)
        well_known = constraint.well_known(state.core[AT.pos], self._settings.vague_share) & (constraint.freedom > 0)
        P, freedom = state.P[columns, columns], np.maximum(constraint.freedom, 1)
        distance = constraint.mahalanobis(P)
        passed = well_known & (distance <= self._gate.limits(freedom))
        if passed.any():
            weight, _ = robust_pose_weights(constraint, P, passed, np.zeros(len(P)))
            state.correct(*unit_noise_rows(*constraint.information(weight)), columns)
        return GateCounts(
            int(passed.sum()),
            int((well_known & ~passed).sum()),
            float(distance[passed].sum() / max(freedom[passed].sum(), 1)),
        )

    def _initialise_landmarks(self, state: FilterState) -> GateCounts:
        """Fill the free places for landmarks, longest tracks first."""
        s, unused = self._settings, self._unused
        free, length = s.points - len(state.landmarks), unused.observed.sum(axis=1)
        ready = np.flatnonzero((length >= _MIN_POSES) & unused.observed[:, -1])
        if free <= 0 or not len(ready):
            return GateCounts()
        ready = ready[np.argsort(-length[ready], kind="stable")][: 2 * free]
        constraint = marginalise_points(unused.select(ready), state.clones, self._cams)
        well_known = constraint.well_known(state.core[AT.pos], s.depth_share)
        tried = np.flatnonzero(well_known & (constraint.freedom >= _MIN_FREEDOM))[:free]
        if not len(tried):
            return GateCounts()
        chosen = ready[tried]
        rows = 2 * len(self._cams)
        passed = initialise_landmarks(state, unused.ids[chosen], constraint.select(tried), self._gate, rows)
        kept = np.ones(len(unused.ids), bool)
        kept[chosen[passed]] = False
        self._unused = unused.select(kept)
        return GateCounts(int(passed.sum()), int((~passed).sum()), 1.0)


def _is_stale(state: FilterState) -> bool:
    """True if the oldest clone has turned too far from the first estimate where its Jacobians are taken."""
    w = state.clones
    return len(w.R) > 0 and float((w.R[0] * w.first_R[0]).sum()) < 1.0 + 2.0 * np.cos(_MAX_LINEARISATION_ERROR)
