"""Poses refined with the map: exposures, plane, heights and template in one small solve (docs/method/recursive.md).

The pictures fix the exposures and the map relative to each other; their common position stays that of the prior. A
cell's height and template value are marginalised, the height with the map's own sigma as prior.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from alight.arrays import F32, F64
from alight.geometry import Grid, Pose, plane_on
from alight.parallax.gauss_newton_kernels import template
from alight.parallax.pose_refinement import kernels
from alight.parallax.pose_refinement.gaussian import PoseGaussian, corrected_pose
from alight.parallax.pose_refinement.kernels import PLANE, POSE
from alight.parallax.sorting_kernels import network
from alight.parallax.views import Buffers, Prepared, centres_of, maps_at, sample
from alight.settings.tuning.parallax import PoseRefinementTuning

log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class RefinementView:
    """One view of the solve: picture, exposure and place of its camera."""

    prepared: Prepared
    body_from_cam: Pose
    exposure: int  # t_ns

    def at(self, world_from_body: Pose) -> Prepared:
        """The prepared picture with another pose of its body."""
        return self.prepared.posed(world_from_body @ self.body_from_cam)


@dataclass(frozen=True, eq=False)
class RefinementCells:
    """The cells of the solve."""

    xs: F64  # (C,) metres east
    ys: F64  # (R,) metres north
    height: F32  # (R, C) metres, NaN: left out
    kappa: F32  # (R, C) one over the variance of a height about the map's plane
    about: F64  # (2,) metres, to which the plane's offset refers
    arm: float  # metres, of the template's gradient

    def coarser(self) -> RefinementCells:
        """Every second row of the cells, for pictures of half the resolution."""
        half = slice(None, None, 2)
        return replace(self, ys=self.ys[half], height=self.height[half], kappa=self.kappa[half], arm=2 * self.arm)

    def tilted(self, plane: F64) -> F32:
        """The heights corrected for an error of the plane (3,)."""
        return self.height + plane_on(self.xs, self.ys, plane, self.about)


ViewPair = tuple[list[RefinementView], RefinementCells]  # pictures and cells of one linearisation


def thinning(grid: Grid, count: int) -> tuple[slice, slice]:
    """Every k-th row and column, so that about `count` cells are left."""
    k = max(1, round((grid.rows * grid.cols / count) ** 0.5))
    return slice(k // 2, None, k), slice(k // 2, None, k)


def refine_poses(
    prior: PoseGaussian,
    linearisations: Sequence[ViewPair],
    pixel: float,
    drop: float,
    keyframes: int,
    tuning: PoseRefinementTuning,
) -> tuple[PoseGaussian, F64]:
    """The posterior given the pictures, and the error (3,) of the map's plane (eqs. 17 to 24).

    Args:
        prior: distribution of the poses and the plane.
        linearisations: pictures and cells of each, of exposures that the prior holds.
        pixel: rad, angle of a pixel.
        drop: metres from the cameras to the ground.
        keyframes: steps that a picture takes part in; its information is shared among them.
    """
    times = [t for t in prior.times if any(s.exposure == t for s in linearisations[0][0])]
    rows = np.concatenate([np.arange(PLANE), prior.rows(times)])
    pairs = [(t, p) for t, p in zip(prior.times, prior.poses, strict=True) if t in times]
    P, held, one = prior.covariance[np.ix_(rows, rows)], Buffers(), np.eye(len(rows))
    x = prior.start[rows]
    x[:PLANE] = -prior.plane
    apparent = np.tile(np.repeat([pixel * drop, pixel], 3), len(times)) * tuning.apparent_px
    F = np.concatenate([np.zeros(PLANE), apparent]) ** 2
    A, seen, whitened = np.zeros_like(P), np.zeros_like(P), np.zeros(len(rows))
    for views, ground in linearisations:
        poses = [corrected_pose(p, x[PLANE + POSE * k :][:POSE]) for k, (_, p) in enumerate(pairs)]
        seen, b = _information(views, times, poses, ground, ground.tilted(prior.plane + x[:PLANE]), held, tuning)
        damping = np.linalg.inv(one + seen * F)
        A, b = damping @ seen, damping @ b
        whitened = np.asarray(np.linalg.solve(one + A @ P, b + A @ x))  # P^-1 x
        x = P @ whitened
    if not whitened @ x <= tuning.unlikely * len(x):  # so that NaN is refused
        log.info("the pictures contradict the prior of the poses, which stay as they were")
        return prior, np.zeros(PLANE)
    across, shared = prior.covariance[:, rows], A / keyframes
    gain = np.linalg.solve(one + shared @ P, shared)
    after = prior.covariance - across @ (0.5 * (gain + gain.T)) @ across.T
    follow = _following(seen, rows, len(after), tuning.taken_share)
    return prior.corrected(across @ whitened, follow @ after @ follow.T), prior.plane + x[:PLANE]


def _following(seen: F64, rows: NDArray[np.int64], size: int, share: float) -> F64:
    """Transition matrix of the errors when the next step takes a share of the heights from these poses (eq. 24)."""
    out = np.eye(size)
    out[:PLANE, :PLANE] *= 1 - share
    out[:PLANE, rows[PLANE:]] = -share * np.linalg.lstsq(seen[:PLANE, :PLANE], seen[:PLANE, PLANE:], rcond=None)[0]
    return out


def _information(
    used: list[RefinementView],
    times: list[int],
    poses: list[Pose],
    ground: RefinementCells,
    height: F32,
    held: Buffers,
    tuning: PoseRefinementTuning,
) -> tuple[F64, F64]:
    """Normal equations at one linearisation: A (M, M) and b (M,), M = 3 + 6E."""
    owner = np.array([times.index(s.exposure) for s in used], np.int64)
    views = [s.at(poses[k]) for s, k in zip(used, owner, strict=True)]
    s = _crosses(views, ground, height, held)
    n, (rows, cols), M = len(views), height.shape, PLANE + POSE * len(poses)
    weights, mean = np.empty((n, 5 * rows, cols), np.float32), np.empty((5 * rows, cols), np.float32)
    template(s.reshape(n, 5 * rows, cols), network(n), np.float32(tuning.residual_scale), weights, mean)
    w, m = np.ascontiguousarray(weights[:, :rows]), mean.reshape(5, rows, cols)
    samples = np.ascontiguousarray(s[:, 0])
    A, b = np.empty((rows, M, M)), np.empty((rows, M))
    kernels.joint_normal_equations(
        samples, w, m, owner, centres_of(views), np.array([p.translation for p in poses]),
        _precision(samples, w, m[0], tuning), ground.xs, ground.ys, height, ground.about, ground.arm,
        np.ascontiguousarray(ground.kappa), A, b,
    )  # fmt: skip
    upper = A.sum(axis=0)
    return upper + np.triu(upper, 1).T, b.sum(axis=0)


def _crosses(views: list[Prepared], ground: RefinementCells, height: F32, held: Buffers) -> F32:
    """Samples (N, 5, R, C) at the cells and `arm` metres east, west, north and south of them."""
    n, (rows, cols), a = len(views), height.shape, ground.arm
    out = held.get("crosses", (n, 5, rows, cols))
    xs, ys, level = ground.xs, ground.ys, np.tile(height, (3, 1))
    for i, view in enumerate(views):  # cells, north and south at once: starting many small loops is slow
        straight = sample(view.norm, *maps_at(view, xs, np.concatenate([ys, ys + a, ys - a]), level, held))
        out[i, [0, 3, 4]] = straight.reshape(3, rows, cols)
        for k, east in ((1, a), (2, -a)):
            sample(view.norm, *maps_at(view, xs + east, ys, height, held), out=out[i, k])
    return out


def _precision(samples: F32, weights: F32, mean: F32, tuning: PoseRefinementTuning) -> F64:
    """One over the variance of each view's samples; 0 for a view that shares too little ground."""
    e = np.where(weights > 0, samples - mean, np.float32(0))
    total = weights.sum(axis=(1, 2), dtype=np.float64)
    enough = (weights > 0).sum(axis=(1, 2)) >= tuning.least_cells
    variance = (weights * e * e).sum(axis=(1, 2), dtype=np.float64) / np.maximum(total, 1e-9)
    return np.asarray(np.where(enough, 1.0 / (tuning.correlated * np.maximum(variance, 1e-4)), 0.0))
