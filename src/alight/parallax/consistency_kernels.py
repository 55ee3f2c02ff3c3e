"""Loops over views of one instant: deviations that they share and others do not (eqs. 15a and 16d, docs/method)."""

import numpy as np

from alight.arrays import F32, HALF, I64, ONE, ZERO, Mask
from alight.compiled import kernel, parallel_kernel, prange


@kernel
def _pair_row(a: F32, b: F32, m: F32, cut: np.float32, both: F32, own: F32, count: F32) -> None:
    for c in range(m.size):
        ea, eb = a[c] - m[c], b[c] - m[c]
        good = (abs(ea) < cut) & (abs(eb) < cut)  # False for NaN
        ea, eb = (ea if good else ZERO), (eb if good else ZERO)
        both[c] += ea * eb
        own[c] += HALF * (ea * ea + eb * eb)
        count[c] += ONE if good else ZERO


@kernel
def _sum_row(row: F32, count: F32, total: F32, square: F32) -> None:
    for c in range(row.size):
        known = row[c] == row[c]
        v = row[c] if known else ZERO
        count[c] += ONE if known else ZERO
        total[c] += v
        square[c] += v * v


@kernel
def _fold_row(sums: F32, block: int, out: F32) -> None:
    for c in range(sums.size):
        out[c // block] += sums[c]


@parallel_kernel
def common(samples: F32, pairs: I64, mean: F32, block: int, cut: float, out: F32) -> None:
    """Fill `out` (5, R / block, C / block), rounded up, with sums over blocks of cells.

    Rows 0 to 2 are sums over all pairs (i, j) of views: of e_i e_j, of (e_i^2 + e_j^2) / 2, and of 1, where e is the
    deviation of a sample from the template `mean` (R, C). Deviations that are unknown or reach `cut` are left out. Rows
    3 and 4 are sums of the squared template and of 1, where the template is known.

    Args:
        samples: (N, R, C) normalised grey of the views.
        pairs: (K, 2) indices of the views of each pair.
        block: side of a block, cells.
    """
    rows, cols = mean.shape
    for k in prange(out.shape[1]):
        sums = np.zeros((6, cols), np.float32)  # the last row is not wanted
        for r in range(k * block, min((k + 1) * block, rows)):
            for p in range(pairs.shape[0]):
                a, b = samples[pairs[p, 0], r], samples[pairs[p, 1], r]
                _pair_row(a, b, mean[r], np.float32(cut), sums[0], sums[1], sums[2])
            _sum_row(mean[r], sums[4], sums[5], sums[3])
        for s in range(5):
            out[s, k] = ZERO
            _fold_row(sums[s], block, out[s, k])


@kernel
def _spread_row(least: np.float32, count: F32, total: F32, square: F32) -> None:
    for c in range(count.size):
        enough = count[c] >= least
        spread = square[c] - total[c] * total[c] / max(count[c], ONE)
        total[c] = spread if enough else ZERO
        square[c] = square[c] if enough else ZERO
        count[c] = count[c] if enough else ZERO


@kernel
def _residual_row(residual: F32, trusted: Mask, total: F32, count: F32) -> None:
    for c in range(trusted.size):
        total[c] = residual[c] if trusted[c] else ZERO
        count[c] = ONE if trusted[c] else ZERO


@parallel_kernel
def disagreement(samples: F32, residual: F32, trusted: Mask, block: int, least: int, out: F32) -> None:
    """Fill `out` (5, R / block, C / block), rounded up, with sums over blocks of cells.

    Row 0 is the sum of squares of the samples about the mean of each cell, rows 1 and 2 are the sums of their squares
    and of 1, over cells that at least `least` views see. Row 3 is the sum of the map's `residual` (R, C), row 4 of 1,
    over its `trusted` (R, C) cells. `samples`: (N, R, C) normalised grey of the views.
    """
    rows, cols = trusted.shape
    for k in prange(out.shape[1]):
        out[:, k] = ZERO
        for r in range(k * block, min((k + 1) * block, rows)):
            sums = np.zeros((5, cols), np.float32)
            for i in range(samples.shape[0]):
                _sum_row(samples[i, r], sums[2], sums[0], sums[1])
            _spread_row(np.float32(least), sums[2], sums[0], sums[1])
            _residual_row(residual[r], trusted[r], sums[3], sums[4])
            for s in range(5):
                _fold_row(sums[s], block, out[s, k])


@parallel_kernel
def before_and_after(samples: F32, pairs: I64, block: int, least: int, between: F32, whole: F32, count: F32) -> None:
    """Compare the views before and after each moment between successive pairs of views, by sums over blocks of cells.

    The value v of a pair is the mean of its two samples. Cells that fewer than 2 `least` pairs see are left out.

    Args:
        samples: (N, R, C) normalised grey of the views.
        pairs: (K, 2) indices of the views of each pair, in order of time.
        block: side of a block, cells; there are R / `block` x C / `block` blocks, rounded up.
        between: (K - 1, ...) out, sums of n n' / (n + n') (m - m')^2, with the numbers n, n' and the means m, m' of the
            values before and after the moment; 0 where n or n' is less than `least`.
        whole: out, sum of squares of v about its mean over all times.
        count: out, number of v.
    """
    number, rows, cols = pairs.shape[0], samples.shape[1], samples.shape[2]
    for k in prange(count.shape[0]):
        between[:, k], whole[k], count[k] = ZERO, ZERO, ZERO
        v = np.empty(number, np.float32)
        for r in range(k * block, min((k + 1) * block, rows)):
            for c in range(cols):
                n, total, square, b = ZERO, ZERO, ZERO, c // block
                for p in range(number):
                    v[p] = HALF * (samples[pairs[p, 0], r, c] + samples[pairs[p, 1], r, c])
                    if v[p] == v[p]:
                        n += ONE
                        total += v[p]
                        square += v[p] * v[p]
                if n < 2 * least:
                    continue
                whole[k, b] += square - total * total / n
                count[k, b] += n
                first, earlier = ZERO, ZERO
                for p in range(number - 1):
                    if v[p] == v[p]:
                        first += ONE
                        earlier += v[p]
                    second = n - first
                    if first >= least and second >= least:
                        apart = earlier / first - (total - earlier) / second
                        between[p, k, b] += first * second / n * apart * apart
