"""Kernels that triangulate features and eliminate them from the normal equations of the poses (M12, M21).

N features, K poses of a rig, C cameras. The filter uses dense arrays over a short window, linearised in the same pass.
Batch adjustments use lists of observations sorted by point. NumPy would need forty small steps for the same products.
"""

import numpy as np

from alight.arrays import F64, I64
from alight.compiled import inline, kernel

MIN_DEPTH = 1e-3  # m; replaces smaller depths in Jacobians, so that they stay finite


@inline
def invert(A: F64, least: float, root: F64, inverse: F64) -> None:
    """Write the inverse of a positive definite `A` (3, 3), and an upper triangular `root` with root root' = inverse.

    Pivots below `least` are rounding errors and are set to `least`.
    """
    a = np.sqrt(max(A[0, 0], least))
    b, c = A[1, 0] / a, A[2, 0] / a
    d = np.sqrt(max(A[1, 1] - b * b, least))
    e = (A[2, 1] - b * c) / d
    f = np.sqrt(max(A[2, 2] - c * c - e * e, least))
    root[:] = 0.0
    root[0, 0], root[1, 1], root[2, 2] = 1.0 / a, 1.0 / d, 1.0 / f
    root[0, 1], root[1, 2] = -b / (a * d), -e / (d * f)
    root[0, 2] = (b * e - c * d) / (a * d * f)
    for i in range(3):
        for j in range(3):
            inverse[i, j] = root[i, 0] * root[j, 0] + root[i, 1] * root[j, 1] + root[i, 2] * root[j, 2]


@inline
def to_camera(R: F64, origin: F64, x: F64, q: F64) -> None:
    """Write the world point `x` into `q` in the frame of a camera, whose world_from_cam is `R` and `origin`."""
    for i in range(3):
        q[i] = (
            R[0, i] * (x[0] - origin[0]) + R[1, i] * (x[1] - origin[1]) + R[2, i] * (x[2] - origin[2])
        )  # fmt: skip


@inline
def _add_ray(u: F64, o: F64, weight: float, A: F64, y: F64) -> None:
    """Add a ray from `o` in unit direction `u` to the equations A x = y of the point nearest to weighted rays."""
    along = u[0] * o[0] + u[1] * o[1] + u[2] * o[2]
    for i in range(3):
        y[i] += weight * (o[i] - u[i] * along)
        A[i, i] += weight
        for j in range(3):
            A[i, j] -= weight * u[i] * u[j]


@inline
def _add_row(X: F64, e: float, V: F64, g: F64) -> None:
    """Add one row X (3,) of a point's Jacobian and its residual e to the point's normal equations V, g."""
    for i in range(3):
        g[i] += X[i] * e
        for j in range(3):
            V[i, j] += X[i] * X[j]


@inline
def _times_root(W: F64, root: F64) -> None:
    for i in range(6):
        u, v, w = W[i, 0], W[i, 1], W[i, 2]
        W[i, 0] = u * root[0, 0]
        W[i, 1] = u * root[0, 1] + v * root[1, 1]
        W[i, 2] = u * root[0, 2] + v * root[1, 2] + w * root[2, 2]


@inline
def nearest_point(
    ray: F64, origin: F64, weight: F64, first: int, end: int, least: float, room: F64, y: F64, out: F64
) -> None:
    """Write the point (3,) nearest to the weighted rays `first` to `end` - 1, of unit length (midpoint method).

    `least` is added to the diagonal of the equations; `room` (3, 3, 3) and `y` (3,) are scratch.
    """
    A, root, inverse = room[0], room[1], room[2]
    A[:], y[:] = 0.0, 0.0
    for i in range(3):
        A[i, i] = least
    for k in range(first, end):
        _add_ray(ray[k], origin[k], weight[k], A, y)
    invert(A, least, root, inverse)
    for j in range(3):
        out[j] = inverse[j, 0] * y[0] + inverse[j, 1] * y[1] + inverse[j, 2] * y[2]


@kernel
def nearest_to_rays(starts: I64, ray: F64, origin: F64, weight: F64, regular: float, out: F64) -> None:
    """Write the (N, 3) points nearest to weighted rays, see `triangulate_rays`; `ray` (M, 3) are unit vectors."""
    room, y = np.empty((3, 3, 3)), np.empty(3)
    for n in range(starts.shape[0] - 1):
        nearest_point(ray, origin, weight, starts[n], starts[n + 1], regular, room, y, out[n])


@kernel
def eliminate_list(
    starts: I64, residual: F64, by_pose: F64, by_point: F64, regular: float,
    coupling: F64, gradient: F64, root: F64, inverse: F64,
) -> None:  # fmt: skip
    """Eliminate N points from M linearised observations, sorted by point (M21).

    Args:
        starts: (N + 1,) first observation of each point, then M.
        residual, by_pose, by_point: (M, 2), (M, 2, 6), (M, 2, 3) residuals, and Jacobians with respect to pose and
            point, in sigmas.
        regular: constant added to the diagonal of a point's block.
        coupling: (M, 6, 3) out: by_pose' by_point root.
        gradient: (N, 3) out: right side of the points.
        root, inverse: (N, 3, 3) out: root of the covariance of the points for exact poses, and that covariance.
    """
    V = np.empty((3, 3))
    for n in range(starts.shape[0] - 1):
        V[:], gradient[n] = 0.0, 0.0
        for k in range(starts[n], starts[n + 1]):
            for h in range(2):
                _add_row(by_point[k, h], residual[k, h], V, gradient[n])
        for i in range(3):
            V[i, i] += regular
        invert(V, regular, root[n], inverse[n])
        for k in range(starts[n], starts[n + 1]):
            for i in range(6):
                for j in range(3):
                    coupling[k, i, j] = by_pose[k, 0, i] * by_point[k, 0, j] + by_pose[k, 1, i] * by_point[k, 1, j]
            _times_root(coupling[k], root[n])


@inline
def _nearest(normalised: F64, R: F64, origin: F64, regular: float, A: F64, y: F64) -> None:
    A[:], y[:] = 0.0, 0.0
    for i in range(3):
        A[i, i] = regular
    for k in range(normalised.shape[0]):
        for c in range(normalised.shape[1]):
            if np.isfinite(normalised[k, c, 0]):
                T = R[k, c]
                u = T[:, 0] * normalised[k, c, 0] + T[:, 1] * normalised[k, c, 1] + T[:, 2]
                u /= np.sqrt(u[0] ** 2 + u[1] ** 2 + u[2] ** 2)
                _add_ray(u, origin[k, c], 1.0, A, y)


@inline
def _linearise_point(
    normalised: F64, sigma: F64, R: F64, origin: F64, near: float, x: F64, q: F64, A: F64, y: F64
) -> None:
    """Add the observations of one feature, linearised at its point `x`, to its normal equations A (lower half), y."""
    for k in range(normalised.shape[0]):
        for c in range(normalised.shape[1]):
            if not np.isfinite(normalised[k, c, 0]):
                continue
            T = R[k, c]
            to_camera(T, origin[k, c], x, q)
            if q[2] > near:
                for d in range(2):
                    at = q[d] / q[2]
                    e, w = (normalised[k, c, d] - at) / sigma[k], 1.0 / (sigma[k] * q[2])
                    r0, r1, r2 = (
                        w * (T[0, d] - at * T[0, 2]),
                        w * (T[1, d] - at * T[1, 2]),
                        w * (T[2, d] - at * T[2, 2]),
                    )
                    A[0, 0] += r0 * r0
                    A[1, 0] += r1 * r0
                    A[1, 1] += r1 * r1
                    A[2, 0] += r2 * r0
                    A[2, 1] += r2 * r1
                    A[2, 2] += r2 * r2
                    y[0] += r0 * e
                    y[1] += r1 * e
                    y[2] += r2 * e


@kernel
def triangulate_tracks(
    normalised: F64, sigma: F64, R: F64, origin: F64, iterations: int, near: float, regular: float, out: F64
) -> None:
    """Write the (N, 3) least-squares points: the point nearest to the rays, refined by Gauss-Newton (M12).

    Args:
        normalised, sigma: as in `WindowObservations`.
        R, origin: (K, C, 3, 3), (K, C, 3) world_from_cam.
        iterations: number of Gauss-Newton steps.
        near: least depth along the optical axis, m; observations of nearer points are left out.
        regular: constant added to the diagonal of a point's equations, 1/m^2.
    """
    A, root, inverse, y, q = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty(3)
    for n in range(normalised.shape[0]):
        _nearest(normalised[n], R, origin, regular, A, y)
        invert(A, regular, root, inverse)
        x = out[n]
        x[:] = 0.0
        for i in range(iterations + 1):
            for j in range(3):
                x[j] += inverse[j, 0] * y[0] + inverse[j, 1] * y[1] + inverse[j, 2] * y[2]
            if i == iterations:
                break
            A[:], y[:] = 0.0, 0.0
            for j in range(3):
                A[j, j] = regular
            _linearise_point(normalised[n], sigma[n], R, origin, near, x, q, A, y)
            invert(A, regular, root, inverse)


@kernel
def marginalise_tracks(
    normalised: F64, sigma: F64, x: F64,
    R: F64, origin: F64, first_R: F64, first_origin: F64, first_p: F64, near: float, regular: float,
    own: F64, coupling: F64, b: F64, misfit: F64, freedom: I64, root: F64, inverse: F64, step: F64,
) -> None:  # fmt: skip
    """Eliminate the points of N features from linearised observations; write the fields of `PoseConstraint` (M21).

    Residuals are taken at the estimates, Jacobians at the first estimates. `own` and `coupling` are the fields A and V.
    The inputs are as in `triangulate_tracks`, with the points `x` (N, 3) and the first estimates of the cameras
    (`first_R`, `first_origin`) and of the rig (`first_p` (K, 3)).
    """
    V, g, q, f = np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(3)
    P, X = np.empty((2, 6)), np.empty((2, 3))
    for n in range(normalised.shape[0]):
        own[n], coupling[n], b[n] = 0.0, 0.0, 0.0
        V[:], g[:] = 0.0, 0.0
        square, rows = 0.0, -3
        for k in range(normalised.shape[1]):
            d = x[n] - first_p[k]
            for c in range(normalised.shape[2]):
                if not np.isfinite(normalised[n, k, c, 0]):
                    continue
                to_camera(R[k, c], origin[k, c], x[n], q)
                to_camera(first_R[k, c], first_origin[k, c], x[n], f)
                if q[2] <= near or f[2] <= near:
                    continue
                rows += 2
                T = first_R[k, c]
                for h in range(2):
                    e = (normalised[n, k, c, h] - q[h] / q[2]) / sigma[n, k]
                    w, at = 1.0 / (sigma[n, k] * f[2]), f[h] / f[2]
                    for i in range(3):
                        X[h, i] = w * (T[i, h] - at * T[i, 2])
                        P[h, 3 + i] = -X[h, i]
                    P[h, 0] = X[h, 1] * d[2] - X[h, 2] * d[1]
                    P[h, 1] = X[h, 2] * d[0] - X[h, 0] * d[2]
                    P[h, 2] = X[h, 0] * d[1] - X[h, 1] * d[0]
                    square += e * e
                    for i in range(6):
                        b[n, k, i] += P[h, i] * e
                        for j in range(6):
                            own[n, k, i, j] += P[h, i] * P[h, j]
                        for j in range(3):
                            coupling[n, k, i, j] += P[h, i] * X[h, j]
                    _add_row(X[h], e, V, g)
        for i in range(3):
            V[i, i] += regular
        invert(V, regular, root[n], inverse[n])
        for i in range(3):
            step[n, i] = inverse[n, i, 0] * g[0] + inverse[n, i, 1] * g[1] + inverse[n, i, 2] * g[2]
        for k in range(normalised.shape[1]):
            for i in range(6):
                W = coupling[n, k, i]
                b[n, k, i] -= W[0] * step[n, 0] + W[1] * step[n, 1] + W[2] * step[n, 2]
            _times_root(coupling[n, k], root[n])
        misfit[n] = square - (g[0] * step[n, 0] + g[1] * step[n, 1] + g[2] * step[n, 2])
        freedom[n] = rows
