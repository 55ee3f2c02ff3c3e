"""Loops over pictures before matching: local contrast, and which cameras see a cell (eqs. 3b and 5)."""

import numpy as np

from alight.arrays import F32, F64, FAR, ONE, U8, ZERO
from alight.compiled import kernel, parallel_kernel, prange


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
    """Fill `norm` (H, W) with (grey level - local mean) / local standard deviation (eq. 5).

    The deviation is at least `floor`. The window has 2 `reach` + 1 pixels a side; the picture's border is repeated.
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
def _reach_row(u: F32, place: F32, focal: np.float32, x: F32, north: np.float32, level: F32, box: F32) -> None:
    """Add a view at `place` (3,) to `box` (7, C): four bounds of the centres, their number, and two smallest pixels."""
    for c in range(u.size):
        seen = u[c] >= ZERO
        box[0, c] = place[0] if seen & (place[0] > box[0, c]) else box[0, c]
        box[1, c] = place[0] if seen & (place[0] < box[1, c]) else box[1, c]
        box[2, c] = place[1] if seen & (place[1] > box[2, c]) else box[2, c]
        box[3, c] = place[1] if seen & (place[1] < box[3, c]) else box[3, c]
        box[4, c] += ONE if seen else ZERO
        e, n, z = x[c] - place[0], north - place[1], level[c] - place[2]
        pixel = np.sqrt(e * e + n * n + z * z) / focal if seen else FAR
        finest = box[5, c]
        box[5, c] = pixel if pixel < finest else finest
        other = finest if pixel < finest else pixel
        box[6, c] = other if other < box[6, c] else box[6, c]


@parallel_kernel
def seen_from(
    columns: F32, centres: F64, focal: F64, xs: F64, ys: F64, level: F32, cell: float,
    baseline: F32, count: U8, per_px: F32, sampling: F32,
) -> None:  # fmt: skip
    """Fill (R, C) rasters with the geometry of the views of each cell at the heights `level` (R, C), metres.

    Args:
        columns: (N, R, C) pixel column of each cell in each view; negative where the view does not see the cell.
        centres, focal: (N, 3) camera centres, metres, and (N,) focal lengths, pixels.
        baseline: out, metres, horizontal diagonal of the box about the centres of the views that see the cell.
        count: out, number of these views.
        per_px: out, metres of height that move the outermost of these views apart by one `cell` (eq. 3b).
        sampling: out, metres of ground per pixel of the second finest of these views (a height needs two views), at
            least `cell`; NaN where fewer than two views see the cell.
    """
    n, rows, cols = columns.shape
    mean = np.float32(centres[:, 2].mean())
    places, x = centres.astype(np.float32), xs.astype(np.float32)
    for r in prange(rows):
        box = np.zeros((7, cols), np.float32)
        box[0], box[1], box[2], box[3], box[5], box[6] = -FAR, FAR, -FAR, FAR, FAR, FAR
        for i in range(n):
            _reach_row(columns[i, r], places[i], np.float32(focal[i]), x, np.float32(ys[r]), level[r], box)
        for c in range(cols):
            de, dn = box[0, c] - box[1, c], box[2, c] - box[3, c]
            b = np.sqrt(de * de + dn * dn) if de >= ZERO else ZERO
            drop = max(mean - level[r, c], np.float32(1e-2))
            baseline[r, c], count[r, c] = b, np.uint8(box[4, c])
            per_px[r, c] = np.float32(cell) * drop / max(b, np.float32(0.01) * drop)
            second = box[5, c] if n == 1 else box[6, c]
            sampling[r, c] = max(second, np.float32(cell)) if second < FAR else np.float32(np.nan)
