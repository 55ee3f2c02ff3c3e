"""Truth of a touchdown, cell by cell: the least-squares plane of the disc, and the deviations from it.

Only for the simulator's truth: the stages that it judges have kernels of their own.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from alight.compiled import kernel, parallel_kernel, prange

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
B = NDArray[np.bool_]


@parallel_kernel
def running_sums(height: F32, barred: B, base: float, sums: F64, count: I64) -> None:
    """Fill `sums` (R, C + 1, 2) with running sums along each row: heights above `base`, and column times height.

    `count` (R, C + 1): running number of barred cells, whose heights are left out.
    """
    rows, cols = height.shape
    for r in prange(rows):
        sums[r, 0, 0], sums[r, 0, 1], count[r, 0] = 0.0, 0.0, 0
        for c in range(cols):
            h = 0.0 if barred[r, c] else float(height[r, c]) - base
            sums[r, c + 1, 0] = sums[r, c, 0] + h
            sums[r, c + 1, 1] = sums[r, c, 1] + c * h
            count[r, c + 1] = count[r, c] + (1 if barred[r, c] else 0)


@kernel
def _even(height: F32, base: float, r: int, c: int, half: I64, plane: tuple[float, float, float], limit: float) -> bool:
    """Return whether the disc at cell (r, c) keeps within `limit` of a plane: mean, rise per column, rise per row."""
    mean, rise_x, rise_y = plane
    k = half.size // 2
    for i in range(-k, k + 1):
        w, level = half[i + k], mean + base + rise_y * i
        worst = 0.0
        for j in range(-w, w + 1):
            worst = max(worst, abs(float(height[r + i, c + j]) - (level + rise_x * j)))
        if worst > limit:
            return False
    return True


@parallel_kernel
def touchdown(
    height: F32, base: float, sums: F64, count: I64, half: I64, steep: float, limit: float, out: B
) -> None:  # fmt: skip
    """Fill `out` (R, C): whether the disc around a cell has no barred cell, slope <= `steep` and deviations <= `limit`.

    `steep`: rise per cell. `half` (2 k + 1,): half widths of the disc's rows in cells. On a full disc the normal
    equations are diagonal: the plane's slopes are first moments over second moments. A disc that leaves the array is
    not safe.
    """
    rows, cols = height.shape
    k = half.size // 2
    cells, second_x, second_y = 0.0, 0.0, 0.0
    for i in range(-k, k + 1):
        w = float(half[i + k])
        cells += 2.0 * w + 1.0
        second_x += w * (w + 1.0) * (2.0 * w + 1.0) / 3.0
        second_y += i * i * (2.0 * w + 1.0)
    for r in prange(rows):
        for c in range(cols):
            out[r, c] = False
            if r < k or c < k or r + k >= rows or c + k >= cols:
                continue
            barred, total, first_x, first_y = 0, 0.0, 0.0, 0.0
            for i in range(-k, k + 1):
                a, b = c - half[i + k], c + half[i + k] + 1
                barred += count[r + i, b] - count[r + i, a]
                part = sums[r + i, b, 0] - sums[r + i, a, 0]
                total += part
                first_x += sums[r + i, b, 1] - sums[r + i, a, 1] - c * part
                first_y += i * part
            if barred > 0:
                continue
            rise_x, rise_y = first_x / max(second_x, 1.0), first_y / max(second_y, 1.0)
            if math.hypot(rise_x, rise_y) <= steep:
                out[r, c] = _even(height, base, r, c, half, (total / cells, rise_x, rise_y), limit)
