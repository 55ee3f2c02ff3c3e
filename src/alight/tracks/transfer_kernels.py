"""Kernels that transfer features from one view to another: pixels, depth and covariance (M1, M1f)."""

import math

import numpy as np

from alight.arrays import F64
from alight.compiled import kernel


@kernel
def _distort(x: float, y: float, model: int, k: F64, out: F64) -> None:
    """Write the distorted coordinates of (x, y); `model`: 0 no distortion, 1 radial-tangential, 2 equidistant."""
    out[0], out[1] = x, y
    if model == 1:
        r2 = x * x + y * y
        s = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
        out[0] = x * s + 2.0 * k[2] * x * y + k[3] * (r2 + 2.0 * x * x)
        out[1] = y * s + k[2] * (r2 + 2.0 * y * y) + 2.0 * k[3] * x * y
    elif model == 2:
        r = math.hypot(x, y)
        if r > 1e-9:
            theta = math.atan(r)
            t2 = theta * theta
            s = theta * (1.0 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3])))) / r
            out[0], out[1] = x * s, y * s


@kernel
def carry_points(
    rays: F64, depth: F64, R: F64, t: F64, lens: F64, model: int, k: F64, points: F64, pixels: F64
) -> None:
    """Write points in the frame of another camera, and their pixels there, NaN for points behind that camera.

    Args:
        rays: (N, 2) normalised coordinates in this camera.
        depth: (N,) depth along the axis of this camera, m.
        R, t: (3, 3), (3,) there_from_here.
        lens: (4,) focal lengths and principal point of the other camera.
        model, k: code and coefficients (5,) of its distortion.
        points: (N, 3) out, m. pixels: (N, 2) out.
    """
    flat = np.empty(2)
    for n in range(len(rays)):
        x, y, z = rays[n, 0] * depth[n], rays[n, 1] * depth[n], depth[n]
        for i in range(3):
            points[n, i] = R[i, 0] * x + R[i, 1] * y + R[i, 2] * z + t[i]
        pixels[n] = np.nan
        if points[n, 2] > 0.0:
            _distort(points[n, 0] / points[n, 2], points[n, 1] / points[n, 2], model, k, flat)
            pixels[n, 0], pixels[n, 1] = lens[0] * flat[0] + lens[2], lens[1] * flat[1] + lens[3]


@kernel
def pixel_covariances(points: F64, by_depth: F64, focal: float, root: F64, out: F64) -> None:
    """Write the (N, 2, 2) covariance of pixels predicted in a view, px^2; the arguments are as in `pixel_covariance`.

    `root` (6, M): root root' is the covariance of the rotation and shift of all points in the camera of that view.
    """
    for n in range(len(points)):
        x, y, z = points[n, 0], points[n, 1], max(points[n, 2], 1e-9)
        w = focal / z
        u, v = w * (by_depth[n, 0] - x / z * by_depth[n, 2]), w * (by_depth[n, 1] - y / z * by_depth[n, 2])
        xx, xy, yy = u * u, u * v, v * v
        for m in range(root.shape[1]):
            a, b, c = root[0, m], root[1, m], root[2, m]
            dx, dy = b * points[n, 2] - c * y + root[3, m], c * x - a * points[n, 2] + root[4, m]
            dz = a * y - b * x + root[5, m]
            u, v = w * (dx - x / z * dz), w * (dy - y / z * dz)
            xx, xy, yy = xx + u * u, xy + u * v, yy + v * v
        out[n, 0, 0], out[n, 0, 1], out[n, 1, 0], out[n, 1, 1] = xx, xy, xy, yy


@kernel
def triangulate_matches(first: F64, other: F64, R: F64, t: F64, inverse_depth: F64, arm: F64) -> None:
    """Write the (N,) inverse depth, 1/m, and `arm`, m, of matches; see `view_transfer.inverse_depth` (M2).

    `first` and `other` (N, 2) are normalised coordinates; `R` (3, 3) and `t` (3,) are other_from_first.
    """
    for n in range(len(first)):
        x, y, u, v = first[n, 0], first[n, 1], other[n, 0], other[n, 1]
        a = R[0, 0] * x + R[0, 1] * y + R[0, 2]
        b = R[1, 0] * x + R[1, 1] * y + R[1, 2]
        c = R[2, 0] * x + R[2, 1] * y + R[2, 2]
        p, q, r = t[1] - t[2] * v, t[2] * u - t[0], t[0] * v - t[1] * u  # t x (u, v, 1)
        square = max(p * p + q * q + r * r, 1e-18) if p == p and q == q else np.nan
        inverse_depth[n] = -((b - c * v) * p + (c * u - a) * q + (a * v - b * u) * r) / square
        arm[n] = math.sqrt(square)


@kernel
def line_distances(first: F64, other: F64, E: F64, out: F64) -> None:
    """Write the (N,) distance of `other` from the epipolar line of `first`, given the essential matrix `E` (M3)."""
    for n in range(len(first)):
        x, y = first[n, 0], first[n, 1]
        a, b = E[0, 0] * x + E[0, 1] * y + E[0, 2], E[1, 0] * x + E[1, 1] * y + E[1, 2]
        c = E[2, 0] * x + E[2, 1] * y + E[2, 2]
        out[n] = abs(a * other[n, 0] + b * other[n, 1] + c) / max(math.hypot(a, b), 1e-12)
