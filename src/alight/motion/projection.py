"""Projection of points into the cameras of a rig, with Jacobians (docs/method/motion.md, M11)."""

from __future__ import annotations

import numpy as np

from alight.arrays import F64
from alight.geometry import Camera, Pose, skew
from alight.motion.point_kernels import MIN_DEPTH
from alight.records import Tracks
from alight.settings import FilterSettings

POSITION_FIRST = np.array([3, 4, 5, 0, 1, 2])  # takes (rotation, position) of a pose to (position, rotation)


def _times(v: F64, R: F64) -> F64:
    """Return the row vectors v R of (..., 3) vectors; R is (3, 3) or one matrix a vector."""
    return v @ R if R.ndim == 2 else (v[..., None, :] @ R)[..., 0, :]


def in_camera(R: F64, p: F64, rig_from_cam: Pose, x: F64) -> F64:
    """Return the (..., 3) coordinates of world points in a camera.

    Args:
        R, p: (3, 3), (3,) world_from_rig; or one pose a point, (..., 3, 3), (..., 3).
        rig_from_cam: of the camera.
        x: (..., 3) points.
    """
    return np.asarray((_times(x - p, R) - rig_from_cam.translation) @ rig_from_cam.rotation)


def project(R: F64, p: F64, rig_from_cam: Pose, x: F64) -> F64:
    """Return the normalised coordinates (..., 2) of world points in a camera (M11); arguments of `in_camera`."""
    q = in_camera(R, p, rig_from_cam, x)
    return np.asarray(q[..., :2] / q[..., 2:3])


def jacobians(R: F64, p: F64, rig_from_cam: Pose, x: F64) -> tuple[F64, F64]:
    """Return the Jacobians of `project` by the rig's (rotation, position), (..., 2, 6), and by the point (..., 2, 3).

    With d = x - p and C = cam_from_world: d(q) = C (dx - dp + [d]x theta), theta the rotation error in the world.
    """
    cam_from_world = rig_from_cam.rotation.T @ np.swapaxes(R, -1, -2)
    q = in_camera(R, p, rig_from_cam, x)
    w = 1.0 / np.maximum(q[..., 2], MIN_DEPTH)
    J = np.zeros((*x.shape[:-1], 2, 3))
    J[..., 0, 0] = J[..., 1, 1] = w
    J[..., 0, 2], J[..., 1, 2] = -q[..., 0] * w**2, -q[..., 1] * w**2
    by_point = J @ cam_from_world
    by_pose = np.concatenate([by_point @ skew(x - p), -by_point], axis=-1)
    return by_pose, by_point


def observation_sigma(tracks: Tracks, camera: Camera, noise: FilterSettings) -> F64:
    """Return the (N,) 1-sigma of normalised coordinates (M13): the stronger the texture, the sharper the SSD minimum.

    It is proportional to 1 / sqrt(texture), which follows measured tracking errors (docs/method/tracks.md, M13).
    """
    texture = np.full(len(tracks.ids), noise.texture_reference) if tracks.texture is None else tracks.texture
    relative = np.sqrt(noise.texture_reference / np.maximum(texture, 1e-9))
    return np.asarray(np.clip(relative, 0.5, 4.0) * (noise.pixel_sigma / camera.fu))
