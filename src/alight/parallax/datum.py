"""The common error of a batch map: offset and tilt caused by the poses' errors, and the rest that a plane leaves.

A wrong pose moves the ground that its view sees. Where the views of a point move it to different positions, the match
is the point nearest to all of them. So the matched point is linear in the poses' errors: their joint covariance is
propagated to the matched points, and a plane is fitted to their errors (docs/method/uncertainty.md, eqs. 26 and 27).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np

from alight.arrays import F32, F64, Mask
from alight.geometry import Camera, Grid, skew
from alight.parallax.views import inside_picture
from alight.raster import gradient, nearest_known
from alight.records import Datum, ElevationMap, KeyframePosterior, View

SAMPLES = 900  # sampled cells of the map, about
LEAST = 12  # sampled cells that a plane needs
SLOPE_CELLS = 1.5  # sigma of the Gaussian over which the slope of the map is taken: heights are no finer


class Matched(NamedTuple):
    """Tile of the map, and the views from which its heights were matched; the views have no pictures."""

    grid: Grid
    views: tuple[View, ...]

    @classmethod
    def of(cls, grid: Grid, views: Sequence[View]) -> Matched:
        """Return the record of a tile, with the views stripped of their pictures."""
        return cls(grid, tuple(v.without_image for v in views))

    def holds(self, east: F64, north: F64) -> Mask:
        """Return a mask of the positions `east`, `north` (m) that lie in the tile."""
        row, col = self.grid.index(east, north)
        inside = (row >= -0.5) & (row < self.grid.rows - 0.5) & (col >= -0.5) & (col < self.grid.cols - 0.5)
        return np.asarray(inside)


def with_datum(found: ElevationMap, matched: Sequence[Matched], joint: KeyframePosterior) -> ElevationMap:
    """Return the map with the errors from its poses added as `datum` (offset and tilt) and `warp` (the rest per cell).

    Args:
        found: the map; it is returned unchanged if too little of it is known.
        matched: tiles from which the map was made; a later tile covers an earlier one.
        joint: joint posterior of the poses of the recording.
    """
    trusted, lattice = found.trusted, np.zeros(found.grid.shape, np.bool_)
    step = max(1, int(np.sqrt(trusted.sum() / SAMPLES)))
    lattice[step // 2 :: step, step // 2 :: step] = True
    rows, cols = np.nonzero(trusted & lattice)
    e, n = found.grid.xy()
    points = np.column_stack([e[cols], n[rows], found.height[rows, cols].astype(np.float64)])
    J = _through(points, matched, joint)
    known = np.isfinite(J[:, 0, 0])
    if known.sum() < LEAST:
        return found
    J, points, at = J[known], points[known], (rows[known], cols[known])
    centre = points[:, :2].mean(axis=0)
    B = np.column_stack([np.ones(len(points)), points[:, :2] - centre])
    L = np.asarray(np.linalg.pinv(B) @ J[:, 2])
    covariance = L @ joint.covariance @ L.T
    datum = Datum(float(centre[0]), float(centre[1]), 0.5 * (covariance + covariance.T))
    sampled, out = np.zeros(found.grid.shape, np.bool_), np.zeros((2, *found.grid.shape), np.float32)
    sampled[at] = True
    out[0][at] = _sigma(J[:, 2:] - (B @ L)[:, None], joint.covariance)  # metres up, of the rest that the plane leaves
    out[1][at] = _sigma(J[:, :2] - J[:, :2].mean(axis=0), joint.covariance) / np.sqrt(2.0)  # east or north
    bend, shift = (nearest_known(v, sampled) for v in out)
    return replace(found, datum=datum, warp=np.hypot(bend, shift * steepness(found)))


def steepness(found: ElevationMap) -> F32:
    """Return the (R, C) rms slope of the map around each cell, metres of height per metre of horizontal distance."""

    def blurred(values: F32) -> F32:
        return np.asarray(cv2.GaussianBlur(values, (0, 0), SLOPE_CELLS), dtype=np.float32)

    height, known = np.nan_to_num(found.height), np.isfinite(found.height).astype(np.float32)
    share = np.maximum(blurred(known), np.float32(1e-3))
    level = blurred(height * known) / share
    north, east = gradient(level, found.grid.cell)
    return np.sqrt(blurred((north**2 + east**2).astype(np.float32) * known) / share)


def _through(points: F64, matched: Sequence[Matched], joint: KeyframePosterior) -> F64:
    """Return the `sensitivity` (S, 3, M) of points, each with the views of the last tile that contains it; else NaN."""
    out = np.full((len(points), 3, len(joint.covariance)), np.nan)
    left = np.ones(len(points), dtype=bool)
    for tile in reversed(matched):
        mine = left & tile.holds(points[:, 0], points[:, 1])
        if mine.any():
            out[mine] = sensitivity(points[mine], tile.views, joint)
            left &= ~mine
    return out


def _sigma(J: F64, covariance: F64) -> F64:
    flat = J.reshape(-1, J.shape[-1])
    variance = np.maximum(((flat @ covariance) * flat).sum(axis=1), 0.0)
    return np.asarray(np.sqrt(variance.reshape(J.shape[:2]).sum(axis=1)))


def sensitivity(points: F64, views: Sequence[View], joint: KeyframePosterior) -> F64:
    """Return the derivatives of matched points with respect to the errors of the poses and of the lens.

    A point moves to the least-squares intersection of its rays. If errors move the ground that view i sees by `d_i`,
    the point moves by `(sum T_i' T_i)^-1 sum T_i' T_i d_i`, where `T_i = [I | -r_xy / r_z]` with the ray `r` of view i.

    Args:
        points: (S, 3) ground points, metres.
        views: views with which the points were matched; their pictures are not used.
        joint: K poses and L lens parameters with errors, interpolated in time for exposures between two poses.

    Returns:
        (S, 3, 6K + L), per metre, radian or unit of a lens parameter; NaN where fewer than two views see a point.
    """
    S, M = len(points), len(joint.covariance)
    normal, out, count = np.zeros((S, 3, 3)), np.zeros((S, 3, M)), np.zeros(S, np.int64)
    for view in views:
        ray = points - view.world_from_cam.translation
        seen = inside_picture(view.camera, view.world_from_cam.inverse.apply(points))
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
    found = np.linalg.solve(normal + 1e-9 * np.eye(3), out)  # so that a point seen along one ray has a solution
    return np.asarray(np.where(count[:, None, None] >= 2, found, np.nan))


def _carried(points: F64, body: F64) -> F64:
    """Return the (S, 3, 6) displacement of points (S, 3) per unit of pose error (true - estimated) at `body` (3,)."""
    out = np.zeros((len(points), 3, 6))
    out[:, :, :3] = -np.eye(3)
    out[:, :, 3:] = np.array([skew(p - body) for p in points])
    return out


def _bent(view: View, lens: Camera, points: F64, seen: Mask) -> F64:
    """Return the displacement of points (S, 3), metres, if the view's true lens is `lens`; 0 if not `seen` (S,)."""
    out = np.zeros(points.shape)
    in_cam = view.world_from_cam.inverse.apply(points[seen])
    true = lens.rays(view.camera.project(in_cam))
    out[seen] = (in_cam - true / true[:, 2:] * in_cam[:, 2:]) @ view.world_from_cam.rotation.T
    return out


def _shares(t_ns: int, joint: KeyframePosterior) -> list[tuple[int, float]]:
    """Return (index, weight) of the poses in `joint` whose errors are interpolated linearly to the time `t_ns`."""
    times = np.array([m.t_ns for m in joint.motions], np.int64)
    k = int(np.searchsorted(times, t_ns))
    if k == len(times):
        return [(k - 1, 1.0)]
    if k == 0 or times[k] == t_ns:
        return [(k, 1.0)]
    share = float(t_ns - times[k - 1]) / float(times[k] - times[k - 1])
    return [(k - 1, 1.0 - share), (k, share)]
