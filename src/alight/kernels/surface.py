"""Loops over the surface of a height map: plane prior and ray test of visibility (docs/method.md, eqs. 12 and 13)."""

import numpy as np
from numpy.typing import NDArray

from alight.kernels.compiler import kernel, parallel_kernel, prange

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]
I64 = NDArray[np.int64]

UNKNOWN = np.float32(1e6)  # metres: a height so far from all others that no weight is left
ZERO, ONE = np.float32(0), np.float32(1)


@kernel
def _known_row(h: F32, precision: F32, noise: F32, spread: F32, height: F32, trust: F32) -> None:
    """Fill a row with the heights, far away where unknown, and with what each is worth as a neighbour."""
    for c in range(h.size):
        known = h[c] == h[c]
        information = precision[c] / (precision[c] + noise[c] / (spread[c] * spread[c]) + np.float32(1e-12))
        height[c] = h[c] if known else UNKNOWN
        trust[c] = np.float32(0.05) + information if known else ZERO


@kernel
def _pair_row(
    h: F32, h1: F32, h2: F32, t1: F32, t2: F32, spread: F32, dx: np.float32, dy: np.float32, sums: F32
) -> None:
    """Add two opposite neighbours, at (dx, dy) and (-dx, -dy), to the sums of the weighted plane."""
    s0, sx, sy, sxx, sxy, syy = sums[0], sums[1], sums[2], sums[3], sums[4], sums[5]
    sh, shx, shy = sums[6], sums[7], sums[8]
    xx, xy, yy = dx * dx, dx * dy, dy * dy
    for c in range(h.size):
        v1, v2 = h1[c] - h[c], h2[c] - h[c]
        d1, d2 = v1 / spread[c], v2 / spread[c]
        both = np.float32(0.5) * (d1 + d2)  # on a plane the two deviate by equal and opposite amounts
        d1, d2, both = d1 * d1, d2 * d2, both * both
        d1 = (both if both < d1 else d1) + ONE
        d2 = (both if both < d2 else d2) + ONE
        w1, w2 = t1[c] / (d1 * d1), t2[c] / (d2 * d2)
        v1, v2 = w1 * v1, w2 * v2
        even, odd = w1 + w2, w1 - w2
        s0[c] += even
        sx[c] += dx * odd
        sy[c] += dy * odd
        sxx[c] += xx * even
        sxy[c] += xy * even
        syy[c] += yy * even
        sh[c] += v1 + v2
        shx[c] += dx * (v1 - v2)
        shy[c] += dy * (v1 - v2)


@kernel
def _pull_row(sums: F32, h: F32, precision: F32, noise: F32, spread: F32, strength: np.float32, out: F32) -> None:
    """Pull each height to the value of its plane, by weighted least squares v = a + bx dx + by dy, at the centre."""
    for c in range(h.size):
        s0, sx, sy, sxy = sums[0, c], sums[1, c], sums[2, c], sums[4, c]
        sh, shx, shy = sums[6, c], sums[7, c], sums[8, c]
        sxx, syy = sums[3, c] + np.float32(0.1) * s0, sums[5, c] + np.float32(0.1) * s0
        m0, m1, m2 = sxx * syy - sxy * sxy, sx * syy - sxy * sy, sx * sxy - sxx * sy
        det = s0 * m0 - sx * m1 + sy * m2
        good = (s0 >= np.float32(1e-3)) & (det > np.float32(1e-9) * s0 * s0 * s0)
        a = (sh * m0 - sx * (shx * syy - sxy * shy) + sy * (shx * sxy - sxx * shy)) / (det if good else ONE)
        share = s0 if s0 < ONE else ONE
        weight = strength * (noise[c] + np.float32(1e-3)) / (spread[c] * spread[c]) * share
        pull = a * weight / (weight + precision[c] + np.float32(1e-12))
        out[c] = h[c] + (pull if good else ZERO)  # NaN stays NaN


@parallel_kernel
def plane_prior(h: F32, precision: F32, noise: F32, spread: F32, strength: float, pairs: I64, out: F32) -> None:
    """Pull each height towards the robust local plane of its neighbours (eq. 12); what is unseen stays NaN and unused.

    Neighbours are weighted by their own information and by how well they lie on the plane through the centre; the pull
    is `strength` in parallax pixels (through `spread`, metres a pixel), so that it means the same at any height.
    `pairs` (K, 2): offsets (dx, dy) of one neighbour of each opposite pair.
    """
    rows, cols = h.shape
    radius = np.abs(pairs).max()
    height = np.full((rows + 2 * radius, cols + 2 * radius), UNKNOWN, np.float32)
    trust = np.zeros((rows + 2 * radius, cols + 2 * radius), np.float32)
    for r in prange(rows):
        inner = slice(radius, radius + cols)
        _known_row(h[r], precision[r], noise[r], spread[r], height[r + radius, inner], trust[r + radius, inner])
    for r in prange(rows):
        sums = np.zeros((9, cols), np.float32)
        for k in range(pairs.shape[0]):
            dx, dy = pairs[k, 0], pairs[k, 1]
            ahead, behind = slice(radius + dx, radius + dx + cols), slice(radius - dx, radius - dx + cols)
            down, up = r + radius + dy, r + radius - dy
            _pair_row(
                h[r], height[down, ahead], height[up, behind], trust[down, ahead], trust[up, behind], spread[r],
                np.float32(dx), np.float32(dy), sums,
            )  # fmt: skip
        _pull_row(sums, h[r], precision[r], noise[r], spread[r], np.float32(strength), out[r])


@parallel_kernel
def visibility(
    h: F32, tops: F32, block: int, centres: F64, xs: F64, ys: F64, cell: float, margin: F32, visible: U8
) -> None:
    """Fill `visible` (N, R, C) with 1 where the ray from the cell to camera i stays above the map (eq. 13).

    `tops`: for each block of `block` x `block` cells the highest height that a ray from it can meet: the march ends
    once the ray is above it, and on open ground it does not begin. `margin` (R, C) metres are forgiven.
    """
    n, rows, cols = visible.shape
    for r in prange(rows):
        for i in range(n):
            visible[i, r] = 1
        for c in range(cols):
            hc, top, spare = h[r, c], tops[r // block, c // block], margin[r, c]
            if not top > hc + spare:  # NaN too
                continue
            for i in range(n):
                dx = (centres[i, 0] - xs[c]) / cell
                dy = -(centres[i, 1] - ys[r]) / cell
                dz = centres[i, 2] - hc
                length = max(abs(dx), abs(dy))
                if length < 1e-6 or dz <= 0.0:
                    continue
                rise = dz / length  # metres a cell of march
                steps = int(min(length, (top - hc - spare) / rise))
                for s in range(1, steps + 1):
                    y = int(np.floor(r + dy * s / length + 0.5))
                    x = int(np.floor(c + dx * s / length + 0.5))
                    if y < 0 or y >= rows or x < 0 or x >= cols:
                        break
                    over = h[y, x]
                    if not np.isnan(over) and over > hc + rise * s + spare:
                        visible[i, r, c] = 0
                        break
