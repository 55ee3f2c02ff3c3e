"""Gauss-Newton on the world grid: sub-pixel heights from the fused template's gradient (docs/method.md, eqs. 8-12)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from alight.geometry import Grid
from alight.kernels import parallax as kernels
from alight.kernels import surface, trust
from alight.kernels.sorting import network
from alight.parallax.views import Buffers, Prepared, maps, stack
from alight.records import F32, F64

TAU = np.float32(0.35)  # normalised grey, Huber's knee
SEEN_BLOCK = 4  # cells
BLOCK = 8  # cells of half resolution
LOWEST = np.float32(-1e4)  # metres: stands for an unknown height
HIDE_PX = 3.0  # parallax pixels that the map must rise above a ray to stop it
STEP_PX = 0.5  # parallax pixels of the widest baseline a step may go
# of the plane prior: 1 over its variance in parallax pixels^2, for cells taken as independent, which they are not:
# neighbours share pixels, so 100 left three times the noise on a concrete slab
PRIOR = 2500.0
# offsets (dx, dy) of one neighbour of each opposite pair: of 7 x 7 cells these 16 smooth as well as all 24
PRIOR_PAIRS = np.array(
    [
        (1, 0), (0, 1), (1, 1), (-1, 1), (2, 1), (1, 2), (-2, 1), (-1, 2),
        (3, 0), (0, 3), (3, 1), (1, 3), (-3, 1), (-1, 3), (3, 3), (-3, 3),
    ],
    dtype=np.int64,
)  # fmt: skip


@dataclass(eq=False)
class Fit:
    """Heights and what the last step knew about them; all (R, C)."""

    height: F32
    precision: F32  # Lambda of the window, normalised grey^2 / m^2
    noise: F32  # s2 of the window, normalised grey^2
    mean: F32  # template m
    used: NDArray[np.uint8]  # views that agreed
    seen: NDArray[np.uint8]  # views that saw the cell
    metres_per_px: F32  # height that moves the outermost of them apart by one cell


def centres_of(prepared: list[Prepared]) -> F64:
    """Camera centres (N, 3)."""
    return np.array([p.centre for p in prepared])


def middle(height: F32) -> float:
    """About the median of the known heights, metres; 0 where none is known. The exact one costs a step's time."""
    for every in (8, 1):
        some = height[::every, ::every]
        some = some[np.isfinite(some)]
        if some.size:
            return float(np.median(some))
    return 0.0


def _drop(centres: F64, height: F32) -> F32:
    """From the cameras down to each cell, metres."""
    level = np.where(np.isfinite(height), height, np.float32(middle(height)))
    return np.asarray(np.maximum(np.float32(centres[:, 2].mean()) - level, 1e-2), dtype=np.float32)


def metres_per_pixel(prepared: list[Prepared], height: F32, grid: Grid) -> F32:
    """Height that moves the outermost pair of views by one cell, (R, C) metres."""
    centres = centres_of(prepared)
    spread = np.linalg.norm(centres[:, None, :2] - centres[None, :, :2], axis=2).max()
    return np.asarray(grid.cell / max(spread, 1e-6) * _drop(centres, height), dtype=np.float32)


def baselines(prepared: list[Prepared], grid: Grid, height: F32) -> tuple[F32, NDArray[np.uint8]]:
    """Metres between the outermost views that see each cell, and their number, (R, C); looked at in blocks of cells."""
    wide = grid.coarser(SEEN_BLOCK)
    k = min(SEEN_BLOCK // 2, *(n - 1 for n in grid.shape))
    level = height[k::SEEN_BLOCK, k::SEEN_BLOCK]
    some = np.full(wide.shape, middle(height), np.float32)
    inner = some[: level.shape[0], : level.shape[1]]
    np.copyto(inner, level, where=np.isfinite(level))
    seen = np.array([maps(p, wide, some)[0] for p in prepared])
    seen[seen < 0] = np.nan
    baseline, count = np.empty(wide.shape, np.float32), np.empty(wide.shape, np.uint8)
    kernels.baseline(seen, centres_of(prepared), baseline, count)
    return enlarged(baseline, grid, SEEN_BLOCK), enlarged(count, grid, SEEN_BLOCK)


def enlarged(values: NDArray[Any], grid: Grid, factor: int) -> NDArray[Any]:
    """The values of blocks of `factor` x `factor` cells on the cells of the grid."""
    return np.repeat(np.repeat(values, factor, axis=0), factor, axis=1)[: grid.rows, : grid.cols]


def visible_from(prepared: list[Prepared], grid: Grid, height: F32, metres_per_px: F32) -> NDArray[np.uint8]:
    """(N, R / 2, C / 2): 0 where the map stands between a cell and the camera (eq. 13); single spikes hide nothing."""
    wide = grid.coarser(2)
    height, metres_per_px = height[::2, ::2], metres_per_px[::2, ::2]
    centres = centres_of(prepared)
    out = np.empty((len(prepared), *wide.shape), np.uint8)
    solid = cv2.medianBlur(np.where(np.isfinite(height), height, LOWEST), 3)
    tops = _tops(solid, wide, centres)
    solid[solid <= LOWEST] = np.nan
    margin = np.asarray(HIDE_PX * metres_per_px, dtype=np.float32)
    surface.visibility(solid, tops, BLOCK, centres, *wide.xy(), wide.cell, margin, out)
    return out


def _tops(solid: F32, grid: Grid, centres: F64) -> F32:
    """For each block of cells the highest height within reach of its rays to the cameras."""
    rows, cols = (-(-n // BLOCK) for n in grid.shape)
    padded = np.full((rows * BLOCK, cols * BLOCK), LOWEST, np.float32)
    padded[: grid.rows, : grid.cols] = solid
    tops = np.ascontiguousarray(padded.reshape(rows, BLOCK, cols, BLOCK).max(axis=(1, 3)))
    known = solid[solid > LOWEST]
    if not known.size:
        return tops
    low, high = float(known.min()), float(known.max())
    xs, ys = grid.xy()
    corner = np.array([[x, y] for x in (xs[0], xs[-1]) for y in (ys[0], ys[-1])])
    flattest = max(np.linalg.norm(corner - c[:2], axis=1).max() / max(c[2] - high, 1e-2) for c in centres)
    reach = math.ceil((high - low) * flattest / (grid.cell * BLOCK)) + 1
    return np.asarray(cv2.dilate(tops, np.ones((2 * reach + 1,) * 2, np.uint8)), dtype=np.float32)


def gauss_newton(
    prepared: list[Prepared],
    grid: Grid,
    height: F32,
    visible: NDArray[np.uint8] | None,
    iterations: int,
    buffers: Buffers | None = None,
    prior: float = PRIOR,
) -> Fit:
    """Refine `height` (R, C) so that all views of each window agree; NaN stays NaN.

    `visible` (N, R / 2, C / 2) leaves views out where the map stands in their way, unless it leaves one only: then the
    map is wrong. What the fit knows beside the heights is of where the last iteration began.
    """
    held = buffers or Buffers()
    shape, xs_ys = grid.shape, grid.xy()
    a, b, c = (np.zeros(shape, np.float32) for _ in range(3))
    fit = Fit(height.copy(), a, b, c, np.zeros(shape, np.uint8), np.zeros(shape, np.uint8), np.zeros(shape, np.float32))
    lam, eta, s2, step = (held.get(name, shape) for name in ("lambda", "eta", "s2", "step"))
    centres = centres_of(prepared)
    wide, _ = baselines(prepared, grid, height)
    drop = _drop(centres, height)
    spread = fit.metres_per_px = np.float32(grid.cell) * drop / np.maximum(wide, np.float32(0.01) * drop)
    limit = np.float32(STEP_PX) * spread
    for _ in range(iterations):
        samples = stack(prepared, grid, fit.height, held)
        if visible is not None:
            trust.veil(visible, samples)
        kernels.normal_equations(
            samples, network(len(samples)), TAU, centres, *xs_ys, fit.height, grid.cell,
            fit.mean, fit.used, fit.seen, lam, eta, s2,
        )  # fmt: skip
        kernels.solve(lam, eta, s2, fit.height, spread, limit, step, fit.precision, fit.noise)
        moved = np.add(fit.height, step, out=step)
        surface.plane_prior(moved, fit.precision, fit.noise, spread, np.float32(prior), PRIOR_PAIRS, fit.height)
    return fit
