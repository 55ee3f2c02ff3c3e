"""Kernels of the bundle adjustment: loops over observations, and triangulation of points from their rays.

Equation numbers: docs/method/bundle.md.

There are N observations of m points in n photos by c cameras, sorted by point, then photo; a photo observes a point
once. A photo has e unknowns: position, rotation and, if it may rotate during the readout, six more. A camera has up to
f free lens parameters. Common arguments of all loops:

    photo: (N,) photo indices. pixels: (N, 2) observed pixels.
    R, C: (n, 3, 3), (n, 3) world_from_cam in the middle of the readout.
    turns: (n, 2, 3) rad, rotation during the readout, linear and quadratic in time. velocity: (n, 3) m/s.
    camera: (n,) index of the camera that took each photo.
    lens: (c, 11) focal lengths, principal point, five coefficients, height of a photo in pixels, readout in s.
    model: (c,) 0 no distortion, 1 radial-tangential, 2 equidistant.
    point, x: (N,) point indices, (m, 3) points in metres.
"""

import math

import numpy as np

from alight.arrays import F64, I64
from alight.compiled import kernel, pixelwise
from alight.motion.point_kernels import MIN_DEPTH, nearest_point, to_camera
from alight.photos.bundle.camera_kernels import distort, expose, quadratic, row_time, undistort

FAR = 1e4  # px, residual of a point behind the camera


@kernel
def predict_pixels(
    photo: I64, pixels: F64, R: F64, C: F64, turns: F64, velocity: F64, camera: I64, lens: F64, model: I64,
    point: I64, x: F64, out: F64, depth: F64,
) -> None:  # fmt: skip
    """Write pixels `out` (N, 2), NaN behind the camera, and depths (N,) in m (eqs. 1, 10); inputs: see the module."""
    turn, row_R, row_C, q = np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty(3)
    flat, by_xy, by_k = np.empty(2), np.empty((2, 2)), np.empty((2, 5))
    for n in range(len(photo)):
        i = photo[n]
        of = lens[camera[i]]
        t = row_time(pixels[n, 1], of)
        expose(R[i], C[i], turns[i], velocity[i], of, t, turn, row_R, row_C)
        to_camera(row_R, row_C, x[point[n]], q)
        depth[n] = q[2]
        out[n] = np.nan
        if q[2] > 0.0:
            distort(q[0] / q[2], q[1] / q[2], model[camera[i]], of[4:9], flat, by_xy, by_k)
            out[n, 0], out[n, 1] = of[0] * flat[0] + of[2], of[1] * flat[1] + of[3]


@pixelwise
def _residual(depth: float, flat: F64, of: F64, seen: F64, sigma: float, loss: float, r: F64) -> float:
    """Write the residual `r` (2,) in px, predicted minus `seen`; return sqrt(Cauchy weight) / `sigma`.

    `flat`: distorted coordinates of the point; `of`: row of the lens table. If `depth` is not above 0, `r` is `FAR`.
    """
    for h in range(2):
        r[h] = of[h] * flat[h] + of[2 + h] - seen[h] if depth > 0.0 else FAR
        r[h] = min(max(r[h], -FAR), FAR)
    return 1.0 / (sigma * math.sqrt(1.0 + (r[0] * r[0] + r[1] * r[1]) / (sigma * loss) ** 2))


@pixelwise
def _by_point(R: F64, x: float, y: float, near: float, of: F64, by_xy: F64, B: F64) -> None:
    """Write the derivatives B (2, 3) of a pixel with respect to its point in the world (eq. 2).

    `x`, `y`, `near`: ideal coordinates and inverse depth; `of`: row of the lens table; `by_xy`: output of `distort`.
    """
    for h in range(2):
        u, v = of[h] * near * by_xy[h, 0], of[h] * near * by_xy[h, 1]
        z = -(u * x + v * y)
        for j in range(3):
            B[h, j] = u * R[j, 0] + v * R[j, 1] + z * R[j, 2]


@pixelwise
def _by_pose(B: F64, x: F64, C: F64, R: F64, t: float, each: int, J: F64) -> None:
    """Write the derivatives J (2, e) of a pixel with respect to the e unknowns of its photo (eqs. 2, 11).

    `B`: derivatives with respect to the point `x`; `C`: camera centre at the row; `R`: rotation in the middle of the
    readout; `t`: see `row_time`; `each`: e, 6 for position and rotation, 12 with the rotation during the readout.
    """
    a, b, c = x[0] - C[0], x[1] - C[1], x[2] - C[2]
    for h in range(2):
        for j in range(3):
            J[h, j] = -B[h, j]
        J[h, 3], J[h, 4], J[h, 5] = B[h, 1] * c - B[h, 2] * b, B[h, 2] * a - B[h, 0] * c, B[h, 0] * b - B[h, 1] * a
        if each == 12:
            for j in range(3):
                turn = J[h, 3] * R[0, j] + J[h, 4] * R[1, j] + J[h, 5] * R[2, j]
                J[h, 6 + j], J[h, 9 + j] = turn * t, turn * quadratic(t)


@pixelwise
def _by_lens(flat: F64, by_k: F64, of: F64, scale: F64, B: F64, velocity: F64, t: float, D: F64) -> None:
    """Write the derivatives D (2, 10) of a pixel with respect to its lens parameters (eqs. 3, 11).

    They are scale, aspect, cu, cv, five coefficients, and the readout time.

    `flat`, `by_k`: output of `distort`; `of`: row of the lens table; `scale`: 1 + s and 1 + a of the lens; `B`:
    derivatives with respect to the point in the world; `t`: see `row_time`.
    """
    D[0, 1], D[1, 1], D[0, 2], D[1, 2], D[0, 3], D[1, 3] = of[0] * flat[0] / scale[1], 0.0, 1.0, 0.0, 0.0, 1.0
    for h in range(2):
        D[h, 0] = of[h] * flat[h] / scale[0]
        for j in range(5):
            D[h, 4 + j] = of[h] * by_k[h, j]
        D[h, 9] = -t * (B[h, 0] * velocity[0] + B[h, 1] * velocity[1] + B[h, 2] * velocity[2])


@pixelwise
def _add_photo(J: F64, r: F64, own: F64, right: F64) -> None:
    """Add J'J (lower triangle) to `own` and -J'r to `right`, for derivatives J (2, p) and residuals r (2,)."""
    for a in range(J.shape[1]):
        u, v = J[0, a], J[1, a]
        right[a] -= u * r[0] + v * r[1]
        for b in range(a + 1):
            own[a, b] += u * J[0, b] + v * J[1, b]


@pixelwise
def _add_point(B: F64, r: F64, information: F64, gradient: F64) -> None:
    """Add B'B to `information` and -B'r to `gradient`, for derivatives B (2, 3) and residuals r (2,)."""
    for j in range(3):
        gradient[j] -= B[0, j] * r[0] + B[1, j] * r[1]
        for h in range(3):
            information[j, h] += B[0, j] * B[0, h] + B[1, j] * B[1, h]


@pixelwise
def _couple(B: F64, J: F64, each: int, place: I64, coupling: F64, lens_coupling: F64) -> None:
    """Write B'J of the e = `each` unknowns of a photo to `coupling` (3, e), and add B'J of its lens to `lens_coupling`.

    `place`: columns of the free lens parameters in `lens_coupling` (3, k), padded with -1.
    """
    for j in range(3):
        u, v = B[0, j], B[1, j]
        for a in range(each):
            coupling[j, a] = u * J[0, a] + v * J[1, a]
        for f in range(len(place)):
            if place[f] >= 0:
                lens_coupling[j, place[f]] += u * J[0, each + f] + v * J[1, each + f]


@kernel
def linearise(
    photo: I64, pixels: F64, R: F64, C: F64, turns: F64, velocity: F64, camera: I64, lens: F64, model: I64,
    point: I64, x: F64, scale: F64, number: I64, place: I64, each: int, sigma: F64, loss: float,
    own: F64, right: F64, coupling: F64, lens_coupling: F64, information: F64, gradient: F64,
) -> None:  # fmt: skip
    """Add all observations to the blocks of the normal equations, weighted by a Cauchy loss (eqs. 2, 3, 7, 11).

    Args:
        photo ... x: common arguments, see the module.
        scale: (c, 2) factors 1 + s and 1 + a of each lens (eq. 3).
        number: (c, f) indices of each lens's free parameters (see `_by_lens`), padded with -1.
        place: (c, f) indices of the same parameters among all k free lens parameters.
        each: e, number of unknowns per photo.
        sigma: (N,) px, 1-sigma of each observation.
        loss: scale of the loss in sigmas.
        own: (n, e + f, e + f) blocks of the photos and their lenses, lower triangle.
        right: (n, e + f) right-hand side for `own`.
        coupling: (N, 3, e) blocks between points and photos; overwritten, not added to.
        lens_coupling: (m, 3, k) blocks between points and free lens parameters.
        information, gradient: (m, 3, 3), (m, 3) blocks and right-hand side for the points.
    """
    turn, row_R, row_C, q = np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty(3)
    flat, by_xy, by_k = np.empty(2), np.empty((2, 2)), np.empty((2, 5))
    J, B, D, r = np.empty((2, own.shape[1])), np.empty((2, 3)), np.empty((2, 10)), np.empty(2)
    for n in range(len(photo)):
        i, k = photo[n], point[n]
        c = camera[i]
        of, t = lens[c], row_time(pixels[n, 1], lens[c])
        expose(R[i], C[i], turns[i], velocity[i], of, t, turn, row_R, row_C)
        to_camera(row_R, row_C, x[k], q)
        near = 1.0 / max(q[2], MIN_DEPTH)
        distort(q[0] * near, q[1] * near, model[c], of[4:9], flat, by_xy, by_k)
        w = _residual(q[2], flat, of, pixels[n], sigma[n], loss, r)
        _by_point(row_R, q[0] * near, q[1] * near, near, of, by_xy, B)
        _by_pose(B, x[k], row_C, R[i], t, each, J)
        _by_lens(flat, by_k, of, scale[c], B, velocity[i], t, D)
        for h in range(2):
            for f in range(number.shape[1]):
                J[h, each + f] = D[h, number[c, f]] if number[c, f] >= 0 else 0.0
            for a in range(J.shape[1]):
                J[h, a] *= w
            for j in range(3):
                B[h, j] *= w
            r[h] *= w
        _add_photo(J, r, own[i], right[i])
        _add_point(B, r, information[k], gradient[k])
        _couple(B, J, each, place[c], coupling[n], lens_coupling[k])


@kernel
def rays_of_pixels(
    photo: I64, pixels: F64, R: F64, C: F64, turns: F64, velocity: F64, camera: I64, lens: F64, model: I64,
    ray: F64, origin: F64,
) -> None:  # fmt: skip
    """Write unit vectors `ray` (N, 3) of pixels in the world, and origins (N, 3) in m (eq. 10); see the module."""
    turn, row_R, at = np.empty((3, 3)), np.empty((3, 3)), np.empty(2)
    flat, by_xy, by_k = np.empty(2), np.empty((2, 2)), np.empty((2, 5))
    for n in range(len(photo)):
        i = photo[n]
        of = lens[camera[i]]
        t = row_time(pixels[n, 1], of)
        expose(R[i], C[i], turns[i], velocity[i], of, t, turn, row_R, origin[n])
        u, v = (pixels[n, 0] - of[2]) / of[0], (pixels[n, 1] - of[3]) / of[1]
        undistort(u, v, model[camera[i]], of[4:9], at, flat, by_xy, by_k)
        long = math.sqrt(at[0] * at[0] + at[1] * at[1] + 1.0)
        for j in range(3):
            ray[n, j] = (row_R[j, 0] * at[0] + row_R[j, 1] * at[1] + row_R[j, 2]) / long


@pixelwise
def _reweigh(ray: F64, origin: F64, x: F64, focal: float, scale: float) -> float:
    """Return the Cauchy weight of the angle between a ray and the point `x`, divided by the point's squared distance.

    `focal`: focal length in px; `scale`: scale of the loss in px.
    """
    a, b, c = x[0] - origin[0], x[1] - origin[1], x[2] - origin[2]
    along = ray[0] * a + ray[1] * b + ray[2] * c
    square = max(a * a + b * b + c * c, 1e-6 * 1e-6)
    across = (a - ray[0] * along) ** 2 + (b - ray[1] * along) ** 2 + (c - ray[2] * along) ** 2
    weight: float = 1.0 / ((1.0 + across / square * (focal / scale) ** 2) * square)
    return weight


@kernel
def meet_rays(
    starts: I64, ray: F64, origin: F64, focal: F64, rounds: int, scale: float, regular: float, weight: F64, out: F64
) -> None:
    """Triangulate points as the positions nearest to their rays (midpoint method), with Cauchy weights.

    Args:
        starts: (m + 1,) index of the first ray of each point, then N.
        ray, origin: (N, 3) unit directions and origins (m), sorted by point.
        focal: (N,) focal length of each ray, px.
        rounds: number of rounds of weighting.
        scale: scale of the Cauchy loss, px.
        regular: regularisation on the diagonal of a point's information, relative to the largest weight.
        weight: (N,) weights of the first round; overwritten.
        out: (m, 3) points, metres.
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
