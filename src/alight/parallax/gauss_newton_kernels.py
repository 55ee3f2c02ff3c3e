"""Loops of Gauss-Newton on the world grid: template, normal equations, windowed step (docs/method/parallax.md, 8-11).

Sample stacks are (N, R, C) float32 with NaN outside an image. The loops run over single rows and have no branches, so
the compiler vectorises them: they are five to twelve times faster than loops over cells.
"""

import numpy as np

from alight.arrays import F32, F64, FAR, I64, ONE, TWO, U8, ZERO
from alight.compiled import inline, kernel, parallel_kernel, pixelwise, prange
from alight.parallax.sorting_kernels import fill_row, median_row, sort_rows

BAND = 24  # rows that a thread processes at a time
CHUNK = 640  # columns processed at a time
STRIDE = CHUNK + 4  # columns with two neighbours on either side
F = np.float32
Three = tuple[np.float32, np.float32, np.float32]
Four = tuple[np.float32, np.float32, np.float32, np.float32]


@kernel
def _no_lone_row(seen: F32, median: F32) -> None:
    for c in range(seen.size):
        median[c] = median[c] if seen[c] >= TWO else FAR  # a median that no sample agrees with


@pixelwise
def _weigh(s: np.float32, median: np.float32, narrow: np.float32) -> Three:
    """Return (weight, weight times `s`, 1) of a sample `s`; zeros if `narrow` (s - median)^2 is 1 or more."""
    e = s - median
    share = ONE - narrow * e * e
    good = share > ZERO  # False for NaN
    w = share * share if good else ZERO
    return w, (w * s if good else ZERO), (ONE if good else ZERO)


@kernel
def _weigh_two_rows(
    s1: F32, s2: F32, median: F32, narrow: np.float32, w1: F32, w2: F32, sw: F32, sm: F32, used: F32
) -> None:
    """Write the weights `w1`, `w2` of two rows of samples; add the results of `_weigh` to `sw`, `sm` and `used`."""
    # two rows at once, because loading and storing the sums costs as much as adding a row
    for c in range(s1.size):
        a, am, one = _weigh(s1[c], median[c], narrow)
        b, bm, other = _weigh(s2[c], median[c], narrow)
        w1[c], w2[c] = a, b
        sw[c] += a + b
        sm[c] += am + bm
        used[c] += one + other


@kernel
def _mean_row(sw: F32, sm: F32, mean: F32) -> None:
    for c in range(sw.size):
        mean[c] = sm[c] / sw[c] if sw[c] > ZERO else np.float32(np.nan)


@kernel
def _template_row(
    samples: F32, nothing: F32, r: int, pairs: I64, narrow: np.float32, views: F32, sm: F32, median: F32,
    weights: F32, sw: F32, mean: F32, used: F32, seen: F32,
) -> None:  # fmt: skip
    # row `r` of the template; `views` (N, C), `sm` and `median` are scratch, `nothing` is a row of NaN
    n = samples.shape[0]
    sw[:], sm[:], used[:], seen[:] = ZERO, ZERO, ZERO, ZERO
    for i in range(n):
        fill_row(samples[i, r], views[i], seen)
    sort_rows(views, pairs)
    median_row(views, seen, median)
    _no_lone_row(seen, median)
    for i in range(0, n, 2):
        other = samples[i + 1, r] if i + 1 < n else nothing
        _weigh_two_rows(samples[i, r], other, median, narrow, weights[i], weights[i + 1], sw, sm, used)
    _mean_row(sw, sm, mean)


@parallel_kernel
def template(samples: F32, pairs: I64, tau: float, weights: F32, mean: F32) -> None:
    """Write the weights (N, R, C) of the samples and their robust mean, the template (R, C) (eq. 8).

    The weights are biweights about the median, zero beyond 4 `tau`. `pairs` is the sorting network of N values.
    """
    n, rows, cols = samples.shape
    narrow = np.float32(1.0 / (16.0 * tau * tau))
    for r in prange(rows):
        views, work = np.empty((n, cols), np.float32), np.empty((n + n % 2, cols), np.float32)
        rest, nothing = np.empty((5, cols), np.float32), np.full(cols, np.nan, np.float32)
        _template_row(
            samples, nothing, r, pairs, narrow, views, rest[0], rest[1], work, rest[2], mean[r], rest[3], rest[4]
        )
        for i in range(n):
            weights[i, r] = work[i]


@kernel
def _gradient_row(m: F32, up: F32, down: F32, scale: np.float32, gx: F32, gy: F32) -> None:
    for c in range(1, m.size - 1):
        gx[c] = (m[c + 1] - m[c - 1]) * scale
        gy[c] = (up[c] - down[c]) * scale  # rows go south


@pixelwise
def _share(s: np.float32, w: np.float32, m: np.float32, g: np.float32, drop: np.float32) -> Four:
    """Return (w q, w q^2, w q e, w e^2) of a sample `s` of weight `w`, where e = `s` - `m` and q = `g` / `drop`."""
    used = w > ZERO
    q, e = (g / drop if used else ZERO), (s - m if used else ZERO)
    wq = w * q
    return wq, wq * q, wq * e, w * e * e


@kernel
def _sum_two_rows(
    s1: F32, s2: F32, w1: F32, w2: F32, m: F32, h: F32, gx: F32, gy: F32, place1: Three, place2: Three,
    cell: np.float32, sq: F32, sqq: F32, sqe: F32, see: F32,
) -> None:  # fmt: skip
    """Add the rows of two views to the sums of w q, w q^2, w q e and w e^2; `place1` and `place2` are from `_place`."""
    for c in range(s1.size):
        k = np.float32(c) * cell
        a = _share(s1[c], w1[c], m[c], gx[c] * (place1[0] + k) + gy[c] * place1[1], place1[2] - h[c])
        b = _share(s2[c], w2[c], m[c], gx[c] * (place2[0] + k) + gy[c] * place2[1], place2[2] - h[c])
        sq[c] += a[0] + b[0]
        sqq[c] += a[1] + b[1]
        sqe[c] += a[2] + b[2]
        see[c] += a[3] + b[3]


@inline
def _place(centres: F64, i: int, x: float, y: float) -> Three:
    """Return the vector (east, north) from camera `i` to (x, y), and the camera's height, metres."""
    return np.float32(x - centres[i, 0]), np.float32(y - centres[i, 1]), np.float32(centres[i, 2])


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
    """Write the template m (eq. 8), Lambda, eta (eqs. 9, 10) and the residual variance s^2 of every cell.

    q_i = grad m . v_i is the change of view i's sample per metre of height, with v_i = ((X, Y) - C_i,xy) / (C_i,z - h).
    The gradient of the template lacks the noise of single views.

    Args:
        samples: (N, R, C) normalised grey at the heights `h` (R, C), metres.
        pairs: sorting network of N values.
        tau: scale of the weights, see `template`.
        centres: (N, 3) camera centres, metres.
        mean, lam, eta, s2: (R, C) out, template, Lambda, eta, s^2.
        used: (R, C) out, number of views within 4 `tau` of the median; number: (R, C) out, of views that see the cell.
    """
    n, rows, cols = samples.shape
    scale, narrow = np.float32(0.5 / cell), np.float32(1.0 / (16.0 * tau * tau))
    for band in prange((rows + BAND - 1) // BAND):
        first, end = band * BAND, min(rows, band * BAND + BAND)
        views, weights = np.empty((n, cols), np.float32), np.empty((3, n + n % 2, cols), np.float32)
        of_three = np.empty((3, 4, cols), np.float32)  # mean, sum of weights, used, seen of a row and its neighbours
        sm, median = np.empty(cols, np.float32), np.empty(cols, np.float32)
        nothing = np.full(cols, np.nan, np.float32)
        sums, gx, gy = np.empty((4, cols), np.float32), np.empty(cols, np.float32), np.empty(cols, np.float32)
        for ahead in range(max(first - 1, 0), min(end + 1, rows) + 1):
            if ahead < rows:
                k = of_three[ahead % 3]
                _template_row(
                    samples, nothing, ahead, pairs, narrow, views, sm, median, weights[ahead % 3],
                    k[1], k[0], k[2], k[3],
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
                w = weights[r % 3]
                for i in range(0, n, 2):
                    other, j = (samples[i + 1, r], i + 1) if i + 1 < n else (nothing, i)
                    _sum_two_rows(
                        samples[i, r], other, w[i], w[i + 1], m, h[r], gx, gy,
                        _place(centres, i, xs[0], ys[r]), _place(centres, j, xs[0], ys[r]), np.float32(cell),
                        sums[0], sums[1], sums[2], sums[3],
                    )  # fmt: skip
            _normal_row(sums, sw, gx, gy, m, agree, lam[r], eta[r], s2[r])


@kernel
def _fill_known(h: F32, out: F32) -> None:
    for c in range(h.size):
        out[c] = h[c] if h[c] == h[c] else FAR  # so far from all others that its weight is zero


@kernel
def invert_row(x: F32, out: F32) -> None:
    """Fill `out` with 1 / x."""
    for c in range(x.size):
        out[c] = ONE / x[c]


@pixelwise
def _tap(h: F32, lam: F32, eta: F32, s2: F32, i: int, here: np.float32, inverse: np.float32, sums: Four) -> Four:
    """Add neighbour `i` to `sums`; its weight falls from 1 at the height `here` to 0 at `here` +- 1 / `inverse`."""
    d = (h[i] - here) * inverse
    share = ONE - d * d
    share = share if share > ZERO else ZERO
    w = share * share
    known = ONE if lam[i] > ZERO else ZERO
    return sums[0] + w * lam[i], sums[1] + w * eta[i], sums[2] + w * s2[i], sums[3] + w * known


@pixelwise
def _five(h: F32, lam: F32, eta: F32, s2: F32, i: int, here: np.float32, inverse: np.float32, sums: Four) -> Four:
    sums = _tap(h, lam, eta, s2, i, here, inverse, sums)
    sums = _tap(h, lam, eta, s2, i + np.uintp(1), here, inverse, sums)
    sums = _tap(h, lam, eta, s2, i + np.uintp(2), here, inverse, sums)
    sums = _tap(h, lam, eta, s2, i + np.uintp(3), here, inverse, sums)
    sums = _tap(h, lam, eta, s2, i + np.uintp(4), here, inverse, sums)
    return sums


@kernel
def _window_row(h: F32, lam: F32, eta: F32, s2: F32, inverse: F32, sl: F32, se: F32, sn: F32, sw: F32) -> None:
    """Write weighted sums over the 5 x 5 neighbours of each cell; all inputs begin at the upper left neighbour."""
    # rows of `STRIDE`. Unrolled, unsigned and with a constant stride, it is three times as fast as a loop
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
def solve_window(
    lam: F32, eta: F32, s2: F32, h: F32, spread: F32, limit: float, step: F32, precision: F32, noise: F32
) -> None:
    """Sum the normal equations over 5 x 5 cells of similar height and write the step, metres (eq. 11).

    A neighbour whose height differs by dh has the weight (1 - (dh / spread)^2)^2, and 0 beyond `spread`. So a window
    across a step uses only its own side. `spread` is the parallax pixel, metres; `limit` is the largest step, parallax
    pixels. `precision` and `noise` get the windowed Lambda and residual variance.
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
            ph[:] = pl[:] = pe[:] = pn[:] = ZERO  # a border of unknown cells
            for r in range(max(0, first - 2), min(rows, end + 2)):
                k = (r - first + 2) * STRIDE + low - left + 2
                inner = slice(k, k + high - low)
                _fill_known(h[r, low:high], ph[inner])
                pl[inner], pe[inner], pn[inner] = lam[r, low:high], eta[r, low:high], s2[r, low:high]
            for r in range(first, end):
                k, here = (r - first) * STRIDE, slice(left, left + width)
                invert_row(spread[r, here], inverse[:width])
                _window_row(ph[k:], pl[k:], pe[k:], pn[k:], inverse[:width], sums[0], sums[1], sums[2], sums[3])
                known, px = h[r, here], spread[r, here]
                _step_row(sums, known, px, np.float32(limit), step[r, here], precision[r, here], noise[r, here])
