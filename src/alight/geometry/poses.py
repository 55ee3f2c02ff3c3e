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
    """Rigid transform: `x_dst = rotation @ x_src + translation`."""

    rotation: F64 = field(default_factory=lambda: np.eye(3))  # (3, 3), from src to dst
    translation: F64 = field(default_factory=lambda: np.zeros(3))  # (3,) origin of src in dst, metres

    def __post_init__(self) -> None:
        object.__setattr__(self, "rotation", _readonly(self.rotation, (3, 3)))
        object.__setattr__(self, "translation", _readonly(self.translation, (3,)))

    def __setstate__(self, state: dict[str, F64]) -> None:
        """Restore a pickled pose with read-only arrays, as the compiled loops expect."""
        for name, value in state.items():
            value.flags.writeable = False
            object.__setattr__(self, name, value)

    @classmethod
    def from_matrix(cls, matrix: ArrayLike, tolerance: float = 1e-3) -> Pose:
        """Build a pose from a (4, 4) homogeneous matrix; its rotation is made exactly orthonormal.

        Raises:
            ValueError: the matrix is not a rigid transform to within `tolerance`.
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
        """Build a pose from a quaternion (w, x, y, z) and a translation in metres."""
        return cls(matrix_from_quaternion(quaternion_wxyz), np.asarray(translation))

    @property
    def matrix(self) -> F64:
        """Homogeneous matrix, (4, 4)."""
        M = np.eye(4)
        M[:3, :3], M[:3, 3] = self.rotation, self.translation
        return M

    @property
    def quaternion(self) -> F64:
        """Rotation as a unit quaternion (w, x, y, z), w >= 0."""
        return quaternion_from_matrix(self.rotation)

    @property
    def inverse(self) -> Pose:
        """Inverse pose, `src_from_dst`."""
        return Pose(self.rotation.T, -self.rotation.T @ self.translation)

    def __matmul__(self, other: Pose) -> Pose:
        return Pose(self.rotation @ other.rotation, self.rotation @ other.translation + self.translation)

    def apply(self, points: ArrayLike) -> F64:
        """Transform (..., 3) points from src to dst."""
        return np.asarray(points) @ self.rotation.T + self.translation

    def interpolate(self, other: Pose, t: float) -> Pose:
        """Interpolate to `other`, from `t` = 0 (this pose) to 1 (`other`): straight line, shortest rotation."""
        return Pose(slerp(self.rotation, other.rotation, t), (1 - t) * self.translation + t * other.translation)
