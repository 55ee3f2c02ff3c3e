"""Recursive parallax: a ring of keyframes, one step for each new one, heights carried from step to step.

The open problem of the 2004 paper. What is carried is the height itself with its sigma, never a sum of old gradients: a
sample slides by (X - C) / (Z - h) a metre in every view, so stored sums go stale as soon as a height moves. Cells that
are seen for the first time get a sweep of their own; the others start from the map.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from alight.geometry import Grid
from alight.parallax import refine
from alight.parallax.batch import COARSE, coarse_grid, enlarge, judged
from alight.parallax.sweep import parallax_per_metre, planes, sweep
from alight.parallax.views import Prepared, prepare
from alight.records import F32, Heights, View
from alight.settings import Parallax

LEAST_SLIDE = 0.04  # baseline over height that a first look needs
STEPS = 2  # Gauss-Newton steps a keyframe
UNKNOWN_RATIO = np.float32(0.6)  # ambiguity of a cell whose sweep was not kept


class Ring:
    """The last exposures of the rig, and the step that they allow."""

    def __init__(self, settings: Parallax, cell: float, ground: float) -> None:
        self._settings = settings
        self._cell, self._ground = cell, ground
        self._kept: deque[list[tuple[View, Prepared, Prepared]]] = deque(maxlen=settings.ring)
        self._ratio: tuple[Grid, F32] | None = None  # ambiguity, carried along with the window

    def push(self, views: list[View]) -> None:
        """Take the images of one exposure; the oldest exposure leaves."""
        ready = []
        for v in views:
            coarse = prepare(v, self._cell * COARSE, self._ground)
            ready.append((v, prepare(v, self._cell, self._ground), coarse))
        self._kept.append(ready)

    def step(self, grid: Grid, before: F32, sigma: F32, low: float, high: float) -> Heights | None:
        """Improve the heights of a window with the ring as it is now (docs/method.md, section 5).

        Args:
            grid: the window, cells on the map's raster.
            before: (R, C) heights that the map has, metres; NaN = never seen.
            sigma: (R, C) their 1-sigma.
            low, high: heights searched where nothing is known.

        Returns:
            The window after the step, or None while the ring is too short to see any parallax.
        """
        views = [k for exposure in self._kept for k in exposure]
        fine = [f for _, f, _ in views]
        if len(views) < 2 or parallax_per_metre(fine, self._ground) < LEAST_SLIDE:
            return None
        ratio = self._carried(grid)
        start = self._first_look([c for _, _, c in views], grid, before, ratio, low, high)
        if not np.isfinite(start).any():
            return None
        per_px = refine.metres_per_pixel(fine, start, grid)
        hidden = refine.hidden_from(fine, grid, start, per_px)
        fit = refine.gauss_newton(fine, grid, start, hidden, STEPS)
        self._ratio = (grid, ratio)
        new = judged([v for v, _, _ in views], fine, grid, fit, ratio, hidden, (low, high))
        return fused(new, before, sigma, self._settings.ring)

    def _carried(self, grid: Grid) -> F32:
        out = np.full(grid.shape, UNKNOWN_RATIO, np.float32)
        if self._ratio is None:
            return out
        old, values = self._ratio
        dr, dc = round((old.north - grid.north) / grid.cell), round((grid.east - old.east) / grid.cell)
        r = slice(max(0, -dr), min(grid.rows, old.rows - dr))  # rows of the new window that the old one had
        c = slice(max(0, -dc), min(grid.cols, old.cols - dc))
        if r.stop > r.start and c.stop > c.start:
            out[r, c] = values[r.start + dr : r.stop + dr, c.start + dc : c.stop + dc]
        return out

    def _first_look(self, coarse: list[Prepared], grid: Grid, before: F32, ratio: F32, low: float, high: float) -> F32:
        """Sweep the rectangle about the cells that were never seen; `ratio` gets their ambiguity."""
        fresh = np.isnan(before)
        rows, cols = np.flatnonzero(fresh.any(axis=1)), np.flatnonzero(fresh.any(axis=0))
        if not len(rows):
            return before
        part = grid.window(int(rows[0]), int(cols[0]), int(rows[-1] - rows[0] + 1), int(cols[-1] - cols[0] + 1))
        wide = coarse_grid(part, COARSE)
        found, ambiguity = sweep(coarse, wide, planes(coarse, low, high, wide.cell), self._ground)
        where = (slice(rows[0], rows[-1] + 1), slice(cols[0], cols[-1] + 1))
        out = before.copy()
        out[where] = np.where(fresh[where], enlarge(found, part, COARSE, smooth=True), before[where])
        ratio[where] = np.where(fresh[where], enlarge(ambiguity, part, COARSE, smooth=False), ratio[where])
        return out


def fused(new: Heights, before: F32, sigma: F32, ring: int) -> Heights:
    """Weigh a step against the map (eq. 16).

    Consecutive rings share all but one exposure, so a step brings 1/ring of its information. Heights that disagree by
    more than three sigma are not averaged: the new one stands.
    """
    weight_old = 1.0 / np.maximum(sigma, 1e-4) ** 2
    weight_new = 1.0 / (ring * np.maximum(new.sigma, 1e-4) ** 2)
    both = np.isfinite(before) & np.isfinite(new.height) & np.isfinite(weight_old) & np.isfinite(weight_new)
    both &= np.abs(new.height - before) < 3 * np.sqrt(np.nan_to_num(sigma) ** 2 + np.nan_to_num(new.sigma) ** 2)
    total = weight_old + weight_new
    height = np.where(both, (weight_old * before + weight_new * new.height) / total, new.height)
    spread = np.where(both, np.maximum(1 / np.sqrt(total), 0.6 * new.sigma), new.sigma)
    return Heights(
        new.grid, height.astype(np.float32), spread.astype(np.float32), new.flags, new.views, new.rgb, new.residual
    )
