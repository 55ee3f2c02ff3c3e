"""Points of features: triangulated by least squares (M12), and eliminated from the equations of the poses (M21).

This is the Schur complement of the point blocks. For one feature it is the information form of the null-space
projection of the MSCKF (Mourikis and Roumeliotis 2007).
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
from alight.motion.observations import Clones, WindowObservations, cameras_at
from alight.motion.point_kernels import marginalise_tracks, nearest_to_rays, triangulate_tracks

NEAR = 0.1  # m; a camera does not observe points closer along its axis, or behind it
MIN_POSES = 3  # poses that must have observed a track before it is used; so least exposures of a smoothed flight
WEAK_PRIOR = 1e-9  # 1/m^2 added to a point's information, so that even a point at infinity has a covariance


def triangulate_window(observations: WindowObservations, clones: Clones, cams: Sequence[Pose]) -> F64:
    """Return the (N, 3) points in the world, m: nearest to their rays, refined by three Gauss-Newton steps (M12).

    Args:
        observations: N features from K poses by C cameras.
        clones: the K rig poses.
        cams: rig_from_cam of the C cameras.
    """
    points = np.empty((len(observations.ids), 3))
    R, p = cameras_at(clones.R, clones.p, cams)
    triangulate_tracks(observations.normalised, observations.sigma, R, p, 3, NEAR, WEAK_PRIOR, points)
    return points


def triangulate_rays(starts: I64, rays: F64, origins: F64, weight: F64) -> F64:
    """Return the (N, 3) points nearest to weighted rays (midpoint method), to initialise a batch adjustment.

    Args:
        starts: (N + 1,) index of the first ray of each point, then the number M of rays.
        rays, origins: (M, 3) directions of any length and origins in the world, sorted by point.
        weight: (M,) weight of each ray.
    """
    points = np.empty((len(starts) - 1, 3))
    unit = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    nearest_to_rays(starts, unit, np.ascontiguousarray(origins), weight, WEAK_PRIOR, points)
    return points


@dataclass(frozen=True, eq=False)
class PoseConstraint:
    """Constraint of N features on the errors d of K poses, with the points eliminated.

    The cost of one feature is d'(A - V V') d - 2 b'd + misfit. The error of a pose is ordered (rotation, position).
    """

    x: F64  # (N, 3) m, points about which the observations were linearised
    A: F64  # (N, K, 6, 6), block-diagonal matrix before elimination
    V: F64  # (N, K, 6, 3), coupling of the poses with the point
    b: F64  # (N, K, 6)
    misfit: F64  # (N,) squared residual that remains at the best point
    freedom: I64  # (N,) degrees of freedom: rows less three
    root: F64  # (N, 3, 3), root root' is the covariance of the point
    point_covariance: F64  # (N, 3, 3) for exact poses, m^2
    step: F64  # (N, 3) m, from `x` to the best point for the poses as they are

    def select(self, which: Mask | I64) -> PoseConstraint:
        """Return the constraints of the features at the indices or mask `which`."""
        return PoseConstraint(*(getattr(self, f.name)[which] for f in fields(self)))

    def well_known(self, centre: F64, share: float) -> Mask:
        """Return the (N,) mask of points whose largest 1-sigma is below `share` of the distance from `centre` (3,)."""
        variance = np.empty(len(self.x))
        largest_eigenvalues(self.point_covariance, variance)
        return np.asarray(np.sqrt(variance) < share * np.linalg.norm(self.x - centre, axis=1))

    def point_by_poses(self) -> F64:
        """Return the negated derivative (N, 3, 6K) of the best points with respect to the errors of the poses."""
        n = len(self.V)
        return np.asarray((self.V @ self.root[:, None].transpose(0, 1, 3, 2)).reshape(n, -1, 3).transpose(0, 2, 1))

    def information(self, weight: F64) -> tuple[F64, F64]:
        """Return the matrix (6K, 6K) and right side (6K,) of the poses, summed over all features with weights (N,)."""
        size = 6 * self.b.shape[1]
        A, b = np.empty((size, size)), np.empty(size)
        sum_information(self.A, self.V, self.b, weight, A, b)
        return A, b

    def misfit_at(self, error: F64) -> F64:
        """Return the (N,) squared residuals if `error` (6K,) is added to the poses and each point follows."""
        out = np.empty(len(self.b))
        misfits_at(self.A, self.V, self.b, self.misfit, error, out)
        return out

    def mahalanobis(self, P: F64) -> F64:
        """Return the (N,) squared Mahalanobis distance of each feature, given the (6K, 6K) covariance `P` of the poses.

        All distances are infinite if the equations have no solution; then no feature passes a gate.
        """
        out = np.empty(len(self.b))
        try:
            pose_distances(self.A, self.V, self.b, self.misfit, np.ascontiguousarray(P), out)
        except np.linalg.LinAlgError:
            out[:] = np.inf
        return out


def marginalise_points(
    observations: WindowObservations, clones: Clones, cams: Sequence[Pose], points: F64 | None = None
) -> PoseConstraint:
    """Eliminate the points of observations linearised about `points` (N, 3), by default triangulated points (M21)."""
    # Jacobians are taken at the first estimates, so that yaw and position stay unobservable (Huang et al. 2008)
    n, k = observations.sigma.shape
    x = triangulate_window(observations, clones, cams) if points is None else points
    shapes = (n, k, 6, 6), (n, k, 6, 3), (n, k, 6), (n,), (n, 3, 3), (n, 3, 3), (n, 3)
    A, V, b, misfit, root, covariance, step = (np.empty(shape) for shape in shapes)
    out = PoseConstraint(x, A, V, b, misfit, np.empty(n, np.int64), root, covariance, step)
    now, first = cameras_at(clones.R, clones.p, cams), cameras_at(clones.first_R, clones.first_p, cams)
    marginalise_tracks(
        observations.normalised, observations.sigma, x, *now, *first, clones.first_p, NEAR, WEAK_PRIOR,
        *(getattr(out, f.name) for f in fields(out)[1:]),
    )  # fmt: skip
    return out


def unit_noise_rows(A: F64, b: F64) -> tuple[F64, F64]:
    """Return a measurement of unit noise, residual (m,) and rows (m, n), with the information `A` (n, n), `b` (n,)."""
    # Cholesky with pivots takes a tenth of the time of eigenvectors; 1e-10 of the largest pivot is a rounding error
    R, pivots, rank, _ = dpstrf(A, tol=1e-10 * max(float(A.diagonal().max()), 1e-300))
    residual, rows = np.empty(rank), np.zeros((rank, len(b)))
    solve_pivoted(R.T, pivots.astype(np.int64), b, residual, rows)
    return residual, rows
