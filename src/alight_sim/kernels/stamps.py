"""Standing things, stamped into the layers of a tile: domes (rocks, crowns) and boxes (houses, cars).

A thing replaces lower surfaces. Rows run in parallel, and each processes the things in their order, so the result does
not depend on threads. Heights are functions of world positions, so two tiles draw the same thing equally.
"""

from __future__ import annotations

import math
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from alight.compiled import kernel, parallel_kernel, prange
from alight_sim.kernels.noise import gradient_noise

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]


class Column(IntEnum):
    """Columns of the table of things."""

    EAST, NORTH, LEVEL, REACH, TURN, HALF_U, HALF_V, TOP, EXTRA, RED, GREEN, BLUE, LOOK = range(13)


COLUMNS = len(Column)


class DomeShape(IntEnum):
    """Shapes of domes."""

    ELLIPSOID, CONE, DRUM = range(3)


class Roof(IntEnum):
    """Roofs of boxes."""

    GABLE, HIP, FLAT, CAR = range(4)


PARAPET, CHIMNEY = 0.25, 0.4  # metres: width of a flat roof's parapet, half a chimney's side


@kernel
def _span(centre: float, reach: float, first: float, cell: float, count: int) -> tuple[int, int]:
    """Return the range [a, b) of cells whose centres lie within `reach` of `centre`; `first`: centre of cell 0."""
    a = math.ceil((centre - reach - first) / cell)
    b = math.floor((centre + reach - first) / cell) + 1
    return min(max(a, 0), count), min(max(b, 0), count)


@kernel
def _put(
    thing: F64, surface: float, kind: int, r: int, c: int, height: F64, label: U8, depth: F64, look: U8, tint: F32
) -> None:
    if surface <= height[r, c]:
        return
    height[r, c], depth[r, c] = surface, 0.0
    if kind < 0 and thing[Column.LOOK] == 0.0:  # of the ground's own material
        return
    if kind >= 0:
        label[r, c] = kind
    look[r, c] = int(thing[Column.LOOK])
    for k in range(3):
        tint[r, c, k] = thing[Column.RED + k]


@kernel
def _dome(thing: F64, u: float, v: float, x: float, y: float, form: F64, shape: int, seed: int) -> float:
    """Return a dome's height above its base at (u, v), negative outside; (x, y): world position, for the noise."""
    r = math.hypot(u / thing[Column.HALF_U], v / thing[Column.HALF_V])
    if r > 1.5:
        return -1.0
    size = form[2]
    if form[3] > 0.0:
        a, _, _ = gradient_noise(x / size, y / size, seed + 1)
        b, _, _ = gradient_noise(x / (0.35 * size), y / (0.35 * size), seed + 2)
        r *= 1.0 + form[3] * (a + 0.55 * b)
    if r >= 1.0:
        return -1.0
    shaped = math.sqrt(1.0 - r * r) if shape == DomeShape.ELLIPSOID else (1.0 - r if shape == DomeShape.CONE else 1.0)
    rise = thing[Column.TOP] * (form[0] + (1.0 - form[0]) * shaped)
    if form[1] > 0.0:
        a, _, _ = gradient_noise(x / size, y / size, seed + 3)
        b, _, _ = gradient_noise(x / (0.37 * size), y / (0.37 * size), seed + 4)
        rise += form[1] * thing[Column.EXTRA] * (a + b)
    return float(max(rise, 0.02))


@parallel_kernel
def stamp_domes(
    x: F64, y: F64, cell: float, things: F64, form: F64, shape: int, kind: int, rooted: bool, seed: int,
    ground: F64, height: F64, label: U8, depth: F64, look: U8, tint: F32,
) -> None:  # fmt: skip
    """Stamp `things` (N, COLUMNS) as domes of a `shape` on the layers. `x` (C,), `y` (R,): cell centres.

    `form` (4,): skirt (share of the top at the rim), lumps (times EXTRA, metres), size of lumps in metres, raggedness.
    `kind`: class, < 0: the ground's. `rooted`: whether a dome stands on its foot's LEVEL instead of on each cell's
    ground.
    """
    for r in prange(y.size):
        for k in range(things.shape[0]):
            t = things[k]
            if abs(y[r] - t[Column.NORTH]) > t[Column.REACH]:
                continue
            c0, c1 = _span(t[Column.EAST], t[Column.REACH], x[0], cell, x.size)
            cos, sin = math.cos(t[Column.TURN]), math.sin(t[Column.TURN])
            for c in range(c0, c1):
                dx, dy = x[c] - t[Column.EAST], y[r] - t[Column.NORTH]
                rise = _dome(t, cos * dx + sin * dy, cos * dy - sin * dx, x[c], y[r], form, shape, seed)
                if rise > 0.0:
                    base = t[Column.LEVEL] if rooted else ground[r, c]
                    _put(t, base + rise, kind, r, c, height, label, depth, look, tint)


@kernel
def _roof(thing: F64, u: float, v: float, kind: int) -> float:
    """Return a box's height above its base at (u, v): TOP plus a roof of slope EXTRA or a parapet of height EXTRA."""
    u, v = (
        min(max(u, -thing[Column.HALF_U]), thing[Column.HALF_U]),
        min(max(v, -thing[Column.HALF_V]), thing[Column.HALF_V]),
    )
    inside_u, inside_v = thing[Column.HALF_U] - abs(u), thing[Column.HALF_V] - abs(v)
    if kind == Roof.CAR:
        return float(_car(thing, u, v))
    if kind == Roof.FLAT:
        rim = min(inside_u, inside_v) < PARAPET and thing[Column.EXTRA] > 0.0
        return float(thing[Column.TOP] + (thing[Column.EXTRA] if rim else 0.0))
    rise = thing[Column.EXTRA] * (inside_v if kind == Roof.GABLE else min(inside_u, inside_v))
    if abs(u - 0.5 * thing[Column.HALF_U]) < CHIMNEY and abs(v - 0.25 * thing[Column.HALF_V]) < CHIMNEY:
        rise = thing[Column.EXTRA] * thing[Column.HALF_V] + 0.5
    return float(thing[Column.TOP] + rise)


@kernel
def _car(thing: F64, u: float, v: float) -> float:
    """Return the height of a car above its base at (u, v), metres along and across it from its centre."""
    along = u / thing[Column.HALF_U]
    body = 0.62 * thing[Column.TOP]
    screen = min((along + 0.85) / 0.25, (0.45 - along) / 0.3)
    cabin = min(max(screen, 0.0), 1.0) * (thing[Column.TOP] - body)
    if abs(v) > 0.86 * thing[Column.HALF_V]:
        cabin *= 0.4
    return float(body - 0.15 * max(along - 0.5, 0.0) + cabin)


@parallel_kernel
def stamp_boxes(
    x: F64, y: F64, cell: float, things: F64, kind: int, label_code: int,
    height: F64, label: U8, depth: F64, look: U8, tint: F32,
) -> None:  # fmt: skip
    """Stamp `things` (N, COLUMNS) as boxes with vertical sides on their feet's LEVEL; `kind`: GABLE, HIP, FLAT or CAR.

    A cell that an edge crosses rises by the share of it that is covered, which keeps oblique edges straight. The cell
    gets the class `label_code` if half of it is covered.
    """
    for r in prange(y.size):
        for k in range(things.shape[0]):
            t = things[k]
            if abs(y[r] - t[Column.NORTH]) > t[Column.REACH] + cell:
                continue
            c0, c1 = _span(t[Column.EAST], t[Column.REACH] + cell, x[0], cell, x.size)
            cos, sin = math.cos(t[Column.TURN]), math.sin(t[Column.TURN])
            width = cell * (abs(cos) + abs(sin))
            for c in range(c0, c1):
                dx, dy = x[c] - t[Column.EAST], y[r] - t[Column.NORTH]
                u, v = cos * dx + sin * dy, cos * dy - sin * dx
                covered = 0.5 + min(t[Column.HALF_U] - abs(u), t[Column.HALF_V] - abs(v)) / width
                if covered <= 0.0:
                    continue
                rise = t[Column.LEVEL] + _roof(t, u, v, kind) - height[r, c]
                if covered >= 0.5:
                    _put(t, height[r, c] + min(covered, 1.0) * rise, label_code, r, c, height, label, depth, look, tint)
                elif rise > 0.0:
                    height[r, c] += covered * rise
