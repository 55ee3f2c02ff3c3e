"""Loops of what a height is worth: sigma, flags, fusion with the map (docs/method.md, eqs. 14 and 16)."""

import numpy as np
from numpy.typing import NDArray

from alight.kernels.compiler import kernel, parallel_kernel, prange

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]
U16 = NDArray[np.uint16]

ZERO, ONE, TWO = np.float32(0), np.float32(1), np.float32(2)
LEAST = np.float32(1e-4)  # metres: sigmas are at least this


@kernel
def _sigma_row(
    h: F32, noise: F32, precision: F32, per_px: F32, rough2: F32, px2: np.float32, floor2: np.float32, out: F32
) -> None:
    for c in range(out.size):
        information = precision[c]
        good = (information > ZERO) & (h[c] == h[c])
        fitted = TWO * noise[c] / (information if good else ONE)
        variance = fitted + px2 * per_px[c] * per_px[c] + floor2 + rough2[c]
        out[c] = np.sqrt(variance) if good else np.float32(np.nan)


@parallel_kernel
def sigma(
    h: F32, noise: F32, precision: F32, per_px: F32, rough2: F32, floor_px: float, floor: float, out: F32
) -> None:
    """Fill the 1-sigma of each height (eq. 14): fit, a floor of `floor_px` parallax pixels and `floor` metres, relief.

    `rough2` is the variance of the local relief. NaN where there is no height or no information.
    """
    px2, floor2 = np.float32(floor_px * floor_px), np.float32(floor * floor)
    for r in prange(h.shape[0]):
        _sigma_row(h[r], noise[r], precision[r], per_px[r], rough2[r], px2, floor2, out[r])


@kernel
def _flag_row(
    near: U16, h: F32, seen: U8, used: U8, precision: F32, texture: F32, noise: F32,
    limits: tuple[float, float, float], bits: tuple[int, int, int, int, int], out: U16,
) -> None:  # fmt: skip
    low, high, least = np.float32(limits[0]), np.float32(limits[1]), np.float32(limits[2])
    unseen, inconsistent, few, flat, ends = bits
    none = 0
    for c in range(out.size):
        bad = (h[c] != h[c]) | (seen[c] < 2)
        f = unseen if bad else none
        f |= inconsistent if (used[c] < 2) | ~(precision[c] > ZERO) else none
        f |= few if seen[c] < 3 else none
        f |= flat if texture[c] + noise[c] < least else none
        f |= ends if (h[c] < low) | (h[c] > high) else none
        out[c] = np.uint16(near[c // 2] | f)


@parallel_kernel
def flag(
    near: U16, h: F32, seen: U8, used: U8, precision: F32, texture: F32, noise: F32,
    limits: tuple[float, float, float], bits: tuple[int, int, int, int, int], out: U16,
) -> None:  # fmt: skip
    """Fill the flags of every cell: those of its 2 x 2 cells (`near`) and its own.

    `bits`: of unseen, inconsistent, seen by few, without texture (`texture` + `noise` below the third limit), and
    beyond the first two limits.
    """
    for r in prange(out.shape[0]):
        _flag_row(
            near[r // 2], h[r], seen[r], used[r], precision[r], texture[r], noise[r], limits, bits, out[r]
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
    """Make NaN of the samples (N, R, C) of views whose ray the map stops, unless it stops all but one.

    `visible` (N, R / 2, C / 2), rounded up: of 2 x 2 cells.
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
def _fuse_row(
    h: F32,
    s: F32,
    f: U16,
    v: U8,
    e: F32,
    h0: F32,
    s0: F32,
    f0: U16,
    v0: U8,
    e0: F32,
    ring: np.float32,
    worse: np.float32,
) -> None:
    for c in range(h.size):
        was = s0[c] if s0[c] > LEAST else LEAST
        now = s[c] if s[c] > LEAST else LEAST
        old = h0[c] == h0[c]
        keep = old & ((h[c] != h[c]) | ~(s[c] < worse * was))
        d = h[c] - h0[c]
        agree = old & (d * d < np.float32(9) * (was * was + now * now))
        weight_old, weight_new = ONE / (was * was), ONE / (ring * now * now)
        total = weight_old + weight_new
        mean = (weight_old * h0[c] + weight_new * h[c]) / total
        spread = ONE / np.sqrt(total)
        least = np.float32(0.6) * s[c]
        spread = spread if spread > least else least
        height = mean if agree else h[c]
        spread = spread if agree else s[c]
        h[c] = h0[c] if keep else height
        s[c] = s0[c] if keep else spread
        f[c] = f0[c] if keep else f[c]
        v[c] = v0[c] if keep else v[c]
        e[c] = e0[c] if keep else e[c]


@parallel_kernel
def fuse(
    height: F32, sigma: F32, flags: U16, views: U8, residual: F32,
    height0: F32, sigma0: F32, flags0: U16, views0: U8, residual0: F32, ring: int, worse: float,
) -> None:  # fmt: skip
    """Weigh a step (changed in place) against the map before it (`...0`) (eq. 16).

    A step brings 1 / `ring` of its information. Heights that disagree by more than three sigma are not averaged: the
    new one stands. A look whose sigma is `worse` times the map's changes nothing.
    """
    for r in prange(height.shape[0]):
        _fuse_row(
            height[r], sigma[r], flags[r], views[r], residual[r], height0[r], sigma0[r], flags0[r], views0[r],
            residual0[r], np.float32(ring), np.float32(worse),
        )  # fmt: skip
