"""Points of the state: measured in every exposure, and taken up from the sub-filter once well known (M11-M13, M17)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from alight.geometry import Pose
from alight.motion.state import State
from alight.motion.state import Point as StatePoint
from alight.motion.vision import Ray, depth, jacobians, project, triangulate
from alight.records import F64


@dataclass(frozen=True, eq=False)
class Sight:
    """What the cameras saw of one feature at the exposure of one clone."""

    t_ns: int  # of the clone
    normalised: F64  # (cameras, 2), NaN = not seen


class Gate:
    """Mahalanobis gate at one probability for any number of rows."""

    def __init__(self, probability: float) -> None:
        self._probability = probability
        self._limits: dict[int, float] = {}

    def passes(self, residual: F64, S: F64) -> bool:
        """Whether a residual with covariance `S` is inside."""
        m = len(residual)
        limit = self._limits.setdefault(m, float(chi2.ppf(self._probability, m)))
        return bool(residual @ np.linalg.solve(S, residual) <= limit)


def point_rows(state: State, clone: int, index: int, sight: F64, cams: tuple[Pose, ...]) -> tuple[F64, F64, F64] | None:
    """Residual (m,), Jacobian (m, 6) by the clone and (m, 3) by the point, first estimates in the Jacobians (M11)."""
    c, x = state.clones[clone], state.points[index]
    seen = [i for i in range(len(cams)) if np.isfinite(sight[i, 0]) and depth(c.R, c.p, cams[i], x.x) > 0.1]
    if not seen:
        return None
    residual = np.concatenate([sight[i] - project(c.R, c.p, cams[i], x.x) for i in seen])
    pairs = [jacobians(c.first_R, c.first_p, cams[i], x.first_x) for i in seen]
    return residual, np.vstack([a for a, _ in pairs]), np.vstack([b for _, b in pairs])


def measure(
    state: State, clone: int, sights: dict[int, F64], cams: tuple[Pose, ...], sigma: float, gate: Gate
) -> tuple[int, int]:
    """Correct the state by the points seen at one clone; return how many passed the gate, and how many were tried."""
    at, rows, tried = state.clone_at(clone), [], 0
    for i, point in enumerate(state.points):
        found = point_rows(state, clone, i, sights[point.id], cams) if point.id in sights else None
        if found is None:
            continue
        tried += 1
        r, Hc, Hx = found
        where = np.r_[at, state.point_at(i)]
        H = np.hstack([Hc, Hx])
        S = H @ state.P[np.ix_(where, where)] @ H.T + np.eye(len(r)) * sigma**2
        passed = gate.passes(r, S)
        point.misses = 0 if passed else point.misses + 1
        if passed:
            rows.append((r, H, where))
    if rows:
        _correct(state, rows, sigma)
    return len(rows), tried


def _correct(state: State, rows: list[tuple[F64, F64, F64]], sigma: float) -> None:
    m = sum(len(r) for r, _, _ in rows)
    residual, H, k = np.empty(m), np.zeros((m, len(state.P))), 0
    for r, h, where in rows:
        residual[k : k + len(r)] = r
        H[k : k + len(r), where] = h
        k += len(r)
    state.update(residual, H, np.full(m, sigma**2))


def take_up(
    state: State, id_: int, history: list[Sight], cams: tuple[Pose, ...], sigma: float, share: float, gate: Gate
) -> bool:
    """Move a feature from the sub-filter into the state if its depth is known to `share` and its sights agree (M17).

    Delayed initialisation: the rows of the sights are rotated so that three determine the point and the others only
    the clones. The others are a measurement of the poses, used and gated; the three give the point with its exact
    covariance with everything else. No sight is used twice.
    """
    index = {c.t_ns: i for i, c in enumerate(state.clones)}
    sights = [(index[s.t_ns], cam, s.normalised[cam]) for s in history if s.t_ns in index for cam in range(len(cams))]
    sights = [s for s in sights if np.isfinite(s[2][0])]
    clones = [state.clones[i] for i, _, _ in sights]
    found = (
        triangulate([Ray(c.R, c.p, cams[cam], z) for c, (_, cam, z) in zip(clones, sights, strict=True)], sigma)
        if len(sights) > 2
        else None
    )
    if found is None:
        return False
    x, covariance = found
    ray = x - clones[-1].p
    if np.sqrt(np.linalg.eigvalsh(covariance)[-1]) > share * np.linalg.norm(ray):
        return False
    Hc, Hx = np.zeros((2 * len(sights), len(state.P))), np.zeros((2 * len(sights), 3))
    r = np.empty(2 * len(sights))
    for k, ((i, cam, z), c) in enumerate(zip(sights, clones, strict=True)):
        r[2 * k : 2 * k + 2] = z - project(c.R, c.p, cams[cam], x)
        Hc[2 * k : 2 * k + 2, state.clone_at(i)], Hx[2 * k : 2 * k + 2] = jacobians(c.first_R, c.first_p, cams[cam], x)
    return _initialise(state, id_, x, (r, Hc, Hx), sigma, gate)


def _initialise(state: State, id_: int, x: F64, rows: tuple[F64, F64, F64], sigma: float, gate: Gate) -> bool:
    r, Hc, Hx = rows
    Q, R = np.linalg.qr(Hx, mode="complete")
    r, Hc, T = Q.T @ r, Q.T @ Hc, np.linalg.inv(R[:3])
    S = Hc[3:] @ state.P @ Hc[3:].T + np.eye(len(r) - 3) * sigma**2
    if not gate.passes(r[3:], S):
        return False
    cross = -T @ Hc[:3] @ state.P
    own = T @ (Hc[:3] @ state.P @ Hc[:3].T + np.eye(3) * sigma**2) @ T.T
    x = x + T @ r[:3]
    state.add_point(StatePoint(id_, x, x), cross, own)
    state.update(r[3:], np.hstack([Hc[3:], np.zeros((len(r) - 3, 3))]), np.full(len(r) - 3, sigma**2))
    return True
