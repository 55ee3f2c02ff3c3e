"""Kernels for constraints of features on poses, with the points eliminated: sums, residuals and gates (M21).

N features, K poses. A of a feature is its block diagonal `own` (K, 6, 6) less V V', V (K, 6, 3); its right side is b
(K, 6). A pose that did not observe a feature has zero blocks.
"""

import math

import numpy as np

from alight.arrays import F64, I64
from alight.compiled import kernel


@kernel
def sum_information(own: F64, V: F64, b: F64, weight: F64, A: F64, total: F64) -> None:
    """Write the weighted sum of the constraints of all features: matrix `A` (6K, 6K) and right side `total` (6K,).

    `own`, `V` and `b` are the fields A, V and b of a `PoseConstraint`.
    """
    n, k = b.shape[:2]
    rows, diagonal = np.zeros((6 * k, 3 * n)), np.zeros((k, 6, 6))
    total[:] = 0.0
    count = 0
    for f in range(n):
        if weight[f] == 0.0:
            continue
        root = math.sqrt(weight[f])
        for i in range(k):
            if own[f, i, 3, 3] == 0.0 and own[f, i, 4, 4] == 0.0:
                continue
            for r in range(6):
                total[6 * i + r] += weight[f] * b[f, i, r]
                for c in range(6):
                    diagonal[i, r, c] += weight[f] * own[f, i, r, c]
                for c in range(3):
                    rows[6 * i + r, 3 * count + c] = root * V[f, i, r, c]
        count += 1
    used = rows[:, : 3 * count].copy()
    A[:] = -np.dot(used, used.T)
    for i in range(k):
        for r in range(6):
            for c in range(6):
                A[6 * i + r, 6 * i + c] += diagonal[i, r, c]


@kernel
def misfits_at(own: F64, V: F64, b: F64, misfit: F64, error: F64, out: F64) -> None:
    """Write the (N,) squared residuals if `error` (6K,) is added to the poses and each point follows.

    `own`, `V`, `b` and `misfit` are the fields A, V, b and misfit of a `PoseConstraint`.
    """
    n, k = b.shape[:2]
    for f in range(n):
        out[f] = misfit[f]
        along0, along1, along2 = 0.0, 0.0, 0.0
        for i in range(k):
            if own[f, i, 3, 3] == 0.0 and own[f, i, 4, 4] == 0.0:
                continue
            for r in range(6):
                e = error[6 * i + r]
                gradient = -2.0 * b[f, i, r]
                for c in range(6):
                    gradient += own[f, i, r, c] * error[6 * i + c]
                out[f] += gradient * e
                along0 += V[f, i, r, 0] * e
                along1 += V[f, i, r, 1] * e
                along2 += V[f, i, r, 2] * e
        out[f] -= along0 * along0 + along1 * along1 + along2 * along2


@kernel
def _observing(own: F64, poses: I64) -> int:
    count = 0
    for i in range(len(own)):
        if own[i, 3, 3] != 0.0 or own[i, 4, 4] != 0.0:
            poses[count] = i
            count += 1
    return count


@kernel
def pose_distances(own: F64, V: F64, b: F64, misfit: F64, P: F64, out: F64) -> None:
    """Write the (N,) squared Mahalanobis distance of each feature, given the (6K, 6K) covariance `P` of the poses.

    `own`, `V`, `b` and `misfit` are the fields A, V, b and misfit of a `PoseConstraint`.
    """
    n, k = b.shape[:2]
    poses = np.empty(k, np.int64)
    for f in range(n):
        m = _observing(own[f], poses)
        size = 6 * m
        A, prior, right = np.empty((size, size)), np.empty((size, size)), np.empty(size)
        for i in range(m):
            s = poses[i]
            for r in range(6):
                right[6 * i + r] = b[f, s, r]
            for j in range(m):
                t = poses[j]
                for r in range(6):
                    v0, v1, v2 = V[f, s, r, 0], V[f, s, r, 1], V[f, s, r, 2]
                    for c in range(6):
                        prior[6 * i + r, 6 * j + c] = P[6 * s + r, 6 * t + c]
                        value = -(v0 * V[f, t, c, 0] + v1 * V[f, t, c, 1] + v2 * V[f, t, c, 2])
                        A[6 * i + r, 6 * j + c] = value + (own[f, s, r, c] if i == j else 0.0)
        system = np.dot(A, prior)
        for i in range(size):
            system[i, i] += 1.0
        out[f] = misfit[f]
        if size:
            out[f] -= np.dot(right, np.dot(prior, np.linalg.solve(system, right)))


@kernel
def solve_pivoted(L: F64, pivots: I64, b: F64, residual: F64, rows: F64) -> None:
    """Write a residual and rows of unit noise with the information L L', b (see `points.unit_noise_rows`).

    Args:
        L: (n, n) lower Cholesky factor of the matrix, whose rows and columns are in the order of the pivots.
        pivots: (n,) order of the unknowns, numbered from 1 as in LAPACK.
        b: (n,) right side, in the order of the unknowns.
        residual: (m,) out, solution of L residual = b.
        rows: (m, n) zero on input, out: L' in the order of the unknowns.
    """
    for r in range(len(residual)):
        value = b[pivots[r] - 1]
        for i in range(r):
            value -= L[r, i] * residual[i]
        residual[r] = value / L[r, r]
        for c in range(r, len(b)):
            rows[r, pivots[c] - 1] = L[c, r]


@kernel
def largest_eigenvalues(A: F64, out: F64) -> None:
    """Write the largest eigenvalue of each of the (N, 3, 3) symmetric matrices `A` (trigonometric formula)."""
    for n in range(len(A)):
        a, b, c = A[n, 0, 0], A[n, 1, 1], A[n, 2, 2]
        d, e, f = A[n, 1, 0], A[n, 2, 1], A[n, 2, 0]
        mean = (a + b + c) / 3.0
        spread = math.sqrt(((a - mean) ** 2 + (b - mean) ** 2 + (c - mean) ** 2 + 2.0 * (d * d + e * e + f * f)) / 6.0)
        if not spread > 0.0:
            out[n] = mean
            continue
        a, b, c = (a - mean) / spread, (b - mean) / spread, (c - mean) / spread
        d, e, f = d / spread, e / spread, f / spread
        half = 0.5 * (a * (b * c - e * e) - d * (d * c - e * f) + f * (d * e - b * f))
        out[n] = mean + 2.0 * spread * math.cos(math.acos(min(max(half, -1.0), 1.0)) / 3.0)
