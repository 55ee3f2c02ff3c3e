"""Kernels for the covariance of the filter's errors: propagation, insertion and removal of rows, distances."""

import math

import numpy as np

from alight.arrays import F64, I64
from alight.compiled import kernel


@kernel
def propagate_errors(P: F64, F: F64, Q: F64, decay: F64, drift: F64) -> None:
    """Propagate a covariance in place (M10).

    Args:
        P: (n, n) covariance; its first m rows are the motion, the next k rows the errors of GPS/INS.
        F, Q: (m, m) transition and noise covariance of the motion.
        decay, drift: (k,) transition and noise variance of the errors of GPS/INS.
    """
    n, m, k = len(P), len(F), len(decay)
    moved = np.dot(F, P[:m])
    for i in range(m):
        for j in range(m, n):
            P[i, j] = moved[i, j]
    block = np.dot(F, moved[:, :m].T.copy())
    for i in range(m):
        for j in range(m):
            P[i, j] = 0.5 * (block[i, j] + block[j, i]) + Q[i, j]
    for i in range(k):
        for j in range(n):
            P[m + i, j] *= decay[i]
    for i in range(k):
        for j in range(m):
            P[j, m + i] *= decay[i]
        for j in range(m, m + k):
            P[j, m + i] *= decay[i]
        P[m + i, m + i] += drift[i]
    for i in range(m + k):
        for j in range(m + k, n):
            P[j, i] = P[i, j]
    for i in range(m):
        for j in range(m, m + k):
            P[j, i] = P[i, j]


@kernel
def keep_rows(P: F64, kept: I64, out: F64) -> None:
    """Write the rows and columns `kept` (m,) of the covariance `P` to `out` (m, m)."""
    for i in range(len(kept)):
        row = P[kept[i]]
        for j in range(len(kept)):
            out[i, j] = row[kept[j]]


@kernel
def insert_rows(P: F64, at: int, cross: F64, own: F64, out: F64) -> None:
    """Write the covariance `P` (n, n) with k errors inserted at row and column `at` to `out` (n + k, n + k).

    `own` (k, k) is the covariance of the new errors, `cross` (k, n) is that of the new errors with the others.
    """
    n, k = len(P), len(own)
    for i in range(n):
        row = out[i if i < at else i + k]
        row[:at] = P[i, :at]
        row[at + k :] = P[i, at:]
        for j in range(k):
            row[at + j] = cross[j, i]
    for i in range(k):
        row = out[at + i]
        row[:at] = cross[i, :at]
        row[at + k :] = cross[i, at:]
        row[at : at + k] = own[i]


@kernel
def mirror_lower(P: F64) -> None:
    """Copy the lower triangle of P (n, n) to the upper one, block by block."""
    n, size = len(P), 16
    for top in range(0, n, size):
        for left in range(0, top + 1, size):
            for i in range(top, min(top + size, n)):
                for j in range(left, min(left + size, i)):
                    P[j, i] = P[i, j]


@kernel
def unit_noise_distance(residual: F64, S: F64, L: F64, y: F64) -> float:
    """Return `squared_distance`, from the lower half of `S` only; `L` (m, m) and `y` (m,) are scratch."""
    out = 0.0
    for r in range(len(residual)):
        e = residual[r]
        for s in range(r + 1):
            value = S[r, s] + (1.0 if r == s else 0.0)
            for i in range(s):
                value -= L[r, i] * L[s, i]
            L[r, s] = math.sqrt(value) if r == s else value / L[s, s]
        for i in range(r):
            e -= L[r, i] * y[i]
        y[r] = e / L[r, r]
        out += y[r] * y[r]
    return out


@kernel
def squared_distance(residual: F64, S: F64) -> float:
    """Return the squared Mahalanobis distance of a residual (m,) with covariance `S` (m, m) plus unit noise."""
    m = len(residual)
    return float(unit_noise_distance(residual, S, np.empty((m, m)), np.empty(m)))
