"""Choice of the blocks that a step works on, so that all steps cost about the same (docs/method/recursive.md).

A new block is refined with every keyframe. Each further refinement gains less, so a block waits longer the more often
it was refined. Blocks below the newest view do not wait: somebody may come there while the vehicle lands. First sweeps
are postponed until they fit into the step's share of sweeping.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from alight.arrays import F32, F64, I64, Mask
from alight.geometry import Box, Grid
from alight.settings.tuning.parallax import RecursiveTuning

SIDE = 64  # cells on a side of a block
LEAST = 8  # least sampled known cells of a block that is refined: one in 32
ENOUGH = 16  # least sampled new cells of a block that is swept: one in 16
PART = 0.4  # least share of new cells in a block to sweep it at once; fewer are left over from a sweep
NEVER = -(1 << 30)
DEAR = 8192  # cells whose refinement costs as much as one more rectangle
MOST_URGENT = 4.0
WORTH = 0.6  # least mean urgency of a row or column of blocks that is added to a rectangle
TAKEN = -1e9  # urgency of a block that is already in a rectangle
ROUGH = 8  # factor by which a sweep at half the resolution costs less
MOST_NEW = 0.5  # share of new blocks, of those seen, above which the map is beginning
AT_START = 3  # factor by which a step may refine more while the map is beginning
SWEPT_AT_START = 2  # factor by which a step may sweep more then


@dataclass(frozen=True)
class Effort:
    """Limits of the work of one step."""

    share: float  # share of a full step's limits (refined cells, swept samples) that the step may use
    rigs: int  # every `rigs`-th exposure, back from the newest, uses all cameras; other exposures use one of them


EFFORTS = (Effort(1.0, 1), Effort(0.6, 3), Effort(0.4, 3), Effort(0.25, 3))  # full, ..., least


class Rectangle(NamedTuple):
    """Rectangle of rows and columns of blocks; `bottom` and `right` are exclusive."""

    top: int
    left: int
    bottom: int
    right: int

    @property
    def blocks(self) -> int:
        """Number of blocks in the rectangle."""
        return (self.bottom - self.top) * (self.right - self.left)


class Counts(NamedTuple):
    """Number of sampled cells of each kind per block; arrays are (block rows, block columns)."""

    fresh: F32  # cells to sweep, seen over a sufficient baseline
    waiting: F32  # cells to sweep once they are seen over a longer baseline
    known: F32  # cells with a height that two views see


class Plan(NamedTuple):
    """Rectangles, in rows and columns of the window, that one step sweeps and refines."""

    sweep: list[Box]  # rectangles whose new cells are swept
    rough: list[Box]  # rectangles swept at half the resolution, because a full sweep would exceed the limit
    refine: list[Box]  # rectangles to refine: disjoint, and covering all swept ones


class Blocks:
    """Blocks of the map's raster that overlap the present window, with the history of the work on each block."""

    def __init__(self, tuning: RecursiveTuning) -> None:
        self._tuning, self._step = tuning, 0
        self.begins = True  # whether most blocks of the last plan are new
        self._rate = 0.0  # samples per step for the first sweeps that are due; 0 when none is due
        self._first = np.zeros(2, np.int64)  # row and column of the first block in the raster of blocks
        self._offset = np.zeros(2, np.int64)  # rows and columns from the corner of the first block to the window
        self._shape = (0, 0)  # rows and columns of the window
        self._cell = 1.0  # metres
        self.forget(sharper=False)

    def forget(self, sharper: bool) -> None:
        """Mark all blocks as new. `sharper`: whether the cells became smaller, so that old colours are too coarse."""
        self._count, self._last, self._since = (np.zeros((0, 0), np.int64) for _ in range(3))
        self.recolour = sharper  # blocks that were never visited have coarse colours

    def begin_anew(self) -> None:
        """Mark all blocks as new, and set `begins`, as for a new map."""
        self.forget(self.recolour)
        self.begins = True

    def move_to(self, grid: Grid) -> None:
        """Begin a step on the window `grid`; blocks that stay in the window keep their history."""
        self._step += 1
        corner = np.array([round(-grid.north / grid.cell - 0.5), round(grid.east / grid.cell - 0.5)])
        first, self._offset = corner // SIDE, corner % SIDE
        shape = (self._offset + grid.shape - 1) // SIDE + 1
        self._count, self._last, self._since = (
            _moved(old, first - self._first, shape, empty)
            for old, empty in ((self._count, 0), (self._last, NEVER), (self._since, NEVER))
        )
        self._first, self._shape, self._cell = first, grid.shape, grid.cell

    def counted(self, kinds: NDArray[np.bool_], every: int) -> Counts:
        """Count the samples of each block in three masks `kinds` (3, R / every, C / every), ordered as in `Counts`."""
        edges = zip(kinds.shape[1:], self._offset, self._count.shape, strict=True)
        rows, cols = (_members(n, every, int(at), blocks) for n, at, blocks in edges)
        return Counts(*(rows @ kinds.astype(np.float32) @ cols.T))

    def plan(self, counts: Counts, below: tuple[float, float], layers: float, reach: float, effort: Effort) -> Plan:
        """Choose the rectangles that the next step sweeps and refines.

        Args:
            counts: sampled cells of each block.
            below: row and column of the window under the newest view.
            layers: number of samples per swept cell (planes times views).
            reach: number of cells beyond a block that its rays cross, per cell of the block's distance from `below`.
            effort: limits of the work.
        """
        middle = [SIDE * (np.arange(n) + 0.5) - at for n, at in zip(self._count.shape, self._offset, strict=True)]
        dr, dc = np.abs(middle[0][:, None] - below[0]), np.abs(middle[1][None, :] - below[1])
        away, costs = np.hypot(dr, dc), (SIDE + reach * dr) * (SIDE + reach * dc) * layers
        seen = counts.fresh + counts.known >= LEAST
        self.begins = not seen.any() or float((self._count < self._tuning.pace)[seen].mean()) > MOST_NEW
        cells = max(self._shape[0] * self._shape[1], self._tuning.least_cells)
        most = effort.share * min(self._tuning.share * (AT_START if self.begins else 1), 1.0) * cells
        dear = costs > self._tuning.most_sweep
        swept = self._to_sweep(counts, np.where(dear, costs / ROUGH, costs), most, effort)
        beside = np.hypot(np.maximum(dr - SIDE / 2, 0), np.maximum(dc - SIDE / 2, 0))
        refined = self._to_refine(counts, away, swept, beside * self._cell < self._tuning.watched, most)
        new = counts.fresh / np.maximum(counts.fresh + counts.known, 1)
        self._count[swept] = np.rint(self._count * (1 - new))[swept]
        self._since[swept] = NEVER
        fine, rough = (cover(np.where(swept & some, 1.0, TAKEN), away, np.inf) for some in (~dear, dear))
        return Plan(*([self._box(b) for b in boxes] for boxes in (fine, rough, refined)))

    def _to_sweep(self, counts: Counts, costs: F64, most: float, effort: Effort) -> Mask:
        """Return a mask of the blocks to sweep: of all blocks that are due, those that have waited longest.

        `costs`: samples per block. `most`: largest number of cells. `effort`: limits of the step.
        """
        some = counts.fresh >= ENOUGH
        self._since = np.where(some, np.where(self._since == NEVER, self._step, self._since), NEVER)
        many = counts.fresh >= np.maximum(counts.waiting, PART * (counts.fresh + counts.waiting + counts.known))
        ready = some & (many | (self._step - self._since >= self._tuning.patience))
        self._rate = max(self._rate, float(costs[ready].sum()) / self._tuning.backlog) if ready.any() else 0.0
        most_samples = self._tuning.most_sweep * (SWEPT_AT_START if self.begins else 1)
        budget = effort.share * min(max(self._rate, self._tuning.least_sweep), most_samples)
        order = np.argsort(self._since.ravel(), kind="stable")  # neighbours together: one sweep
        return _within(order, ready, np.maximum(costs / budget, SIDE**2 / most), 1.0)

    def _to_refine(self, counts: Counts, away: F64, swept: Mask, watched: Mask, most: float) -> list[Rectangle]:
        """Return rectangles around the `swept` and `watched` blocks, then around those that have waited long enough.

        The more often a block was refined, the more steps it waits. `away`: cells from each block to the point
        below the newest view. The rectangles hold up to `most` cells, not counting blocks that are only watched.
        """
        wait, known = np.clip(self._count / self._tuning.pace, 1.0, self._tuning.longest_wait), counts.known >= LEAST
        urgency = np.where(known, np.minimum((self._step - self._last) / wait, MOST_URGENT), 0.0)
        urgency[watched & known] = urgency[swept] = MOST_URGENT + 1
        return cover(urgency, away, most + SIDE**2 * int((watched & known & ~swept).sum()))

    def _box(self, of: Rectangle) -> Box:
        edges = zip(((of.top, of.bottom), (of.left, of.right)), self._offset, self._shape, strict=True)
        r, c = (slice(*(min(max(SIDE * end - int(at), 0), n) for end in ends)) for ends, at, n in edges)
        return r, c

    def never_visited(self, box: Box) -> bool:
        """Whether a rectangle of the window contains a block that was never refined."""
        return bool((self._last[self._inside(box)] == NEVER).any())

    def visited(self, box: Box, known: Mask, changed: Mask, every: int) -> None:
        """Record that a rectangle of the window was refined; blocks with many changed cells count as new again.

        Args:
            known: mask of sampled cells, `every` cells apart, that had a height before.
            changed: mask of the same samples whose height or trust changed.
        """
        inside = self._inside(box)
        edges = zip(known.shape, box, self._offset, inside, strict=True)
        rows, cols = (_members(n, every, (s.start + int(at)) % SIDE, b.stop - b.start) for n, s, at, b in edges)
        had, moved = (rows @ m.astype(np.float32) @ cols.T for m in (known, known & changed))
        self._count[inside] = np.where(moved > self._tuning.unsettled * had, 0, self._count[inside] + 1)
        self._last[inside] = self._step

    def _inside(self, box: Box) -> Box:
        edges = zip(box, self._offset, strict=True)
        r, c = (slice((s.start + int(at)) // SIDE, (s.stop - 1 + int(at)) // SIDE + 1) for s, at in edges)
        return r, c


def _moved(old: I64, by: I64, shape: I64, empty: int) -> I64:
    """Return the part of the raster `old` from row and column `by` on, of `shape`; `empty`: value outside `old`."""
    out = np.full(shape, empty, np.int64)
    low = np.maximum(by, 0)
    size = np.maximum(np.minimum(by + shape, old.shape) - low, 0)
    there, here = (tuple(slice(a, a + n) for a, n in zip(start, size, strict=True)) for start in (low, low - by))
    out[here] = old[there]
    return out


def _members(count: int, every: int, first: int, blocks: int) -> F32:
    """Return a (blocks, count) matrix: 1 where block i holds sample k.

    The samples lie in the middle of intervals of `every` cells, from cell `first` of block 0 on.
    """
    at = (first + every // 2 + every * np.arange(count)) // SIDE
    return np.asarray(at[None, :] == np.arange(blocks)[:, None], np.float32)


def _within(order: I64, wanted: Mask, costs: F64, budget: float) -> Mask:
    """Return the mask of the first `wanted` blocks in `order` that cost up to `budget` in all; at least one block.

    `order`: flat indices of the blocks.
    """
    ranked = order[wanted.ravel()[order]]
    spent = np.cumsum(costs.ravel()[ranked])
    out = np.zeros(wanted.size, np.bool_)
    out[ranked[: max(1, int(np.searchsorted(spent, budget, side="right")))]] = True
    return out.reshape(wanted.shape)


def cover(urgency: F64, away: F64, most: float) -> list[Rectangle]:
    """Return rectangles that cover the blocks with an `urgency` of 1 or more, the most urgent first.

    Blocks with an urgency above `MOST_URGENT` are covered even beyond `most`, the largest number of cells in all
    rectangles. `away`: distance of each block from the point below the newest view.
    """
    urgency, out = urgency.copy(), list[Rectangle]()
    while (top := urgency.max(initial=0.0)) > MOST_URGENT or (top >= 1.0 and most >= DEAR + SIDE**2):
        found = grown(urgency, away, (most - DEAR) / SIDE**2)
        most -= found.blocks * SIDE**2 + DEAR
        out.append(found)
        urgency[found.top : found.bottom, found.left : found.right] = TAKEN
    return out


def grown(urgency: F64, away: F64, most: float) -> Rectangle:
    """Return a rectangle of up to `most` blocks, grown from the most urgent block while its rim is urgent as well.

    Of several most urgent blocks, it starts from the nearest. `away`: distance of each block, as in `cover`.
    """
    total = np.zeros((urgency.shape[0] + 1, urgency.shape[1] + 1))
    total[1:, 1:] = urgency.cumsum(axis=0).cumsum(axis=1)
    sums = total.tolist()  # Python numbers: a tenth of the time for single accesses
    first = np.flatnonzero(urgency.ravel() == urgency.max())
    row, col = divmod(int(first[np.argmin(away.ravel()[first])]), urgency.shape[1])
    out = Rectangle(row, col, row + 1, col + 1)
    while True:
        top, left, bottom, right = out
        rims = (
            Rectangle(top - 1, left, top, right), Rectangle(bottom, left, bottom + 1, right),
            Rectangle(top, left - 1, bottom, left), Rectangle(top, right, bottom, right + 1),
        )  # fmt: skip
        worth = [_mean(sums, r) if out.blocks + r.blocks <= most else -1.0 for r in rims]
        k = int(np.argmax(worth))
        if worth[k] < WORTH:
            return out
        a, b, c, d = rims[k]
        out = Rectangle(min(top, a), min(left, b), max(bottom, c), max(right, d))


def _mean(sums: list[list[float]], of: Rectangle) -> float:
    """Return the mean of a raster over the rectangle `of`, from its summed-area table; -1 outside the raster."""
    top, left, bottom, right = of
    if min(top, left) < 0 or bottom >= len(sums) or right >= len(sums[0]):
        return -1.0
    return (sums[bottom][right] - sums[top][right] - sums[bottom][left] + sums[top][left]) / of.blocks
