"""Points of the state: measured in every exposure, and taken up from the window once well known (M11-M13, M17)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from alight.geometry import Pose
from alight.motion.ekf.health import Votes
from alight.motion.ekf.observations import PoseConstraint, as_rows
from alight.motion.ekf.state import Clone, FilterState, Point
from alight.motion.projection import depths, jacobians, project
from alight.motion.robust import median_residual, robust_weights
from alight.records import F64

Mask = NDArray[np.bool_]
Ints = NDArray[np.int64]

MISSES = 3  # exposures in a row outside its gate after which a point is dropped: it moves
_RECENT = 0.3  # of a point's lag that the last exposure makes out
_LAG = 9.0  # times what chance makes of a squared lag; points that lag more move
_STEADY = 2.0  # times the usual misfit; features that miss more do not become points


class Gate:
    """Mahalanobis gate at one probability for any number of rows."""

    def __init__(self, probability: float) -> None:
        self._probability = probability
        self._limits = np.zeros(1)

    def limits(self, rows: Ints) -> F64:
        """The largest squared distances that pass (chi-square)."""
        most = int(rows.max(initial=0))
        if most >= len(self._limits):
            self._limits = np.append(0.0, chi2.ppf(self._probability, np.arange(1, most + 16)))
        return np.asarray(self._limits[rows])

    def limit(self, rows: int) -> float:
        """The largest squared distance that passes (chi-square)."""
        return float(self.limits(np.array([rows]))[0])

    def passes(self, residual: F64, S: F64) -> bool:
        """Whether a residual with covariance `S` is inside."""
        return bool(residual @ np.linalg.solve(S, residual) <= self.limit(len(residual)))


@dataclass(frozen=True, eq=False)
class PointRows:
    """Linearised sights of N points from one clone, 2 rows a camera, in units of their sigma; unseen rows are zero."""

    residual: F64  # (N, m)
    by_clone: F64  # (N, m, 6)
    by_point: F64  # (N, m, 3)
    seen: Mask  # (N, m)

    def only(self, which: Mask) -> PointRows:
        """Those of some points."""
        return PointRows(self.residual[which], self.by_clone[which], self.by_point[which], self.seen[which])

    def times(self, unit: F64) -> PointRows:
        """All rows of each point times its (N,) unit."""
        return PointRows(
            self.residual * unit[:, None],
            self.by_clone * unit[:, None, None],
            self.by_point * unit[:, None, None],
            self.seen,
        )


def point_rows(clone: Clone, x: F64, first_x: F64, sights: F64, cams: Sequence[Pose], sigma: F64) -> PointRows:
    """Residuals at the estimates, Jacobians at the first ones (M11), of (N, 3) points seen at (N, cameras, 2).

    Args:
        sigma: (N,) of a normalised coordinate.
    """
    n, m = len(x), 2 * len(cams)
    residual, seen = np.zeros((n, m)), np.zeros((n, m), bool)
    by_clone, by_point = np.zeros((n, m, 6)), np.zeros((n, m, 3))
    for i, cam in enumerate(cams):
        rows = slice(2 * i, 2 * i + 2)
        ok = np.isfinite(sights[:, i, 0]) & (depths(clone.R, clone.p, cam, x) > 0.1)
        ok &= depths(clone.first_R, clone.first_p, cam, first_x) > 0.1
        residual[ok, rows] = sights[ok, i] - project(clone.R, clone.p, cam, x[ok])
        by_clone[ok, rows], by_point[ok, rows] = jacobians(clone.first_R, clone.first_p, cam, first_x[ok])
        seen[ok, rows] = True
    unit = 1.0 / sigma[:, None]
    return PointRows(residual * unit, by_clone * unit[..., None], by_point * unit[..., None], seen)


def update_landmarks(state: FilterState, ids: Ints, sights: F64, sigma: F64, cams: Sequence[Pose], gate: Gate) -> Votes:
    """Correct the state by the points seen at its last clone.

    Args:
        ids, sights, sigma: (N,) sorted, (N, cameras, 2), (N,) what was seen.
    """
    held = np.array([x.id for x in state.points], dtype=np.int64)
    index, at = _common(held, ids)
    if not len(index):
        return Votes()
    points, clone = [state.points[i] for i in index], len(state.clones) - 1
    x, first = np.array([q.x for q in points]), np.array([q.first_x for q in points])
    rows = point_rows(state.clones[clone], x, first, sights[at], cams, sigma[at])
    tried, distance = np.asarray(rows.seen.any(axis=1)), _distances(state, clone, index, rows)
    count = rows.seen.sum(axis=1)
    passed = tried & (distance <= gate.limits(count))
    for q, bad in zip(points, tried & ~passed, strict=True):
        q.misses = q.misses + 1 if bad else 0
    if passed.any():
        misfit = distance / np.maximum(count, 1)
        weight = robust_weights(misfit, median_residual(misfit[tried]))
        count_misses([q for q, ok in zip(points, tried, strict=True) if ok], rows.residual[tried])
        _correct(state, clone, index[passed], rows.times(np.sqrt(weight)).only(passed))
    mean = float(distance[passed].sum() / max(count[passed].sum(), 1))
    return Votes(int(passed.sum()), int((tried & ~passed).sum()), mean)


def count_misses(points: Sequence[Point], residual: F64) -> None:
    """Find points that lag behind what is seen of them, exposure after exposure: they move, slowly."""
    for q, r in zip(points, residual, strict=True):
        q.lag = q.lag + _RECENT * (r - q.lag)
        q.noise = q.noise + _RECENT * (float(r @ r) - q.noise)
    limit = _LAG * _RECENT / (2.0 - _RECENT) * median_residual(np.array([q.noise for q in points]))
    for q in points:
        q.misses = MISSES if q.lag @ q.lag > limit else q.misses


def _common(held: Ints, ids: Ints) -> tuple[Ints, Ints]:
    """Where the points held are among sorted ids: (index of the point, index in ids)."""
    at = np.searchsorted(ids, held)
    there = (at < len(ids)) & (ids[np.minimum(at, len(ids) - 1)] == held) if len(ids) else np.zeros(len(held), bool)
    return np.flatnonzero(there), at[there]


def _distances(state: FilterState, clone: int, index: Ints, rows: PointRows) -> F64:
    """Squared Mahalanobis distance of every point by the covariance of its own rows."""
    at = np.arange(len(state.P))[state.clone_at(clone)]
    own = state.point_start + 3 * index[:, None] + np.arange(3)  # (N, 3)
    where = np.hstack([np.broadcast_to(at, (len(index), len(at))), own])  # (N, 9)
    H = np.concatenate([rows.by_clone, rows.by_point], axis=2)
    S = H @ state.P[where[:, :, None], where[:, None, :]] @ H.transpose(0, 2, 1)
    S += np.eye(S.shape[1])
    return np.asarray((rows.residual * np.linalg.solve(S, rows.residual[..., None])[..., 0]).sum(axis=1))


def _correct(state: FilterState, clone: int, index: Ints, rows: PointRows) -> None:
    n, m = rows.residual.shape
    columns = np.concatenate(
        [
            np.arange(len(state.P))[state.clone_at(clone)],
            (state.point_start + 3 * index[:, None] + np.arange(3)).ravel(),
        ]
    )
    H = np.zeros((n, m, len(columns)))
    H[:, :, :6] = rows.by_clone
    k = np.arange(n)
    for j in range(3):
        H[k, :, 6 + 3 * k + j] = rows.by_point[:, :, j]
    seen = rows.seen.ravel()
    state.correct(rows.residual.ravel()[seen], H.reshape(n * m, -1)[seen], columns)


def initialise_landmarks(state: FilterState, ids: Ints, x: F64, found: PoseConstraint, gate: Gate) -> Mask:
    """Move N features from the window into the state, those whose sights agree (M17); (N,) which of them.

    Delayed initialisation: what the sights say is split in two. The part that no place of the point can change is a
    measurement of the poses, gated and used; the other gives the point with its exact covariance with everything. No
    sight is used twice.
    """
    columns = state.clone_columns()
    P = state.P[columns]
    passed = found.distances(P[:, columns]) <= gate.limits(found.freedom)
    misfit = found.misfit / np.maximum(found.freedom, 1)
    passed &= misfit <= _STEADY * median_residual(misfit)
    if not passed.any():
        return passed
    found, x = found.rows(passed), x[passed]
    G = found.by_poses().reshape(-1, len(columns))  # negated
    own = G @ P[:, columns] @ G.T
    for i, covariance in enumerate(found.point_covariance):
        own[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] += covariance
    best = x + found.step
    points = [Point(int(k), best[i], x[i]) for i, k in enumerate(ids[passed])]  # x is where the Jacobians were taken
    state.add_points(points, -G @ P, own)
    state.correct(*as_rows(*found.information(np.ones(len(x)))), columns)
    return passed
