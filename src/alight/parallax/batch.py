"""Batch parallax: one grid, all views that saw it, from nothing to heights with sigma and flags.

Plane sweep with semi-global aggregation at half resolution, visibility by ray test, Gauss-Newton at full resolution.
For recorded flights, photos, and the restart after a gap.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from alight.geometry import Grid
from alight.parallax import refine, trust
from alight.parallax.edges import sharpen
from alight.parallax.sweep import planes, sweep
from alight.parallax.views import Prepared, choose, maps, prepare
from alight.records import F32, U8, Heights, View
from alight.settings import Parallax

COARSE = 2  # cells of the sweep over cells of the grid
MAX_TANGENT = 0.4  # horizontal over vertical distance of a view that is preferred
ITERATIONS = 4


def coarse_grid(grid: Grid, factor: int) -> Grid:
    """The grid of `factor` x `factor` cells taken as one."""
    shift = 0.5 * (factor - 1) * grid.cell
    return Grid(
        grid.east + shift, grid.north - shift, grid.cell * factor, -(-grid.rows // factor), -(-grid.cols // factor)
    )


def enlarge(values: F32, grid: Grid, factor: int, smooth: bool) -> F32:
    """Bring coarse values to the grid; bilinear where four neighbours are known, the nearest otherwise."""
    shape = (values.shape[1] * factor, values.shape[0] * factor)
    nearest = cv2.resize(values, shape, interpolation=cv2.INTER_NEAREST)
    if smooth:
        linear = cv2.resize(values, shape, interpolation=cv2.INTER_LINEAR)
        nearest = np.where(np.isnan(linear), nearest, linear)
    return np.ascontiguousarray(nearest[: grid.rows, : grid.cols], dtype=np.float32)


class Images:
    """The views of one recording, made ready for matching when first asked for; the last ones asked for are kept."""

    def __init__(self, views: Sequence[View], cell: float, height: float, keep: int = 64) -> None:
        self.views = views
        self.cell = cell
        self.height = height  # metres, of the ground in general: for the ground sampling distance
        self._ready: OrderedDict[tuple[int, bool], Prepared] = OrderedDict()
        self._keep = keep

    def get(self, index: int, coarse: bool) -> Prepared:
        """View `index` at the cell of the grid, or of the sweep."""
        key = (index, coarse)
        if key not in self._ready:
            cell = self.cell * COARSE if coarse else self.cell
            self._ready[key] = prepare(self.views[index], cell, self.height)
            while len(self._ready) > 2 * self._keep:
                self._ready.popitem(last=False)
        self._ready.move_to_end(key)
        return self._ready[key]


def match(images: Images, grid: Grid, low: float, high: float, settings: Parallax) -> Heights | None:
    """Estimate the heights of one grid from the views that see it (docs/method.md, section 3).

    Args:
        images: posed views; those that do not see the grid are ignored.
        grid: cells to estimate, of the images' cell.
        low, high: heights searched, metres above the origin.

    Returns:
        The heights, or None where fewer than two views see the grid.
    """
    chosen = choose(images.views, grid, 0.5 * (low + high), settings.views, MAX_TANGENT)
    if len(chosen) < 2:
        return None
    wide = coarse_grid(grid, COARSE)
    coarse = [images.get(i, coarse=True) for i in chosen]
    found, ratio = sweep(coarse, wide, planes(coarse, low, high, wide.cell), images.height)
    start = enlarge(found, grid, COARSE, smooth=True)
    if not np.isfinite(start).any():
        return None
    fine = [images.get(i, coarse=False) for i in chosen]
    per_px = refine.metres_per_pixel(fine, start, grid)
    start = sharpen(fine, grid, start, per_px)
    hidden = refine.hidden_from(fine, grid, start, per_px)
    fit = refine.gauss_newton(fine, grid, start, hidden, ITERATIONS)
    ambiguity = enlarge(ratio, grid, COARSE, smooth=False)
    return judged([images.views[i] for i in chosen], fine, grid, fit, ambiguity, hidden, (low, high))


def judged(
    views: list[View],
    fine: list[Prepared],
    grid: Grid,
    fit: refine.Fit,
    ratio: F32,
    hidden: NDArray[np.bool_],
    searched: tuple[float, float],
) -> Heights:
    """Put sigma, flags and colour to a fit."""
    per_px = refine.metres_per_pixel(fine, fit.height, grid)
    placed = [maps(p, grid, fit.height) for p in fine]
    contrast, grey = trust.photometry(fine, placed)
    seen = trust.Evidence(ratio, contrast, grey, *searched)
    sigma = trust.sigma(fit, per_px, grid.cell)
    flags = trust.flags(fit, seen, sigma, per_px)
    rgb = colour(views, fine, grid, placed, np.isfinite(fit.height), hidden)
    return Heights(grid, fit.height, sigma, flags, fit.seen, rgb, trust.residual_share(fit))


def colour(
    views: list[View],
    fine: list[Prepared],
    grid: Grid,
    placed: list[tuple[F32, F32]],
    wanted: NDArray[np.bool_],
    hidden: NDArray[np.bool_],
) -> U8:
    """What the steepest view that sees each wanted cell saw, (R, C, 3); `placed` are the maps of `fine`."""
    out = np.zeros((*grid.shape, 3), np.uint8)
    xs, ys = grid.xy()
    left = wanted.copy()
    order = np.argsort([np.hypot(v.centre[0] - xs.mean(), v.centre[1] - ys.mean()) for v in views])
    for strict in (True, False):
        for i in order:
            mx, my = placed[i]
            ok = left & (mx >= 0) & ~(hidden[i] & strict)
            if ok.any():
                scale = views[i].camera.width / fine[i].camera.width
                offset = np.float32(0.5 * scale - 0.5)
                picture = views[i].image
                picture = picture if picture.ndim == 3 else cv2.cvtColor(picture, cv2.COLOR_GRAY2RGB)
                seen = cv2.remap(
                    picture, mx * np.float32(scale) + offset, my * np.float32(scale) + offset, cv2.INTER_LINEAR
                )
                out[ok] = seen[ok]
                left &= ~ok
    return out
