"""The layers of a patch at the positions of a block of pixels: look, light, tint.

At a step of the ground, the height of the hit point determines its side of the step. The surface's contour is straight
along a straight edge (`alight_sim.kernels.stamps`), whereas the border between two cells is a staircase.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from alight.compiled import kernel
from alight_sim.kernels.block import F1, F32, F64, I32, B, Slot, copy, f32, noise_at, smallest, smoothstep

U8 = NDArray[np.uint8]

# codes of records.Terrain with sharp borders: colours keep to them
TREE, ROCK, PAVED, STRUCTURE = 4, 6, 7, 8
STEEP = 3.0  # slope of a side
EDGE, FOOT_OF = 0.06, 0.25  # metres: four cells that differ by more are an edge; its side is ground up to FOOT_OF
STEP, PLAIN = 1, 2  # bits of a cell: it and the next cells in x and y are an edge; all cells within WIDE are equal
WIDE = 3
FAR = 2.5  # cells: a border that wanders farther ends beyond WIDE
SKIN = 8  # layers that are read at once


@kernel
def _class_near(label: U8, gx: float, gy: float) -> tuple[int, int]:
    rows, cols = label.shape
    return min(max(int(gy + 0.5), 0), rows - 1), min(max(int(gx + 0.5), 0), cols - 1)


@kernel
def _hard(kind: int) -> bool:
    """Whether colours keep to the border of a class."""
    return kind in (TREE, ROCK, STRUCTURE)


@kernel
def beside(height: F32, gx: float, gy: float, z: float) -> tuple[int, int, bool]:
    """Return row and column of the nearest cell on the point's level of a height step, and whether it is the upper one.

    `gx`, `gy`: column and row of the point; `z`: its height, metres.
    """
    ix, iy = int(gx), int(gy)
    top, low = height[iy, ix], height[iy, ix]
    for r in range(iy - 1, iy + 3):
        for q in range(ix - 1, ix + 3):
            top, low = max(top, height[r, q]), min(low, height[r, q])
    middle = 0.5 * (float(top) + float(low))
    upper = z > min(middle, float(low) + FOOT_OF)
    row, col = math.ceil(gy - 0.5), math.ceil(gx - 0.5)
    if (float(height[row, col]) > middle) == upper:  # the nearest of all
        return row, col, upper
    best = 1e9
    for r in range(iy - 1, iy + 3):
        for q in range(ix - 1, ix + 3):
            away = (q - gx) * (q - gx) + (r - gy) * (r - gy)
            if (float(height[r, q]) > middle) == upper and away < best:
                best, row, col = away, r, q
    return row, col, upper


@kernel
def _near(buf: F32, i: int, label: U8, gx: float, gy: float) -> tuple[int, int]:
    """Return row and column of the cell that gives pixel `i` at a grid position its look; natural borders are bent."""
    east, north = float(buf[Slot.SLOPE_E + i]), float(buf[Slot.SLOPE_N + i])
    steep = math.sqrt(east * east + north * north)
    if steep > STEEP:  # the side of a thing shows the thing, not the staircase of cells at its foot
        return _class_near(label, gx + east / steep, gy - north / steep)
    r, c = _class_near(label, gx, gy)
    q, p = _class_near(label, gx + buf[Slot.TX + i], gy + buf[Slot.TY + i])
    if label[r, c] == PAVED or label[q, p] == PAVED:  # paving has a sharp border
        q, p = _class_near(label, gx + f32(0.25) * buf[Slot.TX + i], gy + f32(0.25) * buf[Slot.TY + i])
    hard = _hard(label[r, c]) or _hard(label[q, p])
    return (r, c) if hard else (q, p)


@kernel
def look_up_layers(
    buf: F32, height: F32, label: U8, cells: U8, skin: F32, place: F64, base: F64, wet: F32, look: I32
) -> None:
    """Fill the look, light and tint of a block from the layers; see `shade` for the arguments.

    The slots TX, TY must hold the shifts of class borders in cells, written by `wander_borders`.
    """
    per, plain, far = 1.0 / place[2], PLAIN, False
    for i in range(B):
        far |= max(abs(buf[Slot.TX + i]), abs(buf[Slot.TY + i])) > f32(FAR)
    if far:
        plain = 0
    for i in range(B):
        gx = (base[0] - place[0] + buf[Slot.X + i]) * per
        gy = (place[1] - base[1] - buf[Slot.Y + i]) * per
        _skin_at(buf, i, skin, gx, gy)
        r, c = min(max(int(gy), 0), label.shape[0] - 1), min(max(int(gx), 0), label.shape[1] - 1)
        about = cells[r, c, 1]
        if about & STEP:
            r, c, upper = beside(height, gx, gy, base[2] + buf[Slot.Z + i])
            if not upper and not _hard(label[r, c]):  # ground at the foot of a thing is level, however cells slope
                buf[Slot.SLOPE_E + i], buf[Slot.SLOPE_N + i] = (
                    f32(0.1) * buf[Slot.SLOPE_E + i],
                    f32(0.1) * buf[Slot.SLOPE_N + i],
                )
            for k in range(3):
                buf[Slot.TINT_R + k * B + i] = skin[r, c, 5 + k]
        elif not about & plain:
            r, c = _near(buf, i, label, gx, gy)
        look[i] = cells[r, c, 0]
        buf[Slot.WATER + i] = wet[look[i]]


@kernel
def _skin_at(buf: F32, i: int, skin: F32, gx: float, gy: float) -> None:
    """Fill the light and tint of pixel `i` by bilinear interpolation of the layers (R, C, SKIN) at a grid position."""
    rows, cols = skin.shape[0], skin.shape[1]
    gx, gy = min(max(gx, 0.0), cols - 1.001), min(max(gy, 0.0), rows - 1.001)
    ix, iy = int(gx), int(gy)
    u, v = f32(gx - ix), f32(gy - iy)
    a, b, c, d = (F1 - u) * (F1 - v), u * (F1 - v), (F1 - u) * v, u * v
    for k in range(SKIN):
        upper = skin[iy, ix, k] * a + skin[iy, ix + 1, k] * b
        slot = Slot.SLOPE_E + k * B if k < 5 else Slot.TINT_R + (k - 5) * B
        buf[slot + i] = upper + skin[iy + 1, ix, k] * c + skin[iy + 1, ix + 1, k] * d


@kernel
def wander_borders(buf: F32, base: F64) -> None:
    """Fill the slots TX, TY with the shifts of class borders in cells, made of noise of 0.4 and 0.1 m wavelength."""
    copy(buf, Slot.X, Slot.TX)
    copy(buf, Slot.Y, Slot.TY)
    noise_at(buf, base, 0.4, 0.8, 0.6, 77)
    for i in range(B):
        buf[Slot.BUMP_E + i], buf[Slot.BUMP_N + i] = (
            f32(0.25) * buf[Slot.N + B + i],
            f32(0.25) * buf[Slot.N + 2 * B + i],
        )
    if smallest(buf, Slot.FOOT) < 0.08:
        noise_at(buf, base, 0.1, 0.6, 0.8, 78)
        for i in range(B):
            fine = f32(0.22) * smoothstep(f32(1.2), f32(2.4), f32(0.1) / buf[Slot.FOOT + i])
            buf[Slot.BUMP_E + i] += fine * buf[Slot.N + B + i]
            buf[Slot.BUMP_N + i] += fine * buf[Slot.N + 2 * B + i]
    copy(buf, Slot.BUMP_E, Slot.TX)
    copy(buf, Slot.BUMP_N, Slot.TY)
