"""Loops of the plane sweep: robust cost of a height, semi-global aggregation, winner (docs/method/parallax.md, 6-7)."""

import numpy as np

from alight.arrays import F32, F64, FAR, I32, I64
from alight.compiled import inline, kernel, minimum_kernel, parallel_kernel, prange
from alight.parallax.gauss_newton_kernels import BAND
from alight.parallax.sorting_kernels import fill_row, sort_rows

Four = tuple[np.float32, np.float32, np.float32, np.float32]

NEAR = 8  # cells: runs closer than this are computed as one


@kernel
def _middle_row(one: F32, other: F32, median: F32) -> None:
    half = np.float32(0.5)
    for c in range(median.size):
        median[c] = half * one[c] + half * other[c]


@kernel
def _deviate_row(row: F32, median: F32, truncation: np.float32) -> None:
    for c in range(row.size):
        d = abs(row[c] - median[c])
        row[c] = d if d < truncation else truncation


@kernel
def _add_row(row: F32, total: F32) -> None:
    for c in range(row.size):
        total[c] += row[c]


@kernel
def _slide_row(leaves: F32, enters: F32, total: F32, least: F32) -> None:
    for c in range(total.size):
        t = total[c] + (enters[c] - leaves[c])
        total[c] = t
        least[c] = t if t < least[c] else least[c]


@kernel
def _times(row: F32, factor: np.float32, out: F32) -> None:
    for c in range(row.size):
        out[c] = factor * row[c]


@kernel
def _cost_row(
    views: F32, a: int, z: int, seen: int, keep: float, truncation: np.float32, scratch: F32, cost: F32
) -> None:  # fmt: skip
    """Write the cost (eq. 6) of cells `a` to `z` - 1, each seen by `seen` views, from sorted samples `views` (N, C).

    `views` is overwritten; `keep` and `truncation` are as in `sweep_cost`.
    """
    # the samples nearest to the median are adjacent when sorted, so their sum is the smallest of a few window sums
    if seen < 2:
        cost[:] = truncation
        return
    median, total, least = scratch[0, a:z], scratch[1, a:z], scratch[2, a:z]
    _middle_row(views[(seen - 1) // 2, a:z], views[seen // 2, a:z], median)
    for i in range(seen):
        _deviate_row(views[i, a:z], median, truncation)
    m = max(2, int(np.ceil(np.float32(keep) * np.float32(seen))))
    total[:] = views[0, a:z]
    for i in range(1, m):
        _add_row(views[i, a:z], total)
    least[:] = total
    for i in range(m, seen):
        _slide_row(views[i - m, a:z], views[i, a:z], total, least)
    # two views: |s - median| is half their difference, N views approach the mean deviation: same scale for all
    _times(least, np.float32(np.sqrt(seen / (seen - 1.0)) / m), cost)


@inline
def _taps(t: float) -> Four:
    """Return the Catmull-Rom weights of four pixels, at a share `t` of the way from the second to the third."""
    # linear weights would blur samples between pixels, so that planes with such shifts would win
    return (
        np.float32(t * (-0.5 + t * (1.0 - 0.5 * t))),
        np.float32(1.0 + t * t * (1.5 * t - 2.5)),
        np.float32(t * (0.5 + t * (2.0 - 1.5 * t))),
        np.float32(t * t * (0.5 * t - 0.5)),
    )


@kernel
def _between(rows: F32, taps: Four, out: F32) -> None:
    a, b, c, d = rows[0], rows[1], rows[2], rows[3]
    for k in range(out.size):
        out[k] = taps[0] * a[k] + taps[1] * b[k] + taps[2] * c[k] + taps[3] * d[k]


@kernel
def _weigh_row(row: F32, first: F32, second: F32, third: F32, fourth: F32, out: F32) -> None:
    for c in range(out.size):
        a, b = first[c] * row[c], second[c] * row[c + 1]
        out[c] = a + b + third[c] * row[c + 2] + fourth[c] * row[c + 3]


@kernel
def _along(row: F32, first: I32, until: I32, taps: F32, start: int, out: F32) -> None:
    """Interpolate a row at the columns from `start` on, by the first pixels and weights from `_columns`."""
    # in runs of adjacent pixels: a gather takes ten times as long
    c, stop = start, start + out.size
    while c < stop:
        end, k = min(int(until[c]), stop), int(first[c])
        near, part = row[k : k + end - c + 3], out[c - start : end - start]
        _weigh_row(near, taps[0, c:end], taps[1, c:end], taps[2, c:end], taps[3, c:end], part)
        c = end


@kernel
def _columns(scale: float, shift: float, size: int, first: I32, until: I32, taps: F32) -> None:
    """Write the first of the four pixels around `scale` c + `shift` for each column c, and their weights (4, C).

    Weights are NaN outside a row of `size` pixels. `until` is the end of the run of columns with adjacent first pixels.
    """
    cols = first.size
    for c in range(cols):
        x = scale * c + shift
        k = np.floor(x)
        inside = (k >= 1.0) & (k + 2.0 < size)
        first[c] = np.int32(min(max(k - 1.0, 0.0), size - 4.0))
        taps[0, c], taps[1, c], taps[2, c], taps[3, c] = _taps(x - k if inside else np.nan)
    until[cols - 1] = cols
    for c in range(cols - 2, -1, -1):
        until[c] = until[c + 1] if first[c + 1] == first[c] + 1 else c + 1


@kernel
def _next_run(low: I32, high: I32, plane: int, start: int) -> tuple[int, int]:
    """Return start and stop of the next run of cells whose span contains `plane`; runs near each other are joined."""
    cols = low.size
    while start < cols and not low[start] <= plane <= high[start]:
        start += 1
    stop, c = start, start
    while c < cols and c - stop < NEAR:
        if low[c] <= plane <= high[c]:
            stop = c + 1
        c += 1
    return start, stop


@parallel_kernel
def sweep_cost(
    pictures: F32, scale: F64, shift: F64, pairs: I64, keep: float, truncation: float,
    low: I32, high: I32, plane: int, cost: F32, count: I32,
) -> None:  # fmt: skip
    """Write the matching cost of a plane (eq. 6) to `cost` (R, C), and the number of views to `count` (R, C).

    The cost is the mean deviation of the samples from their median. The samples that deviate most are left out, because
    occluded and moving views are among them. Cells whose span does not contain the plane may keep their old cost.

    Args:
        pictures: (N, P, Q) views registered on a plane.
        scale, shift: (N,), (N, 2). Cell (r, c) lies in picture i at row `scale[i] r + shift[i, 0]` and at column
            `scale[i] c + shift[i, 1]`.
        pairs: sorting network of N values.
        keep: share of the samples that is used.
        truncation: upper limit of a deviation.
        low, high: (R, C) first and last plane of each cell.
    """
    n, height, width = pictures.shape
    rows, cols = cost.shape
    first, until = np.empty((n, cols), np.int32), np.empty((n, cols), np.int32)
    taps = np.empty((n, 4, cols), np.float32)
    for i in range(n):
        _columns(scale[i], shift[i, 1], width, first[i], until[i], taps[i])
    for band in prange((rows + BAND - 1) // BAND):
        held, row = np.empty((n + 5) * cols, np.float32), np.empty(width, np.float32)
        for r in range(band * BAND, min(rows, band * BAND + BAND)):
            start, stop = _next_run(low[r], high[r], plane, 0)
            while start < stop:
                m = stop - start
                views, rest = held[: n * m].reshape((n, m)), held[n * m : (n + 5) * m].reshape((5, m))
                seen, samples, scratch = rest[0], rest[1], rest[2:]
                seen[:] = np.float32(0)
                for i in range(n):
                    y = scale[i] * r + shift[i, 0]
                    k = int(np.floor(y))
                    if 1 <= k < height - 2:
                        left, right = int(first[i, start]), int(first[i, stop - 1]) + 4
                        _between(pictures[i, k - 1 : k + 3, left:right], _taps(y - k), row[left:right])
                        _along(row, first[i], until[i], taps[i], start, samples)
                    else:
                        samples[:] = np.float32(np.nan)
                    fill_row(samples, views[i], seen)
                sort_rows(views, pairs)
                a = 0
                while a < m:
                    z = a + 1
                    while z < m and seen[z] == seen[a]:
                        z += 1
                    number = int(seen[a])
                    count[r, start + a : start + z] = number
                    values = cost[r, start + a : start + z]
                    _cost_row(views, a, z, number, keep, np.float32(truncation), scratch, values)
                    a = z
                start, stop = _next_run(low[r], high[r], plane, stop)


@parallel_kernel
def store(values: F32, plane: int, low: I32, high: I32, first: I64, cost: F32) -> None:
    """Write the 3 x 3 means of a plane's `values` (R, C) to the volume `cost`, for cells whose span contains the plane.

    The costs of cell (r, c) begin at `cost[first[r, c]]`, one for each plane from `low[r, c]` to `high[r, c]`.
    """
    rows, cols = values.shape
    ninth = np.float32(1.0 / 9.0)
    for r in prange(rows):
        up, down = r - 1 if r > 0 else min(1, rows - 1), r + 1 if r < rows - 1 else max(rows - 2, 0)
        for c in range(cols):
            if low[r, c] <= plane <= high[r, c]:
                a, b = c - 1 if c > 0 else min(1, cols - 1), c + 1 if c < cols - 1 else max(cols - 2, 0)
                above = values[up, a] + values[up, c] + values[up, b]
                beside = values[r, a] + values[r, c] + values[r, b]
                below = values[down, a] + values[down, c] + values[down, b]
                cost[first[r, c] + plane - low[r, c]] = ninth * (above + beside + below)


@minimum_kernel
def _lowest(values: F32) -> float:
    low: float = values[0]
    for v in values:
        low = min(low, v)
    return low


@kernel
def _extend(cost: F32, before: F32, best: np.float32, jump: np.float32, p1: np.float32, out: F32, total: F32) -> None:
    """Write the path costs of planes near those of the previous cell to `out`, and add them to `total`.

    `before` are the costs at the previous cell, from one plane below to one above; `best` is the lowest of all its
    costs. `jump` is `best` plus the penalty for a larger change, `p1` is the penalty for a change by one plane.
    """
    depth = cost.size
    same, down, up = before[1 : depth + 1], before[:depth], before[2 : depth + 2]
    for d in range(depth):
        m = same[d] if same[d] < jump else jump
        a, b = down[d] + p1, up[d] + p1
        m = a if a < m else m
        m = b if b < m else m
        v = cost[d] + m - best
        out[d] = v
        total[d] += v


@kernel
def _begin(cost: F32, more: np.float32, out: F32, total: F32) -> None:
    """Write the path costs of planes that the previous cell does not have, `cost` + `more`; add them to `total`."""
    for d in range(cost.size):
        v = cost[d] + more
        out[d] = v
        total[d] += v


@kernel
def _path(
    cost: F32, low: I32, high: I32, first: I64, image: F32, p1: float, p2: float, edge: float, dr: int, dc: int,
    total: F32,
) -> None:  # fmt: skip
    """Add the path costs in one direction (`dr`, `dc`) of semi-global matching (Hirschmueller 2008) to `total`."""
    rows, cols = image.shape
    depth = 1
    for r in range(rows):
        for c in range(cols):
            depth = max(depth, high[r, c] - low[r, c] + 1)
    paths = np.full((2, cols, depth + 4), FAR, np.float32)  # two planes of `FAR` at both ends of a cell's own
    best = np.empty((2, cols), np.float32)
    one = np.float32(1)
    r0, r1, rs = (0, rows, 1) if dr >= 0 else (rows - 1, -1, -1)
    c0, c1, cs = (0, cols, 1) if (dc > 0 or (dc == 0 and dr >= 0)) else (cols - 1, -1, -1)
    for r in range(r0, r1, rs):
        now = r & 1
        for c in range(c0, c1, cs):
            pr, pc = r - dr, c - dc
            n = high[r, c] - low[r, c] + 1
            own, sums, path = cost[first[r, c] :][:n], total[first[r, c] :][:n], paths[now, c]
            if pr < 0 or pr >= rows or pc < 0 or pc >= cols:
                _begin(own, np.float32(0), path[2 : n + 2], sums)
            else:
                was = pr & 1
                shift = low[r, c] - low[pr, pc]
                a = min(max(0, -1 - shift), n)
                b = max(min(n, high[pr, pc] - low[pr, pc] + 2 - shift), a)
                least = best[was, pc]
                jump = least + np.float32(p2) / (one + np.float32(edge) * abs(image[r, c] - image[pr, pc]))
                _begin(own[:a], jump - least, path[2 : a + 2], sums[:a])
                before = paths[was, pc][a + shift + 1 : b + shift + 3]
                _extend(own[a:b], before, least, jump, np.float32(p1), path[a + 2 : b + 2], sums[a:b])
                _begin(own[b:], jump - least, path[b + 2 : n + 2], sums[b:])
            path[n + 2] = path[n + 3] = FAR
            best[now, c] = _lowest(path[2 : n + 2])


@parallel_kernel
def aggregate(
    cost: F32, low: I32, high: I32, first: I64, image: F32, p1: float, p2: float, edge: float, halves: F32
) -> None:
    """Write the costs aggregated along eight scanline directions (eq. 7), as two halves (2, V) whose sum is the result.

    Args:
        cost: (V,) cost volume; `low`, `high` and `first` are as in `store`.
        image: (R, C) picture of the reference view.
        p1, p2: penalties for a change by one plane, and by more planes.
        edge: `p2` is divided by 1 + `edge` times the difference of grey between two cells.
    """
    # one half holds the directions down the rows and to the right, the other the opposite ones: two threads always
    # compute the same sums
    for k in prange(2):
        halves[k] = 0.0
        sign = 1 - 2 * k
        _path(cost, low, high, first, image, p1, p2, edge, 0, sign, halves[k])
        for dc in range(-1, 2):
            _path(cost, low, high, first, image, p1, p2, edge, sign, dc, halves[k])


@parallel_kernel
def winner(total: F32, cost: F32, low: I32, high: I32, first: I64, count: I32, height: F32, ratio: F32) -> None:
    """Write the best plane of each cell to `height` (R, C), and its best over second-best cost to `ratio` (R, C).

    The plane has the lowest aggregated cost `total`; it is a fractional index, refined by a parabola. The ratio is that
    of the costs `cost`. Both results are NaN where `count`, the number of views, is below two.
    """
    rows, cols = count.shape
    for r in prange(rows):
        for c in range(cols):
            height[r, c] = np.nan
            ratio[r, c] = np.nan
            if count[r, c] < 2:
                continue
            depth = high[r, c] - low[r, c] + 1
            sums, own = total[first[r, c] :][:depth], cost[first[r, c] :][:depth]
            k = 0
            for d in range(1, depth):
                if sums[d] < sums[k]:
                    k = d
            offset = 0.0
            if 0 < k < depth - 1:
                a, m, z = sums[k - 1], sums[k], sums[k + 1]
                bend = a - 2.0 * m + z
                if bend > 1e-9:
                    offset = min(0.5, max(-0.5, 0.5 * (a - z) / bend))
            height[r, c] = low[r, c] + k + offset
            second = np.float32(0.0)  # cost of the best other local minimum; the worst cost if there is none
            for d in range(depth):
                second = max(second, own[d])
            for d in range(depth):
                v = own[d]
                valley = (d == 0 or own[d - 1] >= v) and (d + 1 == depth or own[d + 1] >= v)
                if abs(d - k) > 2 and valley:
                    second = min(second, v)
            least = own[k]
            for d in range(max(0, k - 1), min(depth, k + 2)):
                least = min(least, own[d])
            ratio[r, c] = least / max(second, np.float32(1e-6))


@kernel
def splat(found: F32, ratio: F32, ground: float, cell: float, place: F64, height: F32, which: F32) -> None:
    """Move heights along their rays to the cells below them; of several in a cell, the highest is kept.

    Args:
        found, ratio: heights on the rays, metres, NaN = none, and their cost ratios.
        ground: height at which the rays are `cell` metres apart.
        place: (5,) metres, from the first cell of `height`: east and north of ray (0, 0) at height `ground`, east and
            north of the camera centre; then the height of the camera centre.
        height, which: in and out, heights of the cells, metres, NaN = none, and their cost ratios.
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
