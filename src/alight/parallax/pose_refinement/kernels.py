"""Normal equations of poses, map plane, heights and template together (docs/method/recursive.md, eqs. 17 to 20)."""

import numpy as np

from alight.arrays import F32, F64, I64
from alight.compiled import kernel, parallel_kernel, prange

PLANE, POSE = 3, 6  # unknowns of the map's plane, which come first, and of an exposure


@kernel
def _take_out(sums: F64, by_first: float, by_second: float, out: F64) -> None:
    for i in range(sums.shape[1]):
        s, t = sums[0, i] * by_first, sums[1, i] * by_second
        if (s != 0.0) | (t != 0.0):
            for j in range(i, sums.shape[1]):
                out[i, j] -= s * sums[0, j] + t * sums[1, j]


@kernel
def _view(
    point: F64, gradient: F64, i: int, k: int, centres: F64, pivots: F64, w: float, e: float, row: F64,
    sums: F64, A: F64, b: F64,
) -> float:  # fmt: skip
    """Add view `i` of exposure `k` at one cell to `A`, `b` and to the `sums` of w J and w q J (eq. 18); return q."""
    # single elements instead of slices, because a slice takes longer than the sums
    gx, gy, at = gradient[0], gradient[1], PLANE + POSE * k
    q = (gx * (point[0] - centres[i, 0]) + gy * (point[1] - centres[i, 1])) / (centres[i, 2] - point[2])
    dx, dy, dz = point[0] - pivots[k, 0], point[1] - pivots[k, 1], point[2] - pivots[k, 2]
    row[0], row[1], row[2] = gx, gy, q
    row[3], row[4], row[5] = dy * q - dz * gy, dz * gx - dx * q, dx * gy - dy * gx
    for x in range(POSE):
        wr = w * row[x]
        sums[0, at + x] += wr
        sums[1, at + x] += wr * q
        b[at + x] += wr * e
        for y in range(x, POSE):
            A[at + x, at + y] += wr * row[y]
    return float(q)


@kernel
def _cell(
    point: F64, phi: F64, gradient: F64, s: F32, weights: F32, mean: float, owner: I64, centres: F64, pivots: F64,
    precision: F64, kappa: float, sums: F64, row: F64, A: F64, b: F64,
) -> None:  # fmt: skip
    # one cell, with its template value and height eliminated (eqs. 19, 20)
    sw, sq, sqq, se, sqe = 0.0, 0.0, 0.0, 0.0, 0.0
    sums[:] = 0.0
    for i in range(s.size):
        if weights[i] > 0.0:
            w, e = weights[i] * precision[i], s[i] - mean
            q = _view(point, gradient, i, owner[i], centres, pivots, w, e, row, sums, A, b)
            sw += w
            sq += w * q
            sqq += w * q * q
            se += w * e
            sqe += w * q * e
    if sw <= 0.0:
        return
    lam, eta = sqq - sq * sq / sw, sq * se / sw - sqe  # eqs. 9, 10
    share = 1.0 / (lam + kappa)
    for x in range(b.size):
        sums[1, x] = sq / sw * sums[0, x] - sums[1, x]
        b[x] -= sums[0, x] * se / sw + sums[1, x] * eta * share
    _take_out(sums, 1.0 / sw, share, A)
    for x in range(PLANE):
        held = phi[x] * kappa * share
        b[x] += held * eta
        for y in range(PLANE, b.size):
            A[x, y] += held * sums[1, y]
        for y in range(x, PLANE):
            A[x, y] += held * lam * phi[y]


@parallel_kernel
def joint_normal_equations(
    samples: F32, weights: F32, mean: F32, owner: I64, centres: F64, pivots: F64, precision: F64,
    xs: F64, ys: F64, h: F32, about: F64, arm: float, kappa: F32, A: F64, b: F64,
) -> None:  # fmt: skip
    """Write the upper triangle of the normal equations of the map's plane and the poses, one system per row of cells.

    Args:
        samples, weights: (N, R, C) samples of the views at the cells, and their weights.
        mean: (5, R, C) template at the cells and `arm` metres east, west, north and south of them.
        owner: (N,) index of the exposure of each view.
        centres: (N, 3) camera centres, metres.
        pivots: (E, 3) positions about which the exposures turn, metres.
        precision: (N,) inverse variance of each view's samples.
        xs, ys, h: (C,), (R,), (R, C) east, north and height of the cells, metres.
        about: (2,) point at which the plane's offset is defined, metres.
        kappa: (R, C) inverse variance of a height relative to the map's plane.
        A, b: (R, 3 + 6E, 3 + 6E), (R, 3 + 6E) out.
    """
    n, rows, cols = samples.shape
    east, west, north, south = mean[1], mean[2], mean[3], mean[4]
    for r in prange(rows):
        A[r], b[r] = 0.0, 0.0
        sums, row = np.empty((2, b.shape[1])), np.empty(POSE)
        point, phi, gradient = np.empty(3), np.ones(PLANE), np.empty(2)
        s, w = np.empty(n, np.float32), np.empty(n, np.float32)
        for c in range(cols):
            point[0], point[1], point[2] = xs[c], ys[r], np.float64(h[r, c])
            phi[1], phi[2] = xs[c] - about[0], ys[r] - about[1]
            gradient[0] = (np.float64(east[r, c]) - np.float64(west[r, c])) * (0.5 / arm)
            gradient[1] = (np.float64(north[r, c]) - np.float64(south[r, c])) * (0.5 / arm)
            if np.isfinite(gradient[0] + gradient[1] + mean[0, r, c]):
                for i in range(n):
                    s[i], w[i] = samples[i, r, c], weights[i, r, c]
                _cell(
                    point, phi, gradient, s, w, np.float64(mean[0, r, c]), owner, centres, pivots, precision,
                    np.float64(kappa[r, c]), sums, row, A[r], b[r],
                )  # fmt: skip
