"""Normal equations that reach only from one block of unknowns to the next: Cholesky, solution, covariance (M21).

Time and memory grow with the length of the flight, not with its square.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from alight.records import F64


class BlockTridiagonal:
    """Symmetric positive definite equations `A x = g` in blocks of `size` unknowns."""

    def __init__(self, blocks: int, size: int) -> None:
        self.size = size
        self.g = np.zeros(blocks * size)
        self._diagonal = np.zeros((blocks, size, size))
        self._below = np.zeros((max(blocks - 1, 0), size, size))  # row block b + 1, column block b

    def add(self, rows: NDArray[np.int64], A: F64, g: F64) -> None:
        """Add a (m, m) term and its (m,) right side at the unknowns `rows`, all within two neighbouring blocks."""
        n, block = self.size, int(rows.min()) // self.size
        local = rows - block * n
        low, high = local < n, local >= n
        self.g[rows] += g
        self._diagonal[block][np.ix_(local[low], local[low])] += A[np.ix_(low, low)]
        if high.any():
            self._below[block][np.ix_(local[high] - n, local[low])] += A[np.ix_(high, low)]
            self._diagonal[block + 1][np.ix_(local[high] - n, local[high] - n)] += A[np.ix_(high, high)]

    def solve(self) -> tuple[F64, F64]:
        """Return x, and the (blocks, size, size) diagonal blocks of the inverse of A.

        Raises:
            numpy.linalg.LinAlgError: A is not positive definite.
        """
        factors, gains, y = [], [], self.g.reshape(-1, self.size).copy()
        S = self._diagonal[0]
        for b in range(len(self._diagonal)):
            factors.append(cho_factor(S, lower=True))
            if b < len(self._below):
                E = self._below[b]
                gains.append(cho_solve(factors[b], E.T))
                S = self._diagonal[b + 1] - E @ gains[b]
                y[b + 1] -= gains[b].T @ y[b]
        return self._back(factors, gains, y)

    def _back(self, factors: list[tuple[F64, bool]], gains: list[F64], y: F64) -> tuple[F64, F64]:
        x, covariance = np.empty_like(y), np.empty_like(self._diagonal)
        for b in reversed(range(len(factors))):
            x[b] = cho_solve(factors[b], y[b])
            covariance[b] = cho_solve(factors[b], np.eye(self.size))
            if b < len(gains):
                x[b] -= gains[b] @ x[b + 1]
                covariance[b] += gains[b] @ covariance[b + 1] @ gains[b].T
        return x.ravel(), covariance
