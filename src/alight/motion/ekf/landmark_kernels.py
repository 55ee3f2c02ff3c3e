"""Kernels for landmarks measured from the last clone: rows, gates, and innovation of the rows that pass (M11)."""

import numpy as np

from alight.arrays import F64, I64
from alight.compiled import kernel
from alight.motion.ekf.state_kernels import unit_noise_distance
from alight.motion.point_kernels import to_camera


@kernel
def linearise_points(
    x: F64, first_x: F64, normalised: F64, sigma: F64, R: F64, origin: F64, first_R: F64, first_origin: F64,
    first_p: F64, near: float, residual: F64, by_pose: F64, by_point: F64, count: I64,
) -> None:  # fmt: skip
    """Write residuals at the estimates and Jacobians at the first estimates, 2 rows per camera, in sigmas.

    Args:
        x, first_x: (N, 3) points and their first estimates, m.
        normalised: (N, C, 2) observations, NaN = not observed.
        sigma: (N,) 1-sigma of a normalised coordinate.
        R, origin, first_R, first_origin: (C, 3, 3), (C, 3) world_from_cam, now and at the first estimate.
        first_p: (3,) first estimate of the rig's position, m.
        near: least depth along the optical axis, m; observations of nearer points are left out.
        residual, by_pose, by_point: (N, 2C), (N, 2C, 6), (N, 2C, 3) out: residuals, and Jacobians with respect to the
            rig's pose and the point; rows without an observation are zero.
        count: (N,) out, number of rows with an observation.
    """
    q, f = np.empty(3), np.empty(3)
    for n in range(x.shape[0]):
        residual[n], by_pose[n], by_point[n], count[n] = 0.0, 0.0, 0.0, 0
        d0, d1, d2 = first_x[n, 0] - first_p[0], first_x[n, 1] - first_p[1], first_x[n, 2] - first_p[2]
        for c in range(normalised.shape[1]):
            if not np.isfinite(normalised[n, c, 0]):
                continue
            to_camera(R[c], origin[c], x[n], q)
            to_camera(first_R[c], first_origin[c], first_x[n], f)
            if q[2] <= near or f[2] <= near:
                continue
            count[n] += 2
            w, T = 1.0 / (sigma[n] * f[2]), first_R[c]
            for h in range(2):
                X, P, at = by_point[n, 2 * c + h], by_pose[n, 2 * c + h], f[h] / f[2]
                residual[n, 2 * c + h] = (normalised[n, c, h] - q[h] / q[2]) / sigma[n]
                for i in range(3):
                    X[i] = w * (T[i, h] - at * T[i, 2])
                    P[3 + i] = -X[i]
                P[0], P[1], P[2] = X[1] * d2 - X[2] * d1, X[2] * d0 - X[0] * d2, X[0] * d1 - X[1] * d0


@kernel
def project_covariance(P: F64, pose: int, points: I64, by_pose: F64, by_point: F64, HP: F64) -> None:
    """Write the covariance `HP` (N, m, n) of m measurement rows of each of N landmarks with all n errors of the state.

    `P` (n, n) is the covariance of the state; `pose` and `points` (N,) are the first rows of the clone and of each
    landmark in it. `by_pose` and `by_point` are the Jacobians from `linearise_points`.
    """
    for k in range(by_pose.shape[0]):
        for r in range(by_pose.shape[1]):
            out = HP[k, r]
            a, b = by_pose[k, r], by_point[k, r]
            a0, a1, a2, a3, a4, a5 = a[0], a[1], a[2], a[3], a[4], a[5]
            b0, b1, b2, at = b[0], b[1], b[2], points[k]
            p0, p1, p2, p3, p4, p5 = P[pose], P[pose + 1], P[pose + 2], P[pose + 3], P[pose + 4], P[pose + 5]
            q0, q1, q2 = P[at], P[at + 1], P[at + 2]
            for j in range(P.shape[0]):
                out[j] = (
                    a0 * p0[j] + a1 * p1[j] + a2 * p2[j] + a3 * p3[j] + a4 * p4[j] + a5 * p5[j]
                    + b0 * q0[j] + b1 * q1[j] + b2 * q2[j]
                )  # fmt: skip


@kernel
def _covariance_with(HP: F64, pose: int, point: int, by_pose: F64, by_point: F64) -> float:
    """Return the covariance of two measurement rows: `HP` (n,) is from one, `by_pose` and `by_point` from the other."""
    out = 0.0
    for j in range(6):
        out += HP[pose + j] * by_pose[j]
    for j in range(3):
        out += HP[point + j] * by_point[j]
    return out


@kernel
def gate_distances(HP: F64, pose: int, points: I64, by_pose: F64, by_point: F64, residual: F64, out: F64) -> None:
    """Write the (N,) squared Mahalanobis distance of the residuals of each landmark.

    The arguments are as in `project_covariance` and `linearise_points`.
    """
    m = residual.shape[1]
    S, L, y = np.zeros((m, m)), np.zeros((m, m)), np.empty(m)
    for k in range(residual.shape[0]):
        for r in range(m):
            for s in range(r + 1):
                S[r, s] = _covariance_with(HP[k, r], pose, points[k], by_pose[k, s], by_point[k, s])
        out[k] = unit_noise_distance(residual[k], S, L, y)


@kernel
def innovation_of(
    HP: F64, pose: int, points: I64, by_pose: F64, by_point: F64, residual: F64, used: I64, scale: F64,
    rows: F64, S: F64, innovation: F64,
) -> None:  # fmt: skip
    """Write residuals and covariances of the rows that are used, each multiplied by the factor of its landmark.

    Args:
        HP, pose, points, by_pose, by_point, residual: as in `gate_distances`.
        used: (M, 2) index of a landmark, and index of one of its rows.
        scale: (N,) factor of each landmark.
        rows: (M, n) out, covariance with all errors.
        S: (M, M) out, covariance of the rows with each other, its lower half.
        innovation: (M,) out, scaled residuals.
    """
    for i in range(len(used)):
        k, r = used[i]
        f = scale[k]
        innovation[i] = f * residual[k, r]
        for j in range(HP.shape[2]):
            rows[i, j] = f * HP[k, r, j]
        for j in range(i + 1):
            other, s = used[j]
            own = _covariance_with(HP[k, r], pose, points[other], by_pose[other, s], by_point[other, s])
            S[i, j] = f * scale[other] * own
