"""Which blocks of the window a step works on, so that steps cost alike (docs/method/recursive.md).

A new block is refined with every keyframe. What a further one adds falls with their number, so that the block then
waits the longer the more it has had. First sweeps are put off until the step's share of sweeping suffices.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from alight.arrays import F32, F64, I64, Mask
from alight.geometry import Grid
from alight.settings.tuning.parallax import RecursiveTuning

SIDE = 64  # cells of a block
LEAST = 8  # samples of a kind from which a block counts: one in 32
NEVER = -(1 << 30)
GAIN = 8192  # cells whose refinement costs as much as one rectangle more

Box = tuple[slice, slice]  # rows and columns of the window


@dataclass(frozen=True)
class Effort:
    """What a step may cost: a row of `EFFORTS`."""

    share: float  # of the cells and of the sweeping that a full step may do
    twins: bool  # cameras that see what another of their exposure sees from beside it take part


EFFORTS = (Effort(1.0, True), Effort(0.8, False), Effort(0.5, False), Effort(0.25, False))  # full, ..., least


class Counts(NamedTuple):
    """Samples of each kind in every block, (BR, BC)."""

    fresh: F32  # that a sweep may look at for the first time
    waiting: F32  # that will be, once seen over a longer baseline
    known: F32  # with a height, that two views see


class SweepCost(NamedTuple):
    """What the sweep of a block takes."""

    layers: float  # samples a cell: planes times views, at the sweep's cells
    reach: float  # cells about a block that rays through it cross as well, a cell of distance from below the camera


class Plan(NamedTuple):
    """The work of one step."""

    sweep: list[Box]  # whose new cells are swept
    refine: list[Box]  # sharing no cell, among them all that are swept


class Blocks:
    """The blocks under a window, in numbers of the map's raster, and what was done to each.

    Args:
        tuning: of the recursive step.
    """

    def __init__(self, tuning: RecursiveTuning) -> None:
        self._tuning, self._step = tuning, 0
        self._row, self._col, self._cell = 0, 0, 0.0
        self._first = np.zeros(2, np.int64)  # row and column of the window in the raster
        self._shape = (0, 0)  # of the window
        self._count, self._last, self._since = (np.zeros((0, 0), np.int64) for _ in range(3))
        self.recolour = False  # blocks that were never visited have coarse colours

    def forget(self, sharper: bool) -> None:
        """All blocks are new; their colours are coarse where the cells became smaller (`sharper`)."""
        self._count, self._last, self._since = (np.zeros((0, 0), np.int64) for _ in range(3))
        self.recolour = sharper

    def move_to(self, grid: Grid) -> None:
        """Begin a step over this window."""
        self._step += 1
        first = np.array([round(-grid.north / grid.cell - 0.5), round(grid.east / grid.cell - 0.5)])
        row, col = (int(v) for v in first // SIDE)
        rows, cols = (int(v) for v in (first + grid.shape - 1) // SIDE - (row, col) + 1)
        self._count, self._last, self._since = (
            _moved(old, (row - self._row, col - self._col), (rows, cols), empty)
            for old, empty in ((self._count, 0), (self._last, NEVER), (self._since, NEVER))
        )
        self._row, self._col, self._first, self._shape = row, col, first, grid.shape

    def counted(self, kinds: NDArray[np.bool_], every: int) -> Counts:
        """Sums of masks (3, R / every, C / every) of every so manieth cell, rounded up, over each block."""
        rows, cols = (
            _members(n, every, int(f) - SIDE * b, blocks)
            for n, f, b, blocks in zip(kinds.shape[1:], self._first, (self._row, self._col), self._count.shape, strict=True)
        )
        return Counts(*(rows @ kinds.astype(np.float32) @ cols.T))

    def plan(self, counts: Counts, below: tuple[float, float], sweep: SweepCost, effort: Effort) -> Plan:
        """Choose what to do; `below`: row and column of the window under the newest view."""
        middle = [SIDE * (b + np.arange(n) + 0.5) - f for b, n, f in zip(
            (self._row, self._col), self._count.shape, self._first, strict=True)]
        dr, dc = np.abs(middle[0][:, None] - below[0]), np.abs(middle[1][None, :] - below[1])
        away, costs = np.hypot(dr, dc), (SIDE + sweep.reach * dr) * (SIDE + sweep.reach * dc) * sweep.layers
        swept = self._to_sweep(counts, away, costs, effort.share * self._tuning.sweep_samples)
        wanted = self._to_refine(counts, away, swept, effort.share)
        self._count[swept] = 0
        self._since[swept] = NEVER
        return Plan(self._boxes(swept), self._boxes(wanted))

    def _to_sweep(self, counts: Counts, away: F64, costs: F64, budget: float) -> Mask:
        some = counts.fresh >= LEAST
        self._since = np.where(some, np.where(self._since == NEVER, self._step, self._since), NEVER)
        ready = some & ((counts.fresh >= counts.waiting) | (self._step - self._since >= self._tuning.patience))
        return _within(np.lexsort((away.ravel(), self._since.ravel())), ready, costs, budget)

    def _to_refine(self, counts: Counts, away: F64, swept: Mask, share: float) -> Mask:
        wait = np.clip(self._count / self._tuning.pace, 1.0, self._tuning.longest_wait)
        urgency = np.where(swept, np.inf, (self._step - self._last) / wait)
        urgency[away < SIDE * 0.75] += self._tuning.longest_wait  # seen best, and its colours are renewed
        due = swept | ((counts.known >= LEAST) & (urgency >= 1))
        budget = max(share * self._tuning.share * self._shape[0] * self._shape[1], share * self._tuning.least_cells)
        return swept | _within(np.lexsort((away.ravel(), -urgency.ravel())), due, np.full(due.shape, float(SIDE * SIDE)), budget)

    def _boxes(self, chosen: Mask) -> list[Box]:
        """Rectangles of cells of the window about chosen blocks."""
        out = []
        for top, left, bottom, right in rectangles(chosen):
            edges = zip((top, left), (bottom, right), (self._row, self._col), self._first, self._shape, strict=True)
            r, c = (slice(max(SIDE * (a + b) - f, 0), min(SIDE * (z + b) - f, n)) for a, z, b, f, n in edges)
            out.append((r, c))
        return out

    def never_visited(self, box: Box) -> bool:
        """Whether some block of a rectangle was never refined."""
        return bool((self._last[self._inside(box)] == NEVER).any())

    def visited(self, box: Box, changed: bool) -> None:
        """A rectangle was refined; where much of it `changed`, it is looked at again soon."""
        inside = self._inside(box)
        self._count[inside] = 0 if changed else self._count[inside] + 1
        self._last[inside] = self._step

    def _inside(self, box: Box) -> Box:
        numbers = zip(box, (self._row, self._col), self._first, strict=True)
        r, c = (slice((s.start + int(f)) // SIDE - b, (s.stop - 1 + int(f)) // SIDE - b + 1) for s, b, f in numbers)
        return r, c


def _moved(old: I64, by: tuple[int, int], shape: tuple[int, int], empty: int) -> I64:
    """The values of a raster of blocks on one that begins `by` blocks further and has another shape."""
    out = np.full(shape, empty, np.int64)
    there = [slice(max(b, 0), max(min(b + n, m), 0)) for b, n, m in zip(by, shape, old.shape, strict=True)]
    here = [slice(s.start - b, s.start - b + max(s.stop - s.start, 0)) for s, b in zip(there, by, strict=True)]
    part = old[there[0], there[1]]
    if part.size:
        out[here[0], here[1]] = part
    return out


def _members(count: int, every: int, first: int, blocks: int) -> F32:
    """(blocks, count) 1 where a sample, every so many cells, lies in a block."""
    at = (first + every // 2 + every * np.arange(count)) // SIDE
    return (at[None, :] == np.arange(blocks)[:, None]).astype(np.float32)


def _within(order: I64, wanted: Mask, costs: F64, budget: float) -> Mask:
    """The first of the wanted in an order whose costs are within a budget; one of them in any case."""
    ranked = order[wanted.ravel()[order]]
    spent = np.cumsum(costs.ravel()[ranked])
    out = np.zeros(wanted.size, np.bool_)
    out[ranked[: max(1, int(np.searchsorted(spent, budget, side="right")))]] = True
    return out.reshape(wanted.shape)


def rectangles(chosen: Mask) -> list[tuple[int, int, int, int]]:
    """Rectangles (top, left, bottom, right) of blocks that cover the chosen ones, few and sharing no block.

    Runs in a row, joined across gaps of one block; a run that continues the one above, or nearly, belongs to it.
    """
    open_, out = [], list[tuple[int, int, int, int]]()
    for r in range(chosen.shape[0]):
        runs = _runs(chosen[r])
        still = []
        for top, left, bottom, right in open_:
            same = next((k for k, (a, z) in enumerate(runs) if a == left and z == right), None)
            if same is None:
                out.append((top, left, bottom, right))
            else:
                runs.pop(same)
                still.append((top, left, bottom + 1, right))
        open_ = still + [(r, a, r + 1, z) for a, z in runs]
    return sorted(out + open_)


def _runs(row: Mask) -> list[tuple[int, int]]:
    at = np.flatnonzero(row)
    if not len(at):
        return []
    cut = np.flatnonzero(np.diff(at) > 2)
    return [(int(a), int(z) + 1) for a, z in zip(at[np.r_[0, cut + 1]], at[np.r_[cut, len(at) - 1]], strict=True)]
