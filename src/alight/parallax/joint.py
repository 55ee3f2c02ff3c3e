"""Poses refined with the map: exposures, heights and template in one small solve (docs/method.md, section 6).

The pictures fix how the exposures lie to each other, the prior fixes what pictures cannot know: where all of them lie
together. A cell's height and template value are eliminated, so nothing depends on how good the map already is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from alight.geometry import Grid, Pose, ground_projection
from alight.kernels import joint as kernels
from alight.kernels.parallax import template
from alight.kernels.sorting import network
from alight.parallax.refine import TAU, centres_of
from alight.parallax.views import Buffers, Prepared, stack
from alight.records import F32, F64, Gauge

CELLS = 5000  # that take part
LEAST = 40  # cells that a view must share with others
CORRELATED = 4.0  # of the variance: samples of neighbouring cells are not independent
APPARENT_PX = 0.03  # px by which a picture as a whole is off, however many cells it has


@dataclass(frozen=True, eq=False)
class Sight:
    """One view of an exposure, as it takes part."""

    prepared: Prepared
    body_from_cam: Pose
    owner: int  # exposure


@dataclass(frozen=True, eq=False)
class Aligned:
    """What the pictures and the prior say together."""

    poses: list[Pose]  # (E) world_from_body
    covariance: F64  # (6E, 6E)
    information: F64  # (6E, 6E) that the pictures brought
    gauge: Gauge


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


def crosses(prepared: list[Prepared], grid: Grid, height: F32, arm: float, held: Buffers) -> F32:
    """Samples (N, 5, R, C) at the cells and `arm` metres east, west, north and south of them."""
    out = held.get("crosses", (len(prepared), 5, *grid.shape))
    for k, (east, north) in enumerate(((0, 0), (arm, 0), (-arm, 0), (0, arm), (0, -arm))):
        moved = replace(grid, east=grid.east + east, north=grid.north + north)
        out[:, k] = stack(prepared, moved, height, held)
    return out


def _sums(
    prepared: list[Prepared], owner: Sequence[int], pivots: F64, grid: Grid, height: F32, loose: F32, arm: float
) -> tuple[F64, F64, F64, F64]:
    """Normal equations of one linearisation: A (6E, 6E), b (6E,), tie (3, 6E), level (3, 4)."""
    held = Buffers()
    s = crosses(prepared, grid, height, arm, held)
    n, rows, cols = len(prepared), *grid.shape
    weights, mean = np.empty((n, 5 * rows, cols), np.float32), np.empty((5 * rows, cols), np.float32)
    used, number = np.empty(mean.shape, np.uint8), np.empty(mean.shape, np.uint8)
    template(s.reshape(n, 5 * rows, cols), network(n), TAU, weights, mean, used, number)
    w, m = np.ascontiguousarray(weights[:, :rows]), mean.reshape(5, rows, cols)
    samples = np.ascontiguousarray(s[:, 0])
    precision = _precision(samples, w, m[0])
    middle = np.array([grid.east + 0.5 * grid.cell * cols, grid.north - 0.5 * grid.cell * rows, 0.0])
    xs, ys = grid.xy()
    e6 = 6 * len(pivots)
    A, b = np.empty((rows, e6, e6)), np.empty((rows, e6))
    tie, level = np.empty((rows, 3, e6)), np.empty((rows, 3, 4))
    kernels.normal_equations(
        samples, w, m, np.asarray(owner, np.int64), centres_of(prepared) - middle, pivots - middle, precision,
        xs - middle[0], ys - middle[1], height, arm, loose, A, b, tie, level,
    )  # fmt: skip
    return A.sum(0), b.sum(0), tie.sum(0), level.sum(0)


def _precision(samples: F32, weights: F32, mean: F32) -> F64:
    """One over the variance of each view's samples; 0 for a view that shares too little."""
    e = np.where(weights > 0, samples - mean, np.float32(0))
    total = weights.sum(axis=(1, 2), dtype=np.float64)
    enough = (weights > 0).sum(axis=(1, 2)) >= LEAST
    variance = (weights * e * e).sum(axis=(1, 2), dtype=np.float64) / np.maximum(total, 1e-9)
    return np.asarray(np.where(enough, 1.0 / (CORRELATED * np.maximum(variance, 1e-4)), 0.0))
