"""Rays into a height field: exact intersection with its bilinear patches, accelerated by a pyramid of maxima.

The surface is bilinear between cell centres, so along a ray its height is a quadratic in the ray's parameter: each
patch is solved, not marched (error: rounding). Patch (r, c) spans the centres r..r+1, c..c+1. Pyramid of maxima after
Tevs, Ihrke, Seidel, "Maximum mipmaps for fast, accurate, and scalable dynamic height field rendering" (I3D 2008).

Grid coordinates: x = column, y = row, fractional, cell centres at integers; z in metres. A ray along a row or a column
is safe: it never reaches the boundary in the other direction.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from alight.compiled import kernel, parallel_kernel, prange

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

Three = tuple[float, float, float]

MISS = -1.0
NEAR = 4  # the coarsest level of the pyramid at which rays advance freely
FALLS = 6  # at each level, at most
STRIP = 16  # pixels of a row that start their rays together


@kernel
def _patch_hit(
    corners: tuple[float, float, float, float], start: tuple[float, float, float], ray: Three, length: float
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
def _clip(origin: Three, ray: Three, shape: tuple[int, int], top: float) -> tuple[float, float]:
    """Return the parameters between which the ray is over the grid and not above `top`; first > second: nowhere."""
    t0, t1 = 0.0, math.inf
    for place, rate, end in ((origin[0], ray[0], shape[1] - 1.0), (origin[1], ray[1], shape[0] - 1.0)):
        if rate != 0.0:
            a, b = -place / rate, (end - place) / rate
            t0, t1 = max(t0, min(a, b)), min(t1, max(a, b))
        elif not 0.0 <= place <= end:
            return 1.0, 0.0
    if ray[2] < 0.0:
        t0 = max(t0, (top - origin[2]) / ray[2])
    elif origin[2] > top:
        return 1.0, 0.0
    return t0, t1


@kernel
def _walk(
    height: F32, pyramid: F32, offsets: I64, widths: I64, origin: Three, ray: Three, span: Three, level: int
) -> float:
    """Return the ray's first hit between parameters `span[0]` and `span[1]`, or MISS; `level`: first pyramid level."""
    rows, cols, last = height.shape[0], height.shape[1], offsets.size - 1
    ox, oy, oz = origin
    rx, ry, rz = ray
    t, t_end = span[0], span[1]
    ix = min(max(int(ox + t * rx), 0), cols - 2)
    iy = min(max(int(oy + t * ry), 0), rows - 2)
    per_x, per_y = 1.0 / rx if rx != 0.0 else 0.0, 1.0 / ry if ry != 0.0 else 0.0
    ahead_x, ahead_y = 1 if rx > 0.0 else 0, 1 if ry > 0.0 else 0
    while True:
        nx, ny = ix >> level, iy >> level
        tx = ((nx + ahead_x << level) - ox) * per_x if rx != 0.0 else math.inf
        ty = ((ny + ahead_y << level) - oy) * per_y if ry != 0.0 else math.inf
        t1 = max(t, min(tx, ty, t_end))
        low = oz + min(t * rz, t1 * rz)
        under = low <= pyramid[offsets[level] + ny * widths[level] + nx] + 1e-9
        if under and level == 0:
            corners = (
                np.float64(height[iy, ix]),  # float() would stay float32 here, and cost a micrometre
                np.float64(height[iy, ix + 1]),
                np.float64(height[iy + 1, ix]),
                np.float64(height[iy + 1, ix + 1]),
            )
            s = _patch_hit(corners, (ox + t * rx - ix, oy + t * ry - iy, oz + t * rz), ray, t1 - t)
            if s >= 0.0:
                return float(t + s)
            under = False
        if not under and t1 >= t_end:
            return MISS
        # down a level or on to the next node, by selection: a branch would be unpredictable
        size, x0, y0, across = 1 << level, nx << level, ny << level, tx <= ty
        jx = min(max(int(ox + t1 * rx), x0), x0 + size - 1)
        jy = min(max(int(oy + t1 * ry), y0), y0 + size - 1)
        jx = (x0 + size if ahead_x else x0 - 1) if across else jx
        jy = jy if across else (y0 + size if ahead_y else y0 - 1)
        ix, iy, t = ix if under else jx, iy if under else jy, t if under else t1
        level = level - 1 if under else min(level + 1, last)
        if ix < 0 or iy < 0 or ix > cols - 2 or iy > rows - 2:
            return MISS


@kernel
def cast_ray(height: F32, pyramid: F32, offsets: I64, widths: I64, origin: F64, ray: F64) -> float:
    """Return the parameter of the ray's first point at or below the surface, or MISS.

    `origin`, `ray` (3,): grid coordinates (column, row) and metres up. `pyramid`, `offsets`, `widths`: see
    `max_pyramid`.
    """
    start, along = (origin[0], origin[1], origin[2]), (ray[0], ray[1], ray[2])
    last = offsets.size - 1
    t, t_end = _clip(start, along, height.shape, float(pyramid[offsets[last]]))
    if t > t_end:
        return MISS
    return float(_walk(height, pyramid, offsets, widths, start, along, (t, t_end, 0.0), last))


@kernel
def _highest(pyramid: F32, offsets: I64, widths: I64, box: F64, shape: tuple[int, int]) -> float:
    """Return an upper bound of the surface in a box (x0, x1, y0, y1) of grid coordinates."""
    x0, x1 = min(max(int(box[0]), 0), shape[1] - 2), min(max(int(box[1]), 0), shape[1] - 2)
    y0, y1 = min(max(int(box[2]), 0), shape[0] - 2), min(max(int(box[3]), 0), shape[0] - 2)
    level = 0
    while (x1 >> level) - (x0 >> level) > 2 or (y1 >> level) - (y0 >> level) > 2:
        level += 1
    top = -math.inf
    for j in range(y0 >> level, (y1 >> level) + 1):
        for i in range(x0 >> level, (x1 >> level) + 1):
            top = max(top, float(pyramid[offsets[level] + j * widths[level] + i]))
    return top


@kernel
def _ceiling(
    pyramid: F32, offsets: I64, widths: I64, shape: tuple[int, int], origin: F64, fan: F64, top: float, low: float
) -> float:
    """Return a height above which no ray of a fan meets the surface.

    `fan` (x0, x1, y0, y1): smallest and largest slopes of the rays, grid columns and rows per metre of fall. `top`,
    `low`: bounds of all heights; `top` is lowered to the largest height in the box that the rays cross between them.
    """
    box = np.empty(4)
    for _ in range(5):
        far, near = origin[2] - low, max(origin[2] - top, 0.0)
        for k in range(2):
            a, b = fan[2 * k], fan[2 * k + 1]
            box[2 * k] = origin[k] + min(a * far, a * near)
            box[2 * k + 1] = origin[k] + max(b * far, b * near)
        before, top = top, min(top, _highest(pyramid, offsets, widths, box, shape) + 1e-6)
        if before - top < 0.02:
            break
    return top


@kernel
def _turn_strip(directions: F32 | F64, r: int, first: int, last: int, turn: F64, rays: F64, fan: F64) -> bool:
    """Fill `rays` (STRIP, 3) with turned rays of row `r`, `fan` with their slopes; return whether all point down."""
    falls = True
    fan[0], fan[1], fan[2], fan[3] = math.inf, -math.inf, math.inf, -math.inf
    for c in range(first, last):
        dx, dy, dz = float(directions[r, c, 0]), float(directions[r, c, 1]), float(directions[r, c, 2])
        for k in range(3):
            rays[c - first, k] = turn[k, 0] * dx + turn[k, 1] * dy + turn[k, 2] * dz
        if rays[c - first, 2] > -0.05:
            falls = False
            continue
        a, b = -rays[c - first, 0] / rays[c - first, 2], -rays[c - first, 1] / rays[c - first, 2]
        fan[0], fan[1], fan[2], fan[3] = min(fan[0], a), max(fan[1], a), min(fan[2], b), max(fan[3], b)
    return falls


@kernel
def _fall(
    about: F32, offsets: I64, widths: I64, shape: tuple[int, int], origin: F64, rays: F64, starts: F64, level: int
) -> bool:
    """Advance each start (STRIP,) to the highest ground around its node, or only to the node's edge.

    No ray meets the surface earlier, because it stays over the 3 x 3 nodes whose maximum is in `about`. Returns whether
    a ray has reached an edge.
    """
    aside = False
    for k in range(STRIP):
        rx, ry, rz, t = rays[k, 0], rays[k, 1], rays[k, 2], starts[k]
        ix = min(max(int(origin[0] + t * rx), 0), shape[1] - 2) >> level
        iy = min(max(int(origin[1] + t * ry), 0), shape[0] - 2) >> level
        down = (about[offsets[level] + iy * widths[level] + ix] + 1e-6 - origin[2]) / rz
        out = t + (1 << level) / max(abs(rx), abs(ry), 1e-9)
        starts[k] = max(t, min(down, out))
        aside |= out < down
    return aside


@kernel
def _fall_freely(
    about: F32, offsets: I64, widths: I64, shape: tuple[int, int], origin: F64, rays: F64, starts: F64
) -> None:
    """Advance the starts of a strip's rays through space that the pyramid of local maxima `about` shows to be empty."""
    for k in range(min(NEAR, offsets.size - 1) + 1):
        level = min(NEAR, offsets.size - 1) - k
        for _ in range(FALLS):
            if not _fall(about, offsets, widths, shape, origin, rays, starts, level):
                break


@parallel_kernel
def cast_rays(
    height: F32, pyramid: F32, offsets: I64, widths: I64, about: F32, origins: F64, directions: F32 | F64, turns: F64,
    low: float, out: F64,
) -> None:  # fmt: skip
    """Fill `out` (H, W) with each pixel's ray parameter at its first hit (depth along the optical axis), or MISS.

    `directions` (H, W, 3): rays in the camera, z = 1; `origins` (N, 3): cameras in grid coordinates; `turns` (N, 3, 3):
    grid from camera axes, N = 1 for all rows or one per row. `low`: lower bound of the surface. `about`: like
    `pyramid`, with maxima over the 3 x 3 nodes around each node. Rays start at the highest ground below their strip,
    2.5 to 3 times as fast as from the camera, and advance to the highest ground around them, which saves another fifth.
    """
    shape = height.shape
    summit = float(pyramid[offsets[offsets.size - 1]])
    for band in prange(-(-out.shape[0] // STRIP)):  # squares of pixels: rows of a picture may run across the grid's
        rays, fan, starts, ends = np.ones((STRIP, 3)), np.empty(4), np.zeros(STRIP), np.zeros(STRIP)
        for first in range(0, out.shape[1], STRIP):
            last = min(first + STRIP, out.shape[1])
            for r in range(band * STRIP, min((band + 1) * STRIP, out.shape[0])):
                n = np.int64(r) if origins.shape[0] > 1 else np.int64(0)
                top, level = math.inf, offsets.size - 1
                falls = _turn_strip(directions, r, first, last, turns[n], rays, fan)
                if falls:
                    top, level = _ceiling(pyramid, offsets, widths, shape, origins[n], fan, summit, low), 0
                start = (origins[n, 0], origins[n, 1], origins[n, 2])
                for k in range(last - first):
                    ray = (rays[k, 0], rays[k, 1], rays[k, 2])
                    starts[k], ends[k] = _clip(start, ray, shape, min(summit, top))
                if falls:
                    _fall_freely(about, offsets, widths, shape, origins[n], rays, starts)
                for k in range(last - first):
                    span, ray = (starts[k], ends[k], 0.0), (rays[k, 0], rays[k, 1], rays[k, 2])
                    hits = span[0] <= span[1]
                    out[r, first + k] = (
                        _walk(height, pyramid, offsets, widths, start, ray, span, level) if hits else MISS
                    )


def max_pyramid(height: F32) -> tuple[F32, I64, I64]:
    """Return a pyramid of the largest heights of 2^k x 2^k patches as one array, and each level's offset and width."""
    level = np.maximum(np.maximum(height[:-1, :-1], height[:-1, 1:]), np.maximum(height[1:, :-1], height[1:, 1:]))
    levels = [level]
    while level.size > 1:
        if level.shape[0] % 2 or level.shape[1] % 2:
            level = np.pad(level, [(0, n % 2) for n in level.shape], constant_values=-np.inf)
        rows = np.maximum(level[::2], level[1::2])  # slices: eight times as fast as a reduction over blocks
        level = np.maximum(rows[:, ::2], rows[:, 1::2])
        levels.append(level)
    offsets = np.cumsum([0] + [a.size for a in levels[:-1]])
    flat = np.concatenate([a.ravel() for a in levels]).astype(np.float32)
    return flat, offsets.astype(np.int64), np.array([a.shape[1] for a in levels], dtype=np.int64)
