"""Stones stamped into the layers of a tile: round or angular, of the ground's own material or of another.

Rows run in parallel, and each processes the stones in their order, so the result does not depend on threads.
"""

from __future__ import annotations

import math
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from alight.compiled import kernel, parallel_kernel, prange
from alight_sim.kernels.noise import gradient_noise, hash3
from alight_sim.kernels.stamps import Column, _span

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]
I32 = NDArray[np.int32]

FACES = 6  # number of faces around an angular stone
# distance of a face from the centre over the radius, [least, spread]: the area stays that of the ellipse
FACE = (0.81, 0.29)
STEEP = 3.0  # rise of an angular stone from its outline: its top is nearly level

ROCK = 6  # code of records.Terrain


class Form(IntEnum):
    """Columns of the table of forms."""

    ANGULAR, ROCK_FROM, HIDDEN, LOOK, TINT = range(5)


@kernel
def _outline(u: float, v: float, bits: int) -> float:
    """Return how far (u, v) is from the centre of a random polygon of seed `bits`; the polygon's outline is at 1."""
    far = 0.0
    for k in range(FACES):
        h = hash3(bits, k, 11)
        turn = (k + 0.5 * (h & 0xFFFF) / 65535.0) * 2.0 * math.pi / FACES
        away = FACE[0] + FACE[1] * (h >> 16) / 65535.0
        far = max(far, (u * math.cos(turn) + v * math.sin(turn)) / away)
    return far


@kernel
def _stone(thing: F64, dx: float, dy: float, x: float, y: float, angular: bool, seed: int) -> tuple[float, float]:
    """Return a stone's height above the ground at (dx, dy), negative outside, and distance from its centre, rim 1."""
    cos, sin = math.cos(thing[Column.TURN]), math.sin(thing[Column.TURN])
    u, v = (cos * dx + sin * dy) / thing[Column.HALF_U], (cos * dy - sin * dx) / thing[Column.HALF_V]
    if math.hypot(u, v) > 1.4:
        return -1.0, 1.0
    size = max(0.4 * thing[Column.EXTRA], 0.08)
    a, _, _ = gradient_noise(x / size, y / size, seed + 1)
    if angular:
        r = _outline(u, v, int(thing[Column.BLUE] * 1e9))
        shaped = min(1.0, STEEP * (1.0 - r)) * (1.0 - 0.25 * r) * (1.0 - 0.12 * u)
    else:
        r = math.hypot(u, v) * (1.0 + 0.05 * a)
        shaped = math.sqrt(max(1.0 - r * r, 0.0))
    if r >= 1.0:
        return -1.0, 1.0
    return float(max(thing[Column.TOP] * (0.08 + 0.92 * shaped) * (1.0 + 0.04 * a), 0.02)), float(r)


@parallel_kernel
def stamp_stones(
    x: F64, y: F64, cell: float, things: F64, form: F64, seed: int, ground: F64, by_class: I32,
    height: F64, label: U8, depth: F64, look: U8, tint: F32, under: F32,
) -> None:  # fmt: skip
    """Stamp stones (N, COLUMNS) on the ground. `x` (C,), `y` (R,): cell centres.

    A stone has the columns of `stamps`; EXTRA: diameter, RED: ratio of its brightness to the ground's, BLUE: seed of
    its outline. `form` (7,): 1 if angular, least diameter of class rock, hidden share, look (0: the ground's), tint of
    that look (3). `by_class` (9,): look of each class; `under` (R, C, 3): tint of the ground.
    """
    for r in prange(y.size):
        for k in range(things.shape[0]):
            t = things[k]
            if abs(y[r] - t[Column.NORTH]) > t[Column.REACH]:
                continue
            c0, c1 = _span(t[Column.EAST], t[Column.REACH], x[0], cell, x.size)
            for c in range(c0, c1):
                rise, away = _stone(
                    t, x[c] - t[Column.EAST], y[r] - t[Column.NORTH], x[c], y[r], form[Form.ANGULAR] > 0.5, seed
                )
                if rise <= 0.0 or ground[r, c] + rise <= height[r, c]:
                    continue
                height[r, c], depth[r, c] = ground[r, c] + rise, 0.0
                own = look[r, c] if look[r, c] > 0 else by_class[label[r, c]]
                if t[Column.EXTRA] >= form[Form.ROCK_FROM]:
                    label[r, c] = ROCK
                look[r, c] = own
                if form[Form.HIDDEN] > 0.0:
                    n, _, _ = gradient_noise(x[c] / 0.13, y[r] / 0.13, seed + 3)
                    if away + 0.25 * n > 1.0 - form[Form.HIDDEN]:
                        continue
                given = form[Form.LOOK] > 0.0
                if given:
                    look[r, c] = int(form[Form.LOOK])
                for m in range(3):
                    tint[r, c, m] = (form[Form.TINT + m] if given else under[r, c, m]) * t[Column.RED]
