"""Normal equations of poses, heights and template together (docs/method.md, eqs. 17 to 20)."""

import numpy as np
from numpy.typing import NDArray

from alight.kernels.compiler import kernel, parallel_kernel, prange

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

EAST, WEST, NORTH, SOUTH = 1, 2, 3, 4  # arms of the cross of samples; 0 is the cell itself


@kernel
def _row_of(g: F64, d: F64, out: F64) -> None:
    """Derivative of a sample by the position and the rotation of its exposure (eq. 18): (g, d x g)."""
    out[0], out[1], out[2] = g[0], g[1], g[2]
    out[3] = d[1] * g[2] - d[2] * g[1]
    out[4] = d[2] * g[0] - d[0] * g[2]
    out[5] = d[0] * g[1] - d[1] * g[0]


@kernel
def _outer(a: F64, scale: float, out: F64) -> None:
    for i in range(a.size):
        s = a[i] * scale
        if s != 0.0:
            for j in range(a.size):
                out[i, j] += s * a[j]


@kernel
def _cell(
    point: F64, gradient: F64, samples: F32, weights: F32, mean: float, owner: I64, centres: F64, pivots: F64,
    precision: F64, loose: float, sums: F64, row: F64, A: F64, b: F64, tie: F64, level: F64,
) -> None:  # fmt: skip
    """Add one cell: its template value and its height are eliminated."""
    sw, sq, sqq, se, sqe = 0.0, 0.0, 0.0, 0.0, 0.0
    sums[:] = 0.0
    g, d = np.empty(3), np.empty(3)
    for i in range(samples.size):
        if not weights[i] > 0.0:
            continue
        w, e, k = weights[i] * precision[i], samples[i] - mean, owner[i]
        drop = centres[i, 2] - point[2]
        g[0], g[1] = gradient[0], gradient[1]
        q = (g[0] * (point[0] - centres[i, 0]) + g[1] * (point[1] - centres[i, 1])) / drop
        g[2] = q
        for x in range(3):
            d[x] = point[x] - pivots[k, x]
        _row_of(g, d, row)
        at = 6 * k
        for x in range(6):
            wr = w * row[x]
            sums[0, at + x] += wr
            sums[1, at + x] += wr * q
            b[at + x] += wr * e
            for y in range(6):
                A[at + x, at + y] += wr * row[y]
        sw += w
        sq += w * q
        sqq += w * q * q
        se += w * e
        sqe += w * q * e
    if sw <= 0.0:
        return
    own = sqq - sq * sq / sw  # Lambda of eq. 9
    eta = sq * se / sw - sqe
    share = 1.0 / (own + loose)
    for x in range(b.size):
        sums[1, x] = sq / sw * sums[0, x] - sums[1, x]
        b[x] -= sums[0, x] * se / sw + sums[1, x] * eta * share
    _outer(sums[0], -1.0 / sw, A)
    _outer(sums[1], -share, A)
    phi = d  # (1, east, north) of the cell
    phi[0], phi[1], phi[2] = 1.0, point[0], point[1]
    for x in range(3):
        for y in range(b.size):
            tie[x, y] -= phi[x] * sums[1, y]
        for y in range(3):
            level[x, y] += phi[x] * phi[y] * own
        level[x, 3] += phi[x] * eta


@parallel_kernel
def normal_equations(
    samples: F32, weights: F32, mean: F32, owner: I64, centres: F64, pivots: F64, precision: F64,
    xs: F64, ys: F64, h: F32, arm: float, loose: F32, A: F64, b: F64, tie: F64, level: F64,
) -> None:  # fmt: skip
    """Fill, row by row of cells, the normal equations of the exposures' poses (eq. 19) and the plane's ties (eq. 22).

    Args:
        samples, weights: (N, R, C) of the views at the cells.
        mean: (5, R, C) template at the cells and `arm` metres east, west, north and south of them.
        owner: (N,) exposure of each view.
        centres: (N, 3) of the cameras; pivots: (E, 3) about which exposures turn.
        precision: (N,) one over each view's variance.
        xs, ys, h: where the cells are, relative to any origin that `centres` and `pivots` share.
        loose: (R, C) one over the variance of the heights' own prior.
        A, b: (R, 6E, 6E), (R, 6E); tie: (R, 3, 6E); level: (R, 3, 4). All are overwritten.
    """
    n, rows, cols = samples.shape
    for r in prange(rows):
        A[r], b[r], tie[r], level[r] = 0.0, 0.0, 0.0, 0.0
        sums, row = np.empty((2, b.shape[1])), np.empty(6)
        point, gradient = np.empty(3), np.empty(2)
        s, w = np.empty(n, np.float32), np.empty(n, np.float32)
        for c in range(cols):
            point[0], point[1], point[2] = xs[c], ys[r], np.float64(h[r, c])
            gradient[0] = (np.float64(mean[EAST, r, c]) - np.float64(mean[WEST, r, c])) * (0.5 / arm)
            gradient[1] = (np.float64(mean[NORTH, r, c]) - np.float64(mean[SOUTH, r, c])) * (0.5 / arm)
            if not np.isfinite(gradient[0] + gradient[1] + mean[0, r, c]):
                continue
            s[:] = samples[:, r, c]
            w[:] = weights[:, r, c]
            _cell(
                point, gradient, s, w, np.float64(mean[0, r, c]), owner, centres, pivots, precision,
                np.float64(loose[r, c]), sums, row, A[r], b[r], tie[r], level[r],
            )  # fmt: skip
