"""Compiled loops that rest a lander's feet or skids on the ground (docs/method-ground.md, section 2)."""

import math

import numpy as np
from numpy.typing import NDArray

from alight.kernels.compiler import kernel, parallel_kernel, prange

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
B = NDArray[np.bool_]


@kernel
def _contact(height: F32, r: int, c: int, offsets: I64, first: int, last: int) -> float:
    """Highest ground under one foot; NaN if any cell of it is unknown or off the map."""
    rows, cols = height.shape
    top = -math.inf
    for i in range(first, last):
        q, p = r + offsets[i, 0], c + offsets[i, 1]
        if q < 0 or q >= rows or p < 0 or p >= cols or math.isnan(height[q, p]):
            return math.nan
        top = max(top, height[q, p])
    return top


@kernel
def _rise(height: F32, r: int, c: int, spans: I64, a: float, gx: float, gy: float, spare: float) -> float:
    """Largest rise of known ground in the disc above a plane; the first one above `spare` found ends the search."""
    rows, cols = height.shape
    reach = spans.size // 2
    top = -math.inf
    for i in range(spans.size):
        q = r + i - reach
        if q < 0 or q >= rows:
            continue
        row_level = a + gy * (i - reach)
        for p in range(max(0, c - spans[i]), min(cols, c + spans[i] + 1)):
            e = height[q, p] - row_level - gx * (p - c)
            top = e if e > top else top
        if top > spare:
            break
    return top


@kernel
def _belly(height: F32, r: int, c: int, spans: I64, plane: F64, a: float, gx: float, gy: float, spare: float) -> float:
    """Rise of the ground above a contact plane, or a bound below -`spare` where that settles it without a search.

    The ground lies within `plane[3]` of the footprint's own plane (level, x, y); the two planes part by no more than
    their difference at the centre plus that of their gradients times the reach.
    """
    reach = spans.size // 2
    bound: float = plane[3] + (plane[0] - a) + math.hypot(plane[1] - gx, plane[2] - gy) * reach
    if bound < spare:
        return bound
    rise: float = _rise(height, r, c, spans, a, gx, gy, spare)
    return rise


@parallel_kernel
def feet_contact(
    height: F32,
    skip: B,
    level: F32,
    grad_c: F32,
    grad_r: F32,
    largest: F32,
    xy: F64,
    offsets: I64,
    starts: I64,
    triples: I64,
    spans: I64,
    spare: float,
    tilt: F32,
    rise: F32,
) -> None:
    """Judge a lander that rests on feet, over every heading and every three of its feet (G4).

    Args:
        height: (R, C) metres in *cells* (height over cell size), so that gradients are tangents.
        skip: (R, C) bool, cells not judged.
        level, grad_c, grad_r, largest: the footprint's plane and its largest deviation, in cells.
        xy: (headings, feet, 2) offset (column, row) of each foot's centre, cells.
        offsets: (n, 2) (row, column) of the cells under each foot; starts: (headings, feet + 1) where they begin.
        triples: (t, 3) feet.
        spans: half widths of the body's disc.
        spare: rise above the contact plane that the belly allows, cells; the rise only says on which side of it.
        tilt, rise: (R, C) filled with the worst tangent of the tilt and the worst rise, NaN where a foot is unknown.
    """
    rows, cols = height.shape
    headings, feet = xy.shape[0], xy.shape[1]
    for r in prange(rows):
        touch = np.empty(feet, np.float64)
        plane = np.empty(4, np.float64)
        for c in range(cols):
            tilt[r, c] = rise[r, c] = math.nan
            if skip[r, c]:
                continue
            plane[0], plane[1], plane[2], plane[3] = level[r, c], grad_c[r, c], grad_r[r, c], largest[r, c]
            worst_tilt, worst_rise = 0.0, -math.inf
            for k in range(headings):
                for f in range(feet):
                    touch[f] = _contact(height, r, c, offsets, starts[k, f], starts[k, f + 1])
                for t in range(triples.shape[0]):
                    i, j, m = triples[t, 0], triples[t, 1], triples[t, 2]
                    ux, uy = xy[k, j, 0] - xy[k, i, 0], xy[k, j, 1] - xy[k, i, 1]
                    vx, vy = xy[k, m, 0] - xy[k, i, 0], xy[k, m, 1] - xy[k, i, 1]
                    u, v = touch[j] - touch[i], touch[m] - touch[i]
                    det = ux * vy - uy * vx
                    gx, gy = (u * vy - v * uy) / det, (v * ux - u * vx) / det
                    a = touch[i] - gx * xy[k, i, 0] - gy * xy[k, i, 1]
                    worst_tilt = max(worst_tilt, math.hypot(gx, gy)) if a == a else math.nan
                    if a == a and worst_rise <= spare < math.inf:
                        worst_rise = max(worst_rise, _belly(height, r, c, spans, plane, a, gx, gy, spare))
                    if worst_tilt != worst_tilt:
                        break
                if worst_tilt != worst_tilt:
                    break
            tilt[r, c] = worst_tilt
            rise[r, c] = worst_rise if worst_tilt == worst_tilt else math.nan


@kernel
def rail_support(along: F64, profile: F64) -> tuple[float, float]:
    """Rest one rail on its profile (G5): return (height over s = 0, slope) of the line that it settles on.

    Args:
        along: (n,) ascending positions s with at least one <= 0 and one >= 0.
        profile: (n,) ground heights there.

    The line minimises its height over s = 0 while it stays on or above the profile: the edge of the upper convex hull
    over the middle. The pair that spans it is found by hopping from one end to the other until neither moves.
    """
    n = along.size
    left, right = 0, n - 1
    for _ in range(2 * n):
        new_right, best = right, -math.inf
        for j in range(n):  # from the left end, the steepest line to the other side
            if along[j] >= 0.0 and along[j] > along[left]:
                g = (profile[j] - profile[left]) / (along[j] - along[left])
                if g > best:
                    best, new_right = g, j
        new_left, best = left, math.inf
        for i in range(n):  # from the right end, the line that falls off least to the other side
            if along[i] <= 0.0 and along[i] < along[new_right]:
                g = (profile[new_right] - profile[i]) / (along[new_right] - along[i])
                if g < best:
                    best, new_left = g, i
        if new_left == left and new_right == right:
            break
        left, right = new_left, new_right
    slope = (profile[right] - profile[left]) / (along[right] - along[left])
    return profile[left] - slope * along[left], slope


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
def _pitch_range(along: F64, left: F64, right: F64, low: float, high: float) -> tuple[float, float]:
    """Halve the range of the common pitch of both rails until it is a milliradian wide (G5).

    The height over the middle, f_l + f_r, is convex in the pitch with the gradient -(s_l + s_r) where the rails touch.
    Where they touch at mirrored places it is level: the lander rocks there, and the whole range counts.
    """
    while high - low > 1e-3:
        pitch = 0.5 * (low + high)
        touch = _clear_over(along, left, pitch)[1] + _clear_over(along, right, pitch)[1]
        if touch == 0.0:
            break
        if touch > 0.0:
            low = pitch
        else:
            high = pitch
    return low, high


@kernel
def _profile(height: F32, r: int, c: int, offsets: I64, first: int, out: F64) -> bool:
    """Read a rail's profile; False if any cell is unknown or off the map."""
    rows, cols = height.shape
    for i in range(out.size):
        q, p = r + offsets[first + i, 0], c + offsets[first + i, 1]
        if q < 0 or q >= rows or p < 0 or p >= cols or math.isnan(height[q, p]):
            return False
        out[i] = height[q, p]
    return True


@parallel_kernel
def skid_contact(
    height: F32,
    skip: B,
    level: F32,
    grad_c: F32,
    grad_r: F32,
    largest: F32,
    axes: F64,
    offsets: I64,
    along: F64,
    gauge: float,
    spans: I64,
    spare: float,
    tilt: F32,
    rise: F32,
) -> None:
    """Judge a lander that rests on two skids, over every heading (G5).

    Args:
        height, skip, level, grad_c, grad_r, largest, spans, spare, tilt, rise: as in `feet_contact`.
        axes: (headings, 2) unit (column, row) of the forward direction.
        offsets: (headings, 2, n, 2) (row, column) of the cells under the left and the right rail.
        along: (n,) position of those cells along the rail, cells.
        gauge: distance between the rails, cells.
    """
    rows, cols = height.shape
    n = along.size
    for r in prange(rows):
        left = np.empty(n, np.float64)
        right = np.empty(n, np.float64)
        plane = np.empty(4, np.float64)
        for c in range(cols):
            tilt[r, c] = rise[r, c] = math.nan
            if skip[r, c]:
                continue
            plane[0], plane[1], plane[2], plane[3] = level[r, c], grad_c[r, c], grad_r[r, c], largest[r, c]
            worst_tilt, worst_rise = 0.0, -math.inf
            known = True
            for k in range(axes.shape[0]):
                known = _profile(height, r, c, offsets[k, 0], 0, left) and _profile(
                    height, r, c, offsets[k, 1], 0, right
                )
                if not known:
                    break
                pitch_l = rail_support(along, left)[1]
                pitch_r = rail_support(along, right)[1]
                low, high = _pitch_range(along, left, right, min(pitch_l, pitch_r), max(pitch_l, pitch_r))
                ax, ay = axes[k, 0], axes[k, 1]
                worst_roll = worst_pitch = 0.0
                for side in range(2):
                    pitch = low if side == 0 else high
                    over_l, over_r = _clear_over(along, left, pitch)[0], _clear_over(along, right, pitch)[0]
                    roll = (over_l - over_r) / gauge  # rise towards the left
                    worst_roll, worst_pitch = max(worst_roll, abs(roll)), max(worst_pitch, abs(pitch))
                    if worst_rise <= spare < math.inf:  # left of forward (ax, ay) in (column, row) is (ay, -ax)
                        gx, gy = pitch * ax + roll * ay, pitch * ay - roll * ax
                        a = 0.5 * (over_l + over_r)
                        worst_rise = max(worst_rise, _belly(height, r, c, spans, plane, a, gx, gy, spare))
                worst_tilt = max(worst_tilt, math.hypot(worst_roll, worst_pitch))
            if known:
                tilt[r, c], rise[r, c] = worst_tilt, worst_rise
