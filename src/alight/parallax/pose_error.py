"""Sensitivity of matched heights to the errors of their views' poses (docs/method/uncertainty.md).

A wrong pose moves the ground that the view sees along with its body. Where the views of a point move it to
different places, the match is the point nearest to all of them. So height and place are linear in the poses' errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from alight.arrays import F64
from alight.geometry import Camera, Grid, Pose, skew
from alight.records import KeyframePosterior, View

_LEAST = 2  # views that a height needs
_REGULAR = 1e-9  # of the normal equations, so that a point seen along one ray has a solution


class PosedCamera(NamedTuple):
    """A view without its picture."""

    t_ns: int
    camera: Camera
    world_from_cam: Pose
    cam: int = 0  # index in the rig


class Matched(NamedTuple):
    """The views that the heights of a tile were matched with."""

    grid: Grid
    cameras: tuple[PosedCamera, ...]

    @classmethod
    def of(cls, grid: Grid, views: Sequence[View]) -> Matched:
        """Keep the grid and the cameras of the views."""
        return cls(grid, tuple(PosedCamera(v.t_ns, v.camera, v.world_from_cam, v.cam) for v in views))

    def holds(self, east: F64, north: F64) -> NDArray[np.bool_]:
        """True for places (metres, east and north) that lie in the tile."""
        row, col = self.grid.index(east, north)
        inside = (row >= -0.5) & (row < self.grid.rows - 0.5) & (col >= -0.5) & (col < self.grid.cols - 0.5)
        return np.asarray(inside)


def sensitivity(points: F64, cameras: Sequence[PosedCamera], joint: KeyframePosterior) -> F64:
    """Derivatives of matched points by the errors of the poses and the lens.

    The displacement is the least-squares intersection of the displaced rays, each measured on the ground as in
    the matching: of view i with ray `r`, `T_i = [I | -r_xy / r_z]`, and `dX = (sum T'T)^-1 sum T'T d_i`.

    Args:
        points: (S, 3) metres, the ground.
        cameras: those of the views.
        joint: the poses with errors; an exposure between two of them has their errors, interpolated in time.

    Returns:
        (S, 3, 6K + L) metres a metre, a radian or a unit of the lens; NaN where fewer than two views see a point.
    """
    S, M = len(points), len(joint.covariance)
    normal, out, count = np.zeros((S, 3, 3)), np.zeros((S, 3, M)), np.zeros(S, np.int64)
    for view in cameras:
        ray = points - view.world_from_cam.translation
        seen = _sees(view, points)
        T = np.zeros((S, 2, 3))
        T[:, 0, 0] = T[:, 1, 1] = 1.0
        T[:, :, 2] = -ray[:, :2] / np.where(np.abs(ray[:, 2:]) > 1e-6, ray[:, 2:], -1e-6)
        W = np.where(seen[:, None, None], T.transpose(0, 2, 1) @ T, 0.0)
        normal += W
        count += seen
        for k, share in _shares(view.t_ns, joint):
            out[:, :, 6 * k : 6 * k + 6] += share * (W @ _carried(points, joint.motions[k].world_from_body.translation))
        for n, lens in enumerate(joint.lenses):
            out[:, :, M - len(joint.lenses) + n] += (W @ _bent(view, lens[view.cam], points, seen)[..., None])[..., 0]
    found = np.linalg.solve(normal + _REGULAR * np.eye(3), out)
    return np.asarray(np.where(count[:, None, None] >= _LEAST, found, np.nan))


def _sees(view: PosedCamera, points: F64) -> NDArray[np.bool_]:
    in_cam = view.world_from_cam.inverse.apply(points)
    uv = view.camera.project(in_cam)
    inside = (uv >= 0).all(axis=1) & (uv[:, 0] <= view.camera.width - 1) & (uv[:, 1] <= view.camera.height - 1)
    return np.asarray(inside & (in_cam[:, 2] > 0))


def _carried(points: F64, body: F64) -> F64:
    """(S, 3, 6): derivatives of the ground by an error of the body's pose, which must be added to the pose."""
    out = np.zeros((len(points), 3, 6))
    out[:, :, :3] = -np.eye(3)
    out[:, :, 3:] = np.array([skew(p - body) for p in points])
    return out


def _bent(view: PosedCamera, lens: Camera, points: F64, seen: NDArray[np.bool_]) -> F64:
    """(S, 3) metres: displacement of the ground by a lens that is one unit off; 0 where it is not seen."""
    out = np.zeros(points.shape)
    in_cam = view.world_from_cam.inverse.apply(points[seen])
    true = lens.rays(view.camera.project(in_cam))
    out[seen] = (in_cam - true / true[:, 2:] * in_cam[:, 2:]) @ view.world_from_cam.rotation.T
    return out


def _shares(t_ns: int, joint: KeyframePosterior) -> list[tuple[int, float]]:
    """Exposures of the joint covariance whose errors an exposure at `t_ns` has, with the share of each."""
    times = np.array([m.t_ns for m in joint.motions], np.int64)
    k = int(np.searchsorted(times, t_ns))
    if k == len(times):
        return [(k - 1, 1.0)]
    if k == 0 or times[k] == t_ns:
        return [(k, 1.0)]
    share = float(t_ns - times[k - 1]) / float(times[k] - times[k - 1])
    return [(k - 1, 1.0 - share), (k, share)]
