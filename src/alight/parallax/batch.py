"""Batch parallax: heights with sigma and flags of one grid, from all views that see it, without initial heights.

The stages are plane sweeps along rays with semi-global aggregation, visibility by ray test, and Gauss-Newton. Used for
recorded flights, photos, and the restart after a gap.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Hashable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from threading import Lock

import numpy as np

from alight.arrays import F64, I64, U8, U16
from alight.geometry import Grid
from alight.parallax import gauss_newton as refine
from alight.parallax import temporal_consistency as witness
from alight.parallax import uncertainty as trust
from alight.parallax.plane_sweep import Swept, sweep, sweep_unseen
from alight.parallax.views import Kept, Prepared, centres_of, choose_views, colour_at, maps, prepare_view, stack
from alight.raster import upsample
from alight.records import Heights, View
from alight.settings import ParallaxSettings

MOST_BYTES = 400_000_000  # bytes of prepared views that stay in memory
LEAST_KEPT = 16  # prepared views that stay in memory, however large
LEAST_ACROSS = 64  # cells that the shorter side of a halved picture must cover: smaller ones show too little


def fuse_sweeps(sweeps: Sequence[Swept]) -> Swept:
    """Return, per cell, the height and cost ratio of that sweep whose height is the (lower) median of all sweeps."""
    heights = np.stack([s.height for s in sweeps])
    order = np.argsort(heights, axis=0)  # NaN last
    middle = np.maximum(np.isfinite(heights).sum(axis=0) - 1, 0) // 2
    which = np.take_along_axis(order, middle[None], axis=0)
    return Swept(*(np.take_along_axis(np.stack(v), which, axis=0)[0] for v in zip(*sweeps, strict=True)))


class Images:
    """Thread-safe store of the views of one recording, each prepared for matching at its first use."""

    def __init__(self, views: Sequence[View], cell: float, height: float | F64, most_bytes: int = MOST_BYTES) -> None:
        self.views = views
        self.cell = cell
        self.heights = np.broadcast_to(height, len(views))  # metres, ground height in each view, for its resolution
        self._ready: OrderedDict[Hashable, Kept] = OrderedDict()
        self._most_bytes = most_bytes
        self._lock = Lock()

    def of(self, views: Sequence[View], heights: F64) -> Images:
        """Return a store of other `views`; both stores share the prepared views.

        `heights`: (N,) metres, height of the ground in each view.
        """
        other = copy(self)
        other.views, other.heights = views, heights
        return other

    def get(self, index: int, halved: int = 0) -> Prepared:
        """Return the view of index `index`, prepared for the cell size, with its resolution halved `halved` times."""
        key = self.views[index].key
        with self._lock:
            if key not in self._ready:
                view = self.views[index]
                fine = prepare_view(view, self.cell, float(self.heights[index]))
                self._ready[key] = Kept(view.without_image, [fine])
                each = 4 / 3 * (fine.grey.nbytes + fine.norm.nbytes)  # with all halvings
                while len(self._ready) > max(LEAST_KEPT, self._most_bytes / each):
                    self._ready.popitem(last=False)
            self._ready.move_to_end(key)
            return self._ready[key].halved(halved)


@dataclass(frozen=True, eq=False)
class MatchedBlock:
    """Heights of a grid, and the (N,) indices of the views from which they were matched."""

    heights: Heights
    chosen: I64


def match_tile(images: Images, grid: Grid, low: float, high: float, settings: ParallaxSettings) -> MatchedBlock | None:
    """Estimate the heights of one grid from the views that see it (docs/method/parallax.md).

    Args:
        images: posed views; those that do not see the grid are ignored.
        grid: cells to estimate, with the cell size of `images`.
        low, high: range of heights to search, metres above the origin.

    Returns:
        The heights and the indices of their views; None if fewer than two views see the grid, or no height was found.
    """
    plan = settings.sweep
    chosen = choose_views(images.views, grid, 0.5 * (low + high), settings.views, plan.max_tangent)
    if len(chosen) < 2:
        return None
    fine = [images.get(i) for i in chosen]
    ground = min(max(float(np.median(images.heights[chosen])), low), high)
    views = [images.views[i] for i in chosen]
    few, of = (
        choose_views(views, grid, 0.5 * (low + high), n, plan.max_tangent) for n in (settings.ring, plan.references)
    )
    across = float(np.median([min(p.camera.width, p.camera.height) / p.ratio for p in fine]))
    halvings = sum(across >= LEAST_ACROSS << k for k in range(1, plan.halvings + 1))
    levels = [fine, *([images.get(i, k) for i in chosen] for k in range(1, halvings + 1))]
    swept = [[prepared[k] for k in few] for prepared in levels]
    start, ratio = fuse_sweeps([sweep(swept, grid, (low, high), ground, few.index(k), plan) for k in of])
    rest, its_ratio = sweep_unseen(swept, grid, (low, high), ground, np.isnan(start), plan, start)
    start, ratio = (np.where(np.isnan(start), b, a) for a, b in ((start, rest), (ratio, its_ratio)))
    if not np.isfinite(start).any():
        return None
    seen = refine.view_geometry(fine, grid, start, ground)
    centres, whole = centres_of(fine), (slice(0, grid.rows), slice(0, grid.cols))
    skyline = refine.Skyline.of(start, grid, centres)
    visible = skyline.visible(centres, whole, seen.metres_per_px, settings.uncertainty.step_px)
    fit = refine.gauss_newton(fine, grid, start, seen.metres_per_px, visible, settings.refinement)
    rgb = colour(views, fine, fit, visible)
    ratio = trust.half_resolution(np.where(np.isnan(ratio), np.float32(1), ratio))
    heights = trust.judged(fit, ratio, fine, (low, high), seen.sampling, rgb, settings.uncertainty)
    flags = heights.flags | _moves(images, chosen, fit, settings)
    return MatchedBlock(replace(heights, flags=flags), np.array(chosen, np.int64))


def _moves(images: Images, chosen: Sequence[int], fit: refine.Fit, settings: ParallaxSettings) -> U16:
    """Return (R, C) MOVING flags at the heights of `fit` from pairs of synchronous views, at least one in `chosen`.

    There are at most as many pairs as a sweep has views.
    """
    pairs = witness.instants(images.views)
    some = pairs[np.isin(pairs, chosen).any(axis=1)]
    some = some[np.unique(np.linspace(0, len(some) - 1, min(settings.ring, len(some))).astype(int))]
    if not len(some):
        return np.zeros(fit.grid.shape, np.uint16)
    samples = stack([images.get(int(i)) for i in some.ravel()], fit.grid, fit.height)
    return witness.moving(samples, np.arange(some.size).reshape(-1, 2), fit, settings.uncertainty)


def colour(views: list[View], fine: list[Prepared], fit: refine.Fit, visible: U8) -> U8:
    """Return the colours (R, C, 3) of the cells, each from the steepest view that sees it; black if none does.

    `views` are N views, `fine` the same views, prepared. `fit`: the heights. `visible`: (N, R / 2, C / 2), 0 where the
    map hides a cell from a view.
    """
    grid, height = fit.grid, fit.height
    out = np.zeros((*grid.shape, 3), np.uint8)
    xs, ys = grid.xy()
    left = np.isfinite(height)
    order = np.argsort([np.hypot(v.centre[0] - xs.mean(), v.centre[1] - ys.mean()) for v in views])
    for strict in (True, False):
        for i in order:
            if not left.any():
                return out
            mx, my = maps(fine[i], xs, ys, height)
            ok = left & (mx >= 0) & ((upsample(visible[i], 2, grid.shape) > 0) | (not strict))
            if ok.any():
                out[ok] = colour_at(views[i], fine[i], mx, my)[ok]
                left &= ~ok
    return out
