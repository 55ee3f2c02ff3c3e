"""Projection of the world grid into an image: homography of the ground, parallax, lens, rolling rows (eqs. 1 to 4b)."""

import numpy as np

from alight.arrays import F32, F64, HALF, ONE, TWO, ZERO
from alight.compiled import kernel, parallel_kernel, pixelwise, prange

NEAR = np.float32(1e-3)  # metres, least depth in front of the camera
ROLLS = 3  # iterations for the pixel row: each reduces the error to a tenth or less
OUTSIDE = np.float32(-1e4)  # pixel of a cell that a camera cannot see; `remap` fills the border value there


@kernel
def _ideal_row(p: F32, step: F32, b: F32, h: F32, x: F32, y: F32, z: F32) -> None:
    for c in range(h.size):
        k = np.float32(c)
        z[c] = p[2] + k * step[2] + h[c] * b[2]
        inverse = ONE / z[c]
        x[c], y[c] = (p[0] + k * step[0] + h[c] * b[0]) * inverse, (p[1] + k * step[1] + h[c] * b[1]) * inverse


@kernel
def _roll_row(r: F32, height: np.float32, mapy: F32, ideal: F32, x: F32, y: F32) -> None:
    """Write to `x`, `y` the `ideal` coordinates after the camera's motion until row `mapy` was exposed (eq. 4b)."""
    for c in range(x.size):
        u, v, inverse = ideal[0, c], ideal[1, c], ONE / ideal[2, c]
        t = (mapy[c] + HALF) / height - HALF
        t = t if (t > -ONE) & (t < ONE) else ZERO
        way, quadratic = t * inverse, t * t - np.float32(1 / 12)
        wx, wy, wz = t * r[3] + quadratic * r[6], t * r[4] + quadratic * r[7], t * r[5] + quadratic * r[8]
        scale = ONE / (ONE - r[2] * way - wx * v + wy * u)
        x[c], y[c] = (u - r[0] * way - wy + wz * v) * scale, (v - r[1] * way - wz * u + wx) * scale


@pixelwise
def _pixel(lens: F32, x: np.float32, y: np.float32, seen: bool) -> tuple[np.float32, np.float32]:
    """Return column and row of distorted coordinates (x, y); `OUTSIDE` if not in the picture or not `seen`."""
    u, v = lens[0] * x + lens[2], lens[1] * y + lens[3]
    ok = seen & (u >= ZERO) & (u <= lens[4]) & (v >= ZERO) & (v <= lens[5])
    return u if ok else OUTSIDE, v if ok else OUTSIDE


@kernel
def _pinhole_row(x: F32, y: F32, z: F32, r2_max: np.float32, lens: F32, mapx: F32, mapy: F32) -> None:
    for c in range(x.size):
        seen = (z[c] > NEAR) & (x[c] * x[c] + y[c] * y[c] < r2_max)
        mapx[c], mapy[c] = _pixel(lens, x[c], y[c], seen)


@kernel
def _radtan_row(x: F32, y: F32, z: F32, r2_max: np.float32, lens: F32, k: F32, mapx: F32, mapy: F32) -> None:
    k1, k2, p1, p2, k3 = k[0], k[1], k[2], k[3], k[4]
    for c in range(x.size):
        xx, yy, xy2 = x[c] * x[c], y[c] * y[c], TWO * x[c] * y[c]
        r2 = xx + yy
        s = ONE + r2 * (k1 + r2 * (k2 + r2 * k3))
        u, v = x[c] * s + p1 * xy2 + p2 * (r2 + TWO * xx), y[c] * s + p1 * (r2 + TWO * yy) + p2 * xy2
        mapx[c], mapy[c] = _pixel(lens, u, v, (z[c] > NEAR) & (r2 < r2_max))


@kernel
def _equidistant_row(x: F32, y: F32, z: F32, r2_max: np.float32, lens: F32, k: F32, mapx: F32, mapy: F32) -> None:
    for c in range(x.size):
        r2 = x[c] * x[c] + y[c] * y[c]
        r = max(np.sqrt(r2), np.float32(1e-9))
        t = np.arctan(r)
        t2 = t * t
        s = t * (ONE + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3])))) / r
        mapx[c], mapy[c] = _pixel(lens, x[c] * s, y[c] * s, (z[c] > NEAR) & (r2 < r2_max))


@kernel
def _lens_row(model: int, x: F32, y: F32, z: F32, r2_max: np.float32, lens: F32, k: F32, mapx: F32, mapy: F32) -> None:
    if model == 1:
        _radtan_row(x, y, z, r2_max, lens, k, mapx, mapy)
    elif model == 2:
        _equidistant_row(x, y, z, r2_max, lens, k, mapx, mapy)
    else:
        _pinhole_row(x, y, z, r2_max, lens, mapx, mapy)


@kernel
def project_row(
    p: F32, step: F32, b: F32, lens: F32, k: F32, model: int, r2_max: np.float32, height: np.float32, roll: F32,
    h: F32, ideal: F32, mapx: F32, mapy: F32,
) -> None:  # fmt: skip
    """Write the pixel columns `mapx` and rows `mapy` of a row of cells at heights `h` (C,), metres (eqs. 1 to 4b).

    Args:
        p, step: (3,) homogeneous coordinates of the first cell at height 0, and their increment from cell to cell.
        b: (3,) increment of the homogeneous coordinates per metre of height.
        lens: fu, fv, cu, cv, last column and row.
        k: (5,) distortion of the `model`.
        r2_max: limit of the squared ideal radius.
        height: number of rows of the picture.
        roll: (9,) motion of the camera during the exposure as in `rolling_of`, or (0,) without rolling shutter.
        ideal: (5, C) scratch.
    """
    x, y, z = ideal[0], ideal[1], ideal[2]
    _ideal_row(p, step, b, h, x, y, z)
    _lens_row(model, x, y, z, r2_max, lens, k, mapx, mapy)
    for _ in range(ROLLS if roll.size else 0):
        _roll_row(roll, height, mapy, ideal, ideal[3], ideal[4])
        _lens_row(model, ideal[3], ideal[4], z, r2_max, lens, k, mapx, mapy)


@parallel_kernel
def project_grid(
    H: F64,
    b: F64,
    intrinsics: F64,
    k: F64,
    model: int,
    r2_max: float,
    width: int,
    height: int,
    rolling: F64,
    xs: F64,
    ys: F64,
    h: F32,
    mapx: F32,
    mapy: F32,
) -> None:
    """Write the pixel column `mapx` and row `mapy` (R, C) of each cell (xs[c], ys[r]) at height h[r, c] (eqs. 1 to 4b).

    Args:
        H, b: (3, 3), (3,) ground homography and image of the vertical (eq. 2).
        intrinsics: fu, fv, cu, cv.
        k, model: (5,) distortion, and code of its model.
        r2_max: limit of the squared ideal radius.
        width, height: size of the picture, px.
        rolling: (9,) motion of the camera as in `rolling_of`, or (0,) without rolling shutter.
    """
    # short loops without branches are 8 times faster than one loop. The start of a row is computed in double precision,
    # its cells in single precision: an error of 0.0001 px in 1000 px
    rows, cols = h.shape
    b32, k32, limit = b.astype(np.float32), k.astype(np.float32), np.float32(r2_max)
    lens = np.array([intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3], width - 1.0, height - 1.0], np.float32)
    roll = rolling.astype(np.float32)
    for r in prange(rows):
        p, step = np.empty(3, np.float32), np.empty(3, np.float32)
        for j in range(3):
            p[j] = H[j, 0] * xs[0] + H[j, 1] * ys[r] + H[j, 2]
            step[j] = H[j, 0] * (xs[-1] - xs[0]) / max(cols - 1, 1)
        ideal = np.empty((5, cols), np.float32)
        project_row(p, step, b32, lens, k32, model, limit, np.float32(height), roll, h[r], ideal, mapx[r], mapy[r])
