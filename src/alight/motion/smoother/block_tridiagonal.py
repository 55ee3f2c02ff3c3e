"""Block tridiagonal normal equations: Cholesky factors, solution, covariance (M21).

Time and memory grow with the length of the flight, not with its square.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from alight.arrays import F64


class BlockTridiagonal:
    """Symmetric positive definite equations `A x = g` in blocks of `size` unknowns."""

    def __init__(self, blocks: int, size: int) -> None:
        self.size = size
        self.g = np.zeros(blocks * size)
        self._diagonal = np.zeros((blocks, size, size))
        self._below = np.zeros((max(blocks - 1, 0), size, size))  # row block b + 1, column block b
        self._factors, self._gains = list[tuple[F64, bool]](), list[F64]()

    def add(self, rows: NDArray[np.int64], A: F64, g: F64) -> None:
        """Add an (m, m) matrix and its (m,) right side at the unknowns `rows`, all within two neighbouring blocks."""
        n, block = self.size, int(rows.min()) // self.size
        local = rows - block * n
        low, high = local < n, local >= n
        self.g[rows] += g
        self._diagonal[block][np.ix_(local[low], local[low])] += A[np.ix_(low, low)]
        if high.any():
            self._below[block][np.ix_(local[high] - n, local[low])] += A[np.ix_(high, low)]
            self._diagonal[block + 1][np.ix_(local[high] - n, local[high] - n)] += A[np.ix_(high, high)]

    def factorise(self) -> None:
        """Compute the block Cholesky factors, from which the solution and the covariance follow.

        Raises:
            numpy.linalg.LinAlgError: A is not positive definite.
        """
        S = self._diagonal[0]
        for b in range(len(self._diagonal)):
            self._factors.append(cho_factor(S, lower=True, check_finite=False))
            if b < len(self._below):
                self._gains.append(cho_solve(self._factors[b], self._below[b].T, check_finite=False))
                S = self._diagonal[b + 1] - self._below[b] @ self._gains[b]

    def solution(self) -> F64:
        """Return the solution x, (blocks * size,)."""
        x = self.g.reshape(-1, self.size).copy()
        for b, gain in enumerate(self._gains):
            x[b + 1] -= gain.T @ x[b]
        for b in reversed(range(len(self._factors))):
            x[b] = cho_solve(self._factors[b], x[b], check_finite=False)
            if b < len(self._gains):
                x[b] -= self._gains[b] @ x[b + 1]
        return x.ravel()

    def covariance(self) -> F64:
        """Return the diagonal blocks of the inverse of A, (blocks, size, size)."""
        out = np.empty_like(self._diagonal)
        for b in reversed(range(len(self._factors))):
            out[b] = cho_solve(self._factors[b], np.eye(self.size), check_finite=False)
            if b < len(self._gains):
                out[b] += self._gains[b] @ out[b + 1] @ self._gains[b].T
        return out

    def joint(self, rows: NDArray[np.int64], own: F64) -> F64:
        """Return the inverse of A at the m unknowns `rows`, ascending, (m, m); `own` is the result of `covariance`."""
        # backward over the blocks: the cross covariance of block b with any later unknown is that of block b + 1, times
        # minus the gain
        size, m = self.size, len(rows)
        out, later = np.zeros((m, m)), np.empty((size, 0))  # `later`: of block b + 1 with the rows from it on
        for b in reversed(range(len(self._factors))):
            here = np.flatnonzero(rows // size == b)
            local, stop = rows[here] - b * size, m - later.shape[1]
            later = np.hstack([own[b][:, local], -self._gains[b] @ later if b < len(self._gains) else later])
            out[stop - len(here) : stop, stop - len(here) :] = later[local]
        return np.asarray(np.triu(out) + np.triu(out, 1).T)
