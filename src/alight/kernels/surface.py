"""Loops over the surface of a height map: plane prior and ray test of visibility (docs/method.md, eqs. 12 and 13)."""

import numpy as np
from numpy.typing import NDArray

from alight.kernels.compiler import kernel, parallel_kernel, pixelwise, prange

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]
I64 = NDArray[np.int64]

UNKNOWN = np.float32(1e6)  # metres: a height so far from all others that no weight is left
ZERO, ONE = np.float32(0), np.float32(1)


@kernel
def _known_row(h: F32, precision: F32, noise: F32, spread: F32, height: F32, trust: F32) -> None:
    """Fill a row with the heights and with what each is worth as a neighbour: nothing where unknown."""
    for c in range(h.size):
        known = h[c] == h[c]
        information = precision[c] / (precision[c] + noise[c] / (spread[c] * spread[c]) + np.float32(1e-12))
        height[c] = h[c] if known else ZERO
        trust[c] = np.float32(0.05) + information if known else ZERO


@kernel
def _inverse_row(x: F32, out: F32) -> None:
    for c in range(x.size):
        out[c] = ONE / x[c]


@pixelwise
def _pair(
    h: np.float32, inverse: np.float32, h1: np.float32, h2: np.float32, t1: np.float32, t2: np.float32
) -> tuple[np.float32, np.float32]:
    """Weight of two opposite neighbours, and how far the middle between them is above the cell."""
    above = np.float32(0.5) * (h1 + h2) - h
    off = above * inverse
    share = ONE - np.float32(0.5) * off * off
    share = share if share > ZERO else ZERO
    return t1 * t2 * share * share, above


@kernel
def _pairs_row(
    h: F32, inverse: F32, a1: F32, a2: F32, ta1: F32, ta2: F32, b1: F32, b2: F32, tb1: F32, tb2: F32, sw: F32, sh: F32
) -> None:
    """Add two pairs to the sums: at once, because loading and storing the sums costs as much as a pair."""
    for c in range(h.size):
        wa, va = _pair(h[c], inverse[c], a1[c], a2[c], ta1[c], ta2[c])
        wb, vb = _pair(h[c], inverse[c], b1[c], b2[c], tb1[c], tb2[c])
        sw[c] += wa + wb
        sh[c] += wa * va + wb * vb


@kernel
def _pull_row(sw: F32, sh: F32, h: F32, precision: F32, noise: F32, inverse: F32, strength: np.float32, out: F32) -> None:
    """Pull each height to the mean of its pairs."""
    for c in range(h.size):
        share = sw[c] if sw[c] < ONE else ONE
        weight = strength * (noise[c] + np.float32(1e-3)) * inverse[c] * inverse[c] * share
        pull = sh[c] / (sw[c] + np.float32(1e-6)) * weight / (weight + precision[c] + np.float32(1e-12))
        out[c] = h[c] + pull  # NaN stays NaN


@parallel_kernel
def plane_prior(h: F32, precision: F32, noise: F32, spread: F32, strength: float, pairs: I64, out: F32) -> None:
    """Pull each height towards the planes of its neighbours (eq. 12); what is unseen stays NaN and unused.

    On a plane the middle between two opposite neighbours is the height, whatever the slope. Pairs are weighted by what
    both know and by how near that middle is; the pull is `strength` in parallax pixels (through `spread`, metres a
    pixel), so that it means the same at any height. `pairs` (2 K, 2): offsets (dx, dy) of one neighbour of each pair.
    """
    rows, cols = h.shape
    radius = np.abs(pairs).max()
    height = np.zeros((rows + 2 * radius, cols + 2 * radius), np.float32)
    trust = np.zeros((rows + 2 * radius, cols + 2 * radius), np.float32)
    for r in prange(rows):
        inner = slice(radius, radius + cols)
        _known_row(h[r], precision[r], noise[r], spread[r], height[r + radius, inner], trust[r + radius, inner])
    for r in prange(rows):
        work, inner = np.zeros((3, cols), np.float32), slice(radius, radius + cols)
        sw, sh, inverse = work[0], work[1], work[2]
        _inverse_row(spread[r], inverse)
        for k in range(0, pairs.shape[0], 2):
            ax, ay, bx, by = pairs[k, 0], pairs[k, 1], pairs[k + 1, 0], pairs[k + 1, 1]
            a1, a2 = slice(radius + ax, radius + ax + cols), slice(radius - ax, radius - ax + cols)
            b1, b2 = slice(radius + bx, radius + bx + cols), slice(radius - bx, radius - bx + cols)
            ra1, ra2, rb1, rb2 = r + radius + ay, r + radius - ay, r + radius + by, r + radius - by
            _pairs_row(
                height[r + radius, inner], inverse,
                height[ra1, a1], height[ra2, a2], trust[ra1, a1], trust[ra2, a2],
                height[rb1, b1], height[rb2, b2], trust[rb1, b1], trust[rb2, b2], sw, sh,
            )  # fmt: skip
        _pull_row(sw, sh, h[r], precision[r], noise[r], inverse, np.float32(strength), out[r])


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
