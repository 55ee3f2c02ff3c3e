"""Points of the state: measured in every exposure, and taken up from the sub-filter once well known (M11-M13, M17)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from alight.geometry import Pose
from alight.motion.state import Clone, Point, State
from alight.motion.vision import Ray, depths, jacobians, project, triangulate
from alight.records import F64


@dataclass(frozen=True, eq=False)
class Sight:
    """What the cameras saw of one feature at the exposure of one clone."""

    t_ns: int  # of the clone
    normalised: F64  # (cameras, 2), NaN = not seen
    sigma: float  # of a normalised coordinate


class Gate:
    """Mahalanobis gate at one probability for any number of rows."""

    def __init__(self, probability: float) -> None:
        self._probability = probability
        self._limits: dict[int, float] = {0: 0.0}

    def limit(self, rows: int) -> float:
        """The largest squared distance that passes (chi-square)."""
        if rows not in self._limits:
            self._limits[rows] = float(chi2.ppf(self._probability, rows))
        return self._limits[rows]

    def passes(self, residual: F64, S: F64) -> bool:
        """Whether a residual with covariance `S` is inside."""
        return bool(residual @ np.linalg.solve(S, residual) <= self.limit(len(residual)))


@dataclass(frozen=True, eq=False)
class Rows:
    """Linearised sights of N points from one clone, 2 rows a camera, in units of their sigma; unseen rows are zero."""

    residual: F64  # (N, m)
    by_clone: F64  # (N, m, 6)
    by_point: F64  # (N, m, 3)
    seen: NDArray[np.bool_]  # (N, m)


def point_rows(clone: Clone, x: F64, first_x: F64, sights: F64, cams: tuple[Pose, ...], sigma: F64) -> Rows:
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
    return Rows(residual * unit, by_clone * unit[..., None], by_point * unit[..., None], seen)


def measure(state: State, clone: int, sights: dict[int, Sight], cams: tuple[Pose, ...], gate: Gate) -> tuple[int, int]:
    """Correct the state by the points seen at one clone; return how many passed the gate, and how many were tried."""
    index = np.array([i for i, x in enumerate(state.points) if x.id in sights], dtype=int)
    if not len(index):
        return 0, 0
    points = [state.points[i] for i in index]
    x, first = np.array([q.x for q in points]), np.array([q.first_x for q in points])
    now = [sights[q.id] for q in points]
    seen, sigma = np.array([s.normalised for s in now]), np.array([s.sigma for s in now])
    rows = point_rows(state.clones[clone], x, first, seen, cams, sigma)
    tried = rows.seen.any(axis=1)
    passed = tried & _inside(state, clone, index, rows, gate)
    for q, bad in zip(points, tried & ~passed, strict=True):
        q.misses = q.misses + 1 if bad else 0
    if passed.any():
        _correct(state, clone, index[passed], _only(rows, passed))
    return int(passed.sum()), int(tried.sum())


def _only(rows: Rows, which: NDArray[np.bool_]) -> Rows:
    return Rows(rows.residual[which], rows.by_clone[which], rows.by_point[which], rows.seen[which])


def _inside(state: State, clone: int, index: NDArray[np.int64], rows: Rows, gate: Gate) -> NDArray[np.bool_]:
    """Gate every point by the covariance of its own rows."""
    at = np.arange(len(state.P))[state.clone_at(clone)]
    own = np.array([np.arange(len(state.P))[state.point_at(i)] for i in index])  # (N, 3)
    where = np.hstack([np.broadcast_to(at, (len(index), len(at))), own])  # (N, 9)
    H = np.concatenate([rows.by_clone, rows.by_point], axis=2)
    S = H @ state.P[where[:, :, None], where[:, None, :]] @ H.transpose(0, 2, 1)
    S += np.eye(S.shape[1])
    distance = np.einsum("nm,nm->n", rows.residual, np.linalg.solve(S, rows.residual[..., None])[..., 0])
    return np.asarray(distance <= np.array([gate.limit(int(k)) for k in rows.seen.sum(axis=1)]))


def _correct(state: State, clone: int, index: NDArray[np.int64], rows: Rows) -> None:
    n, m = rows.residual.shape
    H = np.zeros((n, m, len(state.P)))
    H[:, :, state.clone_at(clone)] = rows.by_clone
    for k, i in enumerate(index):
        H[k, :, state.point_at(i)] = rows.by_point[k]
    seen = rows.seen.ravel()
    state.update(rows.residual.ravel()[seen], H.reshape(n * m, -1)[seen], np.ones(int(seen.sum())))


def take_up(state: State, id_: int, history: list[Sight], cams: tuple[Pose, ...], share: float, gate: Gate) -> bool:
    """Move a feature from the sub-filter into the state if its depth is known to `share` and its sights agree (M17).

    Delayed initialisation: the rows of the sights are rotated so that three determine the point and the others only
    the clones. The others are a measurement of the poses, used and gated; the three give the point with its exact
    covariance with everything else. No sight is used twice.
    """
    sights = _at_clones(state, history)
    rays = [Ray(c.R, c.p, cams[cam], s.normalised[cam]) for _, c, cam, s in sights]
    found = triangulate(rays, history[-1].sigma) if len(rays) > 2 else None
    if found is None:
        return False
    x, covariance = found
    if np.sqrt(np.linalg.eigvalsh(covariance)[-1]) > share * np.linalg.norm(x - rays[-1].p):
        return False
    Hc, Hx = np.zeros((2 * len(sights), len(state.P))), np.zeros((2 * len(sights), 3))
    r = np.empty(2 * len(sights))
    for k, (i, c, cam, s) in enumerate(sights):
        rows = slice(2 * k, 2 * k + 2)
        by_clone, by_point = jacobians(c.first_R, c.first_p, cams[cam], x)
        r[rows] = (s.normalised[cam] - project(c.R, c.p, cams[cam], x)) / s.sigma
        Hc[rows, state.clone_at(i)], Hx[rows] = by_clone / s.sigma, by_point / s.sigma
    return _initialise(state, id_, x, (r, Hc, Hx), gate)


def _at_clones(state: State, history: list[Sight]) -> list[tuple[int, Clone, int, Sight]]:
    """The sights whose clone is still there: its index, the clone, the camera."""
    index = {c.t_ns: i for i, c in enumerate(state.clones)}
    return [
        (index[s.t_ns], state.clones[index[s.t_ns]], cam, s)
        for s in history
        if s.t_ns in index
        for cam, z in enumerate(s.normalised)
        if np.isfinite(z[0])
    ]


def _initialise(state: State, id_: int, x: F64, rows: tuple[F64, F64, F64], gate: Gate) -> bool:
    r, Hc, Hx = rows
    Q, R = np.linalg.qr(Hx, mode="complete")
    r, Hc, T = Q.T @ r, Q.T @ Hc, np.linalg.inv(R[:3])
    S = Hc[3:] @ state.P @ Hc[3:].T + np.eye(len(r) - 3)
    if not gate.passes(r[3:], S):
        return False
    cross = -T @ Hc[:3] @ state.P
    own = T @ (Hc[:3] @ state.P @ Hc[:3].T + np.eye(3)) @ T.T
    x = x + T @ r[:3]
    state.add_point(Point(id_, x, x), cross, own)
    state.update(r[3:], np.hstack([Hc[3:], np.zeros((len(r) - 3, 3))]), np.ones(len(r) - 3))
    return True
