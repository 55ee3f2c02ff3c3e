"""State of the filter: nominal values, and the covariance of their errors (docs/method/motion.md, M7).

Attitude errors are in the world frame: `R = exp(theta) R_hat`, `p = p_hat + dp`.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.linalg.blas import dtrsm

from alight.arrays import F64
from alight.geometry import so3_exp
from alight.motion.observations import WindowPoses

ATT = slice(0, 3)  # rad, body attitude
POS = slice(3, 6)  # m
VEL = slice(6, 9)  # m/s
GYRO = slice(9, 12)  # rad/s, gyro bias; without IMU the angular velocity of the body itself
ACC = slice(12, 15)  # m/s^2, accelerometer bias; without IMU unused
MOTION = slice(0, 15)  # all of the above: what the motion model carries on
NAV_POS = slice(15, 18)  # m, slowly varying error of the GPS/INS position
NAV_ATT = slice(18, 21)  # rad, of its attitude, in the world
NAV_VEL = slice(21, 24)  # m/s, of its velocity
NAV = slice(15, 24)  # these three
MOUNT = slice(24, 27)  # rad, rotation from the INS body to the body that the cameras are calibrated to
OFFSET = slice(27, 30)  # m, from the map frame, where the start is exact, to the world: minus the first GPS error
TIME = slice(30, 31)  # s that the cameras' stamps are ahead of the clock of GPS/INS and IMU
CORE = 31
CLONE = 6  # errors of a clone: (rotation, position)
LANDMARK = 3
_UNMODELLED = (1.0, 2.0)  # rad/s^2, m/s^2: accelerations that M27 leaves out


@dataclass(eq=False)
class Clone:
    """The pose of the rig at an earlier exposure, and its first estimate, where Jacobians are taken."""

    t_ns: int  # stamp of the exposure
    R: F64  # (3, 3) world_from_rig
    p: F64  # (3,) m
    first_R: F64  # noqa: N815
    first_p: F64


@dataclass(eq=False)
class Landmark:
    """One point x_i of the paper's state."""

    id: int
    x: F64  # (3,) m, world
    first_x: F64
    rejections: int = 0  # exposures in a row in which it failed its gate
    mean_residual: F64 = field(default_factory=lambda: np.zeros(1))  # of the last exposures, in sigmas
    mean_square: float = 0.0  # of the same residuals


@dataclass(eq=False)
class FilterState:
    """Core, clones and landmarks; `P` follows that order."""

    t_ns: int
    R: F64  # (3, 3) world_from_body
    core: F64  # (31,) values of the slices; ATT stays zero, R holds the attitude
    P: F64  # (n, n)
    clones: list[Clone] = field(default_factory=list)
    landmarks: list[Landmark] = field(default_factory=list)
    rate: F64 = field(default_factory=lambda: np.zeros(3))  # rad/s, angular velocity in the body frame
    rate_variance: float = 0.0  # (rad/s)^2

    def copy(self) -> FilterState:
        """Return an independent copy."""
        clones, landmarks = [copy(c) for c in self.clones], [copy(x) for x in self.landmarks]
        return replace(self, core=self.core.copy(), P=self.P.copy(), clones=clones, landmarks=landmarks)

    @property
    def rig(self) -> F64:
        """(3, 3) world_from_rig: the attitude with the mounting correction."""
        return self.R @ so3_exp(self.core[MOUNT])

    def clone_slice(self, index: int) -> slice:
        """Rows of a clone in `P`."""
        start = CORE + CLONE * index
        return slice(start, start + CLONE)

    def landmark_slice(self, index: int) -> slice:
        """Rows of a landmark in `P`."""
        start = self.landmark_start + LANDMARK * index
        return slice(start, start + LANDMARK)

    @property
    def landmark_start(self) -> int:
        """Row of the first landmark in `P`."""
        return CORE + CLONE * len(self.clones)

    def clone_rows(self) -> NDArray[np.int64]:
        """Rows of all clones in `P`."""
        return np.arange(CORE, self.landmark_start)

    def landmark_rows(self, index: NDArray[np.int64]) -> NDArray[np.int64]:
        """(N, 3) rows in `P` of (N,) landmarks."""
        return self.landmark_start + LANDMARK * index[:, None] + np.arange(LANDMARK)

    def window_poses(self) -> WindowPoses:
        """The poses of the clones."""
        c = self.clones
        return WindowPoses(
            np.array([x.R for x in c]),
            np.array([x.p for x in c]),
            np.array([x.first_R for x in c]),
            np.array([x.first_p for x in c]),
        )

    def relinearise(self) -> None:
        """Take Jacobians at the present estimates from now on."""
        for c in self.clones:
            c.first_R, c.first_p = c.R, c.p
        for x in self.landmarks:
            x.first_x = x.x

    def add_clone(self, t_ns: int) -> None:
        """Append the present pose of the rig to the clones, as that of an exposure stamped `t_ns`.

        Its Jacobian by the time offset: a stamp further ahead than assumed means an earlier pose (M27).
        """
        J = np.zeros((CLONE, len(self.P)))
        J[0:3, ATT], J[0:3, MOUNT], J[3:6, POS] = np.eye(3), self.R, np.eye(3)
        J[0:3, TIME], J[3:6, TIME] = -(self.R @ self.rate)[:, None], -self.core[VEL][:, None]
        self.P = _insert(self.P, self.landmark_start, J @ self.P, J @ self.P @ J.T + self._time_offset_noise())
        R, p = self.rig, self.core[POS].copy()
        self.clones.append(Clone(t_ns, R, p, R, p))

    def _time_offset_noise(self) -> F64:
        """(6, 6) covariance that M27 leaves out while the time offset is uncertain: errors and changes of the rates.

        Without it the noise of a gyro (7 mrad/s a sample) is taken for rotation, and a wrong offset is learned.
        """
        time, velocity = float(self.P[TIME, TIME][0, 0]), float(self.P[VEL, VEL].diagonal().max())
        rotation = time * self.rate_variance + (0.5 * time * _UNMODELLED[0]) ** 2
        position = time * velocity + (0.5 * time * _UNMODELLED[1]) ** 2
        return np.diag(np.repeat([rotation, position], 3))

    def add_landmarks(self, landmarks: Sequence[Landmark], cross: F64, covariance: F64) -> None:
        """Append m landmarks.

        Args:
            cross: (3m, n) covariance of the landmarks with the state.
            covariance: (3m, 3m) of the landmarks.
        """
        self.P = _insert(self.P, len(self.P), cross, covariance)
        self.landmarks.extend(landmarks)

    def drop(self, clones: Sequence[int] = (), landmarks: Sequence[int] = ()) -> None:
        """Marginalise clones and landmarks by index."""
        rows = [np.arange(len(self.P))[self.clone_slice(i)] for i in clones]
        rows += [np.arange(len(self.P))[self.landmark_slice(i)] for i in landmarks]
        if rows:
            keep = np.ones(len(self.P), bool)
            keep[np.concatenate(rows)] = False
            self.P = np.ascontiguousarray(self.P[np.ix_(keep, keep)])
        self.clones = [c for i, c in enumerate(self.clones) if i not in set(clones)]
        self.landmarks = [x for i, x in enumerate(self.landmarks) if i not in set(landmarks)]

    def correct(self, residual: F64, H: F64, columns: NDArray[np.int64]) -> None:
        """EKF update by a measurement of unit noise: `residual = H error[columns] + noise`, H (m, len(columns))."""
        if not len(residual):
            return
        HP = H @ self.P[columns]
        S = HP[:, columns] @ H.T
        S[np.diag_indices(len(S))] += 1.0
        L = np.linalg.cholesky(S)
        half = dtrsm(1.0, L.T, HP.T, side=1, overwrite_b=1)  # (S^-1/2 H P)'
        self.P -= half @ half.T  # symmetric by construction
        self._apply(half @ solve_triangular(L, residual, lower=True, check_finite=False))

    def update(self, residual: F64, H: F64, noise: F64) -> None:
        """EKF update by a measurement `residual = H error + noise` of all errors; `noise` (m,) variances."""
        used, unit = np.flatnonzero(H.any(axis=0)), 1.0 / np.sqrt(noise)  # H is zero for most of the errors
        self.correct(residual * unit, H[:, used] * unit[:, None], used)

    def _apply(self, error: F64) -> None:
        """Add (n,) errors to the nominal values."""
        self.R = so3_exp(error[ATT]) @ self.R
        self.core[3:] += error[3:CORE]
        e = error[CORE : self.landmark_start].reshape(-1, CLONE)
        for c, rotation, shift in zip(self.clones, so3_exp(e[:, :3]), e[:, 3:], strict=True):
            c.R, c.p = rotation @ c.R, c.p + shift
        for x, shift in zip(self.landmarks, error[self.landmark_start :].reshape(-1, LANDMARK), strict=True):
            x.x = x.x + shift


def moment_in_world(covariance: F64, by_offset: F64, offset: F64, offset_covariance: F64) -> F64:
    """Return the (6, 6) second moment of the error of a map pose (position, rotation) in the world.

    Args:
        covariance: (6, 6) of the pose in the map frame.
        by_offset: (6, 3) cross covariance with the offset of the map.
        offset, offset_covariance: (3,) m, (3, 3) of the map.
    """
    out = covariance.copy()
    out[:, :3] += by_offset
    out[:3, :] += by_offset.T
    out[:3, :3] += offset_covariance + np.outer(offset, offset)
    return out


def _insert(P: F64, at: int, cross: F64, own: F64) -> F64:
    """Insert k rows and columns at `at`: covariance `own` (k, k), and `cross` (k, n) with the others."""
    k, n = len(own), len(P)
    out = np.empty((n + k, n + k))
    old = np.r_[0:at, at + k : n + k]
    out[np.ix_(old, old)] = P
    out[at : at + k, old], out[np.ix_(old, np.arange(at, at + k))] = cross, cross.T
    out[at : at + k, at : at + k] = own
    return out
