"""Recursive parallax: a ring of keyframes, one step for each new one, heights carried from step to step.

The open problem of the 2004 paper. What is carried is the height itself with its sigma, never a sum of old gradients: a
sample slides by (X - C) / (Z - h) a metre in every view, so stored sums go stale as soon as a height moves. A cell
enters the map by a sweep, as soon as the views that see it span `first_baseline` of the height; from then on it
starts from the map.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from alight.arrays import F32, F64, U8
from alight.geometry import Grid, box_of
from alight.parallax import gauss_newton as refine
from alight.parallax import temporal_consistency as witness
from alight.parallax import uncertainty as trust
from alight.parallax import uncertainty_kernels as kernels
from alight.parallax.batch import judged, picture_at
from alight.parallax.plane_sweep import sweep_unseen
from alight.parallax.pose_refinement.alignment import Alignment, Kept
from alight.parallax.views import Buffers, Prepared, coarser, maps, prepare_view
from alight.raster import close_mask, weighted_gaussian
from alight.records import ElevationMap, Heights, KeyframePosterior, View
from alight.settings import ParallaxSettings

GAP = 4  # cells: a gap narrower than twice that, between heights, starts from them
FUSED = ("height", "sigma", "flags", "views", "residual", "sampling")


class RecursiveParallax:
    """Keyframes at distances that grow with age, and the step that they allow."""

    def __init__(self, settings: ParallaxSettings, cell: float, ground: float) -> None:
        self._settings, self._tuning = settings, settings.recursive
        self._unswept = np.float32(settings.recursive.unknown_ratio)
        self._cell, self._ground = cell, ground
        self._kept: list[list[Kept]] = []
        self._unknown = self._unswept
        self._ratio: tuple[Grid, F32] | None = None  # ambiguity, carried along with the window; NaN: look anew
        self._sharper = False  # the cells became smaller: the colours of the map are coarse
        self._buffers = Buffers()
        self._alignment = Alignment(settings.ring, settings.poses)

    @property
    def plane(self) -> F64:
        """Error of the map that the last step found: (3,) up, and rise a metre towards east and north."""
        return self._alignment.plane

    @property
    def about(self) -> F64:
        """The place (2,) east and north to which the offset of `plane` refers."""
        return self._alignment.about

    def plane_on(self, grid: Grid) -> F32:
        """`plane` at the cells of a grid, (R, C) metres."""
        return self._alignment.plane_on(grid)

    def work_at(self, cell: float, ground: float) -> None:
        """Go on with cells of this size (metres) above a ground of this height; the kept pictures are made ready anew.

        Pictures that were made ready for another ground stay as they are: the height only says how much to smooth.
        """
        self._ground = ground
        if cell != self._cell:
            self._sharper = cell < self._cell
            self._cell = cell
            if self._ratio is not None:  # the other cells confirm or refute what the sweep found
                self._ratio = self._ratio[0], np.sqrt(self._ratio[1] * self._unswept)
            self._kept = [[self._ready(v) for v, _, _ in exposure] for exposure in self._kept]

    def look_anew(self) -> None:
        """Sweep every cell again before its height is used."""
        self._ratio, self._unknown = None, np.float32(np.nan)

    def _ready(self, view: View) -> Kept:
        fine = prepare_view(view, self._cell, self._ground)
        return view, fine, coarser(fine)

    def push(self, views: list[View], poses: KeyframePosterior | None = None) -> None:
        """Take the images of one exposure, late or not; the keyframe that leaves the smallest gap is dropped.

        `poses`: posterior of the keyframes, this one among them; None: the poses of the views are used as given.
        """
        if any(exposure[0][0].t_ns == views[0].t_ns for exposure in self._kept):
            return  # a repeated time: the same picture twice would agree with itself
        self._kept.append([self._ready(v) for v in views])
        self._kept.sort(key=lambda exposure: exposure[0][0].t_ns)
        centres = np.array([exposure[0][0].centre for exposure in self._kept])
        drop = max(centres[-1][2] - self._ground, 1e-2)
        away = np.linalg.norm(centres - centres[-1], axis=1) / drop
        self._kept = [self._kept[i] for i in spread_baselines(away, self._settings.ring, self._tuning.span)]
        if poses is not None:
            times = {exposure[0][0].t_ns for exposure in self._kept}
            self._alignment.update_posterior(poses, times, drop)

    def step(self, grid: Grid, known: ElevationMap, low: float, high: float) -> Heights | None:
        """Improve the heights of a window with the ring as it is now (docs/method/recursive.md).

        Args:
            grid: the window, cells on the map's raster.
            known: what the map has there.
            low, high: heights searched where nothing is known.

        Returns:
            The window after the step, or None while no cell has seen enough parallax.
        """
        ratio = self._carried(grid)
        self._kept = self._alignment.align(self._kept, grid, known, np.isnan(ratio), self._ground)
        if self.plane.any():
            known = replace(known, height=known.height + self.plane_on(grid))
        views = [k for exposure in self._kept for k in exposure]
        fine = [f for _, f, _ in views]
        seen = refine.view_geometry(fine, grid, known.height)
        per_px = refine.enlarged(seen.metres_per_px, grid, refine.SEEN_BLOCK)
        start, wrong = self._sweep_new(fine, grid, known.height, ratio, seen, per_px, (low, high))
        self._ratio = (grid, ratio)
        enough = (seen.count >= self._tuning.first_views).astype(np.float32)
        start = _bridged(start, ~np.isnan(ratio) & (refine.enlarged(enough, grid, refine.SEEN_BLOCK) > 0.5))
        if not np.isfinite(start).any():
            return None
        tuning = self._settings.refinement
        visible = refine.visible_from(fine, grid, start, per_px, tuning.occlusion_px)
        fit = refine.gauss_newton(fine, grid, start, per_px, visible, self._tuning.steps, tuning, self._buffers)
        rgb = self._coloured(views[-1], grid, fit.height, known)
        ratio = trust.half_resolution(np.where(np.isnan(ratio) | np.isnan(start), self._unswept, ratio))
        if wrong.any():
            known = replace(known, height=np.where(wrong, np.float32(np.nan), known.height))
        found = judged(fine[-1:], grid, fit, ratio, (low, high), seen, rgb, self._settings.uncertainty)
        samples = self._buffers.get("samples", (len(fine), *grid.shape))  # as the fit left them
        pairs, consistency = witness.instants([v for v, _, _ in views]), self._settings.consistency
        moves = witness.moving(samples, pairs, fit, grid, consistency.least_views, consistency)
        found = replace(found, flags=found.flags | moves)
        return replace(fused(found, known, self._tuning.worse), gauge=self._alignment.gauge(grid))

    def _carried(self, grid: Grid) -> F32:
        out = np.full(grid.shape, self._unknown, np.float32)
        if self._ratio is not None:
            old, values = self._ratio
            (row, r), (col, c) = (_shared(*i) for i in zip(old.index(*grid.xy()), old.shape, strict=True))
            if r.size and c.size:
                same = old.cell == grid.cell  # then both are ranges, and views are copied fast
                there = values[row[0] : row[-1] + 1, col[0] : col[-1] + 1] if same else values[np.ix_(row, col)]
                out[r[0] : r[-1] + 1, c[0] : c[-1] + 1] = there
        return out

    def _sweep_new(
        self,
        fine: list[Prepared],
        grid: Grid,
        before: F32,
        ratio: F32,
        seen: refine.ViewGeometry,
        per_px: F32,
        searched: tuple[float, float],
    ) -> tuple[F32, NDArray[np.bool_]]:
        """Sweep the cells that have enough baseline for the first time since the restart; `ratio` gets their ambiguity.

        The map is shifted to the sweep as a whole and keeps its shape, except where they differ by more than
        `same_px`. Cells not swept yet are left out of the step.

        Returns:
            Initial heights (R, C) metres, and the mask of cells whose height in the map is wrong.
        """
        drop, anew = fine[-1].centre[2] - self._ground, np.isnan(ratio)
        wide = seen.baseline / np.float32(self._tuning.first_baseline * drop)
        base = np.where(seen.count >= self._tuning.first_views, wide, np.float32(0))
        asked = np.where(ratio >= 1, 2 * ratio, np.float32(1))  # after a sweep in vain, twice the baseline
        fresh = (np.isnan(before) | anew) & (refine.enlarged(base, grid, refine.SEEN_BLOCK) >= asked)
        start = np.where(anew, np.float32(np.nan), before)
        if not fresh.any():
            return start, fresh
        ground = float(np.clip(self._ground, *searched))
        new, found = sweep_unseen(fine, grid, searched, ground, fresh, self._settings.sweep)
        shifted = before + shift_of((new - before)[fresh], per_px[fresh], self._tuning.shift_px)
        new = np.where(np.abs(new - shifted) < self._tuning.same_px * per_px, shifted, new)
        wrong = fresh & np.isfinite(before) & np.isfinite(new) & (new != before)
        np.copyto(start, new, where=fresh)
        np.copyto(ratio, np.where(np.isnan(new), asked, found), where=fresh)
        return start, wrong

    def _coloured(self, newest: Kept, grid: Grid, height: F32, known: ElevationMap) -> U8:
        """The map's colour, renewed by the newest view just below it and where there was none."""
        view, fine, _ = newest
        out = known.rgb.copy()
        row, col = (float(v) for v in grid.index(view.centre[0], view.centre[1]))
        k = self._tuning.renew_below * (view.centre[2] - self._ground) / grid.cell
        under = (slice(max(0, int(row - k)), max(0, int(row + k))), slice(max(0, int(col - k)), max(0, int(col + k))))
        fresh = (np.isnan(known.height) | self._sharper) & np.isfinite(height)
        self._sharper = False
        for where, only in ((box_of(fresh), fresh), (under, None)):
            r, c = where
            part = grid.window(r.start, c.start, *height[where].shape)
            if not part.rows * part.cols:
                continue
            mapx, mapy = maps(fine, part, np.ascontiguousarray(height[where]))
            take = mapx >= 0  # not where there is no height
            if only is not None:
                take &= only[where]
            cv2.copyTo(picture_at(view, fine, mapx, mapy), take.view(np.uint8), out[where])
        return out


def _shared(index: F64, size: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows (or columns) that two grids share: indices (K,) in the grid of `size` rows, and in the other grid."""
    nearest = np.rint(index).astype(np.intp)
    has = np.flatnonzero((nearest >= 0) & (nearest < size))
    return nearest[has], has


def _bridged(start: F32, wanted: NDArray[np.bool_]) -> F32:
    """Narrow gaps that are `wanted` start from the heights beside them.

    A sweep at the rim of the pictures is often in vain, and the next one has to wait for twice the baseline. Without
    this, the rims of earlier steps stay in the map as seams, one cell wide, that no touchdown may cross.
    """
    known = np.isfinite(start)
    gaps = wanted & ~known & close_mask(known, GAP)
    if not gaps.any():
        return start
    return np.where(gaps, weighted_gaussian(start, known.astype(np.float32), GAP).mean, start)


def shift_of(apart: F32, per_px: F32, least_px: float) -> np.float32:
    """Median difference of a sweep and the map, metres; 0 where it is below `least_px` or they share no cell."""
    both = np.isfinite(apart)
    if not both.any():
        return np.float32(0)
    shift = np.median(apart[both])
    return np.float32(shift if abs(shift) > least_px * np.median(per_px[both]) else 0)


def spread_baselines(away: NDArray[np.float64], count: int, span: float) -> list[int]:
    """Choose `count` keyframes, oldest first, whose distances from the newest grow evenly in proportion.

    `away` (N,): baseline to the newest, the last, over the height. The nearest find what is new, the farthest measure
    it best; what is farther than `span` sees too little of what the newest sees.
    """
    kept = [i for i in range(len(away)) if away[i] < span]
    while len(kept) > count:
        gaps = [
            (away[kept[k - 1]] - away[kept[k + 1]]) / (away[kept[k]] + 0.02) for k in range(1, len(kept) - 1)
        ]  # what would be left open, in proportion
        kept.pop(1 + int(np.argmin(gaps)))
    return kept


def fused(new: Heights, old: ElevationMap, worse: float) -> Heights:
    """Weigh a step against the map (eq. 16).

    Heights that disagree by more than three sigma are not averaged: the new one replaces the old. Where the new sigma
    is much larger than the old, at the edge of the pictures, the map stays as it is.
    """
    out = replace(new, height=new.height.copy(), views=new.views.copy())  # the rest is not held in buffers
    kernels.fuse(*(getattr(out, f) for f in FUSED), *(getattr(old, f) for f in FUSED), worse)
    return out
