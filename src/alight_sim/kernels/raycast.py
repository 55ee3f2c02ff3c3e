"""Rays into a height field: exact intersection with its bilinear patches, accelerated by a pyramid of maxima.

The surface is bilinear between cell centres, so along a ray its height is a quadratic in the ray's parameter: each
patch is solved, not marched (error: rounding). Patch (r, c) spans the centres r..r+1, c..c+1. Pyramid of maxima after
Tevs, Ihrke, Seidel, "Maximum mipmaps for fast, accurate, and scalable dynamic height field rendering" (I3D 2008).

Grid coordinates: x = column, y = row, fractional, cell centres at integers; z in metres. A ray along a row or a column
is safe: it never reaches the boundary in the other direction.
"""

from __future__ import annotations

import math
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from alight.compiled import kernel, parallel_kernel, pixelwise, prange

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

Three = tuple[float, float, float]
Four = tuple[float, float, float, float]

MISS = -1.0
NEAR = 4  # the coarsest level of the pyramid at which rays advance freely
FALLS = 6  # at each level, at most
STRIP = 16  # pixels of a row that start their rays together


class Lane(IntEnum):
    """Where the values of a strip's rays begin in one array, so that LLVM sees that they are apart, and vectorises."""

    # direction in the grid, its inverse across, parameter, patch, corners of the patch, hit
    RX, RY, RZ, PER_X, PER_Y, T, X, Y, H00, H10, H01, H11, HIT = (k * STRIP for k in range(13))


@pixelwise
def _patch_hit(corners: Four, start: Three, ray: Three, length: float) -> float:
    """Return the first parameter in [0, length] where the ray is at or below the bilinear patch, or MISS.

    `corners`: heights at (0,0), (1,0), (0,1), (1,1) in (x, y); `start`: the ray's entry in patch coordinates. Without
    branches, for loops over rays.
    """
    h00, h10, h01, h11 = corners
    x, y, z = start
    b, c, d = h10 - h00, h01 - h00, h00 - h10 - h01 + h11
    gap = z - (h00 + b * x + c * y + d * x * y)
    A = -d * ray[0] * ray[1]
    B = ray[2] - b * ray[0] - c * ray[1] - d * (x * ray[1] + y * ray[0])
    line = -gap / B if B < 0.0 else MISS
    root = B * B - 4.0 * A * gap
    q = -0.5 * (B + math.copysign(math.sqrt(max(root, 0.0)), B))
    s1, s2 = q / A, (gap / q if q != 0.0 else MISS)
    near, far = min(s1, s2), max(s1, s2)
    s = near if near >= 0.0 else far
    s = s if root >= 0.0 else MISS
    s = line if abs(A) * length < 1e-12 * (abs(B) + 1e-300) else s
    s = s if 0.0 <= s <= length else MISS
    return 0.0 if gap <= 0.0 else s


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
    pyramid: F32, offsets: I64, widths: I64, shape: tuple[int, int], origin: F64, fan: F64, top: float, low: float,
    box: F64,
) -> float:  # fmt: skip
    """Return a height above which no ray of a fan meets the surface; `box` becomes what the rays cross below it.

    `fan` (x0, x1, y0, y1): smallest and largest slopes of the rays, grid columns and rows per metre of fall. `top`,
    `low`: bounds of all heights; `top` is lowered to the largest height in the box that the rays cross between them.
    """
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
def _turn_strip(directions: F32 | F64, r: int, first: int, last: int, turn: F64, buf: F64, fan: F64) -> bool:
    """Fill RX, RY, RZ with turned rays of row `r`, `fan` with their slopes; return whether all point down."""
    for k in range(STRIP):
        c = min(first + k, last - 1)
        dx, dy, dz = float(directions[r, c, 0]), float(directions[r, c, 1]), float(directions[r, c, 2])
        buf[Lane.RX + k] = turn[0, 0] * dx + turn[0, 1] * dy + turn[0, 2] * dz
        buf[Lane.RY + k] = turn[1, 0] * dx + turn[1, 1] * dy + turn[1, 2] * dz
        buf[Lane.RZ + k] = turn[2, 0] * dx + turn[2, 1] * dy + turn[2, 2] * dz
    for k in range(STRIP):
        rx, ry, rz = buf[Lane.RX + k], buf[Lane.RY + k], buf[Lane.RZ + k]
        buf[Lane.X + k], buf[Lane.Y + k], buf[Lane.HIT + k] = -rx / rz, -ry / rz, MISS
        buf[Lane.PER_X + k], buf[Lane.PER_Y + k] = 1.0 / rx, 1.0 / ry
    west, east, top, bottom, steep = math.inf, -math.inf, math.inf, -math.inf, -math.inf
    for k in range(STRIP):
        west, east = min(west, buf[Lane.X + k]), max(east, buf[Lane.X + k])
        top, bottom = min(top, buf[Lane.Y + k]), max(bottom, buf[Lane.Y + k])
        steep = max(steep, buf[Lane.RZ + k])
    fan[0], fan[1], fan[2], fan[3] = west, east, top, bottom
    return bool(steep <= -0.05)


@kernel
def _fall(about: F32, offsets: I64, widths: I64, origin: F64, buf: F64, level: int) -> bool:
    """Advance each ray to the highest ground around its node, or only to the node's edge.

    No ray meets the surface earlier, because it stays over the 3 x 3 nodes whose maximum is in `about`. Returns whether
    a ray has reached an edge.
    """
    width, offset, size = widths[level], offsets[level], float(1 << level)
    for k in range(STRIP):
        t = buf[Lane.T + k]
        x, y = int(origin[0] + t * buf[Lane.RX + k]) >> level, int(origin[1] + t * buf[Lane.RY + k]) >> level
        buf[Lane.H00 + k] = about[offset + y * width + x]
    aside = 0
    for k in range(STRIP):
        t = buf[Lane.T + k]
        down = (buf[Lane.H00 + k] + 1e-6 - origin[2]) / buf[Lane.RZ + k]
        out = t + size * min(abs(buf[Lane.PER_X + k]), abs(buf[Lane.PER_Y + k]))
        buf[Lane.T + k] = max(t, min(down, out))
        aside |= out < down
    return aside != 0


@kernel
def _cross(height: F32, origin: F64, buf: F64) -> bool:
    """Intersect each ray with the patch below it, and move those that miss on to the next; return whether any does."""
    for k in range(STRIP):
        r, c = int(buf[Lane.Y + k]), int(buf[Lane.X + k])
        buf[Lane.H00 + k], buf[Lane.H10 + k] = height[r, c], height[r, c + 1]
        buf[Lane.H01 + k], buf[Lane.H11 + k] = height[r + 1, c], height[r + 1, c + 1]
    ox, oy, oz, going = origin[0], origin[1], origin[2], 0
    for k in range(STRIP):
        rx, ry, rz, t = buf[Lane.RX + k], buf[Lane.RY + k], buf[Lane.RZ + k], buf[Lane.T + k]
        x, y = buf[Lane.X + k], buf[Lane.Y + k]
        tx = (x + (1.0 if rx > 0.0 else 0.0) - ox) * buf[Lane.PER_X + k] if rx != 0.0 else math.inf
        ty = (y + (1.0 if ry > 0.0 else 0.0) - oy) * buf[Lane.PER_Y + k] if ry != 0.0 else math.inf
        t1 = max(t, min(tx, ty))
        corners = (buf[Lane.H00 + k], buf[Lane.H10 + k], buf[Lane.H01 + k], buf[Lane.H11 + k])
        s = _patch_hit(corners, (ox + t * rx - x, oy + t * ry - y, oz + t * rz), (rx, ry, rz), t1 - t)
        on, east, south = s < 0.0, 1.0 if rx > 0.0 else -1.0, 1.0 if ry > 0.0 else -1.0
        buf[Lane.HIT + k] = MISS if on else t + s
        buf[Lane.X + k] = x + east if on and tx <= ty else x
        buf[Lane.Y + k] = y + south if on and tx > ty else y
        buf[Lane.T + k] = t1 if on else t
        going |= on
    return going != 0


@kernel
def _fall_and_cross(
    height: F32, about: F32, offsets: I64, widths: I64, origin: F64, top: float, box: F64, buf: F64
) -> None:
    """Follow the rays of a strip from the height `top` through the `box` below it, to their hits or close above them.

    Only levels of the pyramid of local maxima `about` with nodes smaller than the box help.
    """
    for k in range(STRIP):
        buf[Lane.T + k] = max((top - origin[2]) / buf[Lane.RZ + k], 0.0)
    level, wide = 0, max(box[1] - box[0], box[3] - box[2])
    while level < min(NEAR, offsets.size - 1) and (3 << level + 1) < wide:
        level += 1
    for down in range(level + 1):
        for _ in range(FALLS):
            if not _fall(about, offsets, widths, origin, buf, level - down):
                break
    for k in range(STRIP):
        t = buf[Lane.T + k]
        buf[Lane.X + k] = math.floor(origin[0] + t * buf[Lane.RX + k])
        buf[Lane.Y + k] = math.floor(origin[1] + t * buf[Lane.RY + k])
    for _ in range(FALLS):
        if not _cross(height, origin, buf):
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
    2.5 to 3 times as fast as from the camera. The rays of a strip that stays over the grid advance together.
    """
    rows, cols = height.shape
    summit = float(pyramid[offsets[offsets.size - 1]])
    for band in prange(-(-out.shape[0] // STRIP)):  # squares of pixels: rows of a picture may run across the grid's
        buf, fan, box = np.zeros(Lane.HIT + STRIP), np.empty(4), np.empty(4)
        for first in range(0, out.shape[1], STRIP):
            last = min(first + STRIP, out.shape[1])
            for r in range(band * STRIP, min((band + 1) * STRIP, out.shape[0])):
                n = np.int64(r) if origins.shape[0] > 1 else np.int64(0)
                top, level, over, origin = math.inf, offsets.size - 1, False, origins[n]
                if _turn_strip(directions, r, first, last, turns[n], buf, fan):
                    top, level = _ceiling(pyramid, offsets, widths, height.shape, origin, fan, summit, low, box), 0
                    over = box[0] > 1.0 and box[1] < cols - 2.0 and box[2] > 1.0 and box[3] < rows - 2.0
                if over:
                    _fall_and_cross(height, about, offsets, widths, origin, top, box, buf)
                for k in range(last - first):
                    t, end = buf[Lane.T + k], math.inf
                    ray = (buf[Lane.RX + k], buf[Lane.RY + k], buf[Lane.RZ + k])
                    start = (origin[0], origin[1], origin[2])
                    if not over:
                        t, end = _clip(start, ray, height.shape, min(summit, top))
                    hit = buf[Lane.HIT + k]
                    if hit < 0.0 and t <= end:
                        hit = _walk(height, pyramid, offsets, widths, start, ray, (t, end, 0.0), level)
                    out[r, first + k] = hit


def max_pyramid(height: F32) -> tuple[F32, I64, I64]:
    """Return a pyramid of the largest heights of 2^k x 2^k patches as one array, and each level's offset and width."""
    rows = np.maximum(height[:-1], height[1:])
    level = np.maximum(rows[:, :-1], rows[:, 1:])
    levels = [level]
    while level.size > 1:
        if level.shape[0] % 2 or level.shape[1] % 2:
            level = np.pad(level, [(0, n % 2) for n in level.shape], constant_values=-np.inf)
        rows = np.maximum(level[::2], level[1::2])  # slices: eight times as fast as a reduction over blocks
        level = np.maximum(rows[:, ::2], rows[:, 1::2])
        levels.append(level)
    offsets = np.cumsum([0] + [a.size for a in levels[:-1]])
    flat = np.concatenate([a.ravel() for a in levels], dtype=np.float32)
    return flat, offsets.astype(np.int64), np.array([a.shape[1] for a in levels], dtype=np.int64)
