"""Straight pieces of wires: lines in the difference of one view that other views show at one height above ground."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import cv2
import numpy as np

from alight.arrays import F32, F64, I64, U8, Mask
from alight.parallax.wires.line_kernels import BLOCK, REACH, pick_lines, raise_lines, sum_lines
from alight.parallax.wires.residuals import PlaneView

DIRECTIONS = 40
SLOPES = np.linspace(-1.0, 1.0, DIRECTIONS // 2, endpoint=False) + 2.0 / DIRECTIONS  # cells down for a cell along
LONG = BLOCK * (2 * REACH + 1)  # cells of a line, along its nearer axis
TALL = 16  # cells across, of which a view gives its strongest line only
LEAST = 3.5  # noise of the sums, of a line in one view that is looked for in the others
MOST = 150  # lines of a view
STILL = 2.0  # cells: see `raise_lines`
CLEAR = 100.0  # noise of the sums, of a line that is followed
CAP = 3.0  # noise of the sums: see `raise_lines`
FEWEST = 3  # other views that confirm a line
ABOUT = np.linspace(-3.0, 3.0, 7)  # cells of parallax above and below a place at which its line is looked for
BESIDE = np.linspace(-3.0, 3.0, 5)  # cells beside it
MOST_VAGUE = 0.3  # metres that are taken for a cell of parallax at most
STEP = 1.5  # cells by which a line moves in the farthest view from one height to the next


@dataclass(frozen=True, eq=False)
class Pieces:
    """Pieces of wires, found by one view and confirmed by others, in no order."""

    own: I64  # (K,) number of the view that shows it
    score: F64  # (K,) sum of the other views over the root of their number
    height: F64  # (K,) metres above the plane
    place: F64  # (K, 2) east, north of its middle
    along: F64  # (K, 2) unit vector, east, north
    half: F64  # (K,) metres, half its length
    shown: F64  # (K, 2) east, north where its view shows it on the plane
    sign: F64  # (K,) 1: brighter than the ground, -1: darker
    vague: F64  # (K,) metres of height that move it by a cell in the view that tells most

    def of(self, which: Mask | I64) -> Pieces:
        """Return some of the pieces."""
        return Pieces(**{k: v[which] for k, v in vars(self).items()})

    @classmethod
    def joined(cls, parts: Sequence[Pieces]) -> Pieces:
        """Return all pieces of all parts."""
        return cls(**{k: np.concatenate([getattr(p, k) for p in parts]) for k in vars(parts[0])})


class Nearby(NamedTuple):
    """The best line near a given one."""

    score: float
    height: float  # metres above the plane
    views: int  # number of them
    strength: float  # as the score, but of views that count in full


@dataclass(frozen=True, eq=False)
class LineSums:
    """Sums along lines in the differences of all views, over their noise."""

    views: Sequence[PlaneView]

    @cached_property
    def sums(self) -> F32:
        """(V, 2, D, B, R) sums; family 0: lines nearly along rows, family 1: the same of the transposed picture."""
        shapes = [s for v in self.views for s in (v.grid.shape, v.grid.shape[::-1])]
        most_rows, most_blocks = max(s[0] for s in shapes), max(s[1] for s in shapes) // BLOCK
        out = np.zeros((len(self.views), 2, len(SLOPES), most_blocks, most_rows), np.float32)
        for k, v in enumerate(self.views):
            for family, picture in enumerate((v.difference, v.difference.T)):
                rows, blocks = picture.shape[0], picture.shape[1] // BLOCK
                columns = picture[:, : blocks * BLOCK].T.reshape(blocks, BLOCK, rows).swapaxes(0, 1)
                sums = np.empty((len(SLOPES), blocks, rows), np.float32)
                sum_lines(np.ascontiguousarray(columns), SLOPES, sums)
                np.multiply(sums, 1 / _noise_of(sums), out=out[k, family, :, :blocks, :rows])
        return out

    @cached_property
    def _known(self) -> U8:
        """(V, 2, B, R) share of each block's row that is known, 0 to 255."""
        out = np.zeros((len(self.views), 2, *self.sums.shape[3:]), np.uint8)
        for k, v in enumerate(self.views):
            for family, known in enumerate((v.known, v.known.T)):
                rows, blocks = known.shape[0], known.shape[1] // BLOCK
                shares = cv2.resize(
                    np.ascontiguousarray(known[:, : blocks * BLOCK]), (blocks, rows), interpolation=cv2.INTER_AREA
                )
                out[k, family, :blocks, :rows] = shares.T
        return out

    @cached_property
    def _grids(self) -> F64:
        return np.array([[v.grid.east, v.grid.north, v.grid.cell, *v.grid.shape] for v in self.views])

    @cached_property
    def _centres(self) -> F64:
        return np.array([v.above for v in self.views])

    def segments(self, own: int, lowest: float, highest: float, least: float) -> Pieces:
        """Return the lines of a view that other views confirm, from `lowest` to `highest` metres above the plane."""
        family, d, block, row = self._lines(own)
        strength = self.sums[own, family, d, block, row]
        grid, slope = self.views[own].grid, SLOPES[d]
        level, middle = family == 0, BLOCK * block + 0.5 * (BLOCK - 1)
        rows, cols = np.where(level, row, middle), np.where(level, middle, row)
        shown = np.column_stack([grid.east + cols * grid.cell, grid.north - rows * grid.cell])
        along = np.column_stack([np.where(level, 1.0, slope), np.where(level, -slope, -1.0)])
        lengths = np.hypot(1.0, slope)
        lines = np.column_stack([shown, family, d, strength]).astype(np.float64)
        found = self._raised(lines, own, self._heights(own, lowest, highest)[None], FEWEST)
        share = 1.0 - found[:, 1] / self.views[own].above[2]
        middle_m = self.views[own].above[:2] + (shown - self.views[own].above[:2]) * share[:, None]
        out = Pieces(
            np.full(len(d), own), found[:, 0], found[:, 1], middle_m, along / lengths[:, None],
            0.5 * LONG * grid.cell * lengths * share, shown, np.sign(strength),
            self._vague(own, along / lengths[:, None], found[:, 1]),
        )  # fmt: skip
        return out.of(found[:, 0] >= least)

    def _vague(self, own: int, along: F64, height: F64) -> F64:
        """Return the metres of height (K,) that move lines by one cell, across, in the view that tells most.

        A line at `h` moves by `b h / (H - h)` for a baseline `b` across it.
        """
        base = (self._centres - self._centres[own])[:, :2] @ np.array([-along[:, 1], along[:, 0]])  # (V, K)
        up, widest = self._centres[own, 2], np.abs(base).max(axis=0)
        return np.asarray(self.views[own].grid.cell * (up - height) ** 2 / np.maximum(widest * up, 1e-3))

    def around(self, own: int, places: F64, along: F64, sign: float, heights: F64) -> list[Nearby]:
        """Return the best line near each of some parallel lines in the air.

        Args:
            own: number of a view that shows them.
            places: (N, 2) east, north.
            along: (2,) unit vector.
            sign: 1: brighter than the ground, -1: darker.
            heights: (N,) metres above the plane.
        """
        above, cell = self.views[own].above, self.views[own].grid.cell
        vague = np.minimum(self._vague(own, np.tile(along, (len(places), 1)), heights), MOST_VAGUE)
        around = np.clip(heights[:, None] + vague[:, None] * ABOUT, 0.5, above[2] - 1.5)
        level = abs(along[0]) >= abs(along[1])
        slope = -along[1] / along[0] if level else -along[0] / along[1]
        d = float(np.argmin(np.abs(SLOPES - slope)))
        lowered = above[2] / (above[2] - around[:, ABOUT.size // 2])
        shown = above[:2] + (places - above[:2]) * lowered[:, None]
        beside = BESIDE[:, None] * cell * np.array([-along[1], along[0]])
        shown = (shown[:, None] + beside).reshape(-1, 2)
        lines = np.column_stack([shown, np.tile([0.0 if level else 1.0, d, CLEAR * sign], (len(shown), 1))])
        found = self._raised(lines, own, np.repeat(around, len(beside), axis=0), FEWEST - 1)
        found = found.reshape(len(places), len(beside), 4)
        best = found[np.arange(len(places)), np.argmax(found[:, :, 3], axis=1)]
        return [Nearby(score, at, int(count), strength) for score, at, count, strength in best.tolist()]

    def _raised(self, lines: F64, own: int, heights: F64, fewest: int) -> F64:
        """Return score, height, number of views and strength of each line at its best height, (K, 4)."""
        out = np.zeros((len(lines), 4))
        if heights.size:
            raise_lines(
                lines, own, heights, self._centres, self._grids, self._known, self.sums, SLOPES, STILL, CAP, fewest, out
            )
        return out

    def _lines(self, own: int) -> tuple[I64, I64, I64, I64]:
        """Return family, slope number, block and row of the strongest lines of a view, (N,) each."""
        out, rows = np.empty((2, 4 * MOST, 3), np.int64), self.views[own].grid.shape
        counts = [pick_lines(self.sums[own, f], rows[f], TALL, LEAST, out[f]) for f in range(2)]
        family = np.repeat(np.arange(2), counts)
        d, block, row = np.concatenate([out[f, : counts[f]] for f in range(2)]).T
        strength = np.abs(self.sums[own, family, d, block, row])
        best = np.argsort(-strength, kind="stable")[:MOST]
        return family[best], d[best], block[best], row[best]

    def _heights(self, own: int, lowest: float, highest: float) -> F64:
        """Return the heights (T,), metres above the plane, at which lines are looked for.

        From one to the next a line moves by `STEP` cells in the farthest view that shows it. With the camera at `H`, it
        moves by `b m` with `m = h / (H - h)`. Of pictures `W` wide on the plane, those within `b = W / (1 + m)` show a
        wire at `h`. So there is a step for every cell of the widest baseline, at first, and of the picture for every
        factor of `1 + m`, later.
        """
        up, grid = self._centres[own, 2], self.views[own].grid
        highest = min(highest, up - 1.5)
        base = float(np.hypot(*(self._centres - self._centres[own]).T[:2]).max())
        if highest <= lowest or base <= 0:
            return np.zeros(0)
        low, high, step = lowest / (up - lowest), highest / (up - highest), STEP * grid.cell
        wide = grid.cell * max(grid.shape)
        turn = float(np.clip(wide / base - 1.0, low, high))
        first = np.arange(low, turn, step / base)
        later = (1.0 + turn) * np.exp(np.arange(0.0, math.log((1.0 + high) / (1.0 + turn)) + 1e-9, step / wide)) - 1.0
        moves = np.concatenate([first, later])
        return np.asarray(up * moves / (1.0 + moves))


def _noise_of(sums: F32) -> F32:
    """Return the noise (D, 1, 1) of the sums (D, B, R) of each direction: ground with a grain is noisy along it."""
    size = np.abs(sums[:, :, ::3])
    mean = size.sum(axis=(1, 2)) / np.maximum(np.count_nonzero(size, axis=(1, 2)), 1)
    usual = np.median(mean)
    return np.asarray(1.2533 * np.maximum(mean, max(usual, 1e-6))[:, None, None], np.float32)
