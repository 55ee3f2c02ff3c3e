"""Recursive parallax: a ring of keyframes, one step for each new one, heights carried from step to step.

The open problem of the 2004 paper. What is carried is the height itself with its sigma, never a sum of old gradients: a
sample slides by (X - C) / (Z - h) a metre in every view, so stored sums go stale as soon as a height moves. A cell
enters the map by a sweep of its own, as soon as the views that see it span `FIRST_LOOK` of the height; from then on it
starts from the map.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from alight.geometry import Grid, box_of
from alight.kernels import trust as kernels
from alight.parallax import refine, trust
from alight.parallax.batch import COARSE, interpolated, judged, picture_at
from alight.parallax.sweep import planes, sweep
from alight.parallax.views import Buffers, Prepared, maps, prepare
from alight.records import F32, U8, ElevationMap, Heights, View
from alight.settings import Parallax

FIRST_LOOK = 0.12  # baseline over height that a cell needs to be swept; 0.04 left four times the wrong heights
LEAST_VIEWS = 3  # of that sweep
SPAN = 0.8  # baseline over height beyond which a keyframe leaves the ring
STEPS = 1  # Gauss-Newton steps a keyframe
UNKNOWN_RATIO = np.float32(0.6)  # ambiguity of a cell whose sweep was not kept
WORSE = 1.5  # a look whose sigma is larger by this changes nothing
BELOW = 0.12  # horizontal over vertical distance at which the newest view renews the colour
FUSED = ("height", "sigma", "flags", "views", "residual")

Kept = tuple[View, Prepared, Prepared]  # at the cells of the map, and of the sweep


class Ring:
    """Keyframes at distances that grow with age, and the step that they allow."""

    def __init__(self, settings: Parallax, cell: float, ground: float) -> None:
        self._settings = settings
        self._cell, self._ground = cell, ground
        self._kept: list[list[Kept]] = []
        self._ratio: tuple[Grid, F32] | None = None  # ambiguity, carried along with the window
        self._buffers = Buffers()

    def push(self, views: list[View]) -> None:
        """Take the images of one exposure; the one that is missed least leaves."""
        self._kept.append(
            [(v, prepare(v, self._cell, self._ground), prepare(v, self._cell * COARSE, self._ground)) for v in views]
        )
        centres = np.array([exposure[0][0].centre for exposure in self._kept])
        above = max(centres[-1][2] - self._ground, 1e-2)
        away = np.linalg.norm(centres - centres[-1], axis=1) / above
        self._kept = [self._kept[i] for i in spread_out(away, self._settings.ring)]

    def step(self, grid: Grid, known: ElevationMap, low: float, high: float) -> Heights | None:
        """Improve the heights of a window with the ring as it is now (docs/method.md, section 5).

        Args:
            grid: the window, cells on the map's raster.
            known: what the map has there.
            low, high: heights searched where nothing is known.

        Returns:
            The window after the step, or None while no cell has seen enough parallax.
        """
        views = [k for exposure in self._kept for k in exposure]
        fine = [f for _, f, _ in views]
        seen = refine.sight(fine, grid, known.height)
        ratio = self._carried(grid)
        start = self._first_look(views, grid, known.height, self._parallax_enough(seen, grid), ratio, low, high)
        self._ratio = (grid, ratio)
        if not np.isfinite(start).any():
            return None
        per_px = refine.enlarged(seen.metres_per_px, grid, refine.SEEN_BLOCK)
        visible = refine.visible_from(fine, grid, start, per_px)
        fit = refine.gauss_newton(fine, grid, start, per_px, visible, STEPS, self._buffers)
        rgb = self._coloured(views[-1], grid, start, fit.height, known)
        return fused(judged(fine[-1:], grid, fit, ratio, (low, high), rgb), known, self._settings.ring)

    def _carried(self, grid: Grid) -> F32:
        """The ambiguity of 2 x 2 cells of the window."""
        wide = grid.coarser(COARSE)
        out = np.full(wide.shape, UNKNOWN_RATIO, np.float32)
        if self._ratio is None:
            return out
        old, values = self._ratio[0].coarser(COARSE), self._ratio[1]
        dr, dc = round((old.north - wide.north) / wide.cell), round((wide.east - old.east) / wide.cell)
        r = slice(max(0, -dr), min(wide.rows, old.rows - dr))  # rows of the new window that the old one had
        c = slice(max(0, -dc), min(wide.cols, old.cols - dc))
        if r.stop > r.start and c.stop > c.start:
            out[r, c] = values[r.start + dr : r.stop + dr, c.start + dc : c.stop + dc]
        return out

    def _parallax_enough(self, seen: refine.Sight, grid: Grid) -> NDArray[np.bool_]:
        """Where at least `LEAST_VIEWS` see the ground over a baseline of `FIRST_LOOK`, (R, C)."""
        above = self._kept[-1][-1][0].centre[2] - self._ground
        enough = (seen.baseline >= FIRST_LOOK * above) & (seen.count >= LEAST_VIEWS)
        return refine.enlarged(enough.view(np.uint8), grid, refine.SEEN_BLOCK).view(np.bool_)

    def _first_look(
        self, views: list[Kept], grid: Grid, before: F32, enough: NDArray[np.bool_], ratio: F32, low: float, high: float
    ) -> F32:
        """Sweep the rectangle about the cells that are seen well for the first time; `ratio` gets their ambiguity."""
        fresh = np.isnan(before) & enough
        if not fresh.any():
            return before
        where = tuple(slice(s.start - s.start % COARSE, s.stop) for s in box_of(fresh))
        part = grid.window(where[0].start, where[1].start, *fresh[where].shape)
        wide = part.coarser(COARSE)
        coarse = [c for _, _, c in views]
        found, ambiguity = sweep(coarse, wide, planes(coarse, low, high, wide.cell), self._ground)
        out = before.copy()
        out[where] = np.where(fresh[where], interpolated(found, part), before[where])
        half = tuple(slice(s.start // COARSE, s.start // COARSE + n) for s, n in zip(where, wide.shape, strict=True))
        some = trust.halved(fresh[where].astype(np.float32)) > 0
        ratio[half] = np.where(some, ambiguity, ratio[half])
        return out

    def _coloured(self, newest: Kept, grid: Grid, start: F32, height: F32, known: ElevationMap) -> U8:
        """The map's colour, renewed by the newest view just below it and where there was none."""
        view, fine, _ = newest
        out = known.rgb.copy()
        row, col = (float(v) for v in grid.index(view.centre[0], view.centre[1]))
        k = BELOW * (view.centre[2] - self._ground) / grid.cell
        below = (slice(max(0, int(row - k)), max(0, int(row + k))), slice(max(0, int(col - k)), max(0, int(col + k))))
        looks: list[tuple[tuple[slice, slice], NDArray[np.bool_] | None]] = [(below, None)]
        if start is not known.height:
            fresh = np.isnan(known.height) & np.isfinite(height)
            looks.insert(0, (box_of(fresh), fresh))
        for where, only in looks:
            r, c = where
            part = grid.window(r.start, c.start, *height[where].shape)
            if not part.rows * part.cols:
                continue
            mapx, mapy = maps(fine, part, np.ascontiguousarray(height[where]))
            take = mapx >= 0  # not where there is no height
            if only is not None:
                take &= only[where]
            np.copyto(out[where], picture_at(view, fine, mapx, mapy), where=take[..., None])
        return out


def spread_out(away: NDArray[np.float64], count: int) -> list[int]:
    """Choose `count` keyframes, oldest first, whose distances from the newest grow evenly in proportion.

    `away` (N,): baseline to the newest, the last, over the height. The nearest find what is new, the farthest measure
    it best; what is farther than `SPAN` sees too little of what the newest sees.
    """
    kept = [i for i in range(len(away)) if away[i] < SPAN]
    while len(kept) > count:
        gaps = [
            (away[kept[k - 1]] - away[kept[k + 1]]) / (away[kept[k]] + 0.02) for k in range(1, len(kept) - 1)
        ]  # what would be left open, in proportion
        kept.pop(1 + int(np.argmin(gaps)))
    return kept


def fused(new: Heights, old: ElevationMap, ring: int) -> Heights:
    """Weigh a step against the map (eq. 16).

    Consecutive rings share all but one exposure, so a step brings 1/ring of its information. Heights that disagree by
    more than three sigma are not averaged: the new one stands. Where the ring sees a cell much worse than it once did,
    at the edge of its pictures, the map stays as it is.
    """
    out = replace(new, height=new.height.copy(), views=new.views.copy())  # the rest is not held in buffers
    kernels.fuse(*(getattr(out, f) for f in FUSED), *(getattr(old, f) for f in FUSED), ring, WORSE)
    return out
