"""Spans: wires and branches in the air. They are in the pictures and in the truth, but in no raster of heights.

A span hangs between two ends as a parabola: the catenary within 1 % of its sag, for a sag of a tenth of the length.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from alight.arrays import F64, Mask
from alight.geometry import Grid

COLUMNS = 11
CHUNK = 128  # spans whose distances are computed at once
HEADER = (
    "from east [m],from north [m],from up [m],to east [m],to north [m],to up [m],"
    "sag [m],diameter [m],red,green,blue"
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class TrueSpans:
    """Spans of the world, or of a part of it."""

    table: F64 = field(
        default_factory=lambda: np.zeros((0, COLUMNS))
    )  # (N, COLUMNS), one a row, as `HEADER` names them

    @classmethod
    def of(
        cls, start: F64, end: F64, *, sag: float | F64, diameter: float | F64, colour: Iterable[float] | F64
    ) -> TrueSpans:
        """Make spans from `start` to `end` (N, 3); `sag` below the middle of the chord; `colour`: reflectance, RGB."""
        table = np.empty((len(start), COLUMNS))
        table[:, :3], table[:, 3:6], table[:, 6], table[:, 7] = start, end, sag, diameter
        table[:, 8:] = np.asarray(colour, float)
        return cls(table)

    @classmethod
    def joined(cls, parts: Iterable[TrueSpans]) -> TrueSpans:
        """All spans of all parts."""
        return cls(np.concatenate([np.zeros((0, COLUMNS)), *(p.table for p in parts)]))

    def __len__(self) -> int:
        return len(self.table)

    @property
    def start(self) -> F64:
        """(N, 3) one end: east, north, up."""
        return self.table[:, :3]

    @property
    def end(self) -> F64:
        """(N, 3) the other end."""
        return self.table[:, 3:6]

    @property
    def sag(self) -> F64:
        """(N,) depth of the middle below the chord."""
        return self.table[:, 6]

    @property
    def diameter(self) -> F64:
        """(N,) diameter."""
        return self.table[:, 7]

    @property
    def colour(self) -> F64:
        """(N, 3) reflectance: red, green, blue."""
        return self.table[:, 8:]

    def within(self, box: tuple[float, float, float, float]) -> TrueSpans:
        """Select the spans whose bounding box meets a box (west, south, east, north)."""
        low, high = np.minimum(self.start, self.end), np.maximum(self.start, self.end)
        near = (high[:, 0] >= box[0]) & (low[:, 0] <= box[2]) & (high[:, 1] >= box[1]) & (low[:, 1] <= box[3])
        return TrueSpans(self.table[near])

    def at(self, number: NDArray[np.intp], share: F64) -> F64:
        """(M, 3) places on spans `number` (M,), at a share (M,) of the way from start to end."""
        s = share[:, None]
        out = (1.0 - s) * self.start[number] + s * self.end[number]
        out[:, 2] -= 4.0 * self.sag[number] * share * (1.0 - share)
        return np.asarray(out)

    def pieces(self, longest: float) -> tuple[NDArray[np.intp], F64]:
        """(M,) number of the span and (M, 2, 3) ends of the straight pieces, of about `longest` metres or less."""
        count = np.maximum(np.ceil(np.linalg.norm(self.end - self.start, axis=1) / longest), 1).astype(np.intp)
        number = np.repeat(np.arange(len(self)), count)
        k = np.arange(len(number)) - np.repeat(np.cumsum(count) - count, count)
        ends = [self.at(number, (k + more) / count[number]) for more in (0, 1)]
        return number, np.stack(ends, axis=1)

    def aside(self, places: F64) -> F64:
        """(..., N) horizontal distance from places (..., 2) to the surface of each span; negative: under it."""
        a, along = self.start[:, :2], (self.end - self.start)[:, :2]
        away = places[..., None, :] - a
        length = np.maximum((along**2).sum(axis=1), 1e-12)
        share = np.clip((away * along).sum(axis=-1) / length, 0.0, 1.0)
        return np.asarray(np.linalg.norm(away - share[..., None] * along, axis=-1) - 0.5 * self.diameter)

    def near(self, places: F64, radius: float) -> Mask:
        """(N,) true for places (N, 2) within `radius`, horizontally, of a span at any height."""
        out = np.zeros(len(places), bool)
        for first in range(0, len(self), CHUNK):
            out |= (TrueSpans(self.table[first : first + CHUNK]).aside(places) <= radius).any(axis=1)
        return out

    def over(self, grid: Grid, radius: float) -> Mask:
        """(R, C) true for cells whose centre is within `radius`, horizontally, of a span at any height."""
        out = np.zeros(grid.shape, bool)
        east, north = grid.xy()
        for k in range(len(self)):
            one = TrueSpans(self.table[k : k + 1])
            reach = radius + 0.5 * float(one.diameter[0])
            (west, south), (right, top) = (f(one.start[0, :2], one.end[0, :2]) for f in (np.minimum, np.maximum))
            cols = np.flatnonzero((east >= west - reach) & (east <= right + reach))
            rows = np.flatnonzero((north >= south - reach) & (north <= top + reach))
            if len(cols) and len(rows):
                window = slice(rows[0], rows[-1] + 1), slice(cols[0], cols[-1] + 1)
                places = np.stack(np.meshgrid(east[window[1]], north[window[0]]), -1)
                out[window] |= one.aside(places)[..., 0] <= radius
        return out

    def highest(self, east: float, north: float, radius: float, low: float, high: float) -> float:
        """Height of the highest point that an upright cylinder from `low` to `high` touches; -inf: it touches none."""
        near = self.within((east - radius, north - radius, east + radius, north + radius))
        number, ends = near.pieces(0.05)
        here = ends.mean(axis=1)
        spare = 0.5 * near.diameter[number]
        touched = np.hypot(here[:, 0] - east, here[:, 1] - north) <= radius + spare
        touched &= (here[:, 2] >= low - spare) & (here[:, 2] <= high + spare)
        return float(np.max(here[touched, 2], initial=-math.inf))
