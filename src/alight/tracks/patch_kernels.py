"""Alignment of patches of earlier images with the present one: kernels (docs/method/tracks.md, M1e)."""

import math

import numpy as np

from alight.arrays import F32, F64, U8
from alight.compiled import kernel, sum_kernel

_ZERO, _HALF = np.float32(0.0), np.float32(0.5)
_MIN_GAIN = np.float32(0.2)  # of contrast; a patch with less contrast is not matched


@kernel
def _sample_patch(patch: U8, x: float, y: float, warp: F64, half: int, out: F32) -> bool:
    """Sample a warped patch bilinearly, `half` px around a place; False: the patch is too small."""
    n = patch.shape[0]
    wide = half * (abs(warp[0, 0]) + abs(warp[0, 1]))
    high = half * (abs(warp[1, 0]) + abs(warp[1, 1]))
    if not (x >= wide and y >= high and x + wide < n - 1 and y + high < n - 1):
        return False
    along, aslant = np.float32(warp[0, 0]), np.float32(warp[1, 0])
    for r in range(2 * half + 1):
        left = np.float32(x + warp[0, 1] * (r - half) - warp[0, 0] * half)
        top = np.float32(y + warp[1, 1] * (r - half) - warp[1, 0] * half)
        for c in range(2 * half + 1):
            px, py = left + along * np.float32(c), top + aslant * np.float32(c)
            i, j = np.uint32(py), np.uint32(px)  # not negative: saves a check
            b, a = py - np.float32(i), px - np.float32(j)
            p, q = np.float32(patch[i, j]), np.float32(patch[i + 1, j])
            upper = p + a * (np.float32(patch[i, j + 1]) - p)
            lower = q + a * (np.float32(patch[i + 1, j + 1]) - q)
            out[r, c] = upper + b * (lower - upper)
    return True


@sum_kernel
def _normalise_patch(lay: F32, gx: F32, gy: F32, sums: F64) -> None:
    """Subtract the means of a patch and of its gradients; sums: xx, xy, yy, square of the patch, x and y by patch."""
    m = gx.shape[0]
    mean, mx, my = _ZERO, _ZERO, _ZERO
    for r in range(m):
        for c in range(m):
            gx[r, c] = _HALF * (lay[r + 1, c + 2] - lay[r + 1, c])
            gy[r, c] = _HALF * (lay[r + 2, c + 1] - lay[r, c + 1])
            mean += lay[r + 1, c + 1]
            mx += gx[r, c]
            my += gy[r, c]
    unit = np.float32(1.0 / (m * m))
    mean, mx, my = mean * unit, mx * unit, my * unit
    xx, xy, yy, power, tx, ty = _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO
    for r in range(m):
        for c in range(m):
            gx[r, c] -= mx
            gy[r, c] -= my
            lay[r + 1, c + 1] -= mean
            xx += gx[r, c] * gx[r, c]
            xy += gx[r, c] * gy[r, c]
            yy += gy[r, c] * gy[r, c]
            power += lay[r + 1, c + 1] * lay[r + 1, c + 1]
            tx += gx[r, c] * lay[r + 1, c + 1]
            ty += gy[r, c] * lay[r + 1, c + 1]
    sums[0], sums[1], sums[2], sums[3], sums[4], sums[5] = xx, xy, yy, power, tx, ty


@sum_kernel
def _gauss_newton_step(image: U8, x: float, y: float, lay: F32, gx: F32, gy: F32, sums: F64, step: F64) -> float:
    """Write one Gauss-Newton step over shift, gain and offset of brightness; return the correlation before it."""
    m = gx.shape[0]
    half = m // 2
    top, left = int(y) - half, int(x) - half
    b, a = np.float32(y - int(y)), np.float32(x - int(x))
    one = np.float32(1.0)
    w00, w01, w10, w11 = (one - a) * (one - b), a * (one - b), (one - a) * b, a * b
    total, square, cross, ex, ey = _ZERO, _ZERO, _ZERO, _ZERO, _ZERO
    for r in range(m):
        upper, lower = image[top + r, left : left + m + 1], image[top + r + 1, left : left + m + 1]
        for c in range(m):
            value = w00 * np.float32(upper[c]) + w01 * np.float32(upper[c + 1])
            value += w10 * np.float32(lower[c]) + w11 * np.float32(lower[c + 1])
            total += value
            square += value * value
            cross += lay[r + 1, c + 1] * value
            ex += gx[r, c] * value
            ey += gy[r, c] * value
    gain = cross / np.float32(sums[3])
    variance = square - total * total / np.float32(m * m)
    if gain <= _MIN_GAIN or variance <= 0:
        return -1.0
    off_x, off_y = ex / gain - np.float32(sums[4]), ey / gain - np.float32(sums[5])
    det = sums[0] * sums[2] - sums[1] * sums[1]
    step[0] = (sums[2] * off_x - sums[1] * off_y) / det
    step[1] = (sums[0] * off_y - sums[1] * off_x) / det
    return float(cross / math.sqrt(sums[3] * variance))


@kernel
def align_patches(
    patches: U8, places: F64, warps: F64, image: U8, stop: float, rounds: int, lay: F32, slopes: F32, found: F64,
    fit: F64,
) -> None:  # fmt: skip
    """Align patches with an image by least squares over a shift, a gain and an offset of brightness.

    Inverse compositional Gauss-Newton (Baker and Matthews 2004): gradients are taken once, of the patch.

    Args:
        patches: (N, S, S) grey, cut from earlier images.
        places: (N, 2) column and row of the features in them.
        warps: (N, 2, 2) derivative of pixels of the patch by pixels of the image.
        image: (H, W) grey.
        stop: px, largest last step.
        rounds: most steps; without a last step below `stop` there is no match.
        lay: (M + 2, M + 2) scratch for a window of M px, M odd.
        slopes: (2, M, M) scratch.
        found: (N, 2) start pixels; replaced by the aligned ones.
        fit: (N,) out: correlation, -1 = no match.
    """
    h, w = image.shape
    half, gx, gy = slopes.shape[1] // 2, slopes[0], slopes[1]
    sums, step = np.empty(6), np.empty(2)
    for k in range(patches.shape[0]):
        fit[k] = -1.0
        if not _sample_patch(patches[k], places[k, 0], places[k, 1], warps[k], half + 1, lay):
            continue
        _normalise_patch(lay, gx, gy, sums)
        if sums[0] * sums[2] - sums[1] * sums[1] <= 1e-6:
            continue
        x, y = found[k, 0], found[k, 1]
        for _ in range(rounds):
            if not (x >= half and y >= half and x < w - 1 - half and y < h - 1 - half):
                break
            correlation = _gauss_newton_step(image, x, y, lay, gx, gy, sums, step)
            if correlation < 0:
                break
            x, y = x - step[0], y - step[1]
            if step[0] * step[0] + step[1] * step[1] < stop * stop:
                found[k, 0], found[k, 1], fit[k] = x, y, correlation
                break
