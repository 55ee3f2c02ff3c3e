"""Kernels for one pixel: lens models with derivatives, and the pose at the exposure of a row.

Lens models are those of `Camera.distort`; equation numbers: docs/method/bundle.md.
"""

import math

from alight.arrays import F64
from alight.compiled import pixelwise
from alight.motion.rotation_kernels import exponential, multiply


@pixelwise
def _radial_tangential(x: float, y: float, k: F64, out: F64, by_xy: F64, by_k: F64) -> None:
    """Apply the Brown-Conrady model; see `distort`."""
    r2 = x * x + y * y
    s, slope = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4])), k[0] + r2 * (2.0 * k[1] + 3.0 * r2 * k[4])
    out[0] = x * s + 2.0 * k[2] * x * y + k[3] * (r2 + 2.0 * x * x)
    out[1] = y * s + k[2] * (r2 + 2.0 * y * y) + 2.0 * k[3] * x * y
    by_xy[0, 0] = s + 2.0 * x * x * slope + 2.0 * k[2] * y + 6.0 * k[3] * x
    by_xy[1, 1] = s + 2.0 * y * y * slope + 6.0 * k[2] * y + 2.0 * k[3] * x
    by_xy[0, 1] = by_xy[1, 0] = 2.0 * x * y * slope + 2.0 * k[2] * x + 2.0 * k[3] * y
    by_k[0, 0], by_k[0, 1], by_k[0, 4] = x * r2, x * r2 * r2, x * r2 * r2 * r2
    by_k[1, 0], by_k[1, 1], by_k[1, 4] = y * r2, y * r2 * r2, y * r2 * r2 * r2
    by_k[0, 2], by_k[0, 3] = 2.0 * x * y, r2 + 2.0 * x * x
    by_k[1, 2], by_k[1, 3] = r2 + 2.0 * y * y, 2.0 * x * y


@pixelwise
def _equidistant(x: float, y: float, k: F64, out: F64, by_xy: F64, by_k: F64) -> None:
    """Apply the Kannala-Brandt model; see `distort`."""
    r = math.sqrt(x * x + y * y)
    if r < 1e-9:  # no distortion at the axis
        return
    theta = math.atan(r)
    t2 = theta * theta
    s = theta * (1.0 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3])))) / r
    by_r = (1.0 + t2 * (3.0 * k[0] + t2 * (5.0 * k[1] + t2 * (7.0 * k[2] + t2 * 9.0 * k[3])))) / (1.0 + r * r)
    slope, power = (by_r - s) / (r * r), theta / r
    out[0], out[1] = x * s, y * s
    by_xy[0, 0], by_xy[1, 1] = s + x * x * slope, s + y * y * slope
    by_xy[0, 1] = by_xy[1, 0] = x * y * slope
    for i in range(4):
        power *= t2
        by_k[0, i], by_k[1, i] = x * power, y * power


@pixelwise
def distort(x: float, y: float, model: int, k: F64, out: F64, by_xy: F64, by_k: F64) -> None:
    """Write distorted coordinates and their derivatives.

    Args:
        x, y: ideal coordinates.
        model: 0 no distortion, 1 radial-tangential, 2 equidistant.
        k: (5,) coefficients.
        out: (2,) out: distorted coordinates.
        by_xy: (2, 2) out: derivatives with respect to the ideal coordinates.
        by_k: (2, 5) out: derivatives with respect to the coefficients; 0 for coefficients that the model lacks.
    """
    out[0], out[1] = x, y
    by_xy[0, 0] = by_xy[1, 1] = 1.0
    by_xy[0, 1] = by_xy[1, 0] = 0.0
    by_k[:] = 0.0
    if model == 1:
        _radial_tangential(x, y, k, out, by_xy, by_k)
    elif model == 2:
        _equidistant(x, y, k, out, by_xy, by_k)


@pixelwise
def undistort(u: float, v: float, model: int, k: F64, out: F64, flat: F64, by_xy: F64, by_k: F64) -> None:
    """Write the ideal coordinates `out` (2,) of distorted u, v (Newton's method); the last three arrays are scratch."""
    out[0], out[1] = u, v
    for _ in range(20 if model > 0 else 0):  # usually five suffice
        distort(out[0], out[1], model, k, flat, by_xy, by_k)
        e, f = flat[0] - u, flat[1] - v
        det = by_xy[0, 0] * by_xy[1, 1] - by_xy[0, 1] * by_xy[1, 0]
        det = det if abs(det) > 1e-9 else 1e-9
        a, b = (e * by_xy[1, 1] - f * by_xy[0, 1]) / det, (f * by_xy[0, 0] - e * by_xy[1, 0]) / det
        out[0] -= min(max(a, -0.5), 0.5)  # a longer step may jump over the fold of a lens
        out[1] -= min(max(b, -0.5), 0.5)
        if max(abs(a), abs(b)) < 1e-12:
            break


@pixelwise
def row_time(row: float, of: F64) -> float:
    """Return the exposure time of a pixel row as a share of the readout, -0.5 at the first row, 0.5 at the last row.

    `of` (11,) is a row of the lens table (`adjustment_kernels`).
    """
    t: float = (row + 0.5) / of[9] - 0.5
    return t


@pixelwise
def quadratic(t: float) -> float:
    """Return `t`^2 minus its mean over the readout, the factor of a photo's quadratic rotation; `t`: see `row_time`."""
    return t * t - 1.0 / 12.0


@pixelwise
def expose(R: F64, C: F64, turns: F64, velocity: F64, of: F64, t: float, turn: F64, row_R: F64, row_C: F64) -> None:
    """Write the pose of a camera at the exposure of a row (eq. 10).

    Args:
        R, C: (3, 3), (3,) world_from_cam in the middle of the readout.
        turns: (2, 3) rad, rotation vectors in the camera during the readout, linear and quadratic in time.
        velocity: (3,) m/s.
        of: (11,) row of the lens table.
        t: time of the row, see `row_time`.
        turn: (3, 3) out: rotation from the row's camera to the camera in the middle of the readout.
        row_R, row_C: (3, 3), (3,) out: world_from_cam at the row.
    """
    q = quadratic(t)
    exponential(
        t * turns[0, 0] + q * turns[1, 0], t * turns[0, 1] + q * turns[1, 1], t * turns[0, 2] + q * turns[1, 2], turn
    )
    multiply(R, turn, row_R)
    for i in range(3):
        row_C[i] = C[i] + velocity[i] * of[10] * t
