"""Triangulation: points from observations at known poses, by least squares (docs/method/motion.md, M12)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from alight.arrays import F64, I64
from alight.geometry import Pose
from alight.motion.observations import WindowObservations, WindowPoses, cameras_at
from alight.motion.point_kernels import nearest_to_rays, triangulate_tracks

NEAR = 0.1  # m; a point closer to a camera along its axis, or behind it, is not observed by it
WEAK_PRIOR = 1e-9  # 1/m^2 added to a point's information, so that a point at infinity has a covariance
_ITERATIONS = 3  # of Gauss-Newton, from the point nearest to the rays


def triangulate_window(observations: WindowObservations, poses: WindowPoses, cams: Sequence[Pose]) -> F64:
    """Return (N, 3) points in the world: the point nearest to the rays, refined by Gauss-Newton (M12).

    Args:
        observations: of N features from K poses by C cameras.
        poses: the K rig poses.
        cams: rig_from_cam of the C cameras.
    """
    points = np.empty((len(observations.ids), 3))
    R, p = cameras_at(poses.R, poses.p, cams)
    triangulate_tracks(observations.normalised, observations.sigma, R, p, _ITERATIONS, NEAR, WEAK_PRIOR, points)
    return points


def triangulate_rays(starts: I64, rays: F64, origins: F64, weight: F64) -> F64:
    """Return the (N, 3) points nearest to weighted rays (midpoint method): a start for a batch adjustment.

    Args:
        starts: (N + 1,) first ray of each point, then their number M.
        rays, origins: (M, 3) directions of any length and origins in the world, sorted by point.
        weight: (M,)
    """
    points = np.empty((len(starts) - 1, 3))
    unit = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    nearest_to_rays(starts, unit, np.ascontiguousarray(origins), weight, WEAK_PRIOR, points)
    return points
