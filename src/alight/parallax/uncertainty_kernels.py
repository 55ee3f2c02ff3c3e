"""Loops of the uncertainty of heights: sigma, flags, fusion with the map (eqs. 14 and 16).

docs/method/uncertainty.md, docs/method/recursive.md
"""

import numpy as np

from alight.arrays import F32, ONE, U8, U16, ZERO
from alight.compiled import kernel, parallel_kernel, pixelwise, prange

LEAST = np.float32(1e-4)  # metres, smallest sigma
QUARTER = np.float32(0.25)
Four = tuple[np.float32, np.float32, np.float32, np.float32]
MOST = np.float32(25)  # parallax pixels^2, largest variance


@pixelwise
def _fitted(noise: np.float32, precision: np.float32, per_px: np.float32) -> np.float32:
    """Return the variance `noise` / (`precision` `per_px`^2), parallax pixels^2, at most `MOST`."""
    v = noise / (precision * per_px * per_px + np.float32(1e-12))
    return v if v < MOST else MOST


@pixelwise
def _or(x: np.float32, other: np.float32) -> np.float32:
    return x if x == x else other


@pixelwise
def _heights(a: np.float32, b: np.float32, c: np.float32, d: np.float32) -> Four:
    ab, cd = (a if a < b else b), (c if c < d else d)
    low = ab if ab < cd else cd
    ab, cd = (a if a > b else b), (c if c > d else d)
    high = ab if ab > cd else cd
    mid = QUARTER * ((a + b) + (c + d))
    a, b, c, d = a - mid, b - mid, c - mid, d - mid
    return low, high, mid, QUARTER * (a * a + b * b + c * c + d * d)


@kernel
def _pool_row(
    h0: F32,
    h1: F32,
    m0: F32,
    m1: F32,
    fill: np.float32,
    low: F32,
    high: F32,
    mid: F32,
    off: F32,
    mean: F32,
    square: F32,
) -> None:
    for c in range(low.size):
        i, j = np.uintp(2 * c), np.uintp(2 * c + 1)
        low[c], high[c], mid[c], off[c] = _heights(
            _or(h0[i], fill), _or(h0[j], fill), _or(h1[i], fill), _or(h1[j], fill)
        )
        a, b, d, e = _or(m0[i], ZERO), _or(m0[j], ZERO), _or(m1[i], ZERO), _or(m1[j], ZERO)
        mean[c] = QUARTER * ((a + b) + (d + e))
        square[c] = QUARTER * (a * a + b * b + d * d + e * e)


@kernel
def _pool_fit_row(n0: F32, n1: F32, p0: F32, p1: F32, per_px: F32, noise: F32, fitted: F32) -> None:
    for c in range(noise.size):
        i, j = np.uintp(2 * c), np.uintp(2 * c + 1)
        noise[c] = QUARTER * ((n0[i] + n0[j]) + (n1[i] + n1[j]))
        above = _fitted(n0[i], p0[i], per_px[i]) + _fitted(n0[j], p0[j], per_px[i])
        fitted[c] = QUARTER * (above + _fitted(n1[i], p1[i], per_px[i]) + _fitted(n1[j], p1[j], per_px[i]))


@parallel_kernel
def pool(h: F32, mean: F32, noise: F32, precision: F32, per_px: F32, fill: float, out: F32) -> None:
    """Fill `out` (8, R / 2, C / 2) with statistics of 2 x 2 cells; R and C must be even.

    In this order: lowest, highest and mean height (`fill` replaces unknown heights); variance of the heights; mean and
    mean square of the template (0 replaces unknown values); noise; noise over precision in parallax pixels^2.
    """
    for r in prange(out.shape[1]):
        i, j = 2 * r, 2 * r + 1
        _pool_row(
            h[i], h[j], mean[i], mean[j], np.float32(fill),
            out[0, r], out[1, r], out[2, r], out[3, r], out[4, r], out[5, r],
        )  # fmt: skip
        _pool_fit_row(noise[i], noise[j], precision[i], precision[j], per_px[i], out[6, r], out[7, r])


@kernel
def _sigma_row(h: F32, noise: F32, precision: F32, hidden2: F32, fit: np.float32, sigma: F32) -> None:
    for c in range(h.size):
        known = (precision[c] > ZERO) & (h[c] == h[c])
        variance = fit * noise[c] / (precision[c] if known else ONE) + hidden2[np.uintp(c // 2)]
        sigma[c] = np.sqrt(variance) if known else np.float32(np.nan)


@kernel
def _judge_row(
    near: U16, share: F32, h: F32, seen: U8, used: U8, sigma: F32, low: np.float32, high: np.float32,
    bits: tuple[int, int, int, int], residual: F32, flags: U16,
) -> None:  # fmt: skip
    unseen, inconsistent, few, ends = bits
    none = 0
    for c in range(h.size):
        k = np.uintp(c // 2)
        fits = (used[c] >= 2) & ((sigma[c] == sigma[c]) | (h[c] != h[c]))
        residual[c] = share[k]
        f = unseen if (h[c] != h[c]) | (seen[c] < 2) else none
        f |= none if fits else inconsistent
        f |= few if seen[c] < 3 else none
        f |= ends if (h[c] < low) | (h[c] > high) else none
        flags[c] = np.uint16(near[k] | f)


@parallel_kernel
def height_sigma(h: F32, noise: F32, precision: F32, hidden2: F32, fit: float, out: F32) -> None:
    """Write the 1-sigma of each height, metres (eq. 14); NaN where the height or its precision is missing.

    The variance is `fit` noise / precision, plus `hidden2` (R / 2, C / 2), metres^2, of relief that is smoothed away.
    """
    for r in prange(h.shape[0]):
        _sigma_row(h[r], noise[r], precision[r], hidden2[r // 2], np.float32(fit), out[r])


@parallel_kernel
def flag(
    near: U16, share: F32, h: F32, seen: U8, used: U8, sigma: F32, low: float, high: float,
    bits: tuple[int, int, int, int], residual: F32, flags: U16,
) -> None:  # fmt: skip
    """Write the flags of every cell: the flags `near` (R / 2, C / 2) of its 2 x 2 cells, and its own flags.

    `bits` are the flags for cells that are unseen, inconsistent, seen by few views, and outside of `low` to `high`.
    `seen` and `used` are the numbers of views that see the cell, and that agree. `residual` gets the `share` (R / 2, C
    / 2).
    """
    for r in prange(h.shape[0]):
        _judge_row(
            near[r // 2], share[r // 2], h[r], seen[r], used[r], sigma[r], np.float32(low), np.float32(high), bits,
            residual[r], flags[r],
        )  # fmt: skip


@kernel
def _veil_row(visible: U8, count: U8, samples: F32) -> None:
    for k in range(visible.size):
        if (visible[k] == 0) & (count[k] >= 2):
            for c in range(2 * k, min(2 * k + 2, samples.size)):
                samples[c] = np.nan


@kernel
def _add_row(visible: U8, count: U8) -> None:
    for c in range(count.size):
        count[c] += visible[c]


@parallel_kernel
def veil(visible: U8, samples: F32) -> None:
    """Set samples (N, R, C) to NaN where the map blocks the ray of a view, unless fewer than two views have a free ray.

    `visible` (N, R / 2, C / 2), rounded up, is 1 where the ray from the 2 x 2 cells is free.
    """
    n = samples.shape[0]
    for r in prange(samples.shape[1]):
        count = np.zeros(visible.shape[2], np.uint8)
        for i in range(n):
            _add_row(visible[i, r // 2], count)
        if count.min() < n:
            for i in range(n):
                _veil_row(visible[i, r // 2], count, samples[i, r])


@kernel
def _fuse_row(h: F32, s: F32, h0: F32, s0: F32, worse: np.float32, keep: F32) -> None:
    for c in range(h.size):
        was = s0[c] if s0[c] > LEAST else LEAST
        now = s[c] if s[c] > LEAST else LEAST
        old = h0[c] == h0[c]
        stays = old & ((h[c] != h[c]) | ~(s[c] < worse * was))
        d = h[c] - h0[c]
        agree = old & (d * d < np.float32(9) * (was * was + now * now))
        weight_old, weight_new = ONE / (was * was), ONE / (now * now)
        inverse = ONE / (weight_old + weight_new)
        mean = (weight_old * h0[c] + weight_new * h[c]) * inverse
        spread = np.sqrt(inverse)
        least = np.float32(0.95) * s[c]
        spread = spread if spread > least else least
        height = mean if agree else h[c]
        spread = spread if agree else s[c]
        keep[c] = ONE if stays else ZERO
        h[c] = h0[c] if stays else height
        s[c] = s0[c] if stays else spread


@kernel
def _keep_row(keep: F32, new: F32, old: F32) -> None:
    """Set `new` to `old`, in place, where `keep` is 1."""
    # not in the loop over heights, because loops over several types are not vectorised
    for c in range(new.size):
        new[c] = old[c] if keep[c] > ZERO else new[c]


@parallel_kernel
def fuse(
    height: F32, sigma: F32, flags: U16, views: U8, residual: F32, sampling: F32,
    height0: F32, sigma0: F32, flags0: U16, views0: U8, residual0: F32, sampling0: F32, worse: float,
) -> None:  # fmt: skip
    """Fuse the results of a step, in place, with the map before it, whose arrays are named with a 0 (eq. 16).

    If two heights differ by more than three sigma, the new one replaces the old. If the new sigma is at least `worse`
    times the map's, the map's values are kept. Steps see nearly the same pictures, so sigma hardly falls.
    """
    for r in prange(height.shape[0]):
        keep = np.empty(height.shape[1], np.float32)
        _fuse_row(height[r], sigma[r], height0[r], sigma0[r], np.float32(worse), keep)
        _keep_row(keep, flags[r], flags0[r])
        _keep_row(keep, views[r], views0[r])
        _keep_row(keep, residual[r], residual0[r])
        _keep_row(keep, sampling[r], sampling0[r])
