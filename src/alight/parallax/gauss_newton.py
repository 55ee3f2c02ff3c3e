"""Gauss-Newton on the world grid: sub-pixel heights from the gradient of the mean of all views.

docs/method/parallax.md, eqs. 8-12
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from alight.arrays import F32, F64, U8, Mask
from alight.geometry import Box, Grid
from alight.parallax import gauss_newton_kernels as kernels
from alight.parallax import uncertainty_kernels, view_kernels, visibility_kernels
from alight.parallax.sorting_kernels import network
from alight.parallax.views import BLOCK, Buffers, Prepared, centres_of, maps, stack
from alight.raster import upsample
from alight.settings.tuning.parallax import RefinementTuning

SEEN_BLOCK = 4  # cells


@dataclass(frozen=True, eq=False)
class Fit:
    """Heights of a grid, with statistics of the last Gauss-Newton step; all arrays are (R, C)."""

    grid: Grid
    height: F32
    precision: F32  # windowed Lambda (eq. 9), normalised grey^2 / m^2
    noise: F32  # windowed residual variance s^2 (eq. 10), normalised grey^2
    mean: F32  # template m (eq. 8), normalised grey
    used: U8  # number of views that agree with the template
    seen: U8  # number of views that see the cell
    metres_per_px: F32  # parallax pixel, metres: height that moves the outermost of these views apart by one cell


def median_height(height: F32, none: float = 0.0) -> float:
    """Return the median of a subset of the known heights (R, C), metres; `none` if all heights are NaN."""
    for every in (8, 1):
        some = height[::every, ::every]
        some = some[np.isfinite(some)]
        if some.size:
            return float(np.median(some))
    return none


@dataclass(frozen=True, eq=False)
class ViewGeometry:
    """Geometry of the views that see each cell; (R, C) arrays, constant over blocks of `SEEN_BLOCK` cells a side."""

    baseline: F32  # metres between the outermost views that see the cell
    count: U8  # number of views that see the cell
    metres_per_px: F32  # parallax pixel, metres: height that moves these views apart by one cell (eq. 3b)
    sampling: F32  # metres of ground per pixel of the second finest of these views, at least the cell size
    views: Mask  # (N, R / SEEN_BLOCK, C / SEEN_BLOCK), rounded up: whether each view sees the block


def view_geometry(prepared: list[Prepared], grid: Grid, height: F32, ground: float) -> ViewGeometry:
    """Return the geometry of the views over heights `height` (R, C), metres; unknown ones are set to the median.

    If all heights are unknown, the height `ground` (metres) replaces them.
    """
    wide = grid.coarser(SEEN_BLOCK)
    k = min(SEEN_BLOCK // 2, *(n - 1 for n in grid.shape))
    known = height[k::SEEN_BLOCK, k::SEEN_BLOCK]
    level = np.full(wide.shape, median_height(height, ground), np.float32)
    inner = level[: known.shape[0], : known.shape[1]]
    np.copyto(inner, known, where=np.isfinite(known))
    columns = np.empty((len(prepared), *wide.shape), np.float32)
    for p, out in zip(prepared, columns, strict=True):
        out[:] = maps(p, *wide.xy(), level)[0]
    centres, focal = centres_of(prepared), np.array([p.camera.fu for p in prepared])
    baseline, per_px, sampling = (np.empty(wide.shape, np.float32) for _ in range(3))
    count = np.empty(wide.shape, np.uint8)
    view_kernels.seen_from(columns, centres, focal, *wide.xy(), level, grid.cell, baseline, count, per_px, sampling)
    n, shape = SEEN_BLOCK, grid.shape
    return ViewGeometry(
        upsample(baseline, n, shape), upsample(count, n, shape), upsample(per_px, n, shape),
        upsample(sampling, n, shape), columns >= 0,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Skyline:
    """Height map at half resolution, used to test whether the map blocks the rays to the cameras."""

    grid: Grid  # its cells are 2 x 2 cells of the map
    solid: F32  # (R / 2, C / 2) metres, without single spikes; NaN = unknown
    tops: F32  # metres, highest that a ray from each block of `BLOCK` x `BLOCK` cells to a camera can meet

    @classmethod
    def of(cls, height: F32, grid: Grid, centres: F64) -> Skyline:
        """Build the skyline of a height map (R, C) for cameras at `centres` (N, 3); all in metres."""
        wide = grid.coarser(2)
        height = np.ascontiguousarray(height[::2, ::2])
        solid = cv2.medianBlur(np.where(np.isfinite(height), height, -np.float32(np.inf)), 3)
        tops = _tops(solid, wide, centres)
        solid[np.isneginf(solid)] = np.nan
        return cls(wide, solid, tops)

    def visible(self, centres: F64, where: Box, metres_per_px: F32, rise_px: float) -> U8:
        """Return a raster (N, R / 2, C / 2) of a part of the map: 1 where camera i sees the map, 0 where not (eq. 13).

        A cell is hidden where the map rises more than `rise_px` parallax pixels above the ray to the camera.

        Args:
            centres: (N, 3) camera centres, metres.
            where: rows and columns of the part of the map; both start at an even number.
            metres_per_px: (R, C) parallax pixel of that part, metres.
        """
        margin = np.ascontiguousarray(np.float32(rise_px) * metres_per_px[::2, ::2])
        out = np.empty((len(centres), *margin.shape), np.uint8)
        top, left = (s.start // 2 for s in where)
        visibility_kernels.visibility(
            self.solid, self.tops, BLOCK, centres, *self.grid.xy(), self.grid.cell, margin, top, left, out
        )
        return out


def _tops(solid: F32, grid: Grid, centres: F64) -> F32:
    """Return, per block of cells of `solid`, the highest height (m) that a ray to a camera at `centres` can meet."""
    tops = np.empty(tuple(-(-n // BLOCK) for n in grid.shape), np.float32)
    visibility_kernels.block_tops(solid, BLOCK, -np.inf, tops)
    high = float(tops.max())
    if high == -np.inf:
        return tops
    low = float(solid.min(where=solid > -np.inf, initial=high))
    xs, ys = grid.xy()
    corner = np.array([[x, y] for x in (xs[0], xs[-1]) for y in (ys[0], ys[-1])])
    flattest = max(np.linalg.norm(corner - c[:2], axis=1).max() / max(c[2] - high, 1e-2) for c in centres)
    # a height above a camera may be reached by any ray: then the reach is all of the map
    reach = min(math.ceil((high - low) * flattest / (grid.cell * BLOCK)) + 1, max(tops.shape))
    return np.asarray(cv2.dilate(tops, np.ones((2 * reach + 1,) * 2, np.uint8)), dtype=np.float32)


def gauss_newton(
    prepared: list[Prepared],
    grid: Grid,
    height: F32,
    metres_per_px: F32,
    visible: U8,
    tuning: RefinementTuning,
    buffers: Buffers | None = None,
) -> Fit:
    """Refine heights so that the views agree in every window of cells (docs/method/parallax.md).

    Args:
        prepared: N views.
        height: (R, C) initial heights, metres; NaN stays NaN.
        metres_per_px: (R, C) parallax pixel, metres.
        visible: (N, R / 2, C / 2), rounded up: 0 where the map hides a cell from a view. That view is not used for the
            cell, unless fewer than two views see it: then the map is wrong.
        buffers: arrays to reuse; the fit is valid until they are used again.

    Returns:
        The heights after the last iteration, with the statistics of its start.
    """
    held = buffers or Buffers()
    shape, xs_ys = grid.shape, grid.xy()
    names = ("height", "precision", "noise", "mean", "lambda", "eta", "s2", "step")
    h, precision, noise, mean, lam, eta, s2, step = (held.get(name, shape) for name in names)
    used, seen = held.get("used", shape, np.uint8), held.get("seen", shape, np.uint8)
    np.copyto(h, height)
    centres, scale = centres_of(prepared), np.float32(tuning.residual_scale)
    for _ in range(tuning.iterations):
        samples = stack(prepared, grid, h, held)
        uncertainty_kernels.veil(visible, samples)
        kernels.normal_equations(
            samples, network(len(samples)), scale, centres, *xs_ys, h, grid.cell, mean, used, seen, lam, eta, s2
        )  # fmt: skip
        kernels.solve_window(lam, eta, s2, h, metres_per_px, tuning.step_px, step, precision, noise)
        moved = np.add(h, step, out=step)
        visibility_kernels.plane_prior(moved, precision, noise, metres_per_px, tuning.plane_prior, h)
    return Fit(grid, h, precision, noise, mean, used, seen, metres_per_px)
