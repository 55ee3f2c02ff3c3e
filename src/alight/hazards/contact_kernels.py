"""Compiled loops that rest a lander's feet or skids on the ground (docs/method/hazards.md)."""

import numpy as np

from alight.arrays import F32, F64, I64, Mask
from alight.compiled import kernel, parallel_kernel, prange
from alight.hazards.belly_kernels import gather, keep, may_rise, raise_to, search

HAIR = 1e-5  # cells, tolerance: two equally high diagonals both carry


@kernel
def _add_to(total: F32, line: F32) -> None:
    for c in range(total.size):
        total[c] += line[c]


@kernel
def _touch_row(ground: F32, r: int, offsets: I64, first: int, last: int, mean: bool, out: F32) -> None:
    """Fill `out` (C,) with the height at which a foot rests at each cell of row `r`; +inf over unknown ground.

    `offsets[first:last]` are the cells under the foot. It rests on their mean if `mean`, else on the highest cell.
    """
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
            raise_to(out[lo:hi], ground[q, lo + dc : hi + dc])
        out[:lo] = np.float32(np.inf)
        out[hi:] = np.float32(np.inf)
    if mean:
        out /= np.float32(last - first)


@kernel
def _planes_of(first: F64, second: F64, third: F64, solve: F64, level: F64, across: F64, along: F64) -> None:
    """Compute planes (`level`, `across`, `along`) through three heights per cell, by the matrix `solve` (3, 3)."""
    for c in range(level.size):
        a, b, d = first[c], second[c], third[c]
        level[c] = solve[0, 0] * a + solve[0, 1] * b + solve[0, 2] * d
        across[c] = solve[1, 0] * a + solve[1, 1] * b + solve[1, 2] * d
        along[c] = solve[2, 0] * a + solve[2, 1] * b + solve[2, 2] * d


@kernel
def _raise_above(over: F64, touch: F64, level: F64, across: F64, along: F64, x: float, y: float) -> None:
    """Raise `over` (C,) to `touch` minus the plane at (x, y), the rise of a foot's ground above the contact plane."""
    for c in range(over.size):
        e = touch[c] - (level[c] + x * across[c] + y * along[c])
        t = over[c]
        over[c] = e if e > t else t


@kernel
def _steepen(steep: F64, over: F64, across: F64, along: F64) -> None:
    """Raise `steep` to each plane's squared slope, if larger; skip planes below the ground of a foot (`over` > 0)."""
    for c in range(steep.size):
        g = across[c] * across[c] + along[c] * along[c]
        t = steep[c]
        steep[c] = g if over[c] <= HAIR and g > t else t


@kernel
def _unless(may: F64, over: F64) -> None:
    """Set `may` to -inf for planes below the ground of a foot (`over` > 0), so that `search` skips them."""
    for c in range(may.size):
        may[c] = may[c] if over[c] <= HAIR else -np.inf


@parallel_kernel
def feet_contact(
    ground: F32,
    body: F32,
    tops: F32,
    skip: Mask,
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
    """Compute the worst tilt and rise of a lander on feet, over all headings and triples of feet that carry it (G4).

    Heights are in *cells* (height divided by cell size), so that gradients are tangents.

    Args:
        ground: (R, C) heights, +inf where unknown.
        body: (R + 2 pad, C + 2 pad) heights, -inf where unknown and off the map.
        tops: like `body`, maximum of the BLOCK x BLOCK cells that start at each cell.
        skip: (R, C) bool, cells that are not judged.
        own: (4, R, C) the footprint's plane (level, per column, per row) and the highest ground above it.
        xy: (headings, feet, 2) offset (column, row) of each foot's centre, cells.
        solve: (headings, t, 3, 3) matrices from the heights of three feet to their plane (level, per column, per row).
        offsets: (n, 2) (row, column) offsets of the cells under all feet.
        starts: (headings, feet + 1) first index of each foot's cells in `offsets`.
        triples: (t, 3) indices of three feet.
        spans: half widths of the body's disc.
        blocks: (b, 2) (row, column) offsets of the blocks that cover the disc.
        limits: lowest and highest rise, cells, between which the rise above the contact plane must be exact.
        mean: whether a foot rests on the mean of its cells; False: on the highest cell.
        any_three: whether triples are judged even if another foot would sink into the ground.
        tilt, rise: (R, C) filled with the worst tangent of the tilt and the worst rise; NaN where a foot is unknown.
    """
    rows, cols = ground.shape
    headings, feet = xy.shape[0], xy.shape[1]
    for r in prange(rows):
        under = np.empty(cols, np.float32)
        touch, here = np.empty((feet, cols), np.float64), np.empty((4, cols), np.float64)
        level, across, along = np.empty(cols), np.empty(cols), np.empty(cols)
        over, may, steep, highest = np.empty(cols), np.empty(cols), np.zeros(cols), np.zeros(cols, np.float32)
        gather(own, r, skip, here)
        rise[r, :] = np.float32(limits[0])
        for k in range(headings):
            for f in range(feet):
                _touch_row(ground, r, offsets, starts[k, f], starts[k, f + 1], mean, under)
                touch[f] = under
                raise_to(highest, under)
            for t in range(triples.shape[0]):
                i, j, m = triples[t]
                _planes_of(touch[i], touch[j], touch[m], solve[k, t], level, across, along)
                over[:] = -np.inf
                if not any_three:
                    for f in range(feet):
                        _raise_above(over, touch[f], level, across, along, xy[k, f, 0], xy[k, f, 1])
                _steepen(steep, over, across, along)
                may_rise(here, level, across, along, np.float64(spans.size // 2), rise[r], may)
                _unless(may, over)
                search(body, tops, r, spans, blocks, limits[1], may, level, across, along, rise[r])
        keep(skip[r], highest, steep, tilt[r], rise[r])


@kernel
def _rail(ground: F32, r: int, offsets: I64, base: F32, profile: F32) -> None:
    """Fill `profile` (n, C) with the ground under n points of a rail in row `r`, minus `base`; +inf where unknown."""
    rows, cols = ground.shape
    for i in range(profile.shape[0]):
        q, dc = r + offsets[i, 0], offsets[i, 1]
        lo, hi = max(0, -dc), min(cols, cols - dc)
        profile[i] = np.float32(np.inf)
        if 0 <= q < rows and lo < hi:
            _less(ground[q, lo + dc : hi + dc], base[lo:hi], profile[i, lo:hi])


@kernel
def _less(values: F32, base: F32, out: F32) -> None:
    for c in range(out.size):
        out[c] = values[c] - base[c]


@kernel
def _raise_to_sums(top: F32, left: F32, right: F32, other_left: F32, other_right: F32) -> None:
    """Raise `top` to the larger of `left + right` and `other_left + other_right`, cell by cell."""
    for c in range(top.size):
        e, d, t = left[c] + right[c], other_left[c] + other_right[c], top[c]
        e = e if e > d else d
        top[c] = e if e > t else t


@kernel
def _raise_to_lines(top: F32, behind: F32, ahead: F32, further: F32, i: int, j: int) -> None:
    """Raise `top` to the height at 0 of the lines from `behind` (at -i) to `ahead` (at j) and `further` (at j + 1)."""
    near, far = np.float32(j / (i + j)), np.float32(i / (i + j))
    near_too, far_too = np.float32((j + 1) / (i + j + 1)), np.float32(i / (i + j + 1))
    for c in range(top.size):
        v, t = behind[c], top[c]
        e, d = near * v + far * ahead[c], near_too * v + far_too * further[c]
        e = e if e > d else d
        top[c] = e if e > t else t


@kernel
def _narrow(low: F32, high: F32, behind: F32, ahead: F32, rest: F32, lever: F32) -> None:
    """Narrow [low, high] to pitches that keep `behind` (at -1 / lever) and `ahead` (at 1 / lever) below `rest`."""
    for c in range(rest.size):
        least, most = (ahead[c] - rest[c]) * lever, (rest[c] - behind[c]) * lever
        a, b = low[c], high[c]
        low[c] = least if least > a else a
        high[c] = most if most < b else b


@kernel
def resting_pitches(left: F32, right: F32, apart: float, joint: F32, rest: F32, low: F32, high: F32) -> None:
    """Rest both rails on their profiles at a common pitch (G5), cell by cell.

    `joint(t)` is the highest sum of two heights, one per rail, at positions that add up to `t`. At a given pitch, twice
    the height over the middle is the highest `joint(t) - pitch t`. The lander rests at the pitch with the smallest
    height. If a range of pitches gives this height, the lander rocks within the range.

    Args:
        left, right: (n, C) ground heights at n (odd) evenly spaced positions of the rails, +inf where unknown.
        apart: distance between these positions.
        joint: (2 n - 1, C) work space.
        rest: (C,) filled with twice the smallest height over the middle; +inf where any ground is unknown.
        low, high: (C,) filled with the range of pitches at that height.
    """
    n = left.shape[0]
    joint[:] = np.float32(-np.inf)
    for k in range(2 * n - 1):
        end = min(k, n - 1)
        for i in range(max(0, k - n + 1), end + 1, 2):
            j = min(i + 1, end)
            _raise_to_sums(joint[k], left[i], right[k - i], left[j], right[k - j])
    rest[:] = joint[n - 1]
    for i in range(1, n):
        for j in range(1, n, 2):
            _raise_to_lines(rest, joint[n - 1 - i], joint[n - 1 + j], joint[n + j], i, j)
    low[:] = np.float32(-np.inf)
    high[:] = np.float32(np.inf)
    for i in range(1, n):
        _narrow(low, high, joint[n - 1 - i], joint[n - 1 + i], rest, np.float32(1.0 / (i * apart)))
    for c in range(rest.size):  # equal pitches may differ by rounding
        a, b = low[c], high[c]
        high[c] = b if b > a else a


@kernel
def _raise_to_sloped(top: F32, line: F32, pitch: F32, s: F32) -> None:
    """Raise `top` to `line - s * pitch`, the height of the rail's middle if it rests on `line` at position `s`."""
    for c in range(top.size):
        e, t = line[c] - s * pitch[c], top[c]
        top[c] = e if e > t else t


@kernel
def _plane_on(
    left: F32,
    right: F32,
    along: F64,
    gauge: F32,
    axis: F64,
    base: F32,
    pitch: F32,
    over: F32,
    roll: F32,
    plane: F32,
) -> None:
    """Fill `roll` (C,) and `plane` (3, C) (level, per column, per row) for rails that rest at `pitch` (C,).

    `left`, `right`: ground under the rails minus `base`; `over`: work space; see `skid_contact` for the rails.
    """
    over[:] = np.float32(-np.inf)
    roll[:] = np.float32(-np.inf)  # the right rail's height, until both are known
    for i in range(along.size):
        _raise_to_sloped(over, left[i], pitch, np.float32(along[i]))
        _raise_to_sloped(roll, right[i], pitch, np.float32(along[i]))
    ax, ay = np.float32(axis[0]), np.float32(axis[1])  # left of forward (ax, ay) in (column, row) is (ay, -ax)
    for c in range(over.size):
        mean, across = np.float32(0.5) * (over[c] + roll[c]), (over[c] - roll[c]) / gauge  # rises towards the left
        roll[c] = across
        plane[0, c] = base[c] + mean
        plane[1, c] = pitch[c] * ax + across * ay
        plane[2, c] = pitch[c] * ay - across * ax


@kernel
def _steepen_both(steep: F32, pitch: F32, roll: F32) -> None:
    """Raise `steep` (C,) to the sum of squares of the largest |pitch| and the largest |roll|; both are (2, C)."""
    for c in range(steep.size):
        a, b = max(abs(pitch[0, c]), abs(pitch[1, c])), max(abs(roll[0, c]), abs(roll[1, c]))
        g, t = a * a + b * b, steep[c]
        steep[c] = g if g > t else t


@parallel_kernel
def skid_contact(
    ground: F32,
    body: F32,
    tops: F32,
    skip: Mask,
    own: F32,
    axes: F64,
    offsets: I64,
    along: F64,
    gauge: F64,
    spans: I64,
    blocks: I64,
    limits: tuple[float, float],
    tilt: F32,
    rise: F32,
) -> None:
    """Compute the worst tilt and rise of a lander on two skids, over all headings (G5).

    Args:
        ground, body, tops, skip, own, spans, blocks, limits, tilt, rise: see `feet_contact`.
        axes: (headings, 2) forward unit vector (column, row).
        offsets: (headings, 2, n, 2) (row, column) offsets of the cells under the left and the right rail.
        along: (headings, n) evenly spaced positions of these cells along the rail, cells.
        gauge: (headings,) distance between the rails, cells.
    """
    rows, cols = ground.shape
    n, reach = along.shape[1], np.float32(spans.size // 2)
    for r in prange(rows):
        left, right, joint = (
            np.empty((n, cols), np.float32),
            np.empty((n, cols), np.float32),
            np.empty((2 * n - 1, cols), np.float32),
        )
        here, plane = np.empty((4, cols), np.float32), np.empty((3, cols), np.float32)
        roll, pitch = np.empty((2, cols), np.float32), np.empty((2, cols), np.float32)
        rest, may = np.empty(cols, np.float32), np.empty(cols, np.float32)
        steep, highest = np.zeros(cols, np.float32), np.zeros(cols, np.float32)
        gather(own, r, skip, here)
        rise[r, :] = np.float32(limits[0])
        for k in range(axes.shape[0]):
            _rail(ground, r, offsets[k, 0], here[0], left)
            _rail(ground, r, offsets[k, 1], here[0], right)
            resting_pitches(left, right, along[k, 1] - along[k, 0], joint, rest, pitch[0], pitch[1])
            raise_to(highest, rest)
            for side in range(2):
                apart = np.float32(gauge[k])
                _plane_on(left, right, along[k], apart, axes[k], here[0], pitch[side], rest, roll[side], plane)
                may_rise(here, plane[0], plane[1], plane[2], reach, rise[r], may)
                search(body, tops, r, spans, blocks, limits[1], may, plane[0], plane[1], plane[2], rise[r])
            _steepen_both(steep, pitch, roll)
        keep(skip[r], highest, steep, tilt[r], rise[r])
