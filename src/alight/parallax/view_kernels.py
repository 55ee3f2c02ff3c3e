"""Loops over pictures before anything is matched: local contrast, and which cameras see a cell (eqs. 3b and 5)."""

import numpy as np

from alight.arrays import F32, F64, U8
from alight.compiled import kernel, parallel_kernel, prange

FAR = np.float32(1e6)  # metres: beyond every camera
ZERO, ONE = np.float32(0), np.float32(1)


@kernel
def _column_sums(row: F32, total: F32, squares: F32) -> None:
    for c in range(row.size):
        total[c] += row[c]
        squares[c] += row[c] * row[c]


@kernel
def _add_rows(part: F32, squares: F32, total: F32, total2: F32) -> None:
    for c in range(total.size):
        total[c] += part[c]
        total2[c] += squares[c]


@kernel
def _normalise_row(grey: F32, total: F32, total2: F32, share: np.float32, floor: np.float32, norm: F32) -> None:
    for c in range(grey.size):
        mean = total[c] * share
        variance = total2[c] * share - mean * mean
        sd = np.sqrt(variance if variance > ZERO else ZERO)
        norm[c] = (grey[c] - mean) / (sd if sd > floor else floor)


@parallel_kernel
def normalise(grey: F32, reach: int, floor: float, norm: F32) -> None:
    """Fill `norm` (H, W) with the grey level less its local mean over its local sd, at least `floor` (eq. 5).

    The window has 2 `reach` + 1 pixels; beyond the picture its border goes on.
    """
    rows, cols = grey.shape
    share = np.float32(1.0 / (2 * reach + 1) ** 2)
    for r in prange(rows):
        part, squares = np.zeros(cols + 2 * reach, np.float32), np.zeros(cols + 2 * reach, np.float32)
        inner = slice(reach, reach + cols)
        for y in range(r - reach, r + reach + 1):
            _column_sums(grey[min(max(y, 0), rows - 1)], part[inner], squares[inner])
        part[:reach], part[reach + cols :] = part[reach], part[reach + cols - 1]
        squares[:reach], squares[reach + cols :] = squares[reach], squares[reach + cols - 1]
        total, total2 = np.zeros(cols, np.float32), np.zeros(cols, np.float32)
        for x in range(2 * reach + 1):
            _add_rows(part[x : x + cols], squares[x : x + cols], total, total2)
        _normalise_row(grey[r], total, total2, share, np.float32(floor), norm[r])


@kernel
def _reach_row(s: F32, east: np.float32, north: np.float32, box: F32) -> None:
    """Widen the box (east, west, north, south, number) of the centres that see each cell."""
    for c in range(s.size):
        seen = s[c] == s[c]
        box[0, c] = east if seen & (east > box[0, c]) else box[0, c]
        box[1, c] = east if seen & (east < box[1, c]) else box[1, c]
        box[2, c] = north if seen & (north > box[2, c]) else box[2, c]
        box[3, c] = north if seen & (north < box[3, c]) else box[3, c]
        box[4, c] += ONE if seen else ZERO


@parallel_kernel
def baseline(samples: F32, centres: F64, out: F32, seen: U8) -> None:
    """Fill `out` (R, C) with the diagonal of the box, level with the ground, of the cameras that see each cell.

    `seen` gets their number.
    """
    n, rows, cols = samples.shape
    for r in prange(rows):
        box = np.zeros((5, cols), np.float32)
        box[0], box[1], box[2], box[3] = -FAR, FAR, -FAR, FAR
        for i in range(n):
            _reach_row(samples[i, r], np.float32(centres[i, 0]), np.float32(centres[i, 1]), box)
        for c in range(cols):
            de, dn = box[0, c] - box[1, c], box[2, c] - box[3, c]
            out[r, c] = np.sqrt(de * de + dn * dn) if de >= ZERO else ZERO
            seen[r, c] = np.uint8(box[4, c])
