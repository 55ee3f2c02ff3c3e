"""What an exposure does to the state: points held are measured, the others wait until they are used up (M11-M17)."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy

import numpy as np
from numpy.typing import NDArray

from alight.geometry import Camera, Pose, so3_log
from alight.motion.dynamics import LONG
from alight.motion.ekf.health import Votes
from alight.motion.ekf.keyframe_posterior import RefinedPoses, refine
from alight.motion.ekf.landmarks import MISSES, Gate, initialise_landmarks, update_landmarks
from alight.motion.ekf.observations import (
    WindowObservations,
    WindowPoses,
    as_rows,
    marginalise_points,
    triangulate_window,
)
from alight.motion.ekf.state import POS, FilterState
from alight.motion.projection import observation_sigma
from alight.motion.robust import agree_on_poses
from alight.records import F64, Tracks
from alight.settings import FilterSettings

Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]

_LEAST_POSES = 3  # that must have seen a feature for its sights to measure them
_SPARE = 2  # rows beyond the three that make a point, to tell whether its sights agree
_STALE = 0.04  # rad between a pose held and its first estimate from which Jacobians are no longer good


class VisualUpdate:
    """The sub-filter: sights that the state has not used yet, and how they come to be used."""

    def __init__(self, camera: Camera, cams: Sequence[Pose], settings: FilterSettings) -> None:
        self._camera, self._cams, self._settings = camera, tuple(cams), settings
        self._gate = Gate(settings.gate)
        self._waiting = WindowObservations.none(len(cams))

    def forget(self, state: FilterState) -> None:
        """Start the pictures anew: no point, no pose is held; the motion stays as it is."""
        state.drop(range(len(state.clones)), range(len(state.points)))
        self._waiting = WindowObservations.none(len(self._cams))

    def copy(self) -> VisualUpdate:
        """One that changes of this one leave as it is."""
        return copy(self)  # what it holds is replaced, never changed

    def ring(self, state: FilterState) -> RefinedPoses:
        """The poses held, refined with the sights that wait."""
        return refine(state, self._waiting, self._cams, self._settings)

    def see(self, state: FilterState, tracks: Tracks) -> Votes:
        """One exposure: use up what ended, measure the points held, take up what became well known."""
        order = np.argsort(tracks.ids)
        ids, seen = tracks.ids[order], tracks.normalised[order]
        sigma = observation_sigma(tracks, self._camera, self._settings)[order]
        if _stale(state):
            if (tracks.t_ns - state.clones[-1].t_ns) * 1e-9 > LONG:
                state.relinearise()
            else:
                self.forget(state)
        gone = self._superfluous(state)
        votes = self._use_up(state, ids, gone)
        lost = [i for i, x in enumerate(state.points) if x.misses >= MISSES or not _contains(ids, x.id)]
        state.drop(clones=gone, points=lost)
        state.add_clone(tracks.t_ns)
        votes += update_landmarks(state, ids, seen, sigma, self._cams, self._gate)
        new = ~np.isin(ids, [x.id for x in state.points])
        self._waiting = self._waiting.without_poses(gone).at_next_pose(ids[new], seen[new], sigma[new])
        return votes + self._take_up(state)

    def _superfluous(self, state: FilterState) -> list[int]:
        """The last clone if it is no keyframe; else the oldest when there are too many."""
        c = state.clones
        if len(c) >= 3 and np.linalg.norm(c[-1].p - c[-2].p) < self._settings.keyframe_baseline * self._distance(state):
            return [len(c) - 1]
        return [0] if len(c) >= self._settings.clones else []

    @staticmethod
    def _distance(state: FilterState) -> float:
        if not state.points:
            return 0.0
        return float(np.median(np.linalg.norm(np.array([x.x for x in state.points]) - state.core[POS], axis=1)))

    def _use_up(self, state: FilterState, ids: Ints, gone: list[int]) -> Votes:
        """Measure the poses by the features that are seen no more, or whose first pose is about to be forgotten."""
        w = self._waiting
        if not len(w.ids):
            return Votes()
        ended = ~np.isin(w.ids, ids)
        if gone == [0]:
            ended |= w.where[:, 0]
        self._waiting = w.rows(~ended)
        return self._absorb(state, w.rows(ended & (w.where.sum(axis=1) >= _LEAST_POSES)))

    def _absorb(self, state: FilterState, sights: WindowObservations) -> Votes:
        if not len(sights.ids):
            return Votes()
        poses, columns = WindowPoses.of(state.clones), state.clone_columns()
        x = triangulate_window(sights, poses, self._cams)
        found = marginalise_points(sights, poses, self._cams, x)
        known = self._known(found.point_covariance, x, state, self._settings.vague_share) & (found.freedom > 0)
        P, freedom = state.P[np.ix_(columns, columns)], np.maximum(found.freedom, 1)
        distance = found.distances(P)
        inside = known & (distance <= self._gate.limits(freedom))
        if inside.any():
            weight, _ = agree_on_poses(found, P, inside, np.zeros(len(P)))
            state.correct(*as_rows(*found.information(weight)), columns)
        return Votes(
            int(inside.sum()),
            int((known & ~inside).sum()),
            float(distance[inside].sum() / max(freedom[inside].sum(), 1)),
        )

    @staticmethod
    def _known(covariance: F64, x: F64, state: FilterState, share: float) -> Mask:
        distance = np.linalg.norm(x - state.core[POS], axis=1)
        return np.asarray(np.sqrt(np.linalg.eigvalsh(covariance)[:, -1]) < share * distance)

    def _take_up(self, state: FilterState) -> Votes:
        """Fill the free places, longest seen features first."""
        s, w = self._settings, self._waiting
        free, poses = s.points - len(state.points), w.where.sum(axis=1)
        ready = np.flatnonzero((poses >= _LEAST_POSES) & w.where[:, -1])
        if free <= 0 or not len(ready):
            return Votes()
        ready = ready[np.argsort(-poses[ready], kind="stable")][: 2 * free]
        held = WindowPoses.of(state.clones)
        x = triangulate_window(w.rows(ready), held, self._cams)
        found = marginalise_points(w.rows(ready), held, self._cams, x)
        known = self._known(found.point_covariance, x, state, s.depth_share) & (found.freedom >= _SPARE)
        tried = np.flatnonzero(known)[:free]
        if not len(tried):
            return Votes()
        chosen = ready[tried]
        passed = initialise_landmarks(state, w.ids[chosen], x[tried], found.rows(tried), self._gate)
        self._waiting = w.rows(np.setdiff1d(np.arange(len(w.ids)), chosen[passed]))
        return Votes(int(passed.sum()), int((~passed).sum()), 1.0)


def _contains(ids: Ints, id_: int) -> bool:
    at = int(np.searchsorted(ids, id_))
    return at < len(ids) and int(ids[at]) == id_


def _stale(state: FilterState) -> bool:
    """Whether a pose held has been turned far from where its Jacobians are taken: a start with a wrong heading."""
    return any(float(np.linalg.norm(so3_log(c.R @ c.first_R.T))) > _STALE for c in state.clones[:1])
