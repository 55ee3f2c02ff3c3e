"""Loops over the surface of a height map: plane prior and ray test of visibility (docs/method/parallax.md, 12, 13)."""

import numpy as np

from alight.arrays import F32, F64, ONE, TWO, U8, ZERO
from alight.compiled import kernel, parallel_kernel, pixelwise, prange
from alight.parallax.gauss_newton_kernels import BAND, CHUNK, invert_row

Two = tuple[np.float32, np.float32]

REACH = 3  # cells to the farthest neighbour
STRIDE = CHUNK + 2 * REACH
CENTRE = REACH * STRIDE + REACH  # elements from the upper left neighbour to the cell


@kernel
def _known_row(h: F32, precision: F32, noise: F32, spread: F32, height: F32, trust: F32) -> None:
    """Write a row of heights and their weights as neighbours to `height` and `trust`; both are 0 where unknown."""
    for c in range(h.size):
        known = h[c] == h[c]
        information = precision[c] / (precision[c] + noise[c] / (spread[c] * spread[c]) + np.float32(1e-12))
        height[c] = h[c] if known else ZERO
        trust[c] = np.float32(0.05) + information if known else ZERO


@pixelwise
def _pair(height: F32, trust: F32, i: int, off: int, here: np.float32, inverse: np.float32, sums: Two) -> Two:
    """Add the neighbours `off` elements before and after the cell to the sums of weight and weighted height."""
    ahead, behind = i + np.uintp(CENTRE) + off, i + np.uintp(CENTRE) - off
    above = np.float32(0.5) * (height[ahead] + height[behind]) - here
    high = above * inverse
    share = ONE - TWO * high * high
    share = share if share > ZERO else ZERO
    w = trust[ahead] * trust[behind] * share * share
    return sums[0] + w, sums[1] + w * above


@kernel
def _pairs_row(height: F32, trust: F32, inverse: F32, sw: F32, sh: F32) -> None:
    """Write the sums of `_pair` over sixteen pairs of neighbours per cell; inputs begin at the upper left neighbour."""
    # rows of `STRIDE`. These pairs smooth as well as all twenty-four of 7 x 7 neighbours. Unrolled, unsigned and with a
    # constant stride, it is three times as fast as a loop
    for c in range(inverse.size):
        i, sums = np.uintp(c), (ZERO, ZERO)
        here, inv = height[i + np.uintp(CENTRE)], inverse[c]
        sums = _pair(height, trust, i, np.uintp(1), here, inv, sums)
        sums = _pair(height, trust, i, np.uintp(STRIDE), here, inv, sums)
        sums = _pair(height, trust, i, np.uintp(STRIDE + 1), here, inv, sums)
        sums = _pair(height, trust, i, np.uintp(STRIDE - 1), here, inv, sums)
        sums = _pair(height, trust, i, np.uintp(STRIDE + 2), here, inv, sums)
        sums = _pair(height, trust, i, np.uintp(2 * STRIDE + 1), here, inv, sums)
        sums = _pair(height, trust, i, np.uintp(STRIDE - 2), here, inv, sums)
        sums = _pair(height, trust, i, np.uintp(2 * STRIDE - 1), here, inv, sums)
        sums = _pair(height, trust, i, np.uintp(3), here, inv, sums)
        sums = _pair(height, trust, i, np.uintp(3 * STRIDE), here, inv, sums)
        sums = _pair(height, trust, i, np.uintp(STRIDE + 3), here, inv, sums)
        sums = _pair(height, trust, i, np.uintp(3 * STRIDE + 1), here, inv, sums)
        sums = _pair(height, trust, i, np.uintp(STRIDE - 3), here, inv, sums)
        sums = _pair(height, trust, i, np.uintp(3 * STRIDE - 1), here, inv, sums)
        sums = _pair(height, trust, i, np.uintp(3 * STRIDE + 3), here, inv, sums)
        sums = _pair(height, trust, i, np.uintp(3 * STRIDE - 3), here, inv, sums)
        sw[c], sh[c] = sums


@kernel
def _pull_row(
    sw: F32, sh: F32, h: F32, precision: F32, noise: F32, inverse: F32, strength: np.float32, out: F32
) -> None:
    for c in range(h.size):
        share = sw[c] if sw[c] < ONE else ONE
        weight = strength * (noise[c] + np.float32(1e-3)) * inverse[c] * inverse[c] * share
        pull = sh[c] / (sw[c] + np.float32(1e-6)) * weight / (weight + precision[c] + np.float32(1e-12))
        out[c] = h[c] + pull  # NaN stays NaN


@parallel_kernel
def plane_prior(h: F32, precision: F32, noise: F32, spread: F32, strength: float, out: F32) -> None:
    """Write heights pulled towards the planes of their neighbours to `out` (eq. 12); unknown heights stay NaN.

    `spread` is the parallax pixel, metres: the pull is measured in it, so that `strength` means the same at any height.
    """
    # on a plane, the midpoint between two opposite neighbours is the height, whatever the slope
    rows, cols = h.shape
    for band in prange((rows + BAND - 1) // BAND):
        first, end = band * BAND, min(rows, band * BAND + BAND)
        size = (BAND + 2 * REACH) * STRIDE
        height, trust = np.empty(size, np.float32), np.empty(size, np.float32)
        sw, sh, inverse = np.empty(CHUNK, np.float32), np.empty(CHUNK, np.float32), np.empty(CHUNK, np.float32)
        for left in range(0, cols, CHUNK):
            width = min(CHUNK, cols - left)
            low, high = max(0, left - REACH), min(cols, left + width + REACH)
            height[:], trust[:] = ZERO, ZERO  # a border of unknown cells
            for r in range(max(0, first - REACH), min(rows, end + REACH)):
                k = (r - first + REACH) * STRIDE + low - left + REACH
                inner, near = slice(k, k + high - low), slice(low, high)
                _known_row(h[r, near], precision[r, near], noise[r, near], spread[r, near], height[inner], trust[inner])
            for r in range(first, end):
                k, here = (r - first) * STRIDE, slice(left, left + width)
                invert_row(spread[r, here], inverse[:width])
                _pairs_row(height[k:], trust[k:], inverse[:width], sw, sh)
                _pull_row(
                    sw, sh, h[r, here], precision[r, here], noise[r, here], inverse, np.float32(strength), out[r, here]
                )  # fmt: skip


@parallel_kernel
def block_tops(h: F32, side: int, lowest: float, out: F32) -> None:
    """Fill `out` with the highest known height of each block of `side` x `side` cells; `lowest` if none is known."""
    rows, cols = h.shape
    for i in prange(out.shape[0]):
        out[i] = np.float32(lowest)
        for r in range(i * side, min(rows, (i + 1) * side)):
            for c in range(cols):
                if h[r, c] > out[i, c // side]:
                    out[i, c // side] = h[r, c]


@parallel_kernel
def visibility(
    h: F32, tops: F32, block: int, centres: F64, xs: F64, ys: F64, cell: float, margin: F32, top_row: int,
    left_col: int, visible: U8,
) -> None:  # fmt: skip
    """Fill `visible` (N, P, Q) with 1 where the ray from a cell to camera i stays above the map, else 0 (eq. 13).

    Args:
        h: heights of the map, metres, NaN = unknown.
        tops: for each block of `block` x `block` cells, the highest height that a ray from it can meet, metres.
        margin: (P, Q) metres by which the map may rise above a ray.
        top_row, left_col: row and column of the map at which the P x Q cells begin.
    """
    n, high, wide = visible.shape
    rows, cols = h.shape
    for p in prange(high):
        r = top_row + p
        for i in range(n):
            visible[i, p] = 1
        for q in range(wide):
            c = left_col + q
            hc, top, spare = h[r, c], tops[r // block, c // block], margin[p, q]
            if not top > hc + spare:  # NaN too
                continue
            for i in range(n):
                dx = (centres[i, 0] - xs[c]) / cell
                dy = -(centres[i, 1] - ys[r]) / cell
                dz = centres[i, 2] - hc
                length = max(abs(dx), abs(dy))
                if length < 1e-6 or dz <= 0.0:
                    continue
                rise = dz / length  # metres per cell of the march
                down, right = dy / length, dx / length
                steps = int(min(length, (top - hc - spare) / rise))
                for s in range(1, steps + 1):
                    y, x = r + 0.5 + down * s, c + 0.5 + right * s
                    if not (0.0 <= y < rows and 0.0 <= x < cols):
                        break
                    if h[int(y), int(x)] > hc + rise * s + spare:  # False for NaN
                        visible[i, p, q] = 0
                        break
