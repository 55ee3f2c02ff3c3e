"""State of the filter: nominal values, and the covariance of their errors (docs/method/motion.md, M7).

Attitude errors are in the world frame: `R = exp(theta) R_hat`, `p = p_hat + dp`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg.blas import dsyrk, dtrsm
from scipy.linalg.lapack import dpotrf

from alight.arrays import F64, I64
from alight.geometry import so3_exp
from alight.motion.ekf.state_kernels import insert_rows, keep_rows, mirror_lower
from alight.motion.observations import Clones
from alight.motion.rotation_kernels import move_poses


class CoreLayout(NamedTuple):
    """Slices of the core (all states but clones and landmarks), both in its values and in the error covariance."""

    att: slice = slice(0, 3)  # rad, body attitude
    pos: slice = slice(3, 6)  # m
    vel: slice = slice(6, 9)  # m/s
    gyro: slice = slice(9, 12)  # rad/s, gyro bias; without IMU the angular velocity of the body itself
    acc: slice = slice(12, 15)  # m/s^2, accelerometer bias; without IMU unused
    biases: slice = slice(9, 15)  # both biases
    motion: slice = slice(0, 15)  # all of the above: errors that the motion model propagates
    nav_pos: slice = slice(15, 18)  # m, slowly varying error of the GPS/INS position
    nav_att: slice = slice(18, 21)  # rad, slowly varying error of the GPS/INS attitude, in world axes
    nav_vel: slice = slice(21, 24)  # m/s, slowly varying error of the GPS/INS velocity
    nav: slice = slice(15, 24)  # all slowly varying errors of GPS/INS
    mount: slice = slice(24, 27)  # rad, rotation from the INS body to the body that the cameras are calibrated to
    offset: slice = slice(27, 30)  # m, from the map frame, in which the initial position is exact, to the world
    time: slice = slice(30, 31)  # s by which the cameras' stamps are ahead of the clock of GPS/INS and IMU


AT = CoreLayout()
CORE: int = AT.time.stop
LANDMARK = 3
POSITION_FIRST = np.r_[AT.pos, AT.att]  # takes (rotation, position) of a pose to (position, rotation)
CLONE = len(POSITION_FIRST)  # errors of a clone: (rotation, position)
_UNMODELLED = (1.0, 2.0)  # rad/s^2, m/s^2: accelerations that M27 leaves out


@dataclass(frozen=True, eq=False)
class Landmarks:
    """N landmarks, the points x_i in the state of the 2004 paper."""

    ids: I64  # (N,)
    x: F64  # (N, 3) m, world
    first_x: F64  # (N, 3) m, first estimates, where Jacobians are taken
    rejections: I64  # (N,) exposures in a row in which the landmark failed its gate
    mean_residual: F64  # (N, m) running mean of the residuals, in sigmas
    mean_square: F64  # (N,) running mean of their squared norm

    @classmethod
    def new(cls, ids: I64, x: F64, first_x: F64, rows: int) -> Landmarks:
        """Return new landmarks, each with `rows` residuals per exposure."""
        n = len(ids)
        return cls(ids, x, first_x, np.zeros(n, np.int64), np.zeros((n, rows)), np.zeros(n))

    def __len__(self) -> int:
        return len(self.ids)

    def select(self, kept: I64) -> Landmarks:
        """Return the landmarks at the indices `kept`."""
        return Landmarks(*(getattr(self, f.name)[kept] for f in fields(self)))

    def joined(self, other: Landmarks) -> Landmarks:
        """Return these landmarks followed by `other`."""
        if not len(self):
            return other
        return Landmarks(*(np.concatenate([getattr(self, f.name), getattr(other, f.name)]) for f in fields(self)))


@dataclass(eq=False)
class FilterState:
    """State of the filter, with clones and landmarks that are replaced, never changed in place."""

    t_ns: int
    R: F64  # (3, 3) world_from_body
    core: F64  # (31,) values of the slices; AT.att stays zero, R holds the attitude
    P: F64  # (n, n) covariance of the errors of core, clones and landmarks, in this order
    clones: Clones = field(default_factory=Clones.none)
    landmarks: Landmarks = field(
        default_factory=lambda: Landmarks.new(np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 3)), 0)
    )
    rate: F64 = field(default_factory=lambda: np.zeros(3))  # rad/s, angular velocity in the body frame
    rate_variance: float = 0.0  # (rad/s)^2
    refused: int = 0  # measurements that could not be used: not finite, or a singular matrix

    def anchor(self) -> None:
        """Take the present position as exact in the map frame (M29): its error becomes one of the map's offset.

        Only differences of positions, and their sum with the offset, are ever measured, and these keep their errors.
        """
        position = np.arange(AT.pos.start, AT.pos.stop)
        clones = [self.clone_rows.start + CLONE * i + position for i in range(len(self.clones))]  # rotation, position
        landmarks = [self.landmark_start + LANDMARK * i + np.arange(LANDMARK) for i in range(len(self.landmarks))]
        moved = np.concatenate([position, *clones, *landmarks])
        for P in (self.P, self.P.T):  # rows, then columns
            error = P[position]
            P[moved] -= np.tile(error, (len(moved) // 3, 1))
            P[AT.offset] += error

    def copy(self) -> FilterState:
        """Return an independent copy."""
        return replace(self, core=self.core.copy(), P=self.P.copy())

    @property
    def rig(self) -> F64:
        """Rotation world_from_rig (3, 3): the body's attitude with the mounting correction."""
        return self.R @ so3_exp(self.core[AT.mount])

    @property
    def landmark_start(self) -> int:
        """Row of the first landmark in `P`."""
        return CORE + CLONE * len(self.clones)

    @property
    def clone_rows(self) -> slice:
        """Rows of all clones in `P`."""
        return slice(CORE, self.landmark_start)

    def add_clone(self, t_ns: int) -> None:
        """Append the present pose of the rig, stamped `t_ns`, to the clones, with the error of its stamp (M27)."""
        J = np.zeros((CLONE, CORE))
        J[0:3, AT.att], J[0:3, AT.mount], J[3:6, AT.pos] = np.eye(3), self.R, np.eye(3)
        J[0:3, AT.time], J[3:6, AT.time] = -(self.R @ self.rate)[:, None], -self.core[AT.vel][:, None]
        cross = J @ self.P[:CORE]
        self.insert(self.landmark_start, cross, cross[:, :CORE] @ J.T + self._time_offset_noise())
        self.clones = self.clones.with_pose(t_ns, self.rig, self.core[AT.pos])

    def _time_offset_noise(self) -> F64:
        """Return the (6, 6) covariance that the time offset adds to a clone by errors and changes of the rates."""
        # M27 omits it: the noise of a gyro (7 mrad/s per sample) would be treated as rotation and spoil the offset
        time, velocity = float(self.P[AT.time, AT.time][0, 0]), float(self.P[AT.vel, AT.vel].diagonal().max())
        rotation = time * self.rate_variance + (0.5 * time * _UNMODELLED[0]) ** 2
        position = time * velocity + (0.5 * time * _UNMODELLED[1]) ** 2
        return np.diag(np.repeat([rotation, position], 3))

    def insert(self, at: int, cross: F64, own: F64) -> None:
        """Insert k errors at row `at` of `P`, with covariance `own` (k, k) and cross covariance `cross` (k, n)."""
        n = len(self.P) + len(own)
        out = np.empty((n, n))
        insert_rows(self.P, at, cross, own, out)
        self.P = out

    def drop(self, clones: Sequence[int] = (), landmarks: I64 | Sequence[int] = ()) -> None:
        """Marginalise the clones and landmarks at these indices."""
        if not len(clones) and not len(landmarks):
            return
        keep = np.ones(len(self.P), bool)
        keep[self.clone_rows].reshape(-1, CLONE)[list(clones)] = False
        keep[self.landmark_start :].reshape(-1, LANDMARK)[np.asarray(landmarks, dtype=np.int64)] = False
        rows = np.flatnonzero(keep)
        P = np.empty((len(rows), len(rows)))
        keep_rows(self.P, rows, P)
        kept = np.delete(np.arange(len(self.landmarks)), landmarks)
        self.P, self.landmarks = P, self.landmarks.select(kept)
        self.clones = self.clones.select([i for i in range(len(self.clones)) if i not in set(clones)])

    def correct(self, residual: F64, H: F64, columns: slice | I64) -> None:
        """Update the state by a measurement (m,), residual = H error[columns] + unit noise; H (m, len(columns))."""
        HP = H @ self.P[columns]
        self.correct_by(residual, HP, HP[:, columns] @ H.T)

    def correct_by(self, residual: F64, HP: F64, S: F64) -> None:
        """Update the state by a measurement of unit noise; with a singular matrix or NaN, only count it as `refused`.

        Args:
            residual: (m,) measured less predicted.
            HP: (m, n) covariance of the measured errors with all errors; overwritten.
            S: (m, m) covariance of the measured errors without the noise, only its lower half; overwritten.
        """
        if not len(residual):
            return
        S[np.diag_indices(len(S))] += 1.0
        U, failed = dpotrf(S.T, lower=0, clean=0, overwrite_a=1)
        half = HP.T if failed else dtrsm(1.0, U, HP.T, side=1, overwrite_b=1)  # (S^-1/2 H P)'
        if failed or not (np.isfinite(residual).all() and np.isfinite(half).all()):  # LAPACK lets NaN pass
            self.refused += 1
            return
        dsyrk(-1.0, half, 1.0, self.P.T, overwrite_c=1)  # symmetric by construction: one half is enough
        mirror_lower(self.P)
        self._apply(half @ dtrsm(1.0, U, residual[:, None], trans_a=1)[:, 0])

    def _apply(self, error: F64) -> None:
        R = np.empty((1, 3, 3))
        move_poses(self.R[None], self.core[None, AT.pos], error, R, np.empty((1, 3)))
        self.R = R[0]
        self.core[3:] += error[3:CORE]
        self.clones = self.clones.moved(error[self.clone_rows])
        x = self.landmarks.x + error[self.landmark_start :].reshape(-1, LANDMARK)
        self.landmarks = replace(self.landmarks, x=x)


def moment_in_world(covariance: F64, by_offset: F64, offset: F64, offset_covariance: F64) -> F64:
    """Return the (6, 6) second moment of the error of a map pose (position, rotation) in the world.

    Args:
        covariance: (6, 6) covariance of the pose in the map frame.
        by_offset: (6, 3) cross covariance of the pose with the offset of the map.
        offset, offset_covariance: (3,) m, (3, 3) offset of the map and its covariance.
    """
    out = covariance.copy()
    out[:, :3] += by_offset
    out[:3, :] += by_offset.T
    out[:3, :3] += offset_covariance + np.outer(offset, offset)
    return out
