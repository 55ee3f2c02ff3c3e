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
SLOPES = np.linspace(-1.0, 1.0, DIRECTIONS // 2, endpoint=False) + 2.0 / DIRECTIONS  # cells down per cell along
LONG = BLOCK * (2 * REACH + 1)  # length of a line along its nearer axis, cells
TALL = 16  # cells across a line, of which only the strongest line of a view is used
LEAST = 3.5  # least sum, in units of noise, of a line in one view that is searched in the other views
MOST = 150  # largest number of lines per view
STILL = 2.0  # cells: see `raise_lines`
CLEAR = 100.0  # sum, in units of noise, that is assumed for a line that is followed
CAP = 3.0  # in units of the noise of the sums: see `raise_lines`
FEWEST = 3  # least number of other views that confirm a line
ABOUT = np.linspace(-3.0, 3.0, 7)  # cells of parallax above and below a position at which a line is searched
BESIDE = np.linspace(-3.0, 3.0, 5)  # cells beside the position at which a line is searched
MOST_VAGUE = 0.3  # largest height difference assumed for a cell of parallax, metres
STEP = 1.5  # cells by which a line moves in the farthest view from one height to the next


@dataclass(frozen=True, eq=False)
class Pieces:
    """Pieces of wires, found by one view and confirmed by others, in no order."""

    own: I64  # (K,) index of the view in which the piece was found
    score: F64  # (K,) sum over the other views, divided by the root of their number
    height: F64  # (K,) metres above the plane
    place: F64  # (K, 2) metres, east and north of the middle of the piece
    along: F64  # (K, 2) unit vector along the piece, east and north
    half: F64  # (K,) metres, half the length of the piece
    shown: F64  # (K, 2) metres, east and north at which view `own` shows the piece on the plane
    sign: F64  # (K,) 1: brighter than the ground, -1: darker
    vague: F64  # (K,) metres of height that move the piece by one cell in the most sensitive view

    def of(self, which: Mask | I64) -> Pieces:
        """Return the pieces that a mask (K,) or indices select."""
        return Pieces(**{k: v[which] for k, v in vars(self).items()})

    @classmethod
    def joined(cls, parts: Sequence[Pieces]) -> Pieces:
        """Concatenate the pieces of all parts."""
        return cls(**{k: np.concatenate([getattr(p, k) for p in parts]) for k in vars(parts[0])})


class Nearby(NamedTuple):
    """The best line near a given line."""

    score: float
    height: float  # metres above the plane
    views: int  # number of other views that show the line
    strength: float  # score if each view's sum is limited to the line's own sum instead of `CAP`


@dataclass(frozen=True, eq=False)
class LineSums:
    """Sums along lines in the differences of all views, over their noise."""

    views: Sequence[PlaneView]

    @cached_property
    def sums(self) -> F32:
        """Sums of each view's difference along straight lines, divided by their noise, (V, 2, D, B, R).

        The axes are view, family, slope (`SLOPES`), block of `BLOCK` columns, and row. A line runs through its block's
        middle. Family 0 has lines nearly along rows. Family 1 has lines nearly along columns: slope, block and row
        are those of the transposed picture.
        """
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
        """Share of known cells in each row of each block, 0 to 255, (V, 2, B, R); axes as in `sums`."""
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
        """Return the lines of view `own` that other views confirm, from `lowest` to `highest` metres above the plane.

        `least`: smallest score of the returned lines.
        """
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
        """Return the height differences (K,), metres, that move lines by one cell across in the most sensitive view.

        A line at height `h` moves by `b h / (H - h)` for a baseline `b` across the line and a camera at height `H`.
        """
        base = (self._centres - self._centres[own])[:, :2] @ np.array([-along[:, 1], along[:, 0]])  # (V, K)
        up, widest = self._centres[own, 2], np.abs(base).max(axis=0)
        return np.asarray(self.views[own].grid.cell * (up - height) ** 2 / np.maximum(widest * up, 1e-3))

    def around(self, own: int, places: F64, along: F64, sign: float, heights: F64) -> list[Nearby]:
        """Return the best line near each of some parallel lines in the air.

        Args:
            own: index of a view that shows the lines.
            places: (N, 2) metres, east and north of each line.
            along: (2,) unit vector along the lines.
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
        """Return family, slope index, block and row of the strongest lines of a view, (N,) each; see `sums`."""
        out, rows = np.empty((2, 4 * MOST, 3), np.int64), self.views[own].grid.shape
        counts = [pick_lines(self.sums[own, f], rows[f], TALL, LEAST, out[f]) for f in range(2)]
        family = np.repeat(np.arange(2), counts)
        d, block, row = np.concatenate([out[f, : counts[f]] for f in range(2)]).T
        strength = np.abs(self.sums[own, family, d, block, row])
        best = np.argsort(-strength, kind="stable")[:MOST]
        return family[best], d[best], block[best], row[best]

    def _heights(self, own: int, lowest: float, highest: float) -> F64:
        """Return the heights (T,), metres above the plane, at which lines are searched.

        From one height to the next, a line moves by `STEP` cells in the farthest view that shows it. For a camera at
        height `H` and a baseline `b`, a line at height `h` moves by `b m` with `m = h / (H - h)`. Pictures `W` wide on
        the plane show the line up to the baseline `b = W / (1 + m)`. So `m` grows by equal steps while the widest
        baseline is shorter than that, and `1 + m` by equal factors beyond.
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
    """Return the noise (D, 1, 1) of the sums (D, B, R) per slope; sums along the grain of the ground are noisier."""
    size = np.abs(sums[:, :, ::3])
    mean = size.sum(axis=(1, 2)) / np.maximum(np.count_nonzero(size, axis=(1, 2)), 1)
    usual = np.median(mean)
    return np.asarray(1.2533 * np.maximum(mean, max(usual, 1e-6))[:, None, None], np.float32)
