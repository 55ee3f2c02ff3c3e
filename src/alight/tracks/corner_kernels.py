"""Kernels for corner responses (Shi and Tomasi 1994) from image gradients, and for the table of undistorted rays."""

import math

import numpy as np

from alight.arrays import F32, F64, I64, U8
from alight.compiled import inline, kernel, sum_kernel

_GREY = 4.0 * 255.0  # Sobel gradient of a grey range of 1: the divisor of cv2.cornerMinEigenVal


@inline
def _min_eigenvalue(xx: float, xy: float, yy: float) -> float:
    return 0.5 * (xx + yy) - math.sqrt(0.25 * (xx - yy) ** 2 + xy**2)


@inline
def _mirror(i: int, n: int) -> int:
    return -i if i < 0 else 2 * n - 2 - i if i >= n else i


@kernel
def _copy_box(image: U8, top: int, left: int, rows: int, cols: int, grey: F32) -> None:
    """Copy a rectangle of the image, row by row, to the flat array `grey`."""
    # single precision holds products of gradients exactly, and the compiler would make integers twice as wide. Flat,
    # because loops over one row are too short to be vectorised
    for r in range(rows):
        line, out = image[top + r, left : left + cols], grey[r * cols : (r + 1) * cols]
        for c in range(cols):
            out[c] = line[c]


@kernel
def _mirrored_products(image: U8, top: int, left: int, window: int, xx: F32, xy: F32, yy: F32) -> None:
    """Write the products of `_gradient_products` for a window that extends beyond the image, mirrored at the edge."""
    h, w = image.shape
    for r in range(window):
        y = _mirror(top + r, h)
        above, here, below = image[_mirror(y - 1, h)], image[y], image[_mirror(y + 1, h)]
        for c in range(window):
            x, k = _mirror(left + c, w), r * (window + 2) + c
            i, j = _mirror(x - 1, w), _mirror(x + 1, w)
            gx = int(above[j]) - int(above[i]) + 2 * (int(here[j]) - int(here[i])) + int(below[j]) - int(below[i])
            gy = int(below[i]) - int(above[i]) + 2 * (int(below[x]) - int(above[x])) + int(below[j]) - int(above[j])
            xx[k], xy[k], yy[k] = gx * gx, gx * gy, gy * gy


@kernel
def _gradient_products(grey: F32, count: int, cols: int, xx: F32, xy: F32, yy: F32) -> None:
    """Write the products of the Sobel gradients for `count` pixels of a flat image with `cols` columns.

    Product i belongs to the pixel one row below and one column right of pixel i; it is invalid in the last two columns.
    """
    above, here, below = grey, grey[cols:], grey[2 * cols :]
    for i in range(count):
        rise, fall = below[i + 2] - above[i], below[i] - above[i + 2]
        across, down = here[i + 2] - here[i], below[i + 1] - above[i + 1]
        gx, gy = rise - fall + across + across, rise + fall + down + down
        xx[i], xy[i], yy[i] = gx * gx, gx * gy, gy * gy


@sum_kernel
def _weighted_sum(values: F32, weights: F32, count: int) -> float:
    total = np.float32(0.0)
    for i in range(count):
        total += values[i] * weights[i]
    return float(total)


@kernel
def corner_responses(image: U8, pixels: F32, window: int, out: F64) -> None:
    """Write the Shi-Tomasi response of the window around each pixel, divided by the window's area.

    Args:
        image: (H, W) grey, mirrored at its edge.
        pixels: (N, 2) column and row; pixels outside the image are moved to its edge.
        window: side of the window, px.
        out: (N,) responses, for a grey range of 1.
    """
    h, w = image.shape
    side, low, unit = window + 2, window // 2, 1.0 / (window * window * _GREY * _GREY)
    count = side * window - 2
    grey, weights = np.empty(side * side, np.float32), np.zeros(side * window, np.float32)
    p = np.zeros((3, side * side), np.float32)
    for r in range(window):
        weights[r * side : r * side + window] = 1.0
    for k in range(pixels.shape[0]):
        x = min(max(int(np.rint(pixels[k, 0])), 0), w - 1)
        y = min(max(int(np.rint(pixels[k, 1])), 0), h - 1)
        top, left = y - low, x - low
        if top >= 1 and left >= 1 and top + window < h and left + window < w:
            _copy_box(image, top - 1, left - 1, side, side, grey)
            _gradient_products(grey, count, side, p[0], p[1], p[2])
        else:
            _mirrored_products(image, top, left, window, p[0], p[1], p[2])
        xx, xy = _weighted_sum(p[0], weights, count), _weighted_sum(p[1], weights, count)
        out[k] = _min_eigenvalue(xx * unit, xy * unit, _weighted_sum(p[2], weights, count) * unit)


@kernel
def _box_sums(values: F32, count: int, cols: int, window: int, sums: F32) -> None:
    """Replace values of a flat image with `cols` columns by sums over the window that begins there; `sums`: scratch."""
    for i in range(count):
        sums[i] = values[i]
    for v in range(1, window):
        row = values[v * cols :]
        for i in range(count):
            sums[i] += row[i]
    inner = count - window + 1
    for i in range(inner):
        values[i] = sums[i]
    for u in range(1, window):
        column = sums[u:]
        for i in range(inner):
            values[i] += column[i]


@kernel
def _responses(xx: F32, xy: F32, yy: F32, count: int, unit: float, out: F32) -> None:
    scale, half = np.float32(unit), np.float32(0.5)
    for i in range(count):
        a, b, c = scale * xx[i], scale * xy[i], scale * yy[i]
        d = half * (a - c)
        out[i] = half * (a + c) - np.sqrt(d * d + b * b)


@kernel
def strongest_corners(image: U8, boxes: I64, taken: F32, away: float, half: int, out: F64) -> None:
    """Write, for every box, the strongest corner that keeps the distance `away` from the present features.

    Args:
        image: (H, W) grey.
        boxes: (E, 4) first row, end row, first column, end column; at least `half` + 1 px inside the image.
        taken: (M, 2) pixels of the present features.
        away: smallest distance of a corner from these features, px.
        half: pixels on either side of a pixel over which its response is summed.
        out: (E, 3) column, row, Shi-Tomasi response per pixel; the response is negative where there is no corner.
    """
    window, side = 2 * half + 1, 0
    unit = 1.0 / (window**2 * _GREY * _GREY)
    for e in range(boxes.shape[0]):
        side = max(side, boxes[e, 1] - boxes[e, 0], boxes[e, 3] - boxes[e, 2])
    area = (side + window + 1) ** 2
    grey, p, sums = np.zeros(area, np.float32), np.zeros((3, area), np.float32), np.empty(area, np.float32)
    flat = np.empty(area, np.float32)
    for e in range(boxes.shape[0]):
        top, bottom, left, right = boxes[e]
        rows, cols = bottom - top, right - left
        if rows <= 0 or cols <= 0:
            out[e, 0], out[e, 1], out[e, 2] = left, top, -1.0
            continue
        wide = cols + window + 1
        _copy_box(image, top - half - 1, left - half - 1, rows + window + 1, wide, grey)
        products, count = wide * (rows + window - 1) - 2, wide * rows - 2
        _gradient_products(grey, products, wide, p[0], p[1], p[2])
        for i in range(3):
            _box_sums(p[i], count, wide, window, sums)
        _responses(p[0], p[1], p[2], count - window + 1, unit, flat)
        response = flat[: wide * rows].reshape((rows, wide))
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
def ray_at(table: F64, x: float, y: float, ray: F64) -> None:
    """Interpolate a table (R, C, 2) bilinearly at column `x`, row `y`; positions outside are moved to its edge."""
    rows, cols = table.shape[:2]
    x, y = min(max(x, 0.0), cols - 1.001), min(max(y, 0.0), rows - 1.001)
    i, j = int(y), int(x)
    b, a = y - i, x - j
    for c in range(2):
        upper = (1 - a) * table[i, j, c] + a * table[i, j + 1, c]
        lower = (1 - a) * table[i + 1, j, c] + a * table[i + 1, j + 1, c]
        ray[c] = (1 - b) * upper + b * lower


@kernel
def interpolate_rays(table: F64, pixels: F64, out: F64) -> None:
    """Interpolate a table (R, C, 2) by `ray_at` at (N, 2) positions (column, row); NaN stays NaN."""
    for k in range(pixels.shape[0]):
        if not (np.isfinite(pixels[k, 0]) and np.isfinite(pixels[k, 1])):
            out[k] = np.nan
            continue
        ray_at(table, pixels[k, 0], pixels[k, 1], out[k])
