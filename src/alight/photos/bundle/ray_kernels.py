"""Rays of the observations, and points triangulated from them: kernels. Shapes: `adjustment_kernels`."""

import math

import numpy as np

from alight.arrays import F64, I64
from alight.compiled import kernel, pixelwise
from alight.motion.point_kernels import nearest_point
from alight.photos.bundle.lens_kernels import undistort
from alight.photos.bundle.rolling_kernels import HEIGHT, READOUT, expose, row_time

_NEAR = 1e-6  # m; shorter distances count as this


@kernel
def rays_of_pixels(
    photo: I64, pixels: F64, R: F64, C: F64, turns: F64, velocity: F64, camera: I64, lens: F64, model: I64,
    ray: F64, origin: F64,
) -> None:  # fmt: skip
    """Write the (N, 3) unit rays of pixels in the world, and their (N, 3) origins, metres (eq. 10)."""
    turn, row_R, at = np.empty((3, 3)), np.empty((3, 3)), np.empty(2)
    flat, by_xy, by_k = np.empty(2), np.empty((2, 2)), np.empty((2, 5))
    for n in range(len(photo)):
        i = photo[n]
        of = lens[camera[i]]
        t = row_time(pixels[n, 1], of[HEIGHT])
        expose(R[i], C[i], turns[i], velocity[i], of[READOUT], t, turn, row_R, origin[n])
        u, v = (pixels[n, 0] - of[2]) / of[0], (pixels[n, 1] - of[3]) / of[1]
        undistort(u, v, model[camera[i]], of[4:9], at, flat, by_xy, by_k)
        long = math.sqrt(at[0] * at[0] + at[1] * at[1] + 1.0)
        for j in range(3):
            ray[n, j] = (row_R[j, 0] * at[0] + row_R[j, 1] * at[1] + row_R[j, 2]) / long


@pixelwise
def _reweigh(ray: F64, origin: F64, x: F64, focal: float, scale: float) -> float:
    """The Cauchy weight of a ray that misses a point by an angle, over its squared distance."""
    a, b, c = x[0] - origin[0], x[1] - origin[1], x[2] - origin[2]
    along = ray[0] * a + ray[1] * b + ray[2] * c
    square = max(a * a + b * b + c * c, _NEAR * _NEAR)
    across = (a - ray[0] * along) ** 2 + (b - ray[1] * along) ** 2 + (c - ray[2] * along) ** 2
    weight: float = 1.0 / ((1.0 + across / square * (focal / scale) ** 2) * square)
    return weight


@pixelwise
def _towards(x: F64, C: F64, out: F64) -> None:
    """Write the unit vector from a camera to a point."""
    a, b, c = x[0] - C[0], x[1] - C[1], x[2] - C[2]
    long = max(math.sqrt(a * a + b * b + c * c), _NEAR)
    out[0], out[1], out[2] = a / long, b / long, c / long


@kernel
def meet_rays(
    starts: I64, ray: F64, origin: F64, focal: F64, rounds: int, scale: float, regular: float, weight: F64, out: F64
) -> None:
    """Write the points nearest to their rays (midpoint method), with Cauchy weights.

    Args:
        starts: (m + 1,) first ray of each point, then N.
        ray, origin: (N, 3) unit directions and origins, sorted by point.
        focal: (N,) px.
        rounds: of weighting.
        scale: px, of the Cauchy loss.
        regular: on the diagonal of a point's information, relative to the largest weight.
        weight: (N,) those of the first round; then scratch.
        out: (m, 3)
    """
    room, y = np.empty((3, 3, 3)), np.empty(3)
    largest = 1.0
    for _ in range(rounds):
        least, top = regular * largest, 0.0
        for k in range(len(starts) - 1):
            nearest_point(ray, origin, weight, starts[k], starts[k + 1], least, room, y, out[k])
            for n in range(starts[k], starts[k + 1]):
                weight[n] = _reweigh(ray[n], origin[n], out[k], focal[n], scale)
                top = max(top, weight[n])
        largest = top


@kernel
def widest_angles(starts: I64, photo: I64, C: F64, x: F64, out: F64) -> None:
    """Write (m,) the angle in rad between the first ray of each point and the one farthest from it.

    Args:
        starts: (m + 1,) first observation of each point, then N.
        photo, C, x: (N,) number of the photo, (n, 3) camera centres, (m, 3) points, metres.
        out: (m,)
    """
    first, other = np.empty(3), np.empty(3)
    for k in range(len(starts) - 1):
        sine2 = 0.0
        _towards(x[k], C[photo[starts[k]]], first)
        for n in range(starts[k] + 1, starts[k + 1]):
            _towards(x[k], C[photo[n]], other)
            a = first[1] * other[2] - first[2] * other[1]
            b = first[2] * other[0] - first[0] * other[2]
            c = first[0] * other[1] - first[1] * other[0]
            sine2 = max(sine2, a * a + b * b + c * c)
        out[k] = math.asin(min(math.sqrt(sine2), 1.0))
