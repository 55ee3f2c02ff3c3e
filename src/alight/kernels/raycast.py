"""Rays into a height field: exact intersection with its bilinear patches, sped up by a pyramid of maxima.

The surface is bilinear between cell centres, so along a ray its height is a quadratic in the ray's parameter: each
patch is solved, not marched (error: rounding). Patch (r, c) spans the centres r..r+1, c..c+1. Pyramid of maxima after
Tevs, Ihrke, Seidel, "Maximum mipmaps for fast, accurate, and scalable dynamic height field rendering" (I3D 2008).

Grid coordinates: x = column, y = row, fractional, cell centres at integers; z in metres. Looking straight along a row
or a column is safe: the boundary in the other direction is then never reached.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from alight.kernels.compiler import kernel, parallel_kernel, prange

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

MISS = -1.0


@kernel
def _patch_hit(
    corners: tuple[float, float, float, float], start: tuple[float, float, float], ray: F64, length: float
) -> float:
    """Return the first parameter in [0, length] where the ray is at or below the bilinear patch, or MISS.

    `corners`: heights at (0,0), (1,0), (0,1), (1,1) in (x, y); `start`: the ray's entry in patch coordinates.
    """
    h00, h10, h01, h11 = corners
    x, y, z = start
    b, c, d = h10 - h00, h01 - h00, h00 - h10 - h01 + h11
    gap = z - (h00 + b * x + c * y + d * x * y)
    if gap <= 0.0:
        return 0.0
    A = -d * ray[0] * ray[1]
    B = ray[2] - b * ray[0] - c * ray[1] - d * (x * ray[1] + y * ray[0])
    if abs(A) * length < 1e-12 * (abs(B) + 1e-300):
        s = float(-gap / B) if B < 0.0 else MISS
        return s if 0.0 <= s <= length else MISS
    root = B * B - 4.0 * A * gap
    if root < 0.0:
        return MISS
    q = -0.5 * (B + math.copysign(math.sqrt(root), B))
    s1, s2 = q / A, (gap / q if q != 0.0 else MISS)
    near, far = float(min(s1, s2)), float(max(s1, s2))
    if 0.0 <= near <= length:
        return near
    return far if 0.0 <= far <= length else MISS


@kernel
def _clip(origin: F64, ray: F64, shape: tuple[int, int], top: float) -> tuple[float, float]:
    """Return the parameters between which the ray is over the grid and not above `top` (empty: first > second)."""
    t0, t1 = 0.0, math.inf
    for axis in range(2):
        end = shape[1 - axis] - 1.0
        if ray[axis] != 0.0:
            a, b = -origin[axis] / ray[axis], (end - origin[axis]) / ray[axis]
            t0, t1 = max(t0, min(a, b)), min(t1, max(a, b))
        elif not 0.0 <= origin[axis] <= end:
            return 1.0, 0.0
    if ray[2] < 0.0:
        t0 = max(t0, (top - origin[2]) / ray[2])
    elif origin[2] > top:
        return 1.0, 0.0
    return t0, t1


@kernel
def _exit(position: float, inverse: float, low: int, high: int) -> float:
    """Return the parameter at which one coordinate leaves [low, high]; `inverse`: of its rate, 0 for standing still."""
    if inverse > 0.0:
        return (high - position) * inverse
    if inverse < 0.0:
        return (low - position) * inverse
    return math.inf


@kernel
def cast_ray(height: F32, pyramid: F32, offsets: I64, widths: I64, origin: F64, ray: F64) -> float:
    """Return the parameter of the ray's first point at or below the surface, or MISS.

    `origin`, `ray` (3,): grid coordinates (column, row) and metres up. `pyramid`, `offsets`, `widths`: see
    `max_pyramid`.
    """
    rows, cols = height.shape
    last = offsets.size - 1
    t, t_end = _clip(origin, ray, (rows, cols), pyramid[offsets[last]])
    if t > t_end:
        return MISS
    ix = min(max(math.floor(origin[0] + t * ray[0]), 0), cols - 2)
    iy = min(max(math.floor(origin[1] + t * ray[1]), 0), rows - 2)
    per_x = 1.0 / ray[0] if ray[0] != 0.0 else 0.0
    per_y = 1.0 / ray[1] if ray[1] != 0.0 else 0.0
    level = last
    while True:
        nx, ny = ix >> level, iy >> level
        x0, y0, x1, y1 = nx << level, ny << level, (nx + 1) << level, (ny + 1) << level
        tx, ty = _exit(origin[0], per_x, x0, x1), _exit(origin[1], per_y, y0, y1)
        t1 = max(t, min(tx, ty, t_end))
        low = origin[2] + min(t * ray[2], t1 * ray[2])
        if low <= pyramid[offsets[level] + ny * widths[level] + nx] + 1e-9:
            if level > 0:
                level -= 1
                continue
            corners = (
                np.float64(height[iy, ix]),  # float() would stay float32 here, and cost a micrometre
                np.float64(height[iy, ix + 1]),
                np.float64(height[iy + 1, ix]),
                np.float64(height[iy + 1, ix + 1]),
            )
            start = (origin[0] + t * ray[0] - ix, origin[1] + t * ray[1] - iy, origin[2] + t * ray[2])
            s = _patch_hit(corners, start, ray, t1 - t)
            if s >= 0.0:
                return float(t + s)
        if t1 >= t_end:
            return MISS
        t = t1
        if tx <= ty:
            ix = x1 if ray[0] > 0.0 else x0 - 1
            iy = min(max(math.floor(origin[1] + t * ray[1]), y0), y1 - 1)
        else:
            iy = y1 if ray[1] > 0.0 else y0 - 1
            ix = min(max(math.floor(origin[0] + t * ray[0]), x0), x1 - 1)
        if ix < 0 or iy < 0 or ix > cols - 2 or iy > rows - 2:
            return MISS
        level = min(level + 1, last)


@parallel_kernel
def cast_rays(
    height: F32, pyramid: F32, offsets: I64, widths: I64, origin: F64, directions: F32 | F64, turn: F64, out: F64
) -> None:
    """Fill `out` (H, W) with each pixel's ray parameter at its first hit (depth along the optical axis), MISS without.

    `directions` (H, W, 3): rays in the camera, z = 1; `turn` (3, 3): grid coordinates from the camera's axes.
    """
    for r in prange(out.shape[0]):
        ray = np.empty(3)
        for c in range(out.shape[1]):
            for k in range(3):
                ray[k] = (
                    turn[k, 0] * directions[r, c, 0]
                    + turn[k, 1] * directions[r, c, 1]
                    + turn[k, 2] * directions[r, c, 2]
                )
            out[r, c] = cast_ray(height, pyramid, offsets, widths, origin, ray)


@kernel
def _bilinear(layer: F32, x: float, y: float) -> float:
    ix, iy = min(int(x), layer.shape[1] - 2), min(int(y), layer.shape[0] - 2)
    u, v = x - ix, y - iy
    upper = layer[iy, ix] * (1 - u) + layer[iy, ix + 1] * u
    lower = layer[iy + 1, ix] * (1 - u) + layer[iy + 1, ix + 1] * u
    return float(upper * (1 - v) + lower * v)


@parallel_kernel
def shadow_margin(height: F32, top: float, step: F64, limit: float, out: F32) -> None:
    """Fill `out` (R, C) with how far, in metres, the sun's ray from each cell clears the terrain (negative: shadow).

    `step` (3,): one march step towards the sun in (columns, rows, metres); steps of about a cell. Clipped to `limit`.
    """
    rows, cols = height.shape
    for r in prange(rows):
        for c in range(cols):
            x, y, z, margin = float(c), float(r), float(height[r, c]), limit
            while z < top and margin > -limit:
                x, y, z = x + step[0], y + step[1], z + step[2]
                if x < 0.0 or y < 0.0 or x > cols - 1.0 or y > rows - 1.0:
                    break
                margin = min(margin, z - _bilinear(height, x, y))
            out[r, c] = max(margin, -limit)


def max_pyramid(height: F32) -> tuple[F32, I64, I64]:
    """Return the pyramid of maxima over the patches of `height` (R, C), flat, with offset and width of each level."""
    level = np.maximum(np.maximum(height[:-1, :-1], height[:-1, 1:]), np.maximum(height[1:, :-1], height[1:, 1:]))
    levels = [level]
    while level.size > 1:
        padded = np.pad(level, [(0, n % 2) for n in level.shape], constant_values=-np.inf)
        level = padded.reshape(padded.shape[0] // 2, 2, padded.shape[1] // 2, 2).max(axis=(1, 3))
        levels.append(level)
    offsets = np.cumsum([0] + [a.size for a in levels[:-1]])
    flat = np.concatenate([a.ravel() for a in levels]).astype(np.float32)
    return flat, offsets.astype(np.int64), np.array([a.shape[1] for a in levels], dtype=np.int64)
