"""Procedural noise by world position: an integer hash, so that no position repeats and nothing is stored.

All values are pure functions of position and seed, equal on every thread and in NumPy.
"""

from __future__ import annotations

import math

import numpy as np

from alight.compiled import kernel, pixelwise

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

    Multiply-xorshift rounds (Wellons' lowbias32) mix in one index after the other. An XOR of the multiplied indices
    before the rounds gave one lattice point in six the bits of another.
    """
    h: int = _hash_point(_hash_column(i, seed), j)
    return h


@kernel
def gradient_noise(x: float, y: float, seed: int) -> tuple[float, float, float]:
    """Return Perlin's gradient noise of unit wavelength and unit standard deviation, and its two derivatives.

    Quintic blending makes the value twice differentiable, so its slopes can be used as micro-relief.
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


# ---- 32-bit versions, for loops over a block of pixels that LLVM vectorises ------------------------------------

Two = tuple[np.float32, np.float32]
Three = tuple[np.float32, np.float32, np.float32]
f32, u32, i32 = np.float32, np.uint32, np.int32
_FIRST, _I, _J, _LAST = u32(0x21F0AAAD), u32(0x2DA6B343), u32(0x58163841), u32(0x735A2D97)
_STEP, _STD, _LOW = f32(UNIT_STD / 32768.0), f32(UNIT_STD), u32(0xFFFF)
_15, _16 = u32(15), u32(16)
_F1, _F2, _F6, _F10, _F15, _F30 = f32(1), f32(2), f32(6), f32(10), f32(15), f32(30)


@pixelwise
def floor32(x: np.float32) -> np.int32:
    """Return the largest integer not above `x`; unlike `math.floor`, vectorised."""
    i = i32(x)
    return i32(i - i32(f32(i) > x))


@pixelwise
def column32(i: np.int32, seed: np.uint32) -> np.uint32:
    """Return the hash of lattice column `i`, which `point32` continues for each point; `seed` comes from `seed32`."""
    h = u32(u32(i) * _I + seed)
    h = u32(h ^ u32(h >> _16))
    h = u32(h * _FIRST)
    return u32(h ^ u32(h >> _15))


@pixelwise
def point32(column: np.uint32, j: np.int32) -> np.uint32:
    """Return the hash of the lattice point with index `j` in a column, from the column's hash."""
    h = u32(column + u32(u32(j) * _J))
    h = u32(h ^ u32(h >> _16))
    h = u32(h * _FIRST)
    h = u32(h ^ u32(h >> _15))
    h = u32(h * _LAST)
    return u32(h ^ u32(h >> _15))


@pixelwise
def seed32(seed: int) -> np.uint32:
    """Return the seed in the form that `column32` needs."""
    return u32(((seed & MASK) * 0x4B1AB31F) & MASK)


@pixelwise
def _slopes32(h: np.uint32) -> Two:
    return f32(u32(h & _LOW)) * _STEP - _STD, f32(u32(h >> _16)) * _STEP - _STD


@pixelwise
def corners32(i: np.int32, j: np.int32, seed: np.uint32) -> tuple[Two, Two, Two, Two]:
    """Return the noise slopes at the corners (0, 0), (1, 0), (0, 1), (1, 1) in (x, y) of lattice cell (i, j)."""
    left, right, up = column32(i, seed), column32(i32(i + i32(1)), seed), i32(j + i32(1))
    return (
        _slopes32(point32(left, j)), _slopes32(point32(right, j)),
        _slopes32(point32(left, up)), _slopes32(point32(right, up)),
    )  # fmt: skip


@pixelwise
def blend32(u: np.float32, v: np.float32, corners: tuple[Two, Two, Two, Two]) -> Three:
    """Return the noise and its two derivatives at position (u, v) in a cell, from the slopes at its corners."""
    (ax, ay), (bx, by), (cx, cy), (dx, dy) = corners
    a, b = ax * u + ay * v, bx * (u - _F1) + by * v
    c, d = cx * u + cy * (v - _F1), dx * (u - _F1) + dy * (v - _F1)
    fu, fv = u * u * u * (u * (u * _F6 - _F15) + _F10), v * v * v * (v * (v * _F6 - _F15) + _F10)
    gu, gv = _F30 * u * u * (u * (u - _F2) + _F1), _F30 * v * v * (v * (v - _F2) + _F1)
    k = a - b - c + d
    value = a + fu * (b - a) + fv * (c - a) + fu * fv * k
    slope_x = ax + fu * (bx - ax) + fv * (cx - ax) + fu * fv * (ax - bx - cx + dx) + gu * (fv * k + b - a)
    slope_y = ay + fu * (by - ay) + fv * (cy - ay) + fu * fv * (ay - by - cy + dy) + gv * (fu * k + c - a)
    return value, slope_x, slope_y


@pixelwise
def noise32(
    x: np.float32, y: np.float32, i0: np.int32, j0: np.int32, seed: np.uint32
) -> tuple[np.float32, np.float32, np.float32]:
    """Return `gradient_noise` at (i0 + x, j0 + y) in single precision; integer parts keep it exact far from zero."""
    i, j = floor32(x), floor32(y)
    return blend32(x - f32(i), y - f32(j), corners32(i32(i + i0), i32(j + j0), seed))
