"""Loops of the plane sweep: robust cost of a height, semi-global aggregation, winner (docs/method/parallax.md, 6-7)."""

import numpy as np

from alight.arrays import F32, F64, I32, I64, U8
from alight.compiled import inline, kernel, minimum_kernel, parallel_kernel, prange
from alight.parallax.sorting_kernels import NOTHING, fill_row, median_row, sort_rows

Four = tuple[np.float32, np.float32, np.float32, np.float32]

FAR = np.float32(1e9)  # cost beyond the first and last plane
BAND = 16  # rows a thread takes at once


@kernel
def _deviate_row(row: F32, median: F32) -> None:
    for c in range(row.size):
        s = row[c]
        row[c] = abs(s - median[c]) if s < NOTHING else NOTHING


@kernel
def _quota_row(count: F32, keep: np.float32, out: F32) -> None:
    two = np.float32(2)
    for c in range(count.size):
        k = np.ceil(keep * count[c])
        out[c] = k if k > two else two


@kernel
def _add_row(row: F32, index: np.float32, quota: F32, truncation: np.float32, total: F32) -> None:
    for c in range(row.size):
        d = row[c] if row[c] < truncation else truncation
        total[c] += d if index < quota[c] else np.float32(0)


@kernel
def _cost_row(total: F32, quota: F32, seen: F32, truncation: np.float32, cost: F32, count: I32) -> None:
    # two views: |s - median| is half their difference, N views approach the mean deviation: same scale for all
    one = np.float32(1)
    for c in range(total.size):
        k = seen[c]
        many = k if k > one else np.float32(2)
        value = total[c] / quota[c] * np.sqrt(many / (many - one))
        cost[c] = value if k > one else truncation
        count[c] = np.int32(k)


@inline
def _taps(t: float) -> Four:
    """Weights of four neighbours at a share `t` of the way from the second to the third (Catmull-Rom).

    Linear ones blur half-way samples, so that planes of such shifts win.
    """
    return (
        np.float32(t * (-0.5 + t * (1.0 - 0.5 * t))),
        np.float32(1.0 + t * t * (1.5 * t - 2.5)),
        np.float32(t * (0.5 + t * (2.0 - 1.5 * t))),
        np.float32(t * t * (0.5 * t - 0.5)),
    )


@kernel
def _between(rows: F32, taps: Four, out: F32) -> None:
    """The weighted sum of four rows (4, C)."""
    a, b, c, d = rows[0], rows[1], rows[2], rows[3]
    for k in range(out.size):
        out[k] = taps[0] * a[k] + taps[1] * b[k] + taps[2] * c[k] + taps[3] * d[k]


@kernel
def _along(row: F32, first: I32, taps: F32, out: F32) -> None:
    for c in range(out.size):
        k = first[c]
        out[c] = taps[0, c] * row[k] + taps[1, c] * row[k + 1] + taps[2, c] * row[k + 2] + taps[3, c] * row[k + 3]


@kernel
def _columns(scale: float, shift: float, size: int, first: I32, taps: F32) -> None:
    """The first of the four pixels about each column in a row of `size`, and their weights; NaN outside."""
    for c in range(first.size):
        x = scale * c + shift
        k = np.floor(x)
        inside = (k >= 1.0) & (k + 2.0 < size)
        first[c] = np.int32(k - 1.0) if inside else np.int32(0)
        taps[0, c], taps[1, c], taps[2, c], taps[3, c] = _taps(x - k if inside else np.nan)


@parallel_kernel
def sweep_cost(
    pictures: F32, scale: F64, shift: F64, pairs: I64, keep: float, truncation: float, cost: F32, count: I32
) -> None:
    """Fill `cost` (R, C) with the mean of the smallest `keep` share of |s_i - median| (eq. 6), `count` with the views.

    `pictures` (N, P, Q) are registered on a plane; cell (r, c) lies at row `scale[i] r + shift[i, 0]` and column
    `scale[i] c + shift[i, 1]` of picture i. Occluded and moving views are the largest deviations; leaving them out is
    what keeps walls upright. `pairs`: the sorting network of N.
    """
    n, height, width = pictures.shape
    rows, cols = cost.shape
    first, taps = np.empty((n, cols), np.int32), np.empty((n, 4, cols), np.float32)
    for i in range(n):
        _columns(scale[i], shift[i, 1], width, first[i], taps[i])
    for band in prange((rows + BAND - 1) // BAND):
        views, samples = np.empty((n, cols), np.float32), np.empty(cols, np.float32)
        rest, row = np.empty((4, cols), np.float32), np.empty(width, np.float32)
        seen, median, quota, total = rest[0], rest[1], rest[2], rest[3]
        for r in range(band * BAND, min(rows, band * BAND + BAND)):
            seen[:] = total[:] = np.float32(0)
            for i in range(n):
                y = scale[i] * r + shift[i, 0]
                k = int(np.floor(y))
                if 1 <= k < height - 2:
                    _between(pictures[i, k - 1 : k + 3], _taps(y - k), row)
                    _along(row, first[i], taps[i], samples)
                else:
                    samples[:] = np.float32(np.nan)
                fill_row(samples, views[i], seen)
            sort_rows(views, pairs)
            median_row(views, seen, median)
            for i in range(n):
                _deviate_row(views[i], median)
            sort_rows(views, pairs)
            _quota_row(seen, np.float32(keep), quota)
            for i in range(n):
                _add_row(views[i], np.float32(i), quota, np.float32(truncation), total)
            _cost_row(total, quota, seen, np.float32(truncation), cost[r], count[r])


@minimum_kernel
def _lowest(values: F32) -> float:
    low: float = values[0]
    for v in values:
        low = min(low, v)
    return low


@kernel
def _extend(cost: F32, before: F32, best: np.float32, jump: np.float32, p1: np.float32, now: F32, total: F32) -> None:
    """One cell of one path: `before` and `now` have a cell of `FAR` at both ends."""
    depth = cost.size
    same, down, up = before[1 : depth + 1], before[:depth], before[2 : depth + 2]
    out = now[1 : depth + 1]
    for d in range(depth):
        m = same[d] if same[d] < jump else jump
        a, b = down[d] + p1, up[d] + p1
        m = a if a < m else m
        m = b if b < m else m
        v = cost[d] + m - best
        out[d] = v
        total[d] += v


@kernel
def _path(cost: F32, image: F32, p1: float, p2: float, edge: float, dr: int, dc: int, total: F32) -> None:
    """Add one direction of semi-global matching (Hirschmueller 2008, eq. 13) over `cost` (R, C, D) to `total`."""
    rows, cols, depth = cost.shape
    paths = np.full((2, cols, depth + 2), FAR, np.float32)
    best = np.empty((2, cols), np.float32)
    one = np.float32(1)
    r0, r1, rs = (0, rows, 1) if dr >= 0 else (rows - 1, -1, -1)
    c0, c1, cs = (0, cols, 1) if (dc > 0 or (dc == 0 and dr >= 0)) else (cols - 1, -1, -1)
    for r in range(r0, r1, rs):
        now = r & 1
        for c in range(c0, c1, cs):
            pr, pc = r - dr, c - dc
            if pr < 0 or pr >= rows or pc < 0 or pc >= cols:
                for d in range(depth):
                    paths[now, c, d + 1] = cost[r, c, d]
                    total[r, c, d] += cost[r, c, d]
            else:
                was = pr & 1
                low = best[was, pc]
                jump = low + np.float32(p2) / (one + np.float32(edge) * abs(image[r, c] - image[pr, pc]))
                _extend(cost[r, c], paths[was, pc], low, jump, np.float32(p1), paths[now, c], total[r, c])
            best[now, c] = _lowest(paths[now, c, 1 : depth + 1])


@parallel_kernel
def aggregate(cost: F32, image: F32, p1: float, p2: float, edge: float, halves: F32) -> None:
    """Fill `halves` (2, R, C, D), whose sum is that of eight scanline optimisations of `cost` (R, C, D) (eq. 7).

    One half holds the directions that go down the rows, the other those that go up: two threads, always the same sums.
    """
    for k in prange(2):
        halves[k] = 0.0
        sign = 1 - 2 * k
        _path(cost, image, p1, p2, edge, 0, sign, halves[k])
        for dc in range(-1, 2):
            _path(cost, image, p1, p2, edge, sign, dc, halves[k])


@parallel_kernel
def winner(total: F32, cost: F32, count: U8, height: F32, ratio: F32) -> None:
    """Per cell: the best plane with sub-plane parabola (as a fractional index) and best/second cost; NaN if unseen."""
    rows, cols, depth = total.shape
    for r in prange(rows):
        for c in range(cols):
            height[r, c] = np.nan
            ratio[r, c] = np.nan
            if count[r, c] < 2:
                continue
            k = 0
            for d in range(1, depth):
                if total[r, c, d] < total[r, c, k]:
                    k = d
            offset = 0.0
            if 0 < k < depth - 1:
                a, m, z = total[r, c, k - 1], total[r, c, k], total[r, c, k + 1]
                bend = a - 2.0 * m + z
                if bend > 1e-9:
                    offset = min(0.5, max(-0.5, 0.5 * (a - z) / bend))
            height[r, c] = k + offset
            second = np.float32(0.0)  # the best other local minimum; without one, the worst cost
            for d in range(depth):
                second = max(second, cost[r, c, d])
            for d in range(depth):
                v = cost[r, c, d]
                valley = (d == 0 or cost[r, c, d - 1] >= v) and (d + 1 == depth or cost[r, c, d + 1] >= v)
                if abs(d - k) > 2 and valley:
                    second = min(second, v)
            low = cost[r, c, k]
            for d in range(max(0, k - 1), min(depth, k + 2)):
                low = min(low, cost[r, c, d])
            ratio[r, c] = low / max(second, np.float32(1e-6))


@kernel
def splat(found: F32, ratio: F32, ground: float, cell: float, place: F64, height: F32, which: F32) -> None:
    """Move heights along their rays to the cells above which they lie; the highest stays, its `ratio` in `which`.

    `place`: of the first ray's cell at `ground`, east and north of the first of `height`, then of the rays' origin, and
    its height, metres.
    """
    rows, cols = found.shape
    reach = np.float32(0.3)  # cells about a point that it covers
    for r in range(rows):
        north = place[1] - r * cell - place[3]
        for c in range(cols):
            z = found[r, c]
            if z != z:
                continue
            s = (place[4] - z) / (place[4] - ground)
            row = -(place[3] + s * north) / cell
            col = (place[2] + s * (place[0] + c * cell - place[2])) / cell
            for i in range(int(np.rint(row - reach)), int(np.rint(row + reach)) + 1):
                for j in range(int(np.rint(col - reach)), int(np.rint(col + reach)) + 1):
                    if 0 <= i < height.shape[0] and 0 <= j < height.shape[1] and not z <= height[i, j]:
                        height[i, j], which[i, j] = z, ratio[r, c]
