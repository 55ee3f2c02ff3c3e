"""Kernels that align patches of earlier images with the present image (docs/method/tracks.md, M1e)."""

import math

import numpy as np

from alight.arrays import F32, F64, HALF, I32, I64, ONE, U8, ZERO
from alight.compiled import kernel, sum_kernel
from alight.tracks.corner_kernels import ray_at

_DIFFERENCE = 4.0  # px, step of the numerical derivative of the map between two views
_MIN_DESCENT = 0.2  # cosine; shallower rays meet a plane across the axis instead


@kernel
def _sample_patch(
    patch: U8, x: float, y: float, warp: F64, half: int, at: I32, shares: F32, corners: U8, out: F32
) -> bool:
    """Sample a patch in a warped window, `half` px around (x, y); return False if the patch is too small.

    `out` (S,) is row by row, S = (2 half + 1)^2; `at`, `shares` (2, S) and `corners` (4, S) are scratch.
    """
    # addresses, grey levels and interpolation have separate loops, because the first and the last one are then
    # vectorised, which halves the time
    rows, cols = patch.shape
    wide = half * (abs(warp[0, 0]) + abs(warp[0, 1]))
    high = half * (abs(warp[1, 0]) + abs(warp[1, 1]))
    if not (x >= wide and y >= high and x + wide < cols - 1 and y + high < rows - 1):
        return False
    m, stride, step = 2 * half + 1, np.int32(cols), np.uint32(cols)
    along, aslant = np.float32(warp[0, 0]), np.float32(warp[1, 0])
    for r in range(m):
        left = np.float32(x + warp[0, 1] * (r - half) - warp[0, 0] * half)
        top = np.float32(y + warp[1, 1] * (r - half) - warp[1, 0] * half)
        index, a, b = at[r * m : r * m + m], shares[0, r * m : r * m + m], shares[1, r * m : r * m + m]
        for c in range(m):
            px, py = left + along * np.float32(c), top + aslant * np.float32(c)
            i, j = np.int32(py), np.int32(px)
            index[c] = i * stride + j
            a[c], b[c] = px - np.float32(j), py - np.float32(i)
    flat, count = patch.reshape(-1), m * m
    for k in range(count):
        first = np.uint32(at[k])  # not negative: saves a check
        corners[0, k], corners[1, k] = flat[first], flat[first + 1]
        corners[2, k], corners[3, k] = flat[first + step], flat[first + step + 1]
    p, q, u, v = corners[0], corners[1], corners[2], corners[3]
    for k in range(count):
        upper = np.float32(p[k]) + shares[0, k] * (np.float32(q[k]) - np.float32(p[k]))
        lower = np.float32(u[k]) + shares[0, k] * (np.float32(v[k]) - np.float32(u[k]))
        out[k] = upper + shares[1, k] * (lower - upper)
    return True


@sum_kernel
def _normalise_patch(lay: F32, m: int, grey: F32, gx: F32, gy: F32, sums: F64) -> None:
    """Write the grey levels of a window of side `m`, and their gradients, minus their means, row by row.

    `lay` is the window with one pixel around it. `sums` (6,) gets the products xx, xy, yy of the gradients, the square
    of the grey levels, and the products of the x and y gradient with the grey levels.
    """
    mean, mx, my, count, wide = ZERO, ZERO, ZERO, m * m, m + 2
    for r in range(m):
        above, here, below = lay[r * wide :], lay[(r + 1) * wide :], lay[(r + 2) * wide :]
        for c in range(m):
            k = r * m + c
            grey[k] = here[c + 1]
            gx[k] = HALF * (here[c + 2] - here[c])
            gy[k] = HALF * (below[c + 1] - above[c + 1])
    for k in range(count):
        mean += grey[k]
        mx += gx[k]
        my += gy[k]
    unit = np.float32(1.0 / count)
    mean, mx, my = mean * unit, mx * unit, my * unit
    xx, xy, yy, power, tx, ty = ZERO, ZERO, ZERO, ZERO, ZERO, ZERO
    for k in range(count):
        gx[k] -= mx
        gy[k] -= my
        grey[k] -= mean
        xx += gx[k] * gx[k]
        xy += gx[k] * gy[k]
        yy += gy[k] * gy[k]
        power += grey[k] * grey[k]
        tx += gx[k] * grey[k]
        ty += gy[k] * grey[k]
    sums[0], sums[1], sums[2], sums[3], sums[4], sums[5] = xx, xy, yy, power, tx, ty


@sum_kernel
def _gauss_newton_step(
    image: U8, x: float, y: float, m: int, grey: F32, gx: F32, gy: F32, value: F32, sums: F64, step: F64
) -> float:
    """Write the Gauss-Newton step (2,) of a shift from (x, y); return the correlation before it, -1 for low contrast.

    `grey`, `gx`, `gy` and `sums` are from `_normalise_patch`. `value` is scratch with zeros behind the window, so that
    its size is a multiple of the vector length.
    """
    half = m // 2
    top, left = int(y) - half, int(x) - half
    b, a = np.float32(y - int(y)), np.float32(x - int(x))
    w00, w01, w10, w11 = (ONE - a) * (ONE - b), a * (ONE - b), (ONE - a) * b, a * b
    for r in range(m):
        upper, lower = image[top + r, left : left + m + 1], image[top + r + 1, left : left + m + 1]
        row = value[r * m : r * m + m]
        for c in range(m):
            row[c] = (w00 * np.float32(upper[c]) + w01 * np.float32(upper[c + 1])) + (
                w10 * np.float32(lower[c]) + w11 * np.float32(lower[c + 1])
            )
    total, square, cross, ex, ey = ZERO, ZERO, ZERO, ZERO, ZERO
    for k in range(len(value)):
        total += value[k]
        square += value[k] * value[k]
        cross += grey[k] * value[k]
        ex += gx[k] * value[k]
        ey += gy[k] * value[k]
    gain = cross / np.float32(sums[3])
    variance = square - total * total / np.float32(m * m)
    if gain <= np.float32(0.2) or variance <= 0:  # too little contrast
        return -1.0
    off_x, off_y = ex / gain - np.float32(sums[4]), ey / gain - np.float32(sums[5])
    det = sums[0] * sums[2] - sums[1] * sums[1]
    step[0] = (sums[2] * off_x - sums[1] * off_y) / det
    step[1] = (sums[0] * off_y - sums[1] * off_x) / det
    return float(cross / math.sqrt(sums[3] * variance))


@kernel
def align_patches(
    patches: U8, slots: I64, places: F64, warps: F64, image: U8, m: int, stop: float, rounds: int, found: F64, fit: F64
) -> None:
    """Align patches with an image by least squares over a shift, a gain and an offset of brightness.

    Inverse compositional Gauss-Newton (Baker and Matthews 2004): gradients are computed once, of the patch.

    Args:
        patches: (M, S, T) grey, cut from earlier images, or whole images.
        slots: (N,) index of the patch of each feature.
        places: (N, 2) column and row of each feature in its patch.
        warps: (N, 2, 2) derivative of pixels of the patch with respect to pixels of the image.
        image: (H, W) grey.
        m: side of the window, px, odd.
        stop: a step shorter than this ends the alignment, px.
        rounds: largest number of steps; if none is shorter than `stop`, there is no match.
        found: (N, 2) initial pixels; replaced by the aligned pixels.
        fit: (N,) out, correlation; -1 = no match.
    """
    h, w = image.shape
    half, size = m // 2, (m * m + 31) // 32 * 32
    samples = (m + 2) * (m + 2)
    at, shares, corners = (
        np.empty(samples, np.int32),
        np.empty((2, samples), np.float32),
        np.empty((4, samples), np.uint8),
    )
    lay, rows = np.empty(samples, np.float32), np.zeros((4, size), np.float32)
    grey, gx, gy, value = rows[0], rows[1], rows[2], rows[3]
    sums, step = np.empty(6), np.empty(2)
    for k in range(len(slots)):
        fit[k] = -1.0
        patch = patches[slots[k]]
        if not _sample_patch(patch, places[k, 0], places[k, 1], warps[k], half + 1, at, shares, corners, lay):
            continue
        _normalise_patch(lay, m, grey, gx, gy, sums)
        if sums[0] * sums[2] - sums[1] * sums[1] <= 1e-6:
            continue
        x, y = found[k, 0], found[k, 1]
        for _ in range(rounds):
            if not (x >= half and y >= half and x < w - 1 - half and y < h - 1 - half):
                break
            correlation = _gauss_newton_step(image, x, y, m, grey, gx, gy, value, sums, step)
            if correlation < 0:
                break
            x, y = x - step[0], y - step[1]
            if step[0] * step[0] + step[1] * step[1] < stop * stop:
                found[k, 0], found[k, 1], fit[k] = x, y, correlation
                break


@kernel
def warp_patches(
    pixels: F64, table: F64, R: F64, t: F64, views: I64, up: F64, depth: float, there: F64, other: F64, out: F64
) -> None:
    """Write the (N, 2, 2) derivative of pixels in other views with respect to pixels in this view, for level ground.

    Args:
        pixels: (N, 2) pixels in this view.
        table, other: ray tables (see `ray_at`) of the lenses of this and of the other views; pixel (0, 0) is at (1, 1).
        R, t: (V, 3, 3), (V, 3) other_from_here.
        views: (N,) index of the other view of each feature.
        up: (3,) unit vector upwards in this view.
        depth: depth of the ground along the optical axis, m. If this view is too oblique, a plane perpendicular to the
            axis replaces the ground.
        there: (N, 2) pixels in the other views.
        out: (N, 2, 2).
    """
    steep, ray, ends = up[2] < -_MIN_DESCENT, np.empty(2), np.empty((2, 2))
    moved, by_there = np.empty((2, 2)), np.empty((2, 2))
    for k in range(len(pixels)):
        v = views[k]
        for axis in range(2):
            for side in range(2):
                off = _DIFFERENCE if side == 0 else -_DIFFERENCE
                dx, dy = (off, 0.0) if axis == 0 else (0.0, off)
                ray_at(table, pixels[k, 0] + dx + 1.0, pixels[k, 1] + dy + 1.0, ray)
                down = (ray[0] * up[0] + ray[1] * up[1] + up[2]) / min(up[2], -1e-9)  # 1 along the axis
                z = depth / down if steep and down > _MIN_DESCENT else depth
                q0 = z * (R[v, 0, 0] * ray[0] + R[v, 0, 1] * ray[1] + R[v, 0, 2]) + t[v, 0]
                q1 = z * (R[v, 1, 0] * ray[0] + R[v, 1, 1] * ray[1] + R[v, 1, 2]) + t[v, 1]
                q2 = z * (R[v, 2, 0] * ray[0] + R[v, 2, 1] * ray[1] + R[v, 2, 2]) + t[v, 2]
                ends[side, 0], ends[side, 1] = q0 / q2, q1 / q2
            moved[0, axis], moved[1, axis] = ends[0, 0] - ends[1, 0], ends[0, 1] - ends[1, 1]
            for side in range(2):
                off = _DIFFERENCE if side == 0 else -_DIFFERENCE
                dx, dy = (off, 0.0) if axis == 0 else (0.0, off)
                ray_at(other, there[k, 0] + dx + 1.0, there[k, 1] + dy + 1.0, ends[side])
            by_there[0, axis], by_there[1, axis] = ends[0, 0] - ends[1, 0], ends[0, 1] - ends[1, 1]
        det = by_there[0, 0] * by_there[1, 1] - by_there[0, 1] * by_there[1, 0]
        for axis in range(2):
            out[k, 0, axis] = (by_there[1, 1] * moved[0, axis] - by_there[0, 1] * moved[1, axis]) / det
            out[k, 1, axis] = (by_there[0, 0] * moved[1, axis] - by_there[1, 0] * moved[0, axis]) / det
