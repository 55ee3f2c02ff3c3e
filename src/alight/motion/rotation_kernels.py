"""Kernels for small rotations, and for poses moved by errors."""

import math

import numpy as np

from alight.arrays import F64
from alight.compiled import kernel


@kernel
def exponential(x: float, y: float, z: float, out: F64) -> None:
    """Write the (3, 3) rotation matrix of the rotation vector (x, y, z), rad (Rodrigues)."""
    angle2 = x * x + y * y + z * z
    if angle2 < 1e-12:  # series to second order: error below 1e-18
        a, b = 1.0 - angle2 / 6.0, 0.5 - angle2 / 24.0
    else:
        angle = math.sqrt(angle2)
        a, b = math.sin(angle) / angle, (1.0 - math.cos(angle)) / angle2
    out[0, 0], out[1, 1], out[2, 2] = 1.0 - b * (y * y + z * z), 1.0 - b * (x * x + z * z), 1.0 - b * (x * x + y * y)
    out[0, 1], out[1, 0] = b * x * y - a * z, b * x * y + a * z
    out[0, 2], out[2, 0] = b * x * z + a * y, b * x * z - a * y
    out[1, 2], out[2, 1] = b * y * z - a * x, b * y * z + a * x


@kernel
def multiply(a: F64, b: F64, out: F64) -> None:
    """Write the product of two (3, 3) matrices; `out` must be neither of them."""
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


@kernel
def move_poses(R: F64, p: F64, error: F64, moved_R: F64, moved_p: F64) -> None:
    """Write K poses (K, 3, 3), (K, 3) after adding `error` (6K,), (rotation in the world, position) per pose."""
    turn = np.empty((3, 3))
    for k in range(R.shape[0]):
        e = error[6 * k : 6 * k + 6]
        exponential(e[0], e[1], e[2], turn)
        multiply(turn, R[k], moved_R[k])
        for i in range(3):
            moved_p[k, i] = p[k, i] + e[3 + i]


@kernel
def place_cameras(R: F64, p: F64, rotation: F64, translation: F64, out_R: F64, out_p: F64) -> None:
    """Write world_from_cam of one camera (`out_R`, `out_p`) at K poses world_from_rig (`R`, `p`) of its rig.

    `rotation` (3, 3) and `translation` (3,) are rig_from_cam.
    """
    for k in range(R.shape[0]):
        multiply(R[k], rotation, out_R[k])
        for i in range(3):
            out_p[k, i] = p[k, i]
            for j in range(3):
                out_p[k, i] += R[k, i, j] * translation[j]
