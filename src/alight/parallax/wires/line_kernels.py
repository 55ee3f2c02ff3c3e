"""Sums along straight lines of a picture, and what other views have where a line in the air would be seen."""

import math

import numpy as np

from alight.arrays import F32, F64, I64, U8
from alight.compiled import kernel

BLOCK = 8  # cells along a line that are added first
REACH = 2  # blocks to either side of the middle one


@kernel
def _add(values: F32, down: int, total: F32) -> None:
    """Add the values (R,) from `down` rows below to `total` (R,), as far as there are such rows."""
    if down >= 0:
        here, there = total[: total.size - down], values[down:]
    else:
        here, there = total[-down:], values[: values.size + down]
    for r in range(here.size):
        here[r] += there[r]


@kernel
def sum_lines(columns: F32, slopes: F64, out: F32) -> None:
    """Fill `out` (D, B, R) with the sums along lines of `2 REACH + 1` blocks through the middle of every block.

    Args:
        columns: (BLOCK, B, R), the picture's columns: every `BLOCK`-th, beginning at each of the first `BLOCK`.
        slopes: (D,) cells down for a cell to the right, -1 to 1.
        out: (D, B, R) sums; lines that leave the picture miss what is beyond.
    """
    blocks, rows = columns.shape[1], columns.shape[2]
    part = np.empty((blocks, rows), np.float32)
    for d in range(slopes.size):
        part[:] = np.float32(0)
        for k in range(BLOCK):
            down = round(slopes[d] * (k - 0.5 * (BLOCK - 1)))
            for b in range(blocks):
                _add(columns[k, b], down, part[b])
        out[d] = np.float32(0)
        for step in range(-REACH, REACH + 1):
            down = round(slopes[d] * BLOCK * step)
            for b in range(max(0, -step), min(blocks, blocks - step)):
                _add(part[b + step], down, out[d, b])


@kernel
def pick_lines(sums: F32, rows: int, tall: int, least: float, out: I64) -> int:
    """Write slope, block and row of the strongest line of each block and `tall` rows to `out` (N, 3); return how many.

    Lines are counted if the size of their sum is at least `least`; `sums` (D, B, R), of which `rows` rows are used.
    """
    count = 0
    for b in range(sums.shape[1]):
        for first in range(0, rows, tall):
            best, at_d, at_r = np.float32(least), -1, 0
            for d in range(sums.shape[0]):
                for r in range(first, min(first + tall, rows)):
                    size = abs(sums[d, b, r])
                    if size > best:
                        best, at_d, at_r = size, d, r
            if at_d >= 0 and count < out.shape[0]:
                out[count, 0], out[count, 1], out[count, 2] = at_d, b, at_r
                count += 1
    return count


@kernel
def _is_known(known: U8, block: int, row: int) -> bool:
    """Whether most of a block's row (B, R) is known; a block beyond the picture is not."""
    if block < 0 or block >= known.shape[0] or row < 0 or row >= known.shape[1]:
        return False
    return bool(known[block, row] > 127)


@kernel
def raise_lines(
    lines: F64, own: int, heights: F64, centres: F64, grids: F64, known: U8, sums: F32, slopes: F64, still: float,
    cap: float, fewest: int, out: F64,
) -> None:  # fmt: skip
    """Find the height at which the other views show each line best.

    A line at height `h` above the plane, which one view sees at a place of the plane, is seen by another view at
    another place, parallel to it. Each view counts up to `cap`, so that no view decides alone. The height is that at
    which the sum is largest if each view counts up to the line's own sum instead: near a clear wire many heights reach
    the cap.

    Args:
        lines: (K, 5) east, north on the plane [m]; family: 0 nearly level, 1 nearly upright; slope number; its own
            sum in `own`.
        own: number of the view that shows the lines.
        heights: (K, T) above the plane, metres, rising along each line; or (1, T) for all lines.
        centres: (V, 3) camera centres, metres above the plane.
        grids: (V, 5) east, north of the first cell, cell [m], rows, columns of each view's part of the plane.
        known: (V, 2, B, R) share of the cells of each block and row whose difference is known, 0 to 255; as the sums.
        sums: (V, 2, D, B, R) sums along lines over their noise; family 1 with rows and columns exchanged.
        slopes: (D,) cells down for a cell to the right.
        still: shift in cells, across the line, up to which a view cannot tell the line from one on the ground.
        cap: largest count of a view.
        fewest: least number of other views.
        out: (K, 4) sum over the root of the number of views, height [m], number of views, and the other sum likewise;
            at the best height. Without enough views the sums are 0, and the number is the largest of all heights.
    """
    steps = heights.shape[1]
    total, fit, count = np.empty(steps), np.empty(steps), np.empty(steps, np.int64)
    for k in range(lines.shape[0]):
        east, north, family, d = lines[k, 0], lines[k, 1], int(lines[k, 2]), int(lines[k, 3])
        own_heights = heights[min(k, heights.shape[0] - 1)]
        sign, clear = math.copysign(1.0, lines[k, 4]), max(abs(lines[k, 4]), cap)
        slope = slopes[d]
        down = round(slope * BLOCK * REACH)
        across_e, across_n = (slope, 1.0) if family == 0 else (1.0, slope)
        length = math.hypot(across_e, across_n)
        across_e, across_n = across_e / length, across_n / length
        total[:], fit[:], count[:] = 0.0, 0.0, 0
        for v in range(centres.shape[0]):  # outside, so that neighbouring heights read neighbouring sums
            if v == own:
                continue
            cell, rows, cols = grids[v, 2], int(grids[v, 3]), int(grids[v, 4])
            if family == 1:
                rows, cols = cols, rows
            view_sums, view_known = sums[v, family, d], known[v, family]
            for t in range(steps):
                h = own_heights[t]
                drop = centres[v, 2] - h
                if drop < 1.0:
                    break
                share, far = 1.0 - h / centres[own, 2], centres[v, 2] / drop
                e = centres[v, 0] + (centres[own, 0] + (east - centres[own, 0]) * share - centres[v, 0]) * far
                n = centres[v, 1] + (centres[own, 1] + (north - centres[own, 1]) * share - centres[v, 1]) * far
                if abs((e - east) * across_e + (n - north) * across_n) < still * cell:
                    continue
                row, col = (grids[v, 1] - n) / cell, (e - grids[v, 0]) / cell
                if family == 1:
                    row, col = col, row
                block = round((col - 0.5 * (BLOCK - 1)) / BLOCK)
                if block < 1 or block >= cols // BLOCK - 1:
                    continue
                at = round(row + slope * (BLOCK * block + 0.5 * (BLOCK - 1) - col))
                if at < 2 or at >= rows - 2:
                    continue
                if not (_is_known(view_known, block - REACH, at - down)):
                    continue
                if not (_is_known(view_known, block + REACH, at + down)):
                    continue
                size = sign * view_sums[block, at]
                total[t] += min(max(size, -cap), cap)
                fit[t] += min(max(size, -clear), clear)
                count[t] += 1
        out[k, 0], out[k, 1], out[k, 2], out[k, 3] = 0.0, own_heights[0], 0.0, 0.0
        for t in range(steps):
            if count[t] >= fewest and fit[t] / math.sqrt(count[t]) > out[k, 3]:
                out[k, 0], out[k, 1], out[k, 2] = total[t] / math.sqrt(count[t]), own_heights[t], count[t]
                out[k, 3] = fit[t] / math.sqrt(count[t])
            elif out[k, 3] == 0.0:
                out[k, 2] = max(out[k, 2], count[t])
