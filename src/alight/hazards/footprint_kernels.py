"""Compiled loops that measure the ground under a lander (docs/method/hazards.md).

Loops run over whole rows of cells, offset by offset, so that they vectorise. An unknown height is NaN and fails every
`>` comparison, so it never enters a maximum.
"""

import math

import numpy as np

from alight.arrays import F32, F64, I64, Mask
from alight.compiled import kernel, parallel_kernel, prange


@kernel
def _row_sums(line: F32, reach: int, sums: F64) -> None:
    """Fill `sums` (6, C + 1 + 2 reach) with running sums along a row (C,) of k, k c, k c^2, k h, k c h, k h^2.

    k is 1 where the height h is known, else 0; c is the column. The first `reach` + 1 columns are 0, the last `reach`
    columns repeat the total.
    """
    n = s1 = s2 = sh = sch = shh = 0.0
    sums[:, : reach + 1] = 0.0
    for c in range(line.size):
        h = line[c]
        if not math.isnan(h):
            n += 1.0
            s1 += c
            s2 += c * c
            sh += h
            sch += c * h
            shh += float(h) * h
        at = c + reach + 1
        sums[0, at], sums[1, at], sums[2, at], sums[3, at], sums[4, at], sums[5, at] = n, s1, s2, sh, sch, shh
    for i in range(6):
        sums[i, line.size + reach + 1 :] = sums[i, line.size + reach]


@kernel
def _between(first: F64, last: F64, out: F64) -> None:
    for c in range(out.size):
        out[c] = last[c] - first[c]


@kernel
def _add_moments(span: F64, y: float, moments: F64) -> None:
    """Add the sums `span` (6, C) over one row of every footprint, `y` rows off its centre, to `moments` (10, C)."""
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
        moments[9, c] += span[5, c]


@kernel
def _solve(m: F64) -> tuple[float, float, float, float]:
    """Solve the least-squares plane of G1 from moments (10,) about the centre.

    Returns:
        Level, gradient x, gradient y, and the sum of squared deviations; all NaN without a plane.
    """
    n, mx, my, mh = m[0], m[1] / m[0], m[2] / m[0], m[6] / m[0]
    cxx, cxy, cyy = m[3] - n * mx * mx, m[4] - n * mx * my, m[5] - n * my * my
    det = cxx * cyy - cxy * cxy
    if n < 3.0 or not det > 1e-6 * (1.0 + cxx * cyy):
        return math.nan, math.nan, math.nan, math.nan
    cxh, cyh = m[7] - n * mx * mh, m[8] - n * my * mh
    gx = (cyy * cxh - cxy * cyh) / det
    gy = (cxx * cyh - cxy * cxh) / det
    return mh - gx * mx - gy * my, gx, gy, max(0.0, m[9] - m[6] * m[6] / n - (gx * cxh + gy * cyh))


@parallel_kernel
def fit_planes(height: F32, spans: I64, planes: F32) -> None:
    """Fit the least-squares plane of the footprint around every cell (G1).

    Args:
        height: (R, C), NaN = unknown.
        spans: (2 n + 1,) half widths in cells of the rows of the disc.
        planes: (5, R, C) filled with the number of known cells in the footprint; the plane's height at the centre, its
            rise per column and per row; and the sum of the squared deviations from it.
    """
    rows, cols = height.shape
    reach, band = spans.size // 2, 4 * spans.size  # rows of one thread, which makes the sums of a quarter more
    for b in prange((rows + band - 1) // band):
        top, bottom = b * band, min((b + 1) * band, rows)
        sums, span = np.empty((spans.size, 6, cols + 1 + 2 * reach)), np.empty((6, cols))  # the newest rows, in turn
        for q in range(max(top - reach, 0), bottom + reach):
            if q < rows:
                _row_sums(height[q], reach, sums[q % spans.size])
            r = q - reach
            if r < top:
                continue
            moments = np.zeros((10, cols))
            for i in range(max(0, reach - r), min(spans.size, rows + reach - r)):
                lo, hi = reach - spans[i], reach + spans[i] + 1
                for j in range(6):
                    line = sums[(r + i - reach) % spans.size, j]
                    _between(line[lo : lo + cols], line[hi : hi + cols], span[j])
                _add_moments(span, float(i - reach), moments)
            for c in range(cols):
                planes[0, r, c] = moments[0, c]
                planes[1, r, c], planes[2, r, c], planes[3, r, c], planes[4, r, c] = _solve(moments[:, c])


@kernel
def _widen(top: F32, low: F32, line: F32, after: F32, base: F32, grad: F32, x: float, y: float) -> None:
    """Widen the range [low, top] to include the heights above the plane, `line - base - x grad`, of two lines at once.

    The other line is `after`, at `y`; one line at a time takes 1.6 times as long.
    """
    for c in range(top.size):
        level, slope, t, b = base[c], grad[c], top[c], low[c]
        d, e = line[c] - level - x * slope, after[c] - level - y * slope
        t = d if d > t else t
        b = d if d < b else b
        top[c] = e if e > t else t
        low[c] = e if e < b else b


@parallel_kernel
def deviations(padded: F32, planes: F32, spans: I64, above: F32, below: F32) -> None:
    """Raise `above` and lower `below`, (R, C) zeros, to the largest and smallest h - plane in the footprint (G2).

    `padded` (R, C + 2 n) holds the heights h, with n = len(spans) // 2 unknown columns on both sides; `planes`: see
    `fit_planes`.
    """
    rows, cols = above.shape
    reach = spans.size // 2
    for r in prange(rows):
        base = np.empty(cols, np.float32)
        for i in range(max(0, reach - r), min(spans.size, rows + reach - r)):
            line, dr = padded[r + i - reach], np.float32(i - reach)
            for c in range(cols):
                base[c] = planes[1, r, c] + dr * planes[3, r, c]
            for dc in range(-spans[i], spans[i] + 1, 2):
                x, y = dc, min(dc + 1, spans[i])
                first, second = line[reach + x : reach + x + cols], line[reach + y : reach + y + cols]
                _widen(above[r], below[r], first, second, base, planes[2, r], np.float32(x), np.float32(y))


@kernel
def _lower(least: F32, line: F32, weight: F32, base: F32, grad: F32, x: float) -> None:
    """Lower `least` to `(base + x * grad - line) * weight`, the weighted distance below the plane, cell by cell."""
    for c in range(least.size):
        e = (base[c] + x * grad[c] - line[c]) * weight[c]
        t = least[c]
        least[c] = e if e < t else t


@parallel_kernel
def lower_to_margins(padded: F32, weight: F32, offsets: I64, level: F32, grad_c: F32, grad_r: F32, least: F32) -> None:
    """Lower `least` (R, C) to the least (plane - height) * weight of the cells at `offsets` (n, 2), (row, column).

    Args:
        padded, weight: (R + 2 pad, C + 2 pad) heights and weights, NaN where unknown and off the map.
        offsets: of up to `pad` cells, row by row.
        level, grad_c, grad_r: (R, C) plane of each cell: level, gradient per column, gradient per row.
        least: filled with inf.
    """
    rows, cols = least.shape
    pad = (padded.shape[1] - cols) // 2
    for r in prange(rows):
        base = np.empty(cols, np.float32)
        for i in range(offsets.shape[0]):
            dr, at = offsets[i, 0], pad + offsets[i, 1]
            if i == 0 or dr != offsets[i - 1, 0]:
                for c in range(cols):
                    base[c] = level[r, c] + np.float32(dr) * grad_r[r, c]
            there, its = padded[r + pad + dr][at : at + cols], weight[r + pad + dr][at : at + cols]
            _lower(least[r], there, its, base, grad_c[r], np.float32(offsets[i, 1]))


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
