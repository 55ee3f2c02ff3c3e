"""Ground by world position: fractal relief and distances to lines, for the cells of a tile or single positions.

Every value is a function of its position and the seed only, so adjacent tiles agree at their border, on any thread.
"""

from __future__ import annotations

import math
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from alight.compiled import kernel, parallel_kernel, prange
from alight_sim.kernels.noise import noise32, seed32

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]


class ReliefForm(IntEnum):
    """Forms of fractal relief."""

    HILLS, RIDGES, DUNES = range(3)


BLOCK = 8  # cells of a block's side


@kernel
def _fractal_row(
    x: F64, y: F64, wavelengths: F64, amplitudes: F64, form: int, seed: int, buf: F32, out: F64
) -> None:  # fmt: skip
    """Add the octaves of one row of positions (C,) to `out` (C,); see `add_fractal`. `buf` (2 C,): scratch."""
    cos, sin, count = 1.0, 0.0, out.size
    for k in range(wavelengths.size):
        # wave numbers of the octave's axes: u = a x + b y, v = c x + d y
        a, b = cos / wavelengths[k], -sin / wavelengths[k]
        c, d = sin / wavelengths[k], cos / wavelengths[k]
        if form == ReliefForm.DUNES:
            a, b, c, d = 1.0 / wavelengths[k], 0.0, 0.0, 0.25 / wavelengths[k]
        u0, v0 = math.floor(a * x[0] + b * y[0]), math.floor(c * x[0] + d * y[0])
        i0, j0, bits, gain = np.int32(u0), np.int32(v0), seed32(seed + 101 * k), amplitudes[k]
        for m in range(count):  # in single precision apart from the noise, which is vectorised: twice as fast
            buf[m] = np.float32(a * x[m] + b * y[m] - u0)
            buf[count + m] = np.float32(c * x[m] + d * y[m] - v0)
        for m in range(count):
            buf[m] = noise32(buf[m], buf[count + m], i0, j0, bits)[0]
        if form == ReliefForm.HILLS:
            for m in range(count):
                out[m] += gain * buf[m]
        else:
            for m in range(count):
                out[m] += 1.9 * gain * (0.7 - abs(buf[m]))
        cos, sin = 0.7986 * cos - 0.6018 * sin, 0.6018 * cos + 0.7986 * sin  # 37 degrees: lattices never line up


@kernel
def add_fractal_here(x: F64, y: F64, wavelengths: F64, amplitudes: F64, form: int, seed: int, out: F64) -> None:
    """Add noise octaves like `add_fractal`, but on the calling thread alone, which is faster for a few positions."""
    buf = np.empty(2 * out.shape[1], np.float32)
    for r in range(out.shape[0]):
        _fractal_row(x[r], y[r], wavelengths, amplitudes, form, seed, buf, out[r])


@parallel_kernel
def add_fractal(x: F64, y: F64, wavelengths: F64, amplitudes: F64, form: int, seed: int, out: F64) -> None:
    """Add noise octaves at positions (R, C) to `out` (R, C).

    `form`: HILLS (plain noise), RIDGES (with creases upwards) or DUNES (creases stretched from south to north). The
    standard deviation of an octave is about its amplitude.
    """
    for r in prange(out.shape[0]):
        buf = np.empty(2 * out.shape[1], np.float32)
        _fractal_row(x[r], y[r], wavelengths, amplitudes, form, seed, buf, out[r])


@parallel_kernel
def along_line(x: F64, y: F64, line: F64, reach: float, out: F64) -> None:
    """Fill `out` (R, C, 3) with distance from a line (negative: left of it), distance along it, and its height there.

    `line` (N, 4): east, north, metres along, height of each vertex. Positions farther than `reach` get (`reach`, 0, 0).
    """
    for r in prange(out.shape[0]):
        for c in range(out.shape[1]):
            best, side = reach * reach, 1.0
            out[r, c, 1], out[r, c, 2] = 0.0, 0.0
            for k in range(line.shape[0] - 1):
                ax, ay = x[r, c] - line[k, 0], y[r, c] - line[k, 1]
                bx, by = line[k + 1, 0] - line[k, 0], line[k + 1, 1] - line[k, 1]
                t = min(max((ax * bx + ay * by) / (bx * bx + by * by), 0.0), 1.0)
                d = (ax - t * bx) ** 2 + (ay - t * by) ** 2
                if d < best:
                    best, side = d, -1.0 if bx * ay - by * ax > 0.0 else 1.0
                    out[r, c, 1] = line[k, 2] + t * (line[k + 1, 2] - line[k, 2])
                    out[r, c, 2] = line[k, 3] + t * (line[k + 1, 3] - line[k, 3])
            out[r, c, 0] = side * math.sqrt(best)


@parallel_kernel
def box_mean(values: F32, half: int, out: F32) -> None:
    """Fill `out` (R, C) with the mean over each cell's square of 2 * half + 1 cells per side, cut at the edges."""
    rows, cols = values.shape
    across = np.empty((rows, cols))
    for r in prange(rows):
        total = 0.0
        for c in range(min(half, cols)):
            total += values[r, c]
        for c in range(cols):
            if c + half < cols:
                total += values[r, c + half]
            if c - half > 0:
                total -= values[r, c - half - 1]
            across[r, c] = total / (min(c + half, cols - 1) - max(c - half, 0) + 1)
    for r in prange(rows):
        first, last = max(r - half, 0), min(r + half, rows - 1)
        total_row = np.zeros(cols)
        for k in range(first, last + 1):
            for c in range(cols):
                total_row[c] += across[k, c]
        for c in range(cols):
            out[r, c] = np.float32(total_row[c] / (last - first + 1))


@parallel_kernel
def ground_light(height: F32, means: F32, row: int, col: int, cell: float, gains: F64, out: F32) -> None:
    """Fill `out` (R, C, 3) with slope east, slope north and the share of open sky.

    Cell (0, 0) of `out` is (`row`, `col`) of `height`, which extends a cell or more beyond `out` on every side. `means`
    (K, ...): heights smoothed over K widths. `gains` (K,): loss of sky per metre that a cell lies below them.
    """
    for r in prange(out.shape[0]):
        for c in range(out.shape[1]):
            i, j = row + r, col + c
            out[r, c, 0] = np.float32((height[i, j + 1] - height[i, j - 1]) / (2.0 * cell))
            out[r, c, 1] = np.float32((height[i - 1, j] - height[i + 1, j]) / (2.0 * cell))
            sky = 1.0
            for k in range(gains.size):
                sky /= 1.0 + gains[k] * max(float(means[k, i, j]) - float(height[i, j]), 0.0)
            out[r, c, 2] = np.float32(sky)


@kernel
def _bilinear(layer: F32, x: float, y: float) -> float:
    ix, iy = min(int(x), layer.shape[1] - 2), min(int(y), layer.shape[0] - 2)
    u, v = x - ix, y - iy
    upper = layer[iy, ix] * (1 - u) + layer[iy, ix + 1] * u
    lower = layer[iy + 1, ix] * (1 - u) + layer[iy + 1, ix + 1] * u
    return float(upper * (1 - v) + lower * v)


@parallel_kernel
def tile_block_tops(height: F32, out: F32) -> None:
    """Fill `out` with the largest height in each block of BLOCK x BLOCK cells with a margin of one cell around it."""
    rows, cols = height.shape
    for i in prange(out.shape[0]):
        for j in range(out.shape[1]):
            top = -np.inf
            for r in range(max(i * BLOCK - 1, 0), min((i + 1) * BLOCK + 1, rows)):
                for c in range(max(j * BLOCK - 1, 0), min((j + 1) * BLOCK + 1, cols)):
                    top = max(top, float(height[r, c]))
            out[i, j] = np.float32(top)


@kernel
def _to_leave(x: float, step: float) -> int:
    """Return the number of steps of `step` cells from `x` along one axis that stay inside the block."""
    inside = x - BLOCK * math.floor(x / BLOCK)
    if step > 0.0:
        return int((BLOCK - inside) / step)
    return int(inside / -step) if step < 0.0 else BLOCK


@parallel_kernel
def sun_margin(
    height: F32, tops: F32, row: int, col: int, top: float, step: F64, limit: float, out: F32
) -> None:  # fmt: skip
    """Fill `out` (R, C) with the clearance of each cell's ray to the sun above the ground, metres (negative: shadow).

    Cell (0, 0) of `out` is (`row`, `col`) of `height`. `step` (3,): step of about a cell towards the sun: columns,
    rows, metres. `top`: upper bound of the heights. The clearance is clipped to +- `limit`. With `tops` of
    `tile_block_tops` a ray skips blocks that are too far below it to matter; the result is the same.
    """
    rows, cols = height.shape
    for r in prange(out.shape[0]):
        for c in range(out.shape[1]):
            x0, y0, z0 = float(col + c), float(row + r), float(height[row + r, col + c])
            margin, k = limit, 1
            while margin > -limit:
                x, y, z = x0 + k * step[0], y0 + k * step[1], z0 + k * step[2]
                if z - step[2] >= top or x < 0.0 or y < 0.0 or x > cols - 1.0 or y > rows - 1.0:
                    break
                if z - tops[int(y) // BLOCK, int(x) // BLOCK] >= margin:
                    k += 1 + min(_to_leave(x, step[0]), _to_leave(y, step[1]))
                    continue
                margin = min(margin, z - _bilinear(height, x, y))
                k += 1
            out[r, c] = np.float32(max(margin, -limit))
