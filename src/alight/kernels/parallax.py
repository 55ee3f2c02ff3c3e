"""Loops of Gauss-Newton on the world grid: template, normal equations, windowed step (docs/method.md, eqs. 8 to 11).

Sample stacks are (N, R, C) float32 with NaN outside an image. Everything runs row by row in short loops without
branches, which the compiler turns into vector code: five to twelve times faster than cell by cell.
"""

import numpy as np
from numpy.typing import NDArray

from alight.kernels.compiler import kernel, parallel_kernel, pixelwise, prange
from alight.kernels.sorting import fill_row, median_row, sort_rows

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]
I64 = NDArray[np.int64]

UNKNOWN = np.float32(1e6)  # metres: a height so far from all others that no weight is left
BAND = 32  # rows a thread takes at once
CHUNK = 128  # columns of them
STRIDE = CHUNK + 4  # with two neighbours on either side
F = np.float32
Four = tuple[np.float32, np.float32, np.float32, np.float32]
ZERO, ONE, TWO = np.float32(0), np.float32(1), np.float32(2)


@kernel
def _normalise_row(grey: F32, mean: F32, norm: F32, floor: np.float32) -> None:
    for c in range(grey.size):
        variance = norm[c] - mean[c] * mean[c]
        sd = np.sqrt(variance if variance > ZERO else ZERO)
        norm[c] = (grey[c] - mean[c]) / (sd if sd > floor else floor)


@parallel_kernel
def normalise(grey: F32, mean: F32, norm: F32, floor: float) -> None:
    """Turn the local mean square `norm` (H, W) into the grey level less the local mean over the local sd (eq. 5)."""
    for r in prange(grey.shape[0]):
        _normalise_row(grey[r], mean[r], norm[r], np.float32(floor))


@kernel
def _weigh_row(s: F32, median: F32, seen: F32, narrow: np.float32, w: F32, sw: F32, sm: F32, used: F32) -> None:
    for c in range(s.size):
        e = s[c] - median[c]
        share = ONE - narrow * e * e
        good = (share > ZERO) & (seen[c] >= TWO)  # False for NaN
        weight = share * share if good else ZERO
        w[c] = weight
        sw[c] += weight
        sm[c] += weight * s[c] if good else ZERO
        used[c] += ONE if good else ZERO


@kernel
def _mean_row(sw: F32, sm: F32, mean: F32) -> None:
    for c in range(sw.size):
        mean[c] = sm[c] / sw[c] if sw[c] > ZERO else np.float32(np.nan)


@kernel
def _template_row(
    samples: F32, r: int, pairs: I64, narrow: np.float32, views: F32, sm: F32, median: F32,
    weights: F32, sw: F32, mean: F32, used: F32, seen: F32,
) -> None:  # fmt: skip
    """One row of the template; `views` (N, C), `sm` and `median` are scratch."""
    n = samples.shape[0]
    sw[:], sm[:], used[:], seen[:] = ZERO, ZERO, ZERO, ZERO
    for i in range(n):
        fill_row(samples[i, r], views[i], seen)
    sort_rows(views, pairs)
    median_row(views, seen, median)
    for i in range(n):
        _weigh_row(samples[i, r], median, seen, narrow, weights[i], sw, sm, used)
    _mean_row(sw, sm, mean)


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
    s: F32, w: F32, m: F32, h: F32, gx: F32, gy: F32,
    east: np.float32, cell: np.float32, north: np.float32, up: np.float32, sums: F32,
) -> None:  # fmt: skip
    """Add one view's row to the sums of w q, w q^2, w q e, w e^2; those of w e are zero, m being the mean."""
    sq, sqq, sqe, see = sums[0], sums[1], sums[2], sums[3]
    for c in range(s.size):
        used = w[c] > ZERO
        q = (gx[c] * (east + np.float32(c) * cell) + gy[c] * north) / (up - h[c])
        e = s[c] - m[c]
        q, e = (q if used else ZERO), (e if used else ZERO)
        wq, we = w[c] * q, w[c] * e
        sq[c] += wq
        sqq[c] += wq * q
        sqe[c] += wq * e
        see[c] += we * e


@kernel
def _normal_row(sums: F32, sw: F32, gx: F32, gy: F32, m: F32, used: F32, lam: F32, eta: F32, s2: F32) -> None:
    sq, sqq, sqe, see = sums[0], sums[1], sums[2], sums[3]
    for c in range(m.size):
        known = gx[c] + gy[c] + m[c]
        good = (used[c] >= TWO) & (known == known)
        inverse = ONE / (sw[c] if good else ONE)
        many = used[c] if good else TWO
        a = sqq[c] - sq[c] * sq[c] * inverse
        v = see[c] * inverse * many / (many - ONE)
        lam[c] = a if good else ZERO
        eta[c] = -sqe[c] if good else ZERO
        s2[c] = v if good else ZERO


@kernel
def _count_row(count: F32, out: U8) -> None:
    for c in range(count.size):
        out[c] = np.uint8(count[c])


@parallel_kernel
def normal_equations(
    samples: F32, pairs: I64, tau: float, centres: F64, xs: F64, ys: F64, h: F32, cell: float,
    mean: F32, used: U8, number: U8, lam: F32, eta: F32, s2: F32,
) -> None:  # fmt: skip
    """Fill the template m (eq. 8), Lambda, eta (eqs. 9, 10) and the residual variance of every cell.

    q_i = grad m . (v_i - vbar), v_i = ((X, Y) - C_i,xy) / (C_i,z - h): how far view i's sample slides over the ground a
    metre of height. The template's gradient carries none of the single views' noise. `pairs`: the sorting network of N.
    `used` gets the views that agree, within 4 tau of the median, `number` those that see.
    """
    n, rows, cols = samples.shape
    scale, narrow = np.float32(0.5 / cell), np.float32(1.0 / (16.0 * tau * tau))
    for band in prange((rows + BAND - 1) // BAND):
        first, end = band * BAND, min(rows, band * BAND + BAND)
        views, weights = np.empty((n, cols), np.float32), np.empty((3, n, cols), np.float32)
        of_three = np.empty((3, 4, cols), np.float32)  # mean, sum of weights, used, seen of a row and its neighbours
        sm, median = np.empty(cols, np.float32), np.empty(cols, np.float32)
        sums, gx, gy = np.empty((4, cols), np.float32), np.empty(cols, np.float32), np.empty(cols, np.float32)
        for ahead in range(max(first - 1, 0), min(end + 1, rows) + 1):
            if ahead < rows:
                k = of_three[ahead % 3]
                _template_row(
                    samples, ahead, pairs, narrow, views, sm, median, weights[ahead % 3], k[1], k[0], k[2], k[3]
                )  # fmt: skip
            r = ahead - 1
            if r < first or r >= end:
                continue
            k = of_three[r % 3]
            m, sw, agree = k[0], k[1], k[2]
            mean[r] = m
            _count_row(agree, used[r])
            _count_row(k[3], number[r])
            gx[:] = gy[:] = np.nan
            sums[:] = ZERO
            if 0 < r < rows - 1:
                _gradient_row(m, of_three[(r - 1) % 3, 0], of_three[(r + 1) % 3, 0], scale, gx, gy)
                for i in range(n):
                    east, north = np.float32(xs[0] - centres[i, 0]), np.float32(ys[r] - centres[i, 1])
                    up = np.float32(centres[i, 2])
                    _sum_row(samples[i, r], weights[r % 3, i], m, h[r], gx, gy, east, np.float32(cell), north, up, sums)
            _normal_row(sums, sw, gx, gy, m, agree, lam[r], eta[r], s2[r])


@kernel
def _fill_known(h: F32, out: F32) -> None:
    for c in range(h.size):
        out[c] = h[c] if h[c] == h[c] else UNKNOWN


@kernel
def invert_row(x: F32, out: F32) -> None:
    """Fill with 1 / x."""
    for c in range(x.size):
        out[c] = ONE / x[c]


@pixelwise
def _tap(h: F32, lam: F32, eta: F32, s2: F32, i: int, here: np.float32, inverse: np.float32, sums: Four) -> Four:
    """Add one neighbour: 1 at the same height, nothing from two parallax pixels on."""
    d = (h[i] - here) * inverse
    share = ONE - np.float32(0.25) * d * d
    share = share if share > ZERO else ZERO
    w = share * share
    known = ONE if lam[i] > ZERO else ZERO
    return sums[0] + w * lam[i], sums[1] + w * eta[i], sums[2] + w * s2[i], sums[3] + w * known


@pixelwise
def _five(h: F32, lam: F32, eta: F32, s2: F32, i: int, here: np.float32, inverse: np.float32, sums: Four) -> Four:
    """Add five neighbours side by side."""
    sums = _tap(h, lam, eta, s2, i, here, inverse, sums)
    sums = _tap(h, lam, eta, s2, i + np.uintp(1), here, inverse, sums)
    sums = _tap(h, lam, eta, s2, i + np.uintp(2), here, inverse, sums)
    sums = _tap(h, lam, eta, s2, i + np.uintp(3), here, inverse, sums)
    return _tap(h, lam, eta, s2, i + np.uintp(4), here, inverse, sums)


@kernel
def _window_row(h: F32, lam: F32, eta: F32, s2: F32, inverse: F32, sl: F32, se: F32, sn: F32, sw: F32) -> None:
    """Sum 5 x 5 neighbours of a row of cells; arrays of rows `STRIDE` long from the upper left neighbour on.

    Unrolled, unsigned and with a stride that the compiler knows: three times as fast as a loop over neighbours.
    """
    for c in range(inverse.size):
        i, around = np.uintp(c), (ZERO, ZERO, ZERO, ZERO)
        here = h[i + np.uintp(2 * STRIDE + 2)]
        around = _five(h, lam, eta, s2, i, here, inverse[c], around)
        around = _five(h, lam, eta, s2, i + np.uintp(STRIDE), here, inverse[c], around)
        around = _five(h, lam, eta, s2, i + np.uintp(2 * STRIDE), here, inverse[c], around)
        around = _five(h, lam, eta, s2, i + np.uintp(3 * STRIDE), here, inverse[c], around)
        around = _five(h, lam, eta, s2, i + np.uintp(4 * STRIDE), here, inverse[c], around)
        sl[c], se[c], sn[c], sw[c] = around


@kernel
def _step_row(sums: F32, h: F32, spread: F32, limit: float, step: F32, precision: F32, noise: F32) -> None:
    for c in range(h.size):
        good = (sums[3, c] > ZERO) & (h[c] == h[c])
        damping = np.float32(0.02) * sums[2, c] / (spread[c] * spread[c]) + np.float32(1e-9)
        s = sums[1, c] / (sums[0, c] + damping)
        most = limit * spread[c]
        s = s if s < most else most
        s = s if s > -most else -most
        step[c] = s if good else ZERO
        precision[c] = sums[0, c] if good else ZERO
        noise[c] = sums[2, c] / (sums[3, c] if good else ONE) if good else ZERO


@parallel_kernel
def solve(
    lam: F32, eta: F32, s2: F32, h: F32, spread: F32, limit: float, step: F32, precision: F32, noise: F32
) -> None:
    """Window the normal equations over 5 x 5 cells of like height, fill the step (eq. 11).

    Neighbours count by (1 - (dh / 2 spread)^2)^2, not at all beyond: a window across a height step takes its own side.
    `precision` is the windowed Lambda, `noise` the windowed residual variance.
    """
    rows, cols = h.shape
    for band in prange((rows + BAND - 1) // BAND):
        first, end = band * BAND, min(rows, band * BAND + BAND)
        size = (BAND + 4) * STRIDE
        ph, pl, pe, pn = np.empty(size, F), np.empty(size, F), np.empty(size, F), np.empty(size, F)
        sums, inverse = np.empty((4, CHUNK), F), np.empty(CHUNK, F)
        for left in range(0, cols, CHUNK):
            width = min(CHUNK, cols - left)
            low, high = max(0, left - 2), min(cols, left + width + 2)
            ph[:] = pl[:] = pe[:] = pn[:] = ZERO  # a border that knows nothing
            for r in range(max(0, first - 2), min(rows, end + 2)):
                k = (r - first + 2) * STRIDE + low - left + 2
                inner = slice(k, k + high - low)
                _fill_known(h[r, low:high], ph[inner])
                pl[inner], pe[inner], pn[inner] = lam[r, low:high], eta[r, low:high], s2[r, low:high]
            for r in range(first, end):
                k, here = (r - first) * STRIDE, slice(left, left + width)
                invert_row(spread[r, here], inverse[:width])
                _window_row(ph[k:], pl[k:], pe[k:], pn[k:], inverse[:width], sums[0], sums[1], sums[2], sums[3])
                _step_row(
                    sums, h[r, here], spread[r, here], np.float32(limit), step[r, here], precision[r, here], noise[r, here]
                )  # fmt: skip
