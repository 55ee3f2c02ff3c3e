"""Compiled loops that measure the ground under a lander (docs/method/hazards.md).

Loops run over whole rows of cells, offset by offset, so that they vectorise. An unknown height is NaN and fails every
`>` comparison, so it never enters a maximum.
"""

import math

import numpy as np

from alight.arrays import F32, F64, I64, Mask
from alight.compiled import kernel, parallel_kernel, prange


@parallel_kernel
def row_sums(height: F32, reach: int, sums: F64) -> None:
    """Fill `sums` (R, 6, C + 1 + 2 reach) with running sums along each row of k, k c, k c^2, k h, k c h, k h^2.

    k is 1 where the height h is known, else 0; c is the column. The first `reach` + 1 columns are 0, the last `reach`
    columns repeat the total.
    """
    rows, cols = height.shape
    for r in prange(rows):
        n = s1 = s2 = sh = sch = shh = 0.0
        sums[r, :, : reach + 1] = 0.0
        for c in range(cols):
            h = height[r, c]
            if not math.isnan(h):
                n += 1.0
                s1 += c
                s2 += c * c
                sh += h
                sch += c * h
                shh += float(h) * h
            at = c + reach + 1
            sums[r, 0, at], sums[r, 1, at], sums[r, 2, at] = n, s1, s2
            sums[r, 3, at], sums[r, 4, at], sums[r, 5, at] = sh, sch, shh
        for i in range(6):
            sums[r, i, cols + reach + 1 :] = sums[r, i, cols + reach]


@kernel
def _between(first: F64, last: F64, out: F64) -> None:
    for c in range(out.size):
        out[c] = last[c] - first[c]


@kernel
def _add_moments(span: F64, y: float, moments: F64) -> None:
    """Add the sums `span` (6, C) over one row of every footprint, `y` rows off its centre, to `moments` (9, C)."""
    for c in range(span.shape[1]):
        x = float(c)
        k, kc, kh = span[0, c], span[1, c], span[3, c]
        kx = kc - x * k
        moments[0, c] += k
        moments[1, c] += kx
        moments[2, c] += y * k
        moments[3, c] += span[2, c] - 2.0 * x * kc + x * x * k
        moments[4, c] += y * kx
        moments[5, c] += y * y * k
        moments[6, c] += kh
        moments[7, c] += span[4, c] - x * kh
        moments[8, c] += y * kh


@kernel
def _solve(
    n: float, sx: float, sy: float, sxx: float, sxy: float, syy: float, sh: float, sxh: float, syh: float
) -> tuple[float, float, float, float]:
    """Solve the least-squares plane of G1 from sums about the centre.

    Returns:
        Level, gradient x, gradient y, and the sum of squares that the gradients explain; all NaN without a plane.
    """
    mx, my, mh = sx / n, sy / n, sh / n
    cxx, cxy, cyy = sxx - n * mx * mx, sxy - n * mx * my, syy - n * my * my
    det = cxx * cyy - cxy * cxy
    if not det > 1e-6 * (1.0 + cxx * cyy):
        return math.nan, math.nan, math.nan, math.nan
    cxh, cyh = sxh - n * mx * mh, syh - n * my * mh
    gx = (cyy * cxh - cxy * cyh) / det
    gy = (cxx * cyh - cxy * cxh) / det
    return mh - gx * mx - gy * my, gx, gy, gx * cxh + gy * cyh


@parallel_kernel
def fit_planes(sums: F64, spans: I64, count: F32, level: F32, grad_c: F32, grad_r: F32, squares: F32) -> None:
    """Fit the least-squares plane of the footprint around every cell (G1).

    Args:
        sums: (R, 6, C + 1 + 2 n) from `row_sums`.
        spans: (2 n + 1,) half widths in cells of the rows of the disc.
        count: (R, C) filled with the number of known cells in the footprint.
        level, grad_c, grad_r: (R, C) filled with the plane at the centre and its rise per column and per row.
        squares: (R, C) filled with the sum of the squared deviations from the plane.
    """
    rows, cols = count.shape
    reach = spans.size // 2
    for r in prange(rows):
        span, moments, power = np.empty((6, cols)), np.zeros((9, cols)), np.zeros(cols)
        for i in range(spans.size):
            q = r + i - reach
            if q < 0 or q >= rows:
                continue
            lo, hi = reach - spans[i], reach + spans[i] + 1
            for j in range(6):
                _between(sums[q, j, lo : lo + cols], sums[q, j, hi : hi + cols], span[j])
            _add_moments(span, float(i - reach), moments)
            power += span[5]
        for c in range(cols):
            m = moments[:, c]
            count[r, c] = m[0]
            if m[0] < 3.0:
                level[r, c] = grad_c[r, c] = grad_r[r, c] = squares[r, c] = math.nan
                continue
            a, gx, gy, explained = _solve(m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8])
            level[r, c], grad_c[r, c], grad_r[r, c] = a, gx, gy
            squares[r, c] = max(0.0, power[c] - m[6] * m[6] / m[0] - explained)


@kernel
def _widen(top: F32, low: F32, line: F32, base: F32, grad: F32, x: float) -> None:
    """Widen the range [low, top] to include `line - base - x * grad`, the height above the plane, cell by cell."""
    for c in range(top.size):
        d = line[c] - base[c] - x * grad[c]
        t, b = top[c], low[c]
        top[c] = d if d > t else t
        low[c] = d if d < b else b


@kernel
def _widen_by_two(top: F32, low: F32, line: F32, after: F32, base: F32, grad: F32, x: float, y: float) -> None:
    """Widen [low, top] by two lines of heights in one pass, `line` at `x` and `after` at `y`; see `_widen`."""
    for c in range(top.size):
        level, slope, t, b = base[c], grad[c], top[c], low[c]
        d, e = line[c] - level - x * slope, after[c] - level - y * slope
        t = d if d > t else t
        b = d if d < b else b
        top[c] = e if e > t else t
        low[c] = e if e < b else b


@kernel
def _lower_to_margin(least: F32, line: F32, weight: F32, base: F32, grad: F32, x: float) -> None:
    """Lower `least` to `(base + x * grad - line) * weight`, the weighted distance below the plane, cell by cell."""
    for c in range(least.size):
        e = (base[c] + x * grad[c] - line[c]) * weight[c]
        t = least[c]
        least[c] = e if e < t else t


@parallel_kernel
def deviations(padded: F32, level: F32, grad_c: F32, grad_r: F32, spans: I64, above: F32, below: F32) -> None:
    """Fill `above` and `below` (R, C) with the largest and smallest h - plane in the footprint (G2); 0 without a plane.

    `padded` (R, C + 2 n) holds the heights h, with n = len(spans) // 2 unknown columns on both sides.
    """
    rows, cols = level.shape
    reach = spans.size // 2
    for r in prange(rows):
        base = np.empty(cols, np.float32)
        gc = grad_c[r]
        top, low = above[r], below[r]
        top[:] = np.float32(0.0)
        low[:] = np.float32(0.0)
        for i in range(spans.size):
            q = r + i - reach
            if q < 0 or q >= rows:
                continue
            line = padded[q]
            for c in range(cols):
                base[c] = level[r, c] + np.float32(i - reach) * grad_r[r, c]
            _widen(top, low, line[reach - spans[i] : reach - spans[i] + cols], base, gc, np.float32(-spans[i]))
            for dc in range(1 - spans[i], spans[i] + 1, 2):
                at = reach + dc
                left, right = line[at : at + cols], line[at + 1 : at + 1 + cols]
                _widen_by_two(top, low, left, right, base, gc, np.float32(dc), np.float32(dc + 1))


@parallel_kernel
def neighbour_steps(height: F32, step: F32) -> None:
    """Fill `step` (R, C) with the largest height difference to the four neighbours, if known; NaN for unknown cells."""
    rows, cols = height.shape
    for r in prange(rows):
        for c in range(cols):
            h = height[r, c]
            worst = h - h  # 0, or NaN where h is unknown
            if r > 0:
                worst = max(worst, abs(height[r - 1, c] - h))
            if r < rows - 1:
                worst = max(worst, abs(height[r + 1, c] - h))
            if c > 0:
                worst = max(worst, abs(height[r, c - 1] - h))
            if c < cols - 1:
                worst = max(worst, abs(height[r, c + 1] - h))
            step[r, c] = worst


@parallel_kernel
def least_margin(
    height: F32, weight: F32, level: F32, grad_c: F32, grad_r: F32, inner: I64, outer: I64, out: F32
) -> None:
    """Fill `out` (R, C) with the least (plane - height) * weight in the ring between two discs; inf without heights.

    `inner`, `outer`: half width of each row of the discs, cells; both have the rows of the outer disc, -1: no cells.
    """
    rows, cols = height.shape
    reach = outer.size // 2
    for r in prange(rows):
        base = np.empty(cols, np.float32)
        gc = grad_c[r]
        least = out[r]
        least[:] = np.float32(np.inf)
        for i in range(outer.size):
            q = r + i - reach
            if q < 0 or q >= rows:
                continue
            line, heavy = height[q], weight[q]
            for c in range(cols):
                base[c] = level[r, c] + np.float32(i - reach) * grad_r[r, c]
            for dc in range(-outer[i], outer[i] + 1):
                if abs(dc) <= inner[i]:
                    continue
                lo, hi = max(0, -dc), min(cols, cols - dc)
                if hi > lo:
                    there, its = line[lo + dc : hi + dc], heavy[lo + dc : hi + dc]
                    _lower_to_margin(least[lo:hi], there, its, base[lo:hi], gc[lo:hi], np.float32(dc))


@parallel_kernel
def cast_shadows(height: F32, towards_r: float, towards_c: float, climb: float, longest: int, out: Mask) -> None:
    """Fill `out` (R, C) with True where an obstacle towards the sun is above the ray to it.

    Args:
        height: (R, C) metres, no NaN.
        towards_r, towards_c: unit vector (row, column) towards the sun.
        climb: rise of the ray per cell, metres.
        longest: length of the search along a ray, cells.
    """
    rows, cols = height.shape
    top = height.max()
    for r in prange(rows):
        for c in range(cols):
            out[r, c] = False
            for i in range(1, longest + 1):
                q, p = math.floor(r + i * towards_r + 0.5), math.floor(c + i * towards_c + 0.5)
                ray = height[r, c] + i * climb
                if q < 0 or q >= rows or p < 0 or p >= cols or ray > top:
                    break
                if height[q, p] > ray + 0.5 * climb:
                    out[r, c] = True
                    break
