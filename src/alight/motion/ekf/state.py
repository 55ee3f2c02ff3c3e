"""The filter's state: nominal values, and one covariance over the errors of all of them (docs/method/motion.md, M7).

Errors live in the world: `R = exp(theta) R_hat`, `p = p_hat + dp`.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.linalg.blas import dtrsm

from alight.geometry import so3_exp
from alight.motion.rotations import so3_exps
from alight.records import F64

ATT = slice(0, 3)  # rad, body attitude
POS = slice(3, 6)  # m
VEL = slice(6, 9)  # m/s
GYRO = slice(9, 12)  # rad/s, gyro bias; without IMU the angular velocity of the body itself
ACC = slice(12, 15)  # m/s^2, accelerometer bias; without IMU unused
NAV_POS = slice(15, 18)  # m, slowly varying error of the GPS/INS position
NAV_ATT = slice(18, 21)  # rad, of its attitude, in the world
NAV_VEL = slice(21, 24)  # m/s, of its velocity
MOUNT = slice(24, 27)  # rad, rotation from the INS body to the body that the cameras are calibrated to
OFFSET = slice(27, 30)  # m, from the map, where the start is exact, to the world: what GPS/INS was off by then, negated
TIME = slice(30, 31)  # s that the cameras' stamps are ahead of the clock of GPS/INS and IMU
CORE = 31
_CHANGE = (1.0, 2.0)  # rad/s^2, m/s^2: accelerations that M27 leaves out
CLONE = 6  # (rotation, position)
POINT = 3


@dataclass(eq=False)
class Clone:
    """The pose of the rig at an earlier exposure, with the value at which Jacobians are taken (first estimate)."""

    t_ns: int  # its stamp
    R: F64  # (3, 3) world_from_rig
    p: F64  # (3,) m
    first_R: F64  # noqa: N815
    first_p: F64


@dataclass(eq=False)
class Point:
    """One landmark x_i of the paper's state."""

    id: int
    x: F64  # (3,) m, world
    first_x: F64
    misses: int = 0  # exposures in a row in which it was outside its gate
    lag: F64 = field(default_factory=lambda: np.zeros(1))  # mean of the last residuals, in their sigma
    noise: float = 0.0  # mean of their squares


@dataclass(eq=False)
class FilterState:
    """Core, clones and points; `P` follows that order."""

    t_ns: int
    R: F64  # (3, 3) world_from_body
    core: F64  # (31,) values of the slices; ATT stays zero, R holds the attitude
    P: F64  # (n, n)
    clones: list[Clone] = field(default_factory=list)
    points: list[Point] = field(default_factory=list)
    rate: F64 = field(default_factory=lambda: np.zeros(3))  # rad/s, body: how fast it turns now
    rate_variance: float = 0.0  # (rad/s)^2 of it

    def copy(self) -> FilterState:
        """A state that changes of this one leave as it is."""
        clones, points = [copy(c) for c in self.clones], [copy(x) for x in self.points]
        return replace(self, core=self.core.copy(), P=self.P.copy(), clones=clones, points=points)

    @property
    def rig(self) -> F64:
        """(3, 3) world_from_rig: the attitude with the mounting correction."""
        return self.R @ so3_exp(self.core[MOUNT])

    def in_world(self, covariance: F64, by_offset: F64) -> F64:
        """The (6, 6) second moment of what a pose (position, rotation) of the map is off by in the world.

        Args:
            covariance: (6, 6) of the pose in the map.
            by_offset: (6, 3) its covariance with the map's offset.
        """
        out = covariance.copy()
        out[:, :3] += by_offset
        out[:3, :] += by_offset.T
        out[:3, :3] += self.P[OFFSET, OFFSET] + np.outer(self.core[OFFSET], self.core[OFFSET])
        return out

    def clone_at(self, index: int) -> slice:
        """Rows of a clone."""
        start = CORE + CLONE * index
        return slice(start, start + CLONE)

    def point_at(self, index: int) -> slice:
        """Rows of a point."""
        start = CORE + CLONE * len(self.clones) + POINT * index
        return slice(start, start + POINT)

    @property
    def point_start(self) -> int:
        """Row of the first point."""
        return CORE + CLONE * len(self.clones)

    def clone_columns(self) -> NDArray[np.int64]:
        """Rows of all clones."""
        return np.arange(CORE, self.point_start)

    def relinearise(self) -> None:
        """Take Jacobians at the present estimates from here on."""
        for c in self.clones:
            c.first_R, c.first_p = c.R, c.p
        for x in self.points:
            x.first_x = x.x

    def add_clone(self, t_ns: int) -> None:
        """Copy the present rig pose into the state behind the other clones, as that of an exposure stamped `t_ns`.

        A stamp that is ahead by more than assumed means an earlier pose (M27).
        """
        J = np.zeros((CLONE, len(self.P)))
        J[0:3, ATT], J[0:3, MOUNT], J[3:6, POS] = np.eye(3), self.R, np.eye(3)
        J[0:3, TIME], J[3:6, TIME] = -(self.R @ self.rate)[:, None], -self.core[VEL][:, None]
        at = CORE + CLONE * len(self.clones)
        self.P = _insert(self.P, at, J @ self.P, J @ self.P @ J.T + self._unknown_time())
        R, p = self.rig, self.core[POS].copy()
        self.clones.append(Clone(t_ns, R, p, R, p))

    def _unknown_time(self) -> F64:
        """(6, 6) what M27 misses of a pose while the time is unknown: errors of the rates, and their change.

        Without it a gyro's noise (7 mrad/s a sample) passes for the vehicle's, and a wrong offset is believed.
        """
        time, velocity = float(self.P[TIME, TIME][0, 0]), float(self.P[VEL, VEL].diagonal().max())
        turn = time * self.rate_variance + (0.5 * time * _CHANGE[0]) ** 2
        way = time * velocity + (0.5 * time * _CHANGE[1]) ** 2
        return np.diag(np.repeat([turn, way], 3))

    def add_points(self, points: Sequence[Point], cross: F64, covariance: F64) -> None:
        """Append m points: `cross` (3m, n) is their covariance with the state, `covariance` (3m, 3m) their own."""
        self.P = _insert(self.P, len(self.P), cross, covariance)
        self.points.extend(points)

    def drop(self, clones: Sequence[int] = (), points: Sequence[int] = ()) -> None:
        """Marginalise clones and points by index."""
        rows = [np.arange(len(self.P))[self.clone_at(i)] for i in clones]
        rows += [np.arange(len(self.P))[self.point_at(i)] for i in points]
        if rows:
            keep = np.ones(len(self.P), bool)
            keep[np.concatenate(rows)] = False
            self.P = np.ascontiguousarray(self.P[np.ix_(keep, keep)])
        self.clones = [c for i, c in enumerate(self.clones) if i not in set(clones)]
        self.points = [x for i, x in enumerate(self.points) if i not in set(points)]

    def correct(self, residual: F64, H: F64, columns: NDArray[np.int64]) -> None:
        """Correct by a measurement of unit noise, `residual = H error[columns] + noise`, H (m, len(columns))."""
        if not len(residual):
            return
        HP = H @ self.P[columns]
        S = HP[:, columns] @ H.T
        S[np.diag_indices(len(S))] += 1.0
        L = np.linalg.cholesky(S)
        half = dtrsm(1.0, L.T, HP.T, side=1, overwrite_b=1)  # (S^-1/2 H P)'
        self.P -= half @ half.T  # symmetric by construction
        self._correct(half @ solve_triangular(L, residual, lower=True, check_finite=False))

    def update(self, residual: F64, H: F64, noise: F64) -> None:
        """Correct by a measurement `residual = H error + noise` over all unknowns; `noise` (m,) variances."""
        used, unit = np.flatnonzero(H.any(axis=0)), 1.0 / np.sqrt(noise)  # a row touches few of the unknowns
        self.correct(residual * unit, H[:, used] * unit[:, None], used)

    def _correct(self, error: F64) -> None:
        self.R = so3_exp(error[ATT]) @ self.R
        self.core[3:] += error[3:CORE]
        e = error[CORE : self.point_start].reshape(-1, CLONE)
        for c, turn, way in zip(self.clones, so3_exps(e[:, :3]), e[:, 3:], strict=True):
            c.R, c.p = turn @ c.R, c.p + way
        for q, d in zip(self.points, error[self.point_start :].reshape(-1, POINT), strict=True):
            q.x = q.x + d


def _insert(P: F64, at: int, cross: F64, own: F64) -> F64:
    k, n = len(own), len(P)
    out = np.empty((n + k, n + k))
    old = np.r_[0:at, at + k : n + k]
    out[np.ix_(old, old)] = P
    out[at : at + k, old], out[np.ix_(old, np.arange(at, at + k))] = cross, cross.T
    out[at : at + k, at : at + k] = own
    return out
