"""Compiled loops that rest a lander's feet or skids on the ground (docs/method/hazards.md).

They handle a row of C touchdowns at once. Heights are in *cells* (height divided by cell size), so that gradients are
tangents. Ground under the gear is +inf where unknown and off the map, ground under the body is -inf there.
"""

import math
from typing import NamedTuple

import numpy as np

from alight.arrays import F32, F64, I64
from alight.compiled import kernel, parallel_kernel, prange

HAIR = 1e-5  # cells, tolerance: two equally high diagonals both carry
BLOCK = 4  # side of the blocks that the search under the body opens, cells


class Feet(NamedTuple):
    """Cells under each foot at each heading."""

    xy: F64  # (headings, feet, 2) contact of each foot: (column, row) offset in cells, centroid of its cells
    offsets: I64  # (n, 2) (row, column) offsets of the cells under all feet
    starts: I64  # (headings, feet + 1) first index of each foot's cells in `offsets`
    triples: I64  # (t, 3) indices of three feet that can carry the lander
    solve: F64  # (headings, t, 3, 3) matrices from three feet's heights to their plane (level, per column, per row)
    coarse: bool  # whether the cells do not separate three feet at some heading
    mean: bool  # whether a foot rests on the mean of its cells; False: on the highest cell
    any_three: bool  # whether three feet are judged even if another foot would sink into the ground


class Skids(NamedTuple):
    """Cells under each rail at each heading."""

    axes: F64  # (headings, 2) forward unit vector (column, row)
    offsets: I64  # (headings, 2, n, 2) (row, column) offsets under the left and the right rail
    along: F64  # (headings, n) position along the rail, cells, evenly spaced over the length of its cells
    gauge: F64  # (headings,) distance between the cells of both rails, cells


class Belly(NamedTuple):
    """Ground under the lander's body, and how it is searched for its highest rise above a contact plane."""

    ground: F32  # (R + 2 pad, C + 2 pad) with pad = n + BLOCK
    tops: F32  # like `ground`, maximum of the BLOCK x BLOCK cells that start at each cell
    own: F32  # (4, R, C) the footprint's plane (level, per column, per row) and the highest ground above it
    spans: I64  # (2 n + 1,) half width of each row of the body's disc
    blocks: I64  # (b, 2) (row, column) offsets of the blocks that cover the disc
    least: float  # lowest and highest rise, cells, between which the rise must be exact
    most: float


@kernel
def _rise(belly: Belly, r: int, c: int, level: float, across: float, along: float, rise: float) -> float:
    """Return the larger of `rise` and the rise of the ground in the body's disc around (r, c) above a contact plane.

    `level`: of the plane at (r, c). The search ends once the rise exceeds `belly.most`.
    """
    reach = belly.spans.size // 2
    row, column = r + reach + BLOCK, c + reach + BLOCK
    fall = (BLOCK - 1) * (min(across, 0.0) + min(along, 0.0))
    for i in range(belly.blocks.shape[0]):
        br, bc = belly.blocks[i, 0], belly.blocks[i, 1]
        if not belly.tops[row + br, column + bc] - level - across * bc - along * br - fall > rise:
            continue
        for dr in range(br, min(br + BLOCK, reach + 1)):
            half, base = belly.spans[dr + reach], level + along * dr
            for dc in range(max(bc, -half), min(bc + BLOCK, half + 1)):
                e = belly.ground[row + dr, column + dc] - base - across * dc
                rise = e if e > rise else rise
        if rise > belly.most:
            break
    return rise


@kernel
def _raise_by_body(belly: Belly, own: F32, r: int, level: F64, across: F64, along: F64, rise: F32) -> None:
    """Raise `rise` (C,) to the rise of the ground below the body above the contact planes of row `r`.

    Cells are searched only where the footprint's plane and highest ground, `own` (4, C), leave room for a larger rise.
    """
    reach, may = np.float32(belly.spans.size // 2), np.empty_like(level)
    for c in range(rise.size):
        gx, gy = own[1, c] - across[c], own[2, c] - along[c]
        may[c] = own[3, c] + (own[0, c] - level[c]) + math.sqrt(gx * gx + gy * gy) * reach - rise[c]
    for c in range(rise.size):
        if may[c] > 0.0 and rise[c] <= belly.most:
            rise[c] = _rise(belly, r, c, float(level[c]), float(across[c]), float(along[c]), rise[c])


@kernel
def _touch(ground: F32, pad: int, r: int, offsets: I64, mean: bool, out: F32) -> None:
    """Fill `out` (C,) with the heights at which a foot rests in row `r`: mean or highest of the cells at `offsets`."""
    out[:] = np.float32(0.0 if mean else -np.inf)
    for i in range(offsets.shape[0]):
        row, column = offsets[i] + pad
        line = ground[r + row][column : column + out.size]
        for c in range(out.size):
            v, t = line[c], out[c]
            out[c] = t + v if mean else (v if v > t else t)
    if mean:
        out /= np.float32(offsets.shape[0])


@parallel_kernel
def feet_contact(ground: F32, feet: Feet, belly: Belly, tilt: F32, rise: F32) -> None:
    """Compute the worst tilt and rise of a lander on feet, over all headings and triples of feet that carry it (G4).

    Args:
        ground: (R + 2 pad, C + 2 pad) heights, with a pad at least as wide as the reach of the feet.
        feet: cells under the feet.
        belly: ground under the body.
        tilt: (R, C) filled with the worst tangent of the tilt.
        rise: (R, C) least rises of interest, raised to the worst rise.
    """
    (headings, count), (rows, cols) = feet.xy.shape[:2], tilt.shape
    pad = (ground.shape[1] - cols) // 2
    for r in prange(rows):
        steep, over, under, touch = np.zeros(cols), np.empty(cols), np.empty(cols, np.float32), np.empty((count, cols))
        level, across, along, own = np.empty(cols), np.empty(cols), np.empty(cols), belly.own[:, r].copy()
        for k in range(headings):
            for f in range(count):
                _touch(ground, pad, r, feet.offsets[feet.starts[k, f] : feet.starts[k, f + 1]], feet.mean, under)
                touch[f] = under
            for t in range(feet.triples.shape[0]):
                i, j, m = feet.triples[t]
                s = feet.solve[k, t]
                one, two, three = touch[i], touch[j], touch[m]
                for c in range(cols):
                    level[c] = s[0, 0] * one[c] + s[0, 1] * two[c] + s[0, 2] * three[c]
                    across[c] = s[1, 0] * one[c] + s[1, 1] * two[c] + s[1, 2] * three[c]
                    along[c] = s[2, 0] * one[c] + s[2, 1] * two[c] + s[2, 2] * three[c]
                    over[c] = -np.inf
                for f in range(0 if feet.any_three else count):
                    line, x, y = touch[f], feet.xy[k, f, 0], feet.xy[k, f, 1]
                    for c in range(cols):
                        e = line[c] - (level[c] + x * across[c] + y * along[c])
                        over[c] = e if e > over[c] else over[c]
                for c in range(cols):
                    carries, g = over[c] <= HAIR, across[c] * across[c] + along[c] * along[c]
                    steep[c] = g if carries and g > steep[c] else steep[c]
                    level[c] = level[c] if carries else np.inf  # the plane lies below the ground of a foot
                _raise_by_body(belly, own, r, level, across, along, rise[r])
        for c in range(cols):
            tilt[r, c] = math.sqrt(steep[c])


@kernel
def _raise_to(top: F32, x: float, a: F32, y: float, b: F32, v: float, c: F32, w: float, d: F32) -> None:
    """Raise `top` to `x a + y b` and to `v c + w d`, cell by cell; one sum at a time takes 1.7 times as long."""
    for k in range(top.size):
        e, f, t = x * a[k] + y * b[k], v * c[k] + w * d[k], top[k]
        e = e if e > f else f
        top[k] = e if e > t else t


@kernel
def resting_pitches(left: F32, right: F32, apart: float) -> tuple[F32, F32]:
    """Rest both rails on their profiles at a common pitch (G5).

    `joint(t)` is the highest sum of two heights, one per rail, at positions that add up to `t`. At a given pitch, twice
    the height over the middle is the highest `joint(t) - pitch t`. The lander rests at the pitch with the smallest
    height. If a range of pitches gives this height, the lander rocks within the range.

    Args:
        left, right: (n, C) ground heights at n (odd) evenly spaced positions of the rails.
        apart: distance between these positions.

    Returns:
        Lowest and highest pitch, (C,) each.
    """
    n, cols = left.shape
    joint, middle, one = np.full((2 * n - 1, cols), np.float32(-np.inf)), n - 1, np.float32(1)
    for k in range(2 * n - 1):
        last = min(k, middle)
        for i in range(max(0, k - middle), last + 1, 2):
            j = min(i + 1, last)
            _raise_to(joint[k], one, left[i], one, right[k - i], one, left[j], one, right[k - j])
    rest = joint[middle].copy()
    for i in range(1, n):  # the height at 0 of the line through the sums at -i and j
        behind = joint[middle - i]
        for j in range(1, n, 2):
            x, y = np.float32(j / (i + j)), np.float32(i / (i + j))
            v, w = np.float32((j + 1) / (i + j + 1)), np.float32(i / (i + j + 1))
            _raise_to(rest, x, behind, y, joint[middle + j], v, behind, w, joint[middle + j + 1])
    low, high = np.full(cols, np.float32(-np.inf)), np.full(cols, np.float32(np.inf))
    for i in range(1, n):
        lever, behind, ahead = np.float32(1.0 / (i * apart)), joint[middle - i], joint[middle + i]
        for c in range(cols):
            least, most = (ahead[c] - rest[c]) * lever, (rest[c] - behind[c]) * lever
            low[c] = least if least > low[c] else low[c]
            high[c] = most if most < high[c] else high[c]
    return low, np.fmax(low, high)  # equal pitches may differ by rounding


@parallel_kernel
def skid_contact(ground: F32, skids: Skids, belly: Belly, tilt: F32, rise: F32) -> None:
    """Compute the worst tilt and rise of a lander on two skids, over all headings (G5); see `feet_contact`."""
    n, (rows, cols) = skids.along.shape[1], tilt.shape
    pad = (ground.shape[1] - cols) // 2
    for r in prange(rows):
        rails, tops = np.empty((2, n, cols), np.float32), np.empty((2, cols), np.float32)
        planes, rolls = np.empty((3, cols), np.float32), np.empty(cols, np.float32)
        level, across, along = planes[0], planes[1], planes[2]
        steep, own, half, one = np.zeros(cols, np.float32), belly.own[:, r].copy(), np.float32(0.5), np.float32(1)
        for k in range(skids.axes.shape[0]):
            for side in range(2):
                for i in range(n):
                    row, column = skids.offsets[k, side, i] + pad
                    line, rail = ground[r + row][column : column + cols], rails[side, i]
                    for c in range(cols):
                        rail[c] = line[c] - own[0, c]
            ax, ay, gauge = np.float32(skids.axes[k, 0]), np.float32(skids.axes[k, 1]), np.float32(skids.gauge[k])
            places = skids.along[k].astype(np.float32)
            low, high = resting_pitches(rails[0], rails[1], skids.along[k, 1] - skids.along[k, 0])
            rolls[:] = np.float32(0)
            for pitch in (low, high):
                tops[:] = np.float32(-np.inf)  # heights of the middles of the rails
                for side in range(2):
                    for i in range(0, n, 2):
                        j = min(i + 1, n - 1)
                        here, beside = rails[side, i], rails[side, j]
                        _raise_to(tops[side], one, here, -places[i], pitch, one, beside, -places[j], pitch)
                for c in range(cols):
                    roll = (tops[0, c] - tops[1, c]) / gauge  # rises to the left, which is (ay, -ax)
                    rolls[c] = max(rolls[c], abs(roll))
                    level[c] = own[0, c] + half * (tops[0, c] + tops[1, c])
                    across[c], along[c] = pitch[c] * ax + roll * ay, pitch[c] * ay - roll * ax
                _raise_by_body(belly, own, r, level, across, along, rise[r])
            for c in range(cols):
                pitched = max(abs(low[c]), abs(high[c]))
                steep[c] = max(steep[c], pitched * pitched + rolls[c] * rolls[c])
        for c in range(cols):
            tilt[r, c] = math.sqrt(steep[c])
