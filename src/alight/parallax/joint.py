"""Poses refined with the map: exposures, plane, heights and template in one small solve (docs/method.md, section 6).

The pictures fix how the exposures and the map lie to each other; where all of them lie together no picture tells, and
there the belief stands. A cell's height and template value are eliminated, held to the map as well as the map is known.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from alight.geometry import Grid, Pose, ground_projection
from alight.kernels import joint as kernels
from alight.kernels.parallax import template
from alight.kernels.sorting import network
from alight.parallax.belief import PLANE, POSE, Belief, moved
from alight.parallax.refine import TAU, centres_of
from alight.parallax.views import Buffers, Prepared, stack
from alight.records import F32, F64

log = logging.getLogger(__name__)

CELLS = 1500  # that take part
LEAST = 40  # cells that a view must share with others
CORRELATED = 4.0  # of the variance: samples of neighbouring cells are not independent
UNLIKELY = 6.0  # squared error over its covariance, a degree of freedom, at which nothing is believed
APPARENT_PX = 0.03  # px by which a picture as a whole is off, however many cells it has


@dataclass(frozen=True, eq=False)
class Sight:
    """One view, as it takes part."""

    prepared: Prepared
    body_from_cam: Pose
    exposure: int  # t_ns

    def at(self, world_from_body: Pose) -> Prepared:
        """The same picture seen from elsewhere."""
        return posed(self.prepared, world_from_body @ self.body_from_cam)


@dataclass(frozen=True, eq=False)
class Ground:
    """The cells that take part."""

    grid: Grid
    height: F32  # (R, C) metres, NaN: takes no part
    kappa: F32  # (R, C) one over the variance of a height about the map's plane
    about: F64  # (2,) metres, where the plane's offset is meant
    arm: float  # metres, of the template's gradient

    def tilted(self, plane: F64) -> F32:
        """The heights with an error of the plane taken out."""
        return self.height + plane_on(self.grid, plane, self.about)


def plane_on(grid: Grid, plane: F64, about: F64) -> F32:
    """Heights (R, C) of a plane (3,) that is `plane[0]` high `about` (2,)."""
    x, y = grid.xy()
    up = plane[0] + plane[1] * (x - about[0])[None, :] + plane[2] * (y - about[1])[:, None]
    return np.asarray(up, dtype=np.float32)


Look = tuple[list[Sight], Ground]  # pictures and cells of one linearisation


def posed(prepared: Prepared, world_from_cam: Pose) -> Prepared:
    """The same picture seen from elsewhere."""
    H, b = ground_projection(prepared.camera, world_from_cam)
    return replace(prepared, H=H, b=b, centre=np.array(world_from_cam.translation))


def thinned(grid: Grid, count: int) -> tuple[Grid, int]:
    """Every k-th cell, so that about `count` are left."""
    k = max(1, round((grid.rows * grid.cols / count) ** 0.5))
    first = k // 2
    rows, cols = -(-max(grid.rows - first, 1) // k), -(-max(grid.cols - first, 1) // k)
    return Grid(grid.east + first * grid.cell, grid.north - first * grid.cell, grid.cell * k, rows, cols), k


def refined(belief: Belief, looks: Sequence[Look], pixel: float, drop: float, ring: int) -> tuple[Belief, F64]:
    """The belief with what the pictures say, and the plane (3,) by which the map was off (eqs. 17 to 24).

    Args:
        belief: prior.
        looks: one a linearisation, of exposures that the belief knows.
        pixel: rad.
        drop: metres from the cameras to the ground.
        ring: steps that a picture takes part in; its information is shared among them.
    """
    P, x, held = belief.covariance, belief.start.copy(), Buffers()
    x[:PLANE] = -belief.plane
    index = {t: k for k, t in enumerate(belief.times)}
    apparent = np.tile(np.repeat([APPARENT_PX * pixel * drop, APPARENT_PX * pixel], 3) ** 2, len(belief.times))
    F, one = np.concatenate([np.zeros(PLANE), apparent]), np.eye(len(P))
    A, whitened = np.zeros_like(P), np.asarray(np.zeros(len(x)))
    for sights, ground in looks:
        owner = np.array([index[s.exposure] for s in sights], np.int64)
        poses = [moved(p, x[PLANE + POSE * k :][:POSE]) for k, p in enumerate(belief.poses)]
        views = [s.at(poses[k]) for s, k in zip(sights, owner, strict=True)]
        A, b = _information(views, owner, poses, ground, ground.tilted(belief.plane + x[:PLANE]), held)
        known = np.linalg.inv(one + A * F)
        A, b = known @ A, known @ b
        whitened = np.asarray(np.linalg.solve(one + A @ P, b + A @ x))  # P^-1 x
        x = P @ whitened
    if whitened @ x > UNLIKELY * len(x):
        log.info("the pictures contradict what is believed of the poses, which stay as they were")
        return belief, np.zeros(PLANE)
    after = P @ np.linalg.inv(one + A @ P / ring)
    return belief.corrected(x, 0.5 * (after + after.T)), belief.plane + x[:PLANE]


def _information(
    views: list[Prepared], owner: NDArray[np.int64], poses: list[Pose], ground: Ground, height: F32, held: Buffers
) -> tuple[F64, F64]:
    """Normal equations at one linearisation: A (M, M) and b (M,), M = 3 + 6E."""
    s = _crosses(views, ground, height, held)
    n, (rows, cols), M = len(views), ground.grid.shape, PLANE + POSE * len(poses)
    weights, mean = np.empty((n, 5 * rows, cols), np.float32), np.empty((5 * rows, cols), np.float32)
    template(s.reshape(n, 5 * rows, cols), network(n), TAU, weights, mean)
    w, m = np.ascontiguousarray(weights[:, :rows]), mean.reshape(5, rows, cols)
    samples = np.ascontiguousarray(s[:, 0])
    A, b = np.empty((rows, M, M)), np.empty((rows, M))
    kernels.normal_equations(
        samples, w, m, owner, centres_of(views), np.array([p.translation for p in poses]),
        _precision(samples, w, m[0]), *ground.grid.xy(), height, ground.about, ground.arm, ground.kappa, A, b,
    )  # fmt: skip
    whole = A.sum(axis=0)
    whole[PLANE:, :PLANE] = whole[:PLANE, PLANE:].T
    return whole, b.sum(axis=0)


def _crosses(views: list[Prepared], ground: Ground, height: F32, held: Buffers) -> F32:
    """Samples (N, 5, R, C) at the cells and `arm` metres east, west, north and south of them."""
    out, a = held.get("crosses", (len(views), 5, *ground.grid.shape)), ground.arm
    for k, (east, north) in enumerate(((0.0, 0.0), (a, 0.0), (-a, 0.0), (0.0, a), (0.0, -a))):
        moved_by = replace(ground.grid, east=ground.grid.east + east, north=ground.grid.north + north)
        out[:, k] = stack(views, moved_by, height, held)
    return out


def _precision(samples: F32, weights: F32, mean: F32) -> F64:
    """One over the variance of each view's samples; 0 for a view that shares too little."""
    e = np.where(weights > 0, samples - mean, np.float32(0))
    total = weights.sum(axis=(1, 2), dtype=np.float64)
    enough = (weights > 0).sum(axis=(1, 2)) >= LEAST
    variance = (weights * e * e).sum(axis=(1, 2), dtype=np.float64) / np.maximum(total, 1e-9)
    return np.asarray(np.where(enough, 1.0 / (CORRELATED * np.maximum(variance, 1e-4)), 0.0))
