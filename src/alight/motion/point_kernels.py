"""Points out of their sights, and what is left of the sights without the points (docs/method/motion.md, M12, M21).

N features, K poses of a rig, C cameras. NumPy takes forty small steps for what is a few thousand multiplications.
"""

import numpy as np
from numpy.typing import NDArray

from alight.compiled import inline, kernel

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]


@inline
def _invert(A: F64, least: float, root: F64, inverse: F64) -> None:
    """Write the inverse of a symmetric positive definite (3, 3) and an upper `root` with root root' = inverse.

    Pivots below `least` are rounding.
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
def _seen_from(turn: F64, origin: F64, x: F64, q: F64) -> None:
    """Write a world point in a camera's frame."""
    for i in range(3):
        q[i] = (
            turn[0, i] * (x[0] - origin[0]) + turn[1, i] * (x[1] - origin[1]) + turn[2, i] * (x[2] - origin[2])
        )  # fmt: skip


@inline
def _nearest(seen: F64, turn: F64, origin: F64, regular: float, A: F64, y: F64) -> None:
    """Sum up the equations of the place nearest to all rays of one feature."""
    A[:], y[:] = 0.0, 0.0
    for i in range(3):
        A[i, i] = regular
    for k in range(seen.shape[0]):
        for c in range(seen.shape[1]):
            if np.isfinite(seen[k, c, 0]):
                T, o = turn[k, c], origin[k, c]
                u = T[:, 0] * seen[k, c, 0] + T[:, 1] * seen[k, c, 1] + T[:, 2]
                u /= np.sqrt(u[0] ** 2 + u[1] ** 2 + u[2] ** 2)
                along = u[0] * o[0] + u[1] * o[1] + u[2] * o[2]
                for i in range(3):
                    y[i] += o[i] - u[i] * along
                    A[i, i] += 1.0
                    for j in range(3):
                        A[i, j] -= u[i] * u[j]


@inline
def _improve(seen: F64, sigma: F64, turn: F64, origin: F64, near: float, x: F64, q: F64, A: F64, y: F64) -> None:
    """Add the normal equations of one feature's point at `x` to A, y."""
    for k in range(seen.shape[0]):
        for c in range(seen.shape[1]):
            if not np.isfinite(seen[k, c, 0]):
                continue
            T = turn[k, c]
            _seen_from(T, origin[k, c], x, q)
            if q[2] > near:
                for d in range(2):
                    at = q[d] / q[2]
                    e, w = (seen[k, c, d] - at) / sigma[k], 1.0 / (sigma[k] * q[2])
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
    seen: F64, sigma: F64, turn: F64, origin: F64, iterations: int, near: float, regular: float, out: F64
) -> None:
    """Write the (N, 3) points of least squares: the place nearest to the rays, then Gauss-Newton (M12).

    Args:
        seen: (N, K, C, 2) normalised coordinates, NaN = not seen.
        sigma: (N, K) of them.
        turn, origin: (K, C, 3, 3), (K, C, 3) world_from_cam.
        near: m along the axis that a point must have.
        regular: 1/m^2 on the diagonal.
    """
    A, root, inverse, y, q = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty(3)
    for n in range(seen.shape[0]):
        _nearest(seen[n], turn, origin, regular, A, y)
        _invert(A, regular, root, inverse)
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
            _improve(seen[n], sigma[n], turn, origin, near, x, q, A, y)
            _invert(A, regular, root, inverse)


@kernel
def marginalise_tracks(
    seen: F64, sigma: F64, x: F64,
    turn: F64, origin: F64, first_turn: F64, first_origin: F64, first_p: F64, near: float, regular: float,
    own: F64, mixed: F64, b: F64, misfit: F64, freedom: I64, root: F64, inverse: F64, step: F64,
) -> None:  # fmt: skip
    """Linearise the sights of N points, residuals now and Jacobians at first estimates; eliminate the points (M21).

    Args:
        x: (N, 3) points.
        first_turn, first_origin, first_p: the first estimates of the cameras, and (K, 3) of the rig.
        own: (N, K, 6, 6) information of each pose by itself.
        mixed: (N, K, 6, 3): A of a feature is its blocks less mixed mixed'.
        b: (N, K, 6) right side, the point eliminated.
        misfit: (N,) squared residual that no place of the point takes away.
        freedom: (N,) rows less three.
        root, inverse: (N, 3, 3) covariance of the point for exact poses, and its root.
        step: (N, 3) from `x` to the best place for the poses as they are.
    """
    V, g, q, f = np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(3)
    P, X = np.empty((2, 6)), np.empty((2, 3))
    for n in range(seen.shape[0]):
        own[n], mixed[n], b[n] = 0.0, 0.0, 0.0
        V[:], g[:] = 0.0, 0.0
        square, rows = 0.0, -3
        for k in range(seen.shape[1]):
            d = x[n] - first_p[k]
            for c in range(seen.shape[2]):
                if not np.isfinite(seen[n, k, c, 0]):
                    continue
                _seen_from(turn[k, c], origin[k, c], x[n], q)
                _seen_from(first_turn[k, c], first_origin[k, c], x[n], f)
                if q[2] <= near or f[2] <= near:
                    continue
                rows += 2
                T = first_turn[k, c]
                for h in range(2):
                    e = (seen[n, k, c, h] - q[h] / q[2]) / sigma[n, k]
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
                            mixed[n, k, i, j] += P[h, i] * X[h, j]
                    for i in range(3):
                        g[i] += X[h, i] * e
                        for j in range(3):
                            V[i, j] += X[h, i] * X[h, j]
        for i in range(3):
            V[i, i] += regular
        _invert(V, regular, root[n], inverse[n])
        _eliminate(mixed[n], b[n], g, root[n], inverse[n], step[n])
        misfit[n] = square - (g[0] * step[n, 0] + g[1] * step[n, 1] + g[2] * step[n, 2])
        freedom[n] = rows


@kernel
def _eliminate(mixed: F64, b: F64, g: F64, root: F64, inverse: F64, step: F64) -> None:
    """Take one point out: `mixed` times the root of its covariance, `b` less what the point takes."""
    for i in range(3):
        step[i] = inverse[i, 0] * g[0] + inverse[i, 1] * g[1] + inverse[i, 2] * g[2]
    for k in range(mixed.shape[0]):
        for i in range(6):
            u, v, w = mixed[k, i, 0], mixed[k, i, 1], mixed[k, i, 2]
            b[k, i] -= u * step[0] + v * step[1] + w * step[2]
            mixed[k, i, 0] = u * root[0, 0]
            mixed[k, i, 1] = u * root[0, 1] + v * root[1, 1]
            mixed[k, i, 2] = u * root[0, 2] + v * root[1, 2] + w * root[2, 2]
