"""Loops of Gauss-Newton on the world grid: template, normal equations, windowed step (docs/method.md, eqs. 8 to 11).

Sample stacks are (N, R, C) float32 with NaN outside an image. Everything runs row by row in short loops without
branches, which the compiler turns into vector code: five to twelve times faster than cell by cell.
"""

import numpy as np
from numpy.typing import NDArray

from alight.kernels.compiler import kernel, parallel_kernel, prange
from alight.kernels.sorting import fill_row, median_row, sort_rows

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]
I64 = NDArray[np.int64]

UNKNOWN = np.float32(1e6)  # metres: a height so far from all others that no weight is left
ZERO, ONE, TWO = np.float32(0), np.float32(1), np.float32(2)


@kernel
def _weigh_row(s: F32, median: F32, seen: F32, tau: np.float32, w: F32, sw: F32, sm: F32, used: F32) -> None:
    cut = np.float32(4) * tau
    for c in range(s.size):
        v = s[c]
        e = abs(v - median[c])
        good = (e < cut) & (seen[c] >= TWO)  # False for NaN
        weight = tau / (e if e > tau else tau)
        weight = weight if good else ZERO
        v = v if good else ZERO
        w[c] = weight
        sw[c] += weight
        sm[c] += weight * v
        used[c] += ONE if good else ZERO


@kernel
def _mean_row(sw: F32, sm: F32, count: F32, seen: F32, mean: F32, used: U8, number: U8) -> None:
    for c in range(sw.size):
        mean[c] = sm[c] / sw[c] if sw[c] > ZERO else np.float32(np.nan)
        used[c] = np.uint8(count[c])
        number[c] = np.uint8(seen[c])


@parallel_kernel
def template(samples: F32, pairs: I64, tau: float, weights: F32, mean: F32, used: U8, number: U8) -> None:
    """Fill `weights` (N, R, C) and the samples' robust mean m (eq. 8): Huber, nothing beyond 4 tau of the median.

    `pairs`: the sorting network of N. `used` gets the views that agree, `number` those that see.
    """
    n, rows, cols = samples.shape
    for r in prange(rows):
        views = np.empty((n, cols), np.float32)
        rest = np.zeros((5, cols), np.float32)
        seen, median, sw, sm, count = rest[0], rest[1], rest[2], rest[3], rest[4]
        for i in range(n):
            fill_row(samples[i, r], views[i], seen)
        sort_rows(views, pairs)
        median_row(views, seen, median)
        for i in range(n):
            _weigh_row(samples[i, r], median, seen, np.float32(tau), weights[i, r], sw, sm, count)
        _mean_row(sw, sm, count, seen, mean[r], used[r], number[r])


@kernel
def _reach_row(s: F32, east: np.float32, north: np.float32, box: F32) -> None:
    """Widen the box (east, west, north, south, number) of the centres that see each cell."""
    for c in range(s.size):
        seen = s[c] == s[c]
        box[0, c] = east if seen & (east > box[0, c]) else box[0, c]
        box[1, c] = east if seen & (east < box[1, c]) else box[1, c]
        box[2, c] = north if seen & (north > box[2, c]) else box[2, c]
        box[3, c] = north if seen & (north < box[3, c]) else box[3, c]
        box[4, c] += ONE if seen else ZERO


@parallel_kernel
def baseline(samples: F32, centres: F64, out: F32, seen: U8) -> None:
    """Fill `out` (R, C) with the diagonal of the box, level with the ground, of the cameras that see each cell.

    `seen` gets their number.
    """
    n, rows, cols = samples.shape
    for r in prange(rows):
        box = np.zeros((5, cols), np.float32)
        box[0], box[1], box[2], box[3] = -UNKNOWN, UNKNOWN, -UNKNOWN, UNKNOWN
        for i in range(n):
            _reach_row(samples[i, r], np.float32(centres[i, 0]), np.float32(centres[i, 1]), box)
        for c in range(cols):
            de, dn = box[0, c] - box[1, c], box[2, c] - box[3, c]
            out[r, c] = np.sqrt(de * de + dn * dn) if de >= ZERO else ZERO
            seen[r, c] = np.uint8(box[4, c])


@kernel
def _gradient_row(m: F32, up: F32, down: F32, scale: np.float32, gx: F32, gy: F32) -> None:
    for c in range(1, m.size - 1):
        gx[c] = (m[c + 1] - m[c - 1]) * scale
        gy[c] = (up[c] - down[c]) * scale  # rows go south


@kernel
def _sum_row(
    s: F32, w: F32, m: F32, h: F32, gx: F32, gy: F32, east: F32, north: np.float32, up: np.float32, sums: F32
) -> None:
    """Add one view's row to the sums of w, w q, w q^2, w e, w q e, w e^2."""
    sw, sq, sqq, se, sqe, see = sums[0], sums[1], sums[2], sums[3], sums[4], sums[5]
    for c in range(s.size):
        used = w[c] > ZERO
        q = (gx[c] * east[c] + gy[c] * north) / (up - h[c])
        e = s[c] - m[c]
        q, e = (q if used else ZERO), (e if used else ZERO)
        wq, we = w[c] * q, w[c] * e
        sw[c] += w[c]
        sq[c] += wq
        sqq[c] += wq * q
        se[c] += we
        sqe[c] += wq * e
        see[c] += we * e


@kernel
def _normal_row(sums: F32, gx: F32, gy: F32, m: F32, used: U8, lam: F32, eta: F32, s2: F32) -> None:
    sw, sq, sqq, se, sqe, see = sums[0], sums[1], sums[2], sums[3], sums[4], sums[5]
    for c in range(m.size):
        k = np.float32(used[c])
        known = gx[c] + gy[c] + m[c]
        good = (k >= TWO) & (known == known)
        inverse = ONE / (sw[c] if good else ONE)
        many = k if good else TWO
        a = sqq[c] - sq[c] * sq[c] * inverse
        b = sq[c] * se[c] * inverse - sqe[c]
        v = see[c] * inverse * many / (many - ONE)
        lam[c] = a if good else ZERO
        eta[c] = b if good else ZERO
        s2[c] = v if good else ZERO


@kernel
def _east_row(xs: F64, centre: np.float64, out: F32) -> None:
    for c in range(xs.size):
        out[c] = xs[c] - centre


@parallel_kernel
def normal_equations(
    samples: F32,
    weights: F32,
    mean: F32,
    used: U8,
    centres: F64,
    xs: F64,
    ys: F64,
    h: F32,
    cell: float,
    lam: F32,
    eta: F32,
    s2: F32,
) -> None:
    """Fill Lambda, eta (eqs. 9, 10) and the residual variance of every cell from the template's gradient.

    q_i = grad m . (v_i - vbar), v_i = ((X, Y) - C_i,xy) / (C_i,z - h): how far view i's sample slides over the ground a
    metre of height. The template's gradient carries none of the single views' noise.
    """
    n, rows, cols = samples.shape
    scale = np.float32(0.5 / cell)
    for r in prange(rows):
        sums = np.zeros((6, cols), np.float32)
        gx, gy = np.full(cols, np.nan, np.float32), np.full(cols, np.nan, np.float32)
        if 0 < r < rows - 1:
            _gradient_row(mean[r], mean[r - 1], mean[r + 1], scale, gx, gy)
            east = np.empty(cols, np.float32)
            for i in range(n):
                _east_row(xs, centres[i, 0], east)
                north, up = np.float32(ys[r] - centres[i, 1]), np.float32(centres[i, 2])
                _sum_row(samples[i, r], weights[i, r], mean[r], h[r], gx, gy, east, north, up, sums)
        _normal_row(sums, gx, gy, mean[r], used[r], lam[r], eta[r], s2[r])


@kernel
def _fill_known(h: F32, out: F32) -> None:
    for c in range(h.size):
        out[c] = h[c] if h[c] == h[c] else UNKNOWN


@kernel
def _window_row(h: F32, near: F32, lam: F32, eta: F32, s2: F32, spread: F32, dx: int, sums: F32) -> None:
    """Add the neighbours `dx` columns to the right, of one row, to the windowed sums."""
    low, high = max(0, -dx), min(h.size, h.size - dx)
    here, there, p = h[low:high], near[low + dx : high + dx], spread[low:high]
    lam, eta, s2 = lam[low + dx : high + dx], eta[low + dx : high + dx], s2[low + dx : high + dx]
    sl, se, sn, sw = sums[0, low:high], sums[1, low:high], sums[2, low:high], sums[3, low:high]
    for c in range(here.size):
        d = (there[c] - here[c]) / p[c]
        w = ONE / (ONE + d * d)
        w = w if lam[c] > ZERO else ZERO
        sl[c] += w * lam[c]
        se[c] += w * eta[c]
        sn[c] += w * s2[c]
        sw[c] += w


@kernel
def _step_row(sums: F32, h: F32, spread: F32, limit: F32, step: F32, precision: F32, noise: F32) -> None:
    for c in range(h.size):
        good = (sums[3, c] > ZERO) & (h[c] < UNKNOWN)
        damping = np.float32(0.02) * sums[2, c] / (spread[c] * spread[c]) + np.float32(1e-9)
        s = sums[1, c] / (sums[0, c] + damping)
        s = s if s < limit[c] else limit[c]
        s = s if s > -limit[c] else -limit[c]
        step[c] = s if good else ZERO
        precision[c] = sums[0, c] if good else ZERO
        noise[c] = sums[2, c] / (sums[3, c] if good else ONE) if good else ZERO


@parallel_kernel
def solve(
    lam: F32, eta: F32, s2: F32, h: F32, radius: int, spread: F32, limit: F32, step: F32, precision: F32, noise: F32
) -> None:
    """Window the normal equations over (2 radius + 1)^2 cells of like height, fill the step (eq. 11).

    Neighbours count by 1 / (1 + (dh / spread)^2): a window that straddles a height step takes its own side.
    `precision` is the windowed Lambda, `noise` the windowed residual variance.
    """
    rows, cols = h.shape
    for r in prange(rows):
        sums = np.zeros((4, cols), np.float32)
        here, there = np.empty(cols, np.float32), np.empty(cols, np.float32)
        _fill_known(h[r], here)
        for y in range(max(0, r - radius), min(rows, r + radius + 1)):
            _fill_known(h[y], there)
            for dx in range(-radius, radius + 1):
                _window_row(here, there, lam[y], eta[y], s2[y], spread[r], dx, sums)
        _step_row(sums, here, spread[r], limit[r], step[r], precision[r], noise[r])
