"""Rotations: SO(3) exponential and logarithm, quaternions (w, x, y, z; Hamilton), yaw-pitch-roll.

A rotation matrix is named `dst_from_src` and converts coordinates in `src` to coordinates in `dst`. Batches use SciPy.
Single rotations use the formulas here: SciPy's logarithm of a single rotation takes twenty times as long.
"""

import numpy as np
from numpy.typing import ArrayLike

from alight.arrays import F64


def skew(v: ArrayLike) -> F64:
    """Return the (..., 3, 3) cross-product matrices of (..., 3) vectors: `skew(a) @ b == cross(a, b)`."""
    a = np.asarray(v, dtype=np.float64)
    if a.ndim == 1:
        x, y, z = a
        return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    out = np.zeros((*a.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -a[..., 2], a[..., 1], -a[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = a[..., 2], -a[..., 1], a[..., 0]
    return out


def so3_exp(rotation_vector: ArrayLike) -> F64:
    """Convert rotation vectors (3,) or (N, 3), radians, to rotation matrices (3, 3) or (N, 3, 3) (Rodrigues)."""
    w = np.asarray(rotation_vector, dtype=np.float64)
    if w.ndim > 1:
        from scipy.spatial.transform import Rotation  # a quarter of a second, which the command line waits for

        return np.asarray(Rotation.from_rotvec(w).as_matrix())
    angle2 = float(w @ w)
    if angle2 < 1e-12:  # series to second order: error below 1e-18
        a, b = 1.0 - angle2 / 6.0, 0.5 - angle2 / 24.0
    else:
        angle = np.sqrt(angle2)
        a, b = np.sin(angle) / angle, (1.0 - np.cos(angle)) / angle2
    W = skew(w)
    return np.eye(3) + a * W + b * (W @ W)


def so3_log(rotation: ArrayLike) -> F64:
    """Convert rotation matrices (3, 3) or (N, 3, 3) to rotation vectors (3,) or (N, 3), radians; length at most pi."""
    R = np.asarray(rotation, dtype=np.float64)
    if R.ndim > 2:
        from scipy.spatial.transform import Rotation

        return np.asarray(Rotation.from_matrix(R).as_rotvec())
    q = quaternion_from_matrix(R)
    w, v = q[0], q[1:]
    sine = float(np.linalg.norm(v))
    if sine < 1e-9:
        return np.asarray(2.0 * v / w)
    return np.asarray(2.0 * np.arctan2(sine, w) * v / sine)


def quaternion_from_matrix(rotation: ArrayLike) -> F64:
    """Convert a (3, 3) rotation matrix to a unit quaternion (w, x, y, z) with w >= 0 (largest-pivot method)."""
    R = np.asarray(rotation, dtype=np.float64)
    t = float(np.trace(R))
    pivots = np.array([t, R[0, 0], R[1, 1], R[2, 2]])
    k = int(np.argmax(pivots))
    if k == 0:
        q = np.array([1.0 + t, R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    else:
        i, j, m = k - 1, k % 3, (k + 1) % 3
        q = np.empty(4)
        q[0] = R[m, j] - R[j, m]
        q[1 + i] = 1.0 + R[i, i] - R[j, j] - R[m, m]
        q[1 + j] = R[j, i] + R[i, j]
        q[1 + m] = R[m, i] + R[i, m]
    q /= np.linalg.norm(q)
    return -q if q[0] < 0 else q


def matrix_from_quaternion(quaternion: ArrayLike) -> F64:
    """Convert a quaternion (w, x, y, z) to a (3, 3) rotation matrix; the quaternion is normalised first.

    Raises:
        ValueError: the quaternion is zero or not finite.
    """
    q = np.asarray(quaternion, dtype=np.float64)
    n = float(np.linalg.norm(q))
    if not np.isfinite(n) or n < 1e-9:
        raise ValueError(f"not a rotation: quaternion {q.tolist()} has length {n:g}")
    w, x, y, z = q / n
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def slerp(a: ArrayLike, b: ArrayLike, t: float) -> F64:
    """Interpolate from rotation `a` (`t` = 0) to `b` (`t` = 1) along the shortest arc; all (3, 3)."""
    A = np.asarray(a, dtype=np.float64)
    return A @ so3_exp(t * so3_log(A.T @ np.asarray(b, dtype=np.float64)))


ENU_FROM_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
FRD_FROM_FLU = np.diag([1.0, -1.0, -1.0])


def enu_from_flu(yaw: float, pitch: float, roll: float) -> F64:
    """Return the (3, 3) ENU-from-FLU rotation of yaw (clockwise from north), pitch (nose up) and roll (right down).

    The angles, in radians, are the usual aeronautical Z-Y-X sequence between the frames NED and FRD.
    """
    cy, sy, cp, sp, cr, sr = np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch), np.cos(roll), np.sin(roll)
    ned_from_frd = np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
    return np.asarray(ENU_FROM_NED @ ned_from_frd @ FRD_FROM_FLU)
