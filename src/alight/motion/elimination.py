"""Elimination of points: constraints of observations on the poses when their points are marginalised (M21).

Filter and adjustments use the same algebra, the Schur complement of the point blocks. For one feature it is the
information form of the null-space projection of the MSCKF (Mourikis and Roumeliotis 2007).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from scipy.linalg.lapack import dpstrf

from alight.arrays import F64, I64, Mask
from alight.geometry import Pose
from alight.motion.constraint_kernels import (
    largest_eigenvalues,
    misfits_at,
    pose_distances,
    solve_pivoted,
    sum_information,
)
from alight.motion.observations import WindowObservations, WindowPoses, cameras_at
from alight.motion.point_kernels import eliminate_list, marginalise_tracks
from alight.motion.triangulation import NEAR, WEAK_PRIOR


@dataclass(frozen=True, eq=False)
class PoseConstraint:
    """Constraint of N features on the errors d of K poses, their points eliminated.

    The cost of one feature is d'A d - 2 b'd + misfit. Poses are ordered (rotation, position).
    """

    A: F64  # (N, K, 6, 6): the block diagonal of A before elimination
    V: F64  # (N, K, 6, 3): A of a feature is its block diagonal less V V'
    b: F64  # (N, K, 6)
    misfit: F64  # (N,) squared residual that remains at the best point
    freedom: I64  # (N,) degrees of freedom: rows less three
    root: F64  # (N, 3, 3), root root' is the covariance of the point
    point_covariance: F64  # (N, 3, 3) for exact poses, m^2
    step: F64  # (N, 3) m, from the point given to the best point for the poses as they are

    def select(self, which: Mask | I64) -> PoseConstraint:
        """Return the constraints of some features."""
        return PoseConstraint(*(getattr(self, f.name)[which] for f in fields(self)))

    def point_by_poses(self) -> F64:
        """(N, 3, 6K): the derivative of the best point by the errors of the poses, negated."""
        n = len(self.V)
        return np.asarray((self.V @ self.root[:, None].transpose(0, 1, 3, 2)).reshape(n, -1, 3).transpose(0, 2, 1))

    def information(self, weight: F64) -> tuple[F64, F64]:
        """Return the weighted sum over the features of A (6K, 6K) and b (6K,)."""
        size = 6 * self.b.shape[1]
        A, b = np.empty((size, size)), np.empty(size)
        sum_information(self.A, self.V, self.b, weight, A, b)
        return A, b

    def misfit_at(self, error: F64) -> F64:
        """(N,) squared residual of each feature when the poses move by (6K,) errors and its point follows."""
        out = np.empty(len(self.b))
        misfits_at(self.A, self.V, self.b, self.misfit, error, out)
        return out

    def mahalanobis(self, P: F64) -> F64:
        """(N,) squared Mahalanobis distance of each feature, given the (6K, 6K) covariance `P` of the poses.

        Infinite for all of them where `P` is so far out of range that it has no inverse: none passes a gate.
        """
        out = np.empty(len(self.b))
        try:
            pose_distances(self.A, self.V, self.b, self.misfit, np.ascontiguousarray(P), out)
        except np.linalg.LinAlgError:
            out[:] = np.inf
        return out


def marginalise_points(
    observations: WindowObservations, poses: WindowPoses, cams: Sequence[Pose], points: F64
) -> PoseConstraint:
    """Linearise observations about (N, 3) points and eliminate these (M21).

    Residuals are taken at the estimates and Jacobians at the first estimates, so that yaw and position stay
    unobservable (first-estimates Jacobian, Huang et al. 2008).
    """
    n, k = observations.sigma.shape
    out = PoseConstraint(
        A=np.empty((n, k, 6, 6)),
        V=np.empty((n, k, 6, 3)),
        b=np.empty((n, k, 6)),
        misfit=np.empty(n),
        freedom=np.empty(n, np.int64),
        root=np.empty((n, 3, 3)),
        point_covariance=np.empty((n, 3, 3)),
        step=np.empty((n, 3)),
    )
    now, first = cameras_at(poses.R, poses.p, cams), cameras_at(poses.first_R, poses.first_p, cams)
    marginalise_tracks(
        observations.normalised, observations.sigma, points, *now, *first, poses.first_p, NEAR, WEAK_PRIOR,
        out.A, out.V, out.b, out.misfit, out.freedom, out.root, out.point_covariance, out.step,
    )  # fmt: skip
    return out


def unit_noise_rows(A: F64, b: F64) -> tuple[F64, F64]:
    """Return residual (m,) and rows (m, n) of unit noise with the information `A` (n, n) and `b` (n,).

    Cholesky with pivots: information below 1e-10 of the largest is rounding (a tenth of the time of eigenvectors).
    """
    R, pivots, rank, _ = dpstrf(A, tol=1e-10 * max(float(A.diagonal().max()), 1e-300))
    residual, rows = np.empty(rank), np.zeros((rank, len(b)))
    solve_pivoted(R.T, pivots.astype(np.int64), b, residual, rows)
    return residual, rows


def largest_sigma(covariance: F64) -> F64:
    """(N,) largest 1-sigma in any direction, of (N, 3, 3) covariances."""
    out = np.empty(len(covariance))
    largest_eigenvalues(covariance, out)
    return np.asarray(np.sqrt(out))


@dataclass(frozen=True, eq=False)
class EliminatedPoints:
    """N points eliminated from a list of M observations, sorted by point: the Schur complement in factors.

    The couplings G of all observations of a point are stacked over the poses. G G' is subtracted from the normal matrix
    of the poses, and G z from the right side, z = root' gradient.
    """

    starts: I64  # (N + 1,) first observation of each point, then M
    coupling: F64  # (M, 6, 3) G
    gradient: F64  # (N, 3) right side of the points
    root: F64  # (N, 3, 3), root root' is the covariance of a point
    covariance: F64  # (N, 3, 3) for exact poses
    by_point: F64  # (M, 2, 3) Jacobian, in sigmas

    @property
    def reduced_gradient(self) -> F64:
        """(N, 3): z above."""
        return np.asarray(np.einsum("nji,nj->ni", self.root, self.gradient))

    def point_step(self, predicted: F64) -> F64:
        """Return the (N, 3) steps of the points once the other unknowns have moved (back substitution).

        Args:
            predicted: (M, 2) change of the predicted observations by these unknowns, in sigmas.
        """
        moved = sum_by_point(self.starts, np.einsum("nki,nk->ni", self.by_point, predicted))
        return np.asarray(np.einsum("nij,nj->ni", self.covariance, self.gradient - moved))


def eliminate_points(starts: I64, residual: F64, by_pose: F64, by_point: F64, regular: float) -> EliminatedPoints:
    """Eliminate N points from M linearised observations, sorted by point (M21).

    Args:
        starts: (N + 1,) first observation of each point, then M.
        residual: (M, 2) observed less predicted, in sigmas.
        by_pose, by_point: (M, 2, 6), (M, 2, 3) Jacobians, in sigmas.
        regular: added to the diagonal of a point's information, so that every point has a covariance.
    """
    n, m = len(starts) - 1, len(residual)
    by_point = np.ascontiguousarray(by_point)
    out = EliminatedPoints(
        starts, np.empty((m, 6, 3)), np.empty((n, 3)), np.empty((n, 3, 3)), np.empty((n, 3, 3)), by_point
    )
    rows = np.ascontiguousarray(residual), np.ascontiguousarray(by_pose), by_point
    eliminate_list(starts, *rows, regular, out.coupling, out.gradient, out.root, out.covariance)
    return out


def sum_by_point(starts: I64, values: F64) -> F64:
    """Sum (M, ...) values, sorted by point, into (N, ...); every point has at least one.

    Args:
        starts: (N + 1,) first value of each point, then M.
        values: to be summed.
    """
    return np.add.reduceat(values, starts[:-1])
