"""Compiled loops that rest a lander's feet or skids on the ground (docs/method-hazards.md, section 2)."""

import math

import numpy as np
from numpy.typing import NDArray

from alight.kernels.compiler import kernel, parallel_kernel, prange

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
B = NDArray[np.bool_]

BLOCK = 4  # cells a side of the blocks that the belly search opens
HAIR = 1e-5  # cells; two diagonals equally high carry both ways


@kernel
def _raise_to(top: F32, line: F32) -> None:
    """Keep the larger of the two, cell by cell; slices without offsets vectorise."""
    for c in range(top.size):
        v, t = line[c], top[c]
        top[c] = v if v > t else t


@kernel
def _add_to(total: F32, line: F32) -> None:
    for c in range(total.size):
        total[c] += line[c]


@kernel
def _touch_row(ground: F32, r: int, offsets: I64, first: int, last: int, mean: bool, out: F32) -> None:
    """Ground that carries one foot for every cell of row `r`: highest or mean; +inf where any of it is unknown."""
    rows, cols = ground.shape
    out[:] = np.float32(0.0) if mean else np.float32(-np.inf)
    for i in range(first, last):
        q, dc = r + offsets[i, 0], offsets[i, 1]
        lo, hi = max(0, -dc), min(cols, cols - dc)
        if q < 0 or q >= rows or hi <= lo:
            out[:] = np.float32(np.inf)
            return
        if mean:
            _add_to(out[lo:hi], ground[q, lo + dc : hi + dc])
        else:
            _raise_to(out[lo:hi], ground[q, lo + dc : hi + dc])
        out[:lo] = np.float32(np.inf)
        out[hi:] = np.float32(np.inf)
    if mean:
        out /= np.float32(last - first)


@kernel
def _rise_in_block(
    body: F32, pad: int, r: int, c: int, br: int, bc: int, spans: I64, a: float, gx: float, gy: float, top: float
) -> float:
    """Largest rise in those cells of one block that belong to the disc, or `top` if none is higher."""
    reach = spans.size // 2
    for dr in range(br, min(br + BLOCK, reach + 1)):
        half = spans[dr + reach]
        level = a + gy * dr
        for dc in range(max(bc, -half), min(bc + BLOCK, half + 1)):
            e = body[r + dr + pad, c + dc + pad] - level - gx * dc
            top = e if e > top else top
    return top


@kernel
def _rise(
    body: F32, tops: F32, pad: int, r: int, c: int, spans: I64, blocks: I64, plane: F64, limits: tuple[float, float]
) -> float:
    """Largest rise of known ground in the disc above a plane (level, x, y), where it is between the two limits.

    Below the lower one the lower one is returned; the search ends above the upper one. A block of cells is opened only
    where its highest cell, above the block's lowest corner of the plane, would raise the answer.
    """
    a, gx, gy = plane[0], plane[1], plane[2]
    fall = (BLOCK - 1) * (min(gx, 0.0) + min(gy, 0.0))
    top = limits[0]
    for i in range(blocks.shape[0]):
        br, bc = blocks[i, 0], blocks[i, 1]
        if tops[r + br + pad, c + bc + pad] - a - gx * bc - gy * br - fall > top:
            top = _rise_in_block(body, pad, r, c, br, bc, spans, a, gx, gy, top)
            if top > limits[1]:
                break
    return top


@kernel
def _belly(
    body: F32,
    tops: F32,
    pad: int,
    r: int,
    c: int,
    spans: I64,
    blocks: I64,
    own: F64,
    plane: F64,
    limits: tuple[float, float],
) -> float:
    """Rise of the ground above a contact plane between the limits of `_rise`; without a search where that is enough.

    The ground lies no higher than `own[3]` above the footprint's own plane (level, x, y); the two planes part by no
    more than their difference at the centre plus that of their gradients times the reach.
    """
    apart = own[0] - plane[0] + math.hypot(own[1] - plane[1], own[2] - plane[2]) * (spans.size // 2)
    if own[3] + apart <= limits[0]:
        return limits[0]
    rise: float = _rise(body, tops, pad, r, c, spans, blocks, plane, limits)
    return rise


@kernel
def _plane_of(touch: F32, c: int, solve: F64, three: I64, plane: F64) -> None:
    """Plane (level, x, y) through three contacts; `solve` (3, 3) takes their heights to it."""
    t0, t1, t2 = touch[three[0], c], touch[three[1], c], touch[three[2], c]
    for i in range(3):
        plane[i] = solve[i, 0] * t0 + solve[i, 1] * t1 + solve[i, 2] * t2


@kernel
def _rests(touch: F32, c: int, xy: F64, plane: F64) -> bool:
    """Whether no foot's ground rises above the plane: the lander can stand on it."""
    for f in range(xy.shape[0]):  # noqa: SIM110 (the compiler knows no generators)
        if touch[f, c] > plane[0] + plane[1] * xy[f, 0] + plane[2] * xy[f, 1] + HAIR:
            return False
    return True


@parallel_kernel
def feet_contact(
    ground: F32,
    body: F32,
    tops: F32,
    skip: B,
    own: F32,
    xy: F64,
    solve: F64,
    offsets: I64,
    starts: I64,
    triples: I64,
    spans: I64,
    blocks: I64,
    limits: tuple[float, float],
    mean: bool,
    any_three: bool,
    tilt: F32,
    rise: F32,
) -> None:
    """Judge a lander that rests on feet, over every heading and every three feet that can carry it (G4).

    Heights are in *cells* (height over cell size), so that gradients are tangents.

    Args:
        ground: (R, C) heights, +inf where unknown.
        body: (R + 2 pad, C + 2 pad) the same, -inf where unknown and off the map.
        tops: like `body`, highest of the BLOCK x BLOCK cells that start there.
        skip: (R, C) bool, cells not judged.
        own: (4, R, C) the footprint's plane (level, per column, per row) and the highest ground above it.
        xy: (headings, feet, 2) offset (column, row) of each foot's centre, cells.
        solve: (headings, t, 3, 3) from the heights of three feet to their plane (level, per column, per row).
        offsets: (n, 2) (row, column) of the cells under each foot; starts: (headings, feet + 1) where they begin.
        triples: (t, 3) feet.
        spans: half widths of the body's disc; blocks: (b, 2) (row, column) where the blocks that cover it start.
        limits: the rise above the contact plane is wanted between these, cells.
        mean: a foot stands on the mean of its cells, not on the highest.
        any_three: judge every three feet, also where another foot would sink into the ground.
        tilt, rise: (R, C) filled with the worst tangent of the tilt and the worst rise, NaN where a foot is unknown.
    """
    rows, cols = ground.shape
    pad = (body.shape[0] - rows) // 2
    headings, feet = xy.shape[0], xy.shape[1]
    for r in prange(rows):
        touch = np.empty((feet, cols), np.float32)
        here, plane = np.empty(4, np.float64), np.empty(3, np.float64)
        tilt[r, :] = np.float32(0.0)
        rise[r, :] = np.float32(-np.inf)
        for k in range(headings):
            for f in range(feet):
                _touch_row(ground, r, offsets, starts[k, f], starts[k, f + 1], mean, touch[f])
            for c in range(cols):
                if skip[r, c] or math.isnan(tilt[r, c]):
                    continue
                sure = True
                for f in range(feet):
                    sure = sure and touch[f, c] < np.inf
                if not sure:
                    tilt[r, c] = rise[r, c] = math.nan
                    continue
                for i in range(4):
                    here[i] = own[i, r, c]
                for t in range(triples.shape[0]):
                    _plane_of(touch, c, solve[k, t], triples[t], plane)
                    if any_three or _rests(touch, c, xy[k], plane):
                        tilt[r, c] = max(tilt[r, c], math.hypot(plane[1], plane[2]))
                        if rise[r, c] <= limits[1]:
                            e = _belly(body, tops, pad, r, c, spans, blocks, here, plane, limits)
                            rise[r, c] = max(rise[r, c], e)
        for c in range(cols):
            if skip[r, c]:
                tilt[r, c] = rise[r, c] = math.nan


@kernel
def _clear_over(along: F64, profile: F64, slope: float) -> tuple[float, float]:
    """Lowest height over s = 0 of a rail of a given slope that stays on or above its profile, and where it touches."""
    top, at = -math.inf, 0.0
    for i in range(along.size):
        level = profile[i] - slope * along[i]
        if level > top:
            top, at = level, along[i]
    return top, at


@kernel
def _end_of_level(along: F64, left: F64, right: F64, level: float, value: float, lever: float) -> float:
    """Pitch where the level bottom of the height over the middle ends, sought from a tangent outside of it."""
    pitch = 0.0
    for _ in range(2 * along.size):
        pitch = (value - level) / lever
        over_l, at_l = _clear_over(along, left, pitch)
        over_r, at_r = _clear_over(along, right, pitch)
        if over_l + over_r <= level + HAIR or at_l + at_r == 0.0:
            break
        lever = at_l + at_r
        value = over_l + over_r + pitch * lever
    return pitch


@kernel
def resting_pitch(along: F64, left: F64, right: F64) -> tuple[float, float]:
    """Rest both rails on their profiles at a common pitch (G5): return the range of pitches at which it lies lowest.

    The height over the middle, f_l + f_r, is convex and piecewise linear in the pitch, with the gradient -(s_l + s_r)
    where the rails touch. Tangents from both sides are crossed until their crossing lies on it. Where the rails touch
    at mirrored places it is level: the lander rocks there, and the range has a width.

    Args:
        along: (n,) ascending positions s with at least one < 0 and one > 0.
        left, right: (n,) ground heights there.
    """
    n = along.size
    low_value, low_lever = left[n - 1] + right[n - 1], 2.0 * along[n - 1]
    high_value, high_lever = left[0] + right[0], 2.0 * along[0]
    pitch = 0.0
    for _ in range(4 * n):
        pitch = (low_value - high_value) / (low_lever - high_lever)
        over_l, at_l = _clear_over(along, left, pitch)
        over_r, at_r = _clear_over(along, right, pitch)
        level, lever = over_l + over_r, at_l + at_r
        if level <= low_value - pitch * low_lever + HAIR:
            break
        if abs(lever) < HAIR:
            return (
                _end_of_level(along, left, right, level, low_value, low_lever),
                _end_of_level(along, left, right, level, high_value, high_lever),
            )
        if lever > 0.0:
            low_value, low_lever = level + pitch * lever, lever
        else:
            high_value, high_lever = level + pitch * lever, lever
    return pitch, pitch


@kernel
def _profile(ground: F32, r: int, c: int, offsets: I64, out: F64) -> bool:
    """Read a rail's profile; False if any cell is unknown or off the map."""
    rows, cols = ground.shape
    for i in range(out.size):
        q, p = r + offsets[i, 0], c + offsets[i, 1]
        if q < 0 or q >= rows or p < 0 or p >= cols or not ground[q, p] < np.inf:
            return False
        out[i] = ground[q, p]
    return True


@parallel_kernel
def skid_contact(
    ground: F32,
    body: F32,
    tops: F32,
    skip: B,
    own: F32,
    axes: F64,
    offsets: I64,
    along: F64,
    gauge: float,
    spans: I64,
    blocks: I64,
    limits: tuple[float, float],
    tilt: F32,
    rise: F32,
) -> None:
    """Judge a lander that rests on two skids, over every heading (G5).

    Args:
        ground, body, tops, skip, own, spans, blocks, limits, tilt, rise: as in `feet_contact`.
        axes: (headings, 2) unit (column, row) of the forward direction.
        offsets: (headings, 2, n, 2) (row, column) of the cells under the left and the right rail.
        along: (n,) position of those cells along the rail, cells.
        gauge: distance between the rails, cells.
    """
    rows, cols = ground.shape
    pad = (body.shape[0] - rows) // 2
    n = along.size
    for r in prange(rows):
        left, right = np.empty(n, np.float64), np.empty(n, np.float64)
        here, plane = np.empty(4, np.float64), np.empty(3, np.float64)
        for c in range(cols):
            tilt[r, c] = rise[r, c] = math.nan
            if skip[r, c]:
                continue
            for i in range(4):
                here[i] = own[i, r, c]
            worst_tilt, worst_rise = 0.0, -math.inf
            known = True
            for k in range(axes.shape[0]):
                known = _profile(ground, r, c, offsets[k, 0], left) and _profile(ground, r, c, offsets[k, 1], right)
                if not known:
                    break
                low, high = resting_pitch(along, left, right)
                ax, ay = axes[k, 0], axes[k, 1]
                worst_roll = worst_pitch = 0.0
                for side in range(1 if low == high else 2):
                    pitch = low if side == 0 else high
                    over_l, over_r = _clear_over(along, left, pitch)[0], _clear_over(along, right, pitch)[0]
                    roll = (over_l - over_r) / gauge  # rise towards the left
                    worst_roll, worst_pitch = max(worst_roll, abs(roll)), max(worst_pitch, abs(pitch))
                    if worst_rise <= limits[1]:  # left of forward (ax, ay) in (column, row) is (ay, -ax)
                        plane[0] = 0.5 * (over_l + over_r)
                        plane[1], plane[2] = pitch * ax + roll * ay, pitch * ay - roll * ax
                        e = _belly(body, tops, pad, r, c, spans, blocks, here, plane, limits)
                        worst_rise = max(worst_rise, e)
                worst_tilt = max(worst_tilt, math.hypot(worst_roll, worst_pitch))
            if known:
                tilt[r, c], rise[r, c] = worst_tilt, worst_rise
