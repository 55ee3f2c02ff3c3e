"""Procedural noise by world position: an integer hash, so that no place repeats and nothing is stored.

Everything is a pure function of position and seed: the same on every thread and in NumPy.
"""

from __future__ import annotations

import math

from alight.kernels.compiler import kernel

MASK = 0xFFFFFFFF
UNIT_STD = 5.65  # largest lattice slope: brings the noise below to a standard deviation of one


@kernel
def _hash_column(i: int, seed: int) -> int:
    h = ((i & MASK) * 0x2DA6B343 + ((seed & MASK) * 0x4B1AB31F & MASK)) & MASK
    h ^= h >> 16
    h = (h * 0x21F0AAAD) & MASK
    return h ^ (h >> 15)


@kernel
def _hash_point(column: int, j: int) -> int:
    h = (column + (j & MASK) * 0x58163841) & MASK
    h ^= h >> 16
    h = (h * 0x21F0AAAD) & MASK
    h ^= h >> 15
    h = (h * 0x735A2D97) & MASK
    return h ^ (h >> 15)


@kernel
def hash3(i: int, j: int, seed: int) -> int:
    """Return 32 well mixed bits of two lattice indices and a seed.

    Multiply-xorshift rounds (Wellons' lowbias32), one index after the other: combining the indices first, by XOR of
    their multiples, gave one lattice point in six the bits of another.
    """
    h: int = _hash_point(_hash_column(i, seed), j)
    return h


@kernel
def gradient_noise(x: float, y: float, seed: int) -> tuple[float, float, float]:
    """Return Perlin's gradient noise of unit wavelength and unit standard deviation, and its two derivatives.

    Quintic blending: the value is twice differentiable, so its slopes can be used as micro-relief.
    """
    i, j = math.floor(x), math.floor(y)
    u, v = x - i, y - j
    left, right = _hash_column(i, seed), _hash_column(i + 1, seed)
    h00, h10 = _hash_point(left, j), _hash_point(right, j)
    h01, h11 = _hash_point(left, j + 1), _hash_point(right, j + 1)
    s = UNIT_STD / 32768.0
    ax, ay = (h00 & 0xFFFF) * s - UNIT_STD, (h00 >> 16) * s - UNIT_STD
    bx, by = (h10 & 0xFFFF) * s - UNIT_STD, (h10 >> 16) * s - UNIT_STD
    cx, cy = (h01 & 0xFFFF) * s - UNIT_STD, (h01 >> 16) * s - UNIT_STD
    dx, dy = (h11 & 0xFFFF) * s - UNIT_STD, (h11 >> 16) * s - UNIT_STD
    a, b = ax * u + ay * v, bx * (u - 1) + by * v
    c, d = cx * u + cy * (v - 1), dx * (u - 1) + dy * (v - 1)
    fu, fv = u * u * u * (u * (u * 6 - 15) + 10), v * v * v * (v * (v * 6 - 15) + 10)
    gu, gv = 30 * u * u * (u * (u - 2) + 1), 30 * v * v * (v * (v - 2) + 1)
    k = a - b - c + d
    value = a + fu * (b - a) + fv * (c - a) + fu * fv * k
    slope_x = ax + fu * (bx - ax) + fv * (cx - ax) + fu * fv * (ax - bx - cx + dx) + gu * (fv * k + b - a)
    slope_y = ay + fu * (by - ay) + fv * (cy - ay) + fu * fv * (ay - by - cy + dy) + gv * (fu * k + c - a)
    return value, slope_x, slope_y
