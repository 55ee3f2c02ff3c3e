"""Recursive estimator: a keyframe window, one step per new keyframe, heights carried from step to step.

This was the open problem of the 2004 paper. The height itself is carried with its sigma, not a sum of old gradients: a
sample slides by (X - C) / (Z - h) per metre in every view, so a changed height makes stored sums invalid. A cell enters
the map by a sweep, as soon as the views that see it span `first_baseline` of the height. From then on, each step starts
from the height in the map.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from alight.arrays import F32, U8, Mask
from alight.geometry import Box, Grid
from alight.parallax import gauss_newton as refine
from alight.parallax.blocks import EFFORTS, Blocks, Effort, Plan
from alight.parallax.plane_sweep import Swept, plane_count, sweep_unseen
from alight.parallax.pose_refinement.alignment import Alignment
from alight.parallax.views import Buffers, Kept
from alight.parallax.window import APART, BESIDE, Window, first_of_twins, unswept
from alight.raster import upsample
from alight.records import ElevationMap, Heights, KeyframePosterior, View, is_trusted
from alight.settings import ParallaxSettings


class RecursiveParallax:
    """Recursive estimator of heights, with a window of keyframes whose distances from the newest grow with age."""

    def __init__(self, settings: ParallaxSettings, cell: float, ground: float) -> None:
        self._settings, self._tuning = settings, settings.recursive
        # one reference: cells that it does not see may wait for the next keyframe
        self._sweep_tuning = settings.sweep.model_copy(update={"references": 1})
        self._unswept = self._unknown = np.float32(unswept(settings))
        self._cell, self._ground = cell, ground
        self.kept = dict[int, list[Kept]]()  # views of each exposure, by its time in ns, oldest first
        self._ratio: tuple[Grid, F32] | None = None  # `Window.ratio` of the last step, on its grid; None: nothing swept
        self.blocks, self._buffers = Blocks(settings.recursive), Buffers()
        self.alignment = Alignment(settings)
        self.came = list[tuple[Grid, Mask]]()  # rectangles of the last step; True: somebody came (eq. 16e)

    @property
    def beginning(self) -> bool:
        """Whether most of the window was refined too seldom for its known heights to represent the rest."""
        return self.blocks.begins

    def work_at(self, cell: float, ground: float) -> None:
        """Set the cell size and the ground height, metres; for a new `cell` the kept pictures are prepared again."""
        # pictures prepared for another ground height stay, because that height only affects their smoothing
        self._ground = ground
        if cell != self._cell:
            self.blocks.forget(sharper=cell < self._cell)
            self._cell = cell
            if self._ratio is not None:  # cells of the new size confirm or refute the sweep
                self._ratio = self._ratio[0], np.sqrt(self._ratio[1] * self._unswept)
            self.kept = {t: [Kept.of(k.view, cell, ground) for k in e] for t, e in self.kept.items()}

    def reset_sweep(self) -> None:
        """Discard all sweeps: every cell is swept again before its height is used, as at the beginning."""
        self._ratio, self._unknown = None, np.float32(np.nan)
        self.blocks.begin_anew()

    def push(self, views: list[View], poses: KeyframePosterior | None = None) -> None:
        """Add the images of one exposure, in or out of sequence; an exposure that is already held is ignored.

        A full window drops the keyframe whose loss leaves the smallest gap. `poses` is the posterior of the keyframes,
        including this exposure; None: the poses of the views are used as given.
        """
        if views[0].t_ns in self.kept:
            return  # a repeated time: a picture would agree with itself
        self.kept[views[0].t_ns] = [Kept.of(v, self._cell, self._ground) for v in views]
        exposures = sorted(self.kept.items())
        centres = np.array([exposure[0].view.centre for _, exposure in exposures])
        drop = max(centres[-1][2] - self._ground, 1e-2)
        away = np.linalg.norm(centres - centres[-1], axis=1) / drop
        span = 2 * self._settings.sweep.max_tangent  # from one side of a cell to the other
        self.kept = dict(exposures[i] for i in spread_baselines(away, self._settings.ring, span))
        if poses is not None:
            self.alignment.update_posterior(poses, set(self.kept), drop)

    def step(self, grid: Grid, known: ElevationMap, low: float, high: float, effort: int = 0) -> list[Heights]:
        """Refine the heights in a part of a window with the present keyframes (docs/method/recursive.md).

        Args:
            grid: the window, cells on the map's raster.
            known: the map on the window.
            low, high: range of heights to search where none is known, metres.
            effort: level of the effort, from 0 (full) to 3 (least).

        Returns:
            The refined rectangles with their new heights; an empty list while no cell has seen enough parallax.
        """
        ratio, chosen = np.full(grid.shape, self._unknown), EFFORTS[min(effort, len(EFFORTS) - 1)]
        if self._ratio is not None:
            ratio = self._ratio[0].nearest_on(grid, self._ratio[1], float(self._unknown))
        self.kept = self.alignment.align(self.kept, grid, known, np.isnan(ratio), self._ground)
        if self.alignment.plane.any():
            known = replace(known, height=known.height + self.alignment.plane_on(grid))
        window = self._window(grid, known, ratio, (low, high), chosen)
        plan = self._plan(window, chosen)
        start, wrong = self._swept(window, plan)
        self._ratio, self.came = (grid, ratio), []
        if not plan.refine:
            return []
        skyline = refine.Skyline.of(start, grid, np.array([k.fine.centre for k in window.kept]))
        datum, out = self.alignment.datum(grid), []
        for box in plan.refine:
            recolour = self.blocks.recolour and self.blocks.never_visited(box)
            found = window.refined(skyline, start, wrong, box, recolour)
            self._settle(None if found is None else found.heights, known, box)
            if found is not None:
                ratio[box][found.changed] = np.nan  # swept again; untrusted until then
                out.append(replace(found.heights, datum=datum))
                if found.came.any():
                    self.came.append((found.heights.grid, found.came))
        return out

    def _window(
        self, grid: Grid, known: ElevationMap, ratio: F32, searched: tuple[float, float], effort: Effort
    ) -> Window:
        """Return the window of a step with its views; `ratio`, `searched`: see `Window`; `effort` limits the views."""
        times, views = list(self.kept), [k for exposure in self.kept.values() for k in exposure]
        drop, rigs = float(self.kept[times[-1]][0].view.centre[2]) - self._ground, times[:: -effort.rigs]
        first = first_of_twins(views, APART * drop)
        kept = [k for i, k in enumerate(views) if first[i] == i or k.view.t_ns in rigs]
        ground = float(kept[-1].view.centre[2]) - drop
        seen = refine.view_geometry([k.fine for k in kept], grid, known.height, ground)
        twins = (first_of_twins(kept, share * drop) for share in (BESIDE, APART))
        return Window(self._settings, self._buffers, grid, known, kept, seen, ratio, searched, drop, *twins)

    def _views_of(self, window: Window, box: Box, fresh: Mask) -> list[Kept]:
        """Return views to sweep the `fresh` cells of a rectangle: of a few exposures over twice the least baseline."""
        # more exposures would blur the edges of objects, a longer baseline takes more planes
        seen = [window.kept[i] for i in np.unique(window.apart[window.views_of(box)])]
        wanted = max(1.0, float(np.median(self._wanted(window.ratio[box])[fresh])))
        span, newest = 2 * wanted * self._tuning.first_baseline * window.drop, seen[-1].view.centre
        near = [k for k in seen if np.linalg.norm(k.view.centre - newest) <= span]
        times = sorted({k.view.t_ns for k in near})
        at = np.linspace(0, len(times) - 1, min(self._tuning.first_exposures, len(times)))
        chosen = {times[round(float(i))] for i in at}
        return [k for k in near if k.view.t_ns in chosen]

    @staticmethod
    def _wanted(ratio: F32) -> F32:
        """Return the least baseline, in units of `first_baseline`, at which each cell is swept.

        `ratio`: see `Window.ratio`. A value of 1 or more is the baseline at which the last sweep failed; twice that
        baseline is returned. For a smaller value, the cost ratio of a sweep, and for NaN, 1 is returned.
        """
        return np.where(ratio >= 1, 2 * ratio, np.float32(1))

    def _has_baseline(self, baseline: F32, count: U8, ratio: F32, drop: float) -> Mask:
        """Return a mask of the cells with enough views and baseline to be swept; `ratio`: see `_wanted`.

        `baseline`: metres. `count`: number of views. `drop`: height of the camera above the ground, metres.
        """
        wide = baseline / np.float32(self._tuning.first_baseline * drop)
        return np.where(count >= self._tuning.first_views, wide, np.float32(0)) >= self._wanted(ratio)

    def _plan(self, window: Window, effort: Effort) -> Plan:
        every, drop = refine.SEEN_BLOCK, window.drop
        k = min(every // 2, *(n - 1 for n in window.grid.shape))
        at, seen = (slice(k, None, every), slice(k, None, every)), window.seen
        h, r, baseline, count = window.known.height[at], window.ratio[at], seen.baseline[at], seen.count[at]
        new, enough = np.isnan(h) | np.isnan(r), self._has_baseline(baseline, count, r, drop)
        kinds = np.array([new & enough, new & ~enough & (count > 0), ~new & (count >= 2)])
        self.blocks.move_to(window.grid)
        counts, newest = self.blocks.counted(kinds, every), window.kept[-1].view.centre
        row, col = (float(v) for v in window.grid.index(newest[0], newest[1]))
        low, high = window.searched
        slide = 2 * self._tuning.first_baseline
        planes = plane_count(slide, low, high, window.grid.cell, self._sweep_tuning.most_planes)
        up = float(newest[2])
        reach = drop / max(up - high, 0.1 * drop) - drop / max(up - low, 0.1 * drop)
        return self.blocks.plan(counts, (row, col), self._tuning.first_exposures * planes, reach, effort)

    def _settle(self, found: Heights | None, known: ElevationMap, box: Box) -> None:
        """Record which heights of rectangle `box` were replaced, became trusted, or lost trust.

        `found`: new heights; None: nothing was found. `known`: the map before the step.
        """
        every = refine.SEEN_BLOCK
        h0, s0, f0 = (getattr(known, k)[box][::every, ::every] for k in ("height", "sigma", "flags"))
        before = np.isfinite(h0)
        if found is None:
            return self.blocks.visited(box, before, ~before, every)
        h, s, f = (getattr(found, k)[::every, ::every] for k in ("height", "sigma", "flags"))
        changed = ((h - h0) ** 2 > 9 * (s**2 + s0**2)) | (is_trusted(f) != is_trusted(f0))
        return self.blocks.visited(box, before, changed, every)

    def _swept(self, window: Window, plan: Plan) -> tuple[F32, Mask]:
        """Sweep the planned cells; return initial heights (R, C), metres, and a mask of the map's heights to ignore.

        Heights are NaN in cells still to be swept. Where sweep and map agree to `same_px` parallax pixels, the map's
        height is used, shifted by their median difference. The cost ratios are written to the window's `ratio`.
        """
        anew = np.isnan(window.ratio)
        start, wrong = np.where(anew, np.float32(np.nan), window.known.height), np.zeros(anew.shape, np.bool_)
        for box in plan.sweep + plan.rough:
            before, per_px, doubt = window.known.height[box], window.seen.metres_per_px[box], window.ratio[box]
            seen = window.seen.baseline[box], window.seen.count[box]
            fresh = (np.isnan(before) | anew[box]) & self._has_baseline(*seen, doubt, window.drop)
            if not fresh.any():
                continue
            new, found = self._sweep(window, box, fresh, 0 if box in plan.sweep else 1)
            both = fresh & np.isfinite(before) & np.isfinite(new)
            shifted = before + shift_of((new - before)[both])
            new = np.where(np.abs(new - shifted) < self._tuning.same_px * per_px, shifted, new)
            np.copyto(wrong[box], both & (new != before))
            np.copyto(start[box], new, where=fresh)
            np.copyto(doubt, np.where(np.isnan(new), self._wanted(doubt), found), where=fresh)
        return start, wrong

    def _sweep(self, window: Window, box: Box, fresh: Mask, halvings: int) -> Swept:
        """Sweep the `fresh` cells of a rectangle, with the cell size doubled `halvings` times; return all its cells."""
        grid, ground, coarser = window.grid.part(box), float(np.clip(self._ground, *window.searched)), 1 << halvings
        ready = [v.halved(halvings) for v in self._views_of(window, box, fresh)]
        wanted = np.ascontiguousarray(fresh[::coarser, ::coarser])
        found = sweep_unseen([ready], grid.coarser(coarser), window.searched, ground, wanted, self._sweep_tuning)
        return Swept(*(upsample(v, coarser, grid.shape) for v in found))


def shift_of(apart: F32) -> np.float32:
    """Return the median of the differences `apart` between a sweep and the map, metres; 0 if all are NaN."""
    known = apart[np.isfinite(apart)]
    return np.float32(np.median(known) if known.size else 0)


def spread_baselines(away: NDArray[np.float64], count: int, span: float) -> list[int]:
    """Return the indices of up to `count` keyframes, oldest first, whose distances from the newest grow in proportion.

    Args:
        away: (N,) distance of each keyframe from the newest, which is the last, divided by the height above ground.
        span: keyframes at this distance or farther are left out: they see too little of the newest view's ground.
    """
    kept = [i for i in range(len(away)) if away[i] < span]
    while len(kept) > count:
        gaps = [
            (away[kept[k - 1]] - away[kept[k + 1]]) / (away[kept[k]] + 0.02) for k in range(1, len(kept) - 1)
        ]  # the gap that its loss would leave, in proportion
        kept.pop(1 + int(np.argmin(gaps)))
    return kept
