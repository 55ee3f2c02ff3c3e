"""Rigid poses, named `dst_from_src`: `world_from_cam = world_from_body @ body_from_cam`."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from alight.arrays import F64
from alight.geometry.rotations import matrix_from_quaternion, quaternion_from_matrix, slerp


def _readonly(a: ArrayLike, shape: tuple[int, ...]) -> F64:
    out = np.array(a, dtype=np.float64)
    if out.shape != shape:
        raise ValueError(f"expected shape {shape}, got {out.shape}")
    out.flags.writeable = False
    return out


@dataclass(frozen=True, eq=False)
class Pose:
    """A rigid motion: `x_dst = rotation @ x_src + translation`."""

    rotation: F64 = field(default_factory=lambda: np.eye(3))  # (3, 3) dst from src
    translation: F64 = field(default_factory=lambda: np.zeros(3))  # (3,) origin of src in dst, metres

    def __post_init__(self) -> None:
        object.__setattr__(self, "rotation", _readonly(self.rotation, (3, 3)))
        object.__setattr__(self, "translation", _readonly(self.translation, (3,)))

    def __setstate__(self, state: dict[str, F64]) -> None:
        """Set the arrays read-only again after pickling: loops are compiled for read-only arrays."""
        for name, value in state.items():
            value.flags.writeable = False
            object.__setattr__(self, name, value)

    @classmethod
    def from_matrix(cls, matrix: ArrayLike, tolerance: float = 1e-3) -> Pose:
        """Make a pose of a (4, 4) homogeneous matrix, its rotation made orthonormal.

        Raises:
            ValueError: the matrix is not a rigid motion to within `tolerance`.
        """
        M = np.asarray(matrix, dtype=np.float64)
        if M.shape != (4, 4) or not np.isfinite(M).all():
            raise ValueError("not a rigid motion: needs 4x4 finite numbers")
        R = M[:3, :3]
        if np.abs(R @ R.T - np.eye(3)).max() > tolerance or np.linalg.det(R) < 0:
            raise ValueError("not a rigid motion: its 3x3 part is not a rotation")
        if np.abs(M[3] - [0, 0, 0, 1]).max() > tolerance:
            raise ValueError("not a rigid motion: its last row is not 0 0 0 1")
        U, _, Vt = np.linalg.svd(R)
        return cls(U @ Vt, M[:3, 3])

    @classmethod
    def from_quaternion(cls, quaternion_wxyz: ArrayLike, translation: ArrayLike) -> Pose:
        """Make a pose of a quaternion (w, x, y, z) and a translation in metres."""
        return cls(matrix_from_quaternion(quaternion_wxyz), np.asarray(translation))

    @property
    def matrix(self) -> F64:
        """The (4, 4) homogeneous matrix."""
        M = np.eye(4)
        M[:3, :3], M[:3, 3] = self.rotation, self.translation
        return M

    @property
    def quaternion(self) -> F64:
        """The rotation as (w, x, y, z)."""
        return quaternion_from_matrix(self.rotation)

    @property
    def inverse(self) -> Pose:
        """The inverse transform, `src_from_dst`."""
        return Pose(self.rotation.T, -self.rotation.T @ self.translation)

    def __matmul__(self, other: Pose) -> Pose:
        return Pose(self.rotation @ other.rotation, self.rotation @ other.translation + self.translation)

    def apply(self, points: ArrayLike) -> F64:
        """Transform (..., 3) points from src to dst."""
        return np.asarray(points) @ self.rotation.T + self.translation

    def interpolate(self, other: Pose, t: float) -> Pose:
        """Return the pose a fraction `t` of the way to `other`: straight line, shortest rotation."""
        return Pose(slerp(self.rotation, other.rotation, t), (1 - t) * self.translation + t * other.translation)
