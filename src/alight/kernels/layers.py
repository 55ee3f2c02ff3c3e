"""Ground by world position: fractal relief and distances to lines, for cells of a tile and for single places alike.

Every value is a function of its place and the seed alone: tiles that share a border agree on it, on any thread.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from alight.kernels.compiler import kernel, parallel_kernel, prange
from alight.kernels.noise import gradient_noise

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]

HILLS, RIDGES, DUNES = 0, 1, 2


@kernel
def fractal_at(x: float, y: float, wavelengths: F64, amplitudes: F64, form: int, seed: int) -> float:
    """Return a sum of noise octaves; HILLS: as it is, RIDGES: creases upwards, DUNES: long crests across the east."""
    value, c, s = 0.0, 1.0, 0.0
    for k in range(wavelengths.size):
        u, v = (c * x - s * y) / wavelengths[k], (s * x + c * y) / wavelengths[k]
        if form == DUNES:
            u, v = x / wavelengths[k], 0.25 * y / wavelengths[k]
        n, _, _ = gradient_noise(u, v, seed + 101 * k)
        if form != HILLS:
            n = 1.9 * (0.7 - abs(n))  # unit deviation, about zero
        value += amplitudes[k] * n
        c, s = 0.7986 * c - 0.6018 * s, 0.6018 * c + 0.7986 * s  # 37 degrees an octave: lattices never line up
    return float(value)


@parallel_kernel
def add_fractal(x: F64, y: F64, wavelengths: F64, amplitudes: F64, form: int, seed: int, out: F64) -> None:
    """Add the octaves at places (R, C) to `out` (R, C)."""
    for r in prange(out.shape[0]):
        for c in range(out.shape[1]):
            out[r, c] += fractal_at(x[r, c], y[r, c], wavelengths, amplitudes, form, seed)


@parallel_kernel
def along_line(x: F64, y: F64, line: F64, reach: float, out: F64) -> None:
    """Fill `out` (R, C, 3) with the way of each place from a line: aside (left is negative), along, height there.

    `line` (N, 4): east, north, metres along, height of each vertex. Places farther than `reach`: aside is `reach`.
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
    """Fill `out` (R, C) with the mean of the square of 2 half + 1 cells about each cell, cut at the edges."""
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

    Cell (0, 0) of `out` is (`row`, `col`) of `height`, which goes on by a cell or more on every side. `means` (K, ...):
    heights smoothed over K widths; a hollow is a cell below them, darker by `gains` (K,) a metre.
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
def sun_margin(height: F32, row: int, col: int, top: float, step: F64, limit: float, out: F32) -> None:
    """Fill `out` (R, C) with how far, in metres, the sun's ray from each cell clears the ground (negative: shadow).

    Cell (0, 0) of `out` is (`row`, `col`) of `height`. `step` (3,): one step towards the sun in columns, rows, metres;
    steps of about a cell. Nothing is higher than `top`. Clipped to `limit`.
    """
    rows, cols = height.shape
    for r in prange(out.shape[0]):
        for c in range(out.shape[1]):
            x, y = float(col + c), float(row + r)
            z, margin = float(height[row + r, col + c]), limit
            while z < top and margin > -limit:
                x, y, z = x + step[0], y + step[1], z + step[2]
                if x < 0.0 or y < 0.0 or x > cols - 1.0 or y > rows - 1.0:
                    break
                margin = min(margin, z - _bilinear(height, x, y))
            out[r, c] = np.float32(max(margin, -limit))
