"""Kernels for least squares matching of patches. Equation numbers: docs/method/patches.md.

A patch is a square with S = 2 `HALF` + 3 pixels per side around an observation; one pixel on each side is margin.
"""

import math

import numpy as np

from alight.arrays import F32, F64
from alight.compiled import kernel, pixelwise
from alight.motion.point_kernels import invert

HALF = 7  # pixels from the middle of a patch to the sides of the compared square
_LEAST_VARIANCE = 1.0  # squared grey levels, least variance of a patch


@pixelwise
def _weights(f: float, out: F64) -> None:
    """Write the four weights of cubic convolution at the fraction `f` of a pixel (Keys 1981, a = -1/2)."""
    out[0] = f * (-0.5 + f * (1.0 - 0.5 * f))
    out[1] = 1.0 + f * f * (-2.5 + 1.5 * f)
    out[2] = f * (0.5 + f * (2.0 - 1.5 * f))
    out[3] = f * f * (-0.5 + 0.5 * f)


@pixelwise
def _sample(picture: F32, x: float, y: float, wx: F64, wy: F64) -> float:
    """Return the grey level at column `x`, row `y`; NaN too near the picture's edge. `wx`, `wy`: scratch (4,)."""
    i, j = math.floor(x), math.floor(y)
    if i < 1 or j < 1 or i > picture.shape[1] - 3 or j > picture.shape[0] - 3:
        return math.nan
    _weights(x - i, wx)
    _weights(y - j, wy)
    grey = 0.0
    for b in range(4):
        row = 0.0
        for a in range(4):
            row += wx[a] * picture[j - 1 + b, i - 1 + a]
        grey += wy[b] * row
    return grey


@kernel
def sample_patches(picture: F32, at: F64, out: F32) -> None:
    """Write the patches (K, S, S) around pixels `at` (K, 2) of a picture (H, W); NaN beyond the picture's edge."""
    wx, wy = np.empty(4), np.empty(4)
    for k in range(len(at)):
        for r in range(out.shape[1]):
            for c in range(out.shape[2]):
                out[k, r, c] = _sample(picture, at[k, 0] + c - HALF - 1, at[k, 1] + r - HALF - 1, wx, wy)


@pixelwise
def _template(patch: F32, weight: F64, terms: F64, N: F64) -> float:
    """Write a patch's grey levels and slopes `terms` (3, P) minus their means, and their weighted products N (3, 3).

    Returns the patch's variance in squared grey levels; NaN if the patch reaches beyond the edge of its picture.
    """
    side = 2 * HALF + 1
    mean, whole = np.zeros(3), 0.0
    for r in range(side):
        for c in range(side):
            p = r * side + c
            terms[0, p] = patch[r + 1, c + 1]
            terms[1, p] = 0.5 * (patch[r + 1, c + 2] - patch[r + 1, c])
            terms[2, p] = 0.5 * (patch[r + 2, c + 1] - patch[r, c + 1])
            whole += weight[p]
            for i in range(3):
                mean[i] += weight[p] * terms[i, p]
    N[:] = 0.0
    for p in range(side * side):
        for i in range(3):
            terms[i, p] -= mean[i] / whole
        for i in range(3):
            for j in range(3):
                N[i, j] += weight[p] * terms[i, p] * terms[j, p]
    variance: float = N[0, 0] / whole
    return variance


@pixelwise
def _overlap(
    picture: F32, x: float, y: float, warp: F64, weight: F64, terms: F64, wx: F64, wy: F64, right: F64
) -> tuple[float, float]:
    """Write the weighted products `right` (3,) of a patch's `terms` (3, P) and the picture around column `x`, row `y`.

    Returns the weighted sums of the picture's grey levels and of their squares; NaN beyond the picture's edge.
    `warp`: (2, 2) shift in the picture, px, per pixel of the patch. `wx`, `wy`: scratch.
    """
    side = 2 * HALF + 1
    right[:] = 0.0
    mean, square = 0.0, 0.0
    for r in range(side):
        for c in range(side):
            p, u, v = r * side + c, c - HALF, r - HALF
            there_x = x + warp[0, 0] * u + warp[0, 1] * v
            there_y = y + warp[1, 0] * u + warp[1, 1] * v
            grey = _sample(picture, there_x, there_y, wx, wy)
            mean += weight[p] * grey
            square += weight[p] * grey * grey
            for i in range(3):
                right[i] += weight[p] * terms[i, p] * grey
    return mean, square


@pixelwise
def _slide(
    picture: F32, at: F64, warp: F64, weight: F64, whole: float, terms: F64, variance: float, C: F64, wx: F64, wy: F64,
    right: F64, h: F64, moved: F64,
) -> float:  # fmt: skip
    """Write the shift `moved` (2,) in px from `at` to a patch (eqs. 13, 14); return its correlation, 0 if not found.

    `terms`, `variance`: output of `_template`; `C`: inverse of its N; `whole`: sum of `weight`; `wx` to `h`: scratch.
    """
    moved[:] = 0.0
    for _ in range(10):
        mean, square = _overlap(picture, at[0] + moved[0], at[1] + moved[1], warp, weight, terms, wx, wy, right)
        there = square / whole - (mean / whole) ** 2
        if not there > _LEAST_VARIANCE:  # also refuses NaN
            break
        for i in range(3):
            h[i] = C[i, 0] * right[0] + C[i, 1] * right[1] + C[i, 2] * right[2]
        if not h[0] > 0.0:
            break
        dx, dy = h[1] / h[0], h[2] / h[0]
        step_x, step_y = warp[0, 0] * dx + warp[0, 1] * dy, warp[1, 0] * dx + warp[1, 1] * dy
        moved[0] -= step_x
        moved[1] -= step_y
        if moved[0] * moved[0] + moved[1] * moved[1] > 1.5 * 1.5:  # px, greatest shift of an observation
            break
        if step_x * step_x + step_y * step_y < 0.003 * 0.003:
            likeness: float = right[0] / whole / math.sqrt(there * variance)
            return likeness
    return 0.0


@kernel
def match_patches(patches: F32, picture: F32, at: F64, warp: F64, moved: F64, likeness: F64) -> None:
    """Find patches (K, S, S) in another picture (H, W) to a fraction of a pixel (eqs. 13, 14).

    Args:
        patches: grey levels around the first observation of each point.
        picture: the other picture.
        at: (K, 2) expected positions in the other picture, px.
        warp: (K, 2, 2) shift in the other picture, px, per pixel of the patch.
        moved: (K, 2) out: shift from the expected positions, px; NaN: not found.
        likeness: (K,) out: coefficient of correlation; 0: not found.
    """
    side = 2 * HALF + 1
    weight = np.empty(side * side)
    for r in range(side):
        for c in range(side):
            weight[r * side + c] = math.exp(-0.5 * ((r - HALF) ** 2 + (c - HALF) ** 2) / 4.2**2)
    whole = weight.sum()
    terms, N, C, root = np.empty((3, side * side)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    right, h, wx, wy = np.empty(3), np.empty(3), np.empty(4), np.empty(4)
    for k in range(len(at)):
        likeness[k] = 0.0
        variance = _template(patches[k], weight, terms, N)
        invert(N, 1e-9, root, C)
        determinant = 1.0 / (root[0, 0] * root[1, 1] * root[2, 2]) ** 2
        if variance > _LEAST_VARIANCE and determinant > 1e-4 * N[0, 0] * N[1, 1] * N[2, 2]:  # else N is nearly singular
            likeness[k] = _slide(
                picture, at[k], warp[k], weight, whole, terms, variance, C, wx, wy, right, h, moved[k]
            )  # fmt: skip
        if not likeness[k] > 0.0:
            moved[k] = np.nan
            likeness[k] = 0.0
