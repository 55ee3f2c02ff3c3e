"""Corner responses (Shi and Tomasi 1994) from image gradients, and the table of undistorted rays: kernels."""

import math

import numpy as np

from alight.arrays import F32, F64, I16, I32, I64
from alight.compiled import inline, kernel

_GREY = 4.0 * 255.0  # of a Sobel gradient: what cv2.cornerMinEigenVal divides by


@inline
def _min_eigenvalue(xx: float, xy: float, yy: float) -> float:
    """The smaller eigenvalue of [[xx, xy], [xy, yy]]."""
    return 0.5 * (xx + yy) - math.sqrt(0.25 * (xx - yy) ** 2 + xy**2)


@inline
def _mirror(i: int, n: int) -> int:
    return -i if i < 0 else 2 * n - 2 - i if i >= n else i


@kernel
def corner_responses(gx: I16, gy: I16, pixels: F32, window: int, out: F64) -> None:
    """Write the Shi-Tomasi response a pixel over the window about each of (N, 2) pixels, mirrored at the edge.

    Args:
        gx, gy: (H, W) Sobel gradients.
        out: (N,), grey range 1.
    """
    h, w = gx.shape
    low = window // 2
    for k in range(pixels.shape[0]):
        x = min(max(int(np.rint(pixels[k, 0])), 0), w - 1)
        y = min(max(int(np.rint(pixels[k, 1])), 0), h - 1)
        xx, xy, yy = 0, 0, 0
        inside = x >= low and x + window - low <= w
        for dy in range(-low, window - low):
            row = _mirror(y + dy, h)
            for dx in range(-low, window - low):
                col = x + dx if inside else _mirror(x + dx, w)
                a, b = int(gx[row, col]), int(gy[row, col])
                xx += a * a
                xy += a * b
                yy += b * b
        unit = 1.0 / (window * window * _GREY * _GREY)
        out[k] = _min_eigenvalue(xx * unit, xy * unit, yy * unit)


@kernel
def _column_sums(gx: I16, gy: I16, row: int, left: int, right: int, half: int, sums: I32) -> None:
    """Sum the products of the gradients over a column of the window."""
    n = right - left
    xx, xy, yy = sums[0, :n], sums[1, :n], sums[2, :n]
    xx[:], xy[:], yy[:] = 0, 0, 0
    for v in range(row - half, row + half + 1):
        a, b = gx[v, left:right], gy[v, left:right]
        for u in range(n):
            p, q = np.int32(a[u]), np.int32(b[u])
            xx[u] += p * p
            xy[u] += p * q
            yy[u] += q * q


@kernel
def _row_responses(sums: I32, n: int, half: int, unit: float, out: F32) -> None:
    """Sum the column sums over the window and write the response."""
    scale = np.float32(unit)
    for x in range(n):
        xx, xy, yy = np.int32(0), np.int32(0), np.int32(0)
        for u in range(x, x + 2 * half + 1):
            xx += sums[0, u]
            xy += sums[1, u]
            yy += sums[2, u]
        a, b, c = scale * np.float32(xx), scale * np.float32(xy), scale * np.float32(yy)
        d = np.float32(0.5) * (a - c)
        out[x] = np.float32(0.5) * (a + c) - np.sqrt(d * d + b * b)


@kernel
def strongest_corners(
    gx: I16, gy: I16, boxes: I64, taken: F32, away: float, half: int, response: F32, sums: I32, out: F64
) -> None:
    """Find the strongest corner of every box, at a distance from the features present.

    Args:
        gx, gy: (H, W) Sobel gradients.
        boxes: (E, 4) first row, end row, first column, end column; `half` inside the image.
        taken: (M, 2) pixels of present features.
        away: px, smallest distance of a corner from these.
        half: of the window that the response is summed over, less the middle.
        response: (rows, columns) of the largest box, scratch.
        sums: (3, columns of the largest box + 2 half), scratch.
        out: (E, 3) column, row, Shi-Tomasi response a pixel; the response is negative where there is none.
    """
    unit = 1.0 / ((2 * half + 1) ** 2 * _GREY * _GREY)
    for e in range(boxes.shape[0]):
        top, bottom, left, right = boxes[e]
        for y in range(top, bottom):
            _column_sums(gx, gy, y, left - half, right + half, half, sums)
            _row_responses(sums, right - left, half, unit, response[y - top])
        for k in range(taken.shape[0]):
            for y in range(max(top, int(taken[k, 1] - away)), min(bottom, int(taken[k, 1] + away) + 2)):
                for x in range(max(left, int(taken[k, 0] - away)), min(right, int(taken[k, 0] + away) + 2)):
                    if (x - taken[k, 0]) ** 2 + (y - taken[k, 1]) ** 2 < away * away:
                        response[y - top, x - left] = -1.0
        best = np.float32(-1.0)
        out[e, 0], out[e, 1] = left, top
        for y in range(top, bottom):
            for x in range(left, right):
                if response[y - top, x - left] > best:
                    best = response[y - top, x - left]
                    out[e, 0], out[e, 1] = x, y
        out[e, 2] = best


@kernel
def interpolate_rays(table: F64, pixels: F64, out: F64) -> None:
    """Interpolate a table (R, C, 2) bilinearly at (N, 2) places (column, row); outside, at its edge.

    NaN stays NaN.
    """
    rows, cols = table.shape[:2]
    for k in range(pixels.shape[0]):
        if not (np.isfinite(pixels[k, 0]) and np.isfinite(pixels[k, 1])):
            out[k] = np.nan
            continue
        x = min(max(pixels[k, 0], 0.0), cols - 1.001)
        y = min(max(pixels[k, 1], 0.0), rows - 1.001)
        i, j = int(y), int(x)
        b, a = y - i, x - j
        for c in range(2):
            upper = (1 - a) * table[i, j, c] + a * table[i, j + 1, c]
            lower = (1 - a) * table[i + 1, j, c] + a * table[i + 1, j + 1, c]
            out[k, c] = (1 - b) * upper + b * lower
