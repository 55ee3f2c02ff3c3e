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

CHUNK = 128  # spans whose distances are computed at once
HEADER = (
    "from east [m],from north [m],from up [m],to east [m],to north [m],to up [m],"
    "sag [m],diameter [m],red,green,blue"
)  # fmt: skip
COLUMNS = len(HEADER.split(","))


@dataclass(frozen=True, eq=False)
class TrueSpans:
    """Spans of the world, or of a part of it."""

    table: F64 = field(default_factory=lambda: np.zeros((0, COLUMNS)))  # one row a span, columns as in `HEADER`

    @classmethod
    def of(
        cls, start: F64, end: F64, *, sag: float | F64, diameter: float | F64, colour: Iterable[float] | F64
    ) -> TrueSpans:
        """Build spans from their ends `start` and `end` (N, 3).

        `sag`: metres that the middle hangs below the chord. `diameter`: metres. `colour`: reflectance, RGB.
        """
        table = np.empty((len(start), COLUMNS))
        table[:, :3], table[:, 3:6], table[:, 6], table[:, 7] = start, end, sag, diameter
        table[:, 8:] = np.asarray(colour, float)
        return cls(table)

    @classmethod
    def joined(cls, parts: Iterable[TrueSpans]) -> TrueSpans:
        """Join several sets of spans to one."""
        return cls(np.concatenate([np.zeros((0, COLUMNS)), *(p.table for p in parts)]))

    def __len__(self) -> int:
        return len(self.table)

    @property
    def start(self) -> F64:
        """(N, 3) east, north, up of one end, metres."""
        return self.table[:, :3]

    @property
    def end(self) -> F64:
        """(N, 3) east, north, up of the other end, metres."""
        return self.table[:, 3:6]

    @property
    def sag(self) -> F64:
        """(N,) metres that the middle hangs below the chord between the ends."""
        return self.table[:, 6]

    @property
    def diameter(self) -> F64:
        """(N,) metres."""
        return self.table[:, 7]

    @property
    def colour(self) -> F64:
        """(N, 3) reflectance: red, green, blue."""
        return self.table[:, 8:]

    def within(self, box: tuple[float, float, float, float]) -> TrueSpans:
        """Return the spans whose horizontal bounding box meets a box (west, south, east, north), metres."""
        low, high = np.minimum(self.start, self.end), np.maximum(self.start, self.end)
        near = (high[:, 0] >= box[0]) & (low[:, 0] <= box[2]) & (high[:, 1] >= box[1]) & (low[:, 1] <= box[3])
        return TrueSpans(self.table[near])

    def at(self, number: NDArray[np.intp], share: F64) -> F64:
        """Return (M, 3) points on spans of index `number` (M,); `share`: (M,) from 0 at the start to 1 at the end."""
        s = share[:, None]
        out = (1.0 - s) * self.start[number] + s * self.end[number]
        out[:, 2] -= 4.0 * self.sag[number] * share * (1.0 - share)
        return np.asarray(out)

    def pieces(self, longest: float) -> tuple[NDArray[np.intp], F64]:
        """Cut all spans into straight pieces of up to about `longest` m; return span index (M,), ends (M, 2, 3)."""
        count = np.maximum(np.ceil(np.linalg.norm(self.end - self.start, axis=1) / longest), 1).astype(np.intp)
        number = np.repeat(np.arange(len(self)), count)
        k = np.arange(len(number)) - np.repeat(np.cumsum(count) - count, count)
        ends = [self.at(number, (k + more) / count[number]) for more in (0, 1)]
        return number, np.stack(ends, axis=1)

    def aside(self, places: F64) -> F64:
        """Return (..., N) metres, horizontally, from positions (..., 2) to each span's surface; negative: under it."""
        a, along = self.start[:, :2], (self.end - self.start)[:, :2]
        away = places[..., None, :] - a
        length = np.maximum((along**2).sum(axis=1), 1e-12)
        share = np.clip((away * along).sum(axis=-1) / length, 0.0, 1.0)
        return np.asarray(np.linalg.norm(away - share[..., None] * along, axis=-1) - 0.5 * self.diameter)

    def near(self, places: F64, radius: float) -> Mask:
        """Return the (K,) mask of positions (K, 2) within `radius` (m), horizontally, of a span at any height."""
        out = np.zeros(len(places), bool)
        for first in range(0, len(self), CHUNK):
            out |= (TrueSpans(self.table[first : first + CHUNK]).aside(places) <= radius).any(axis=1)
        return out

    def over(self, grid: Grid, radius: float) -> Mask:
        """Return the (R, C) mask of cell centres within `radius` (m), horizontally, of a span at any height."""
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
        """Return the height of the highest point of a span that an upright cylinder touches; -inf: it touches none.

        The cylinder is at `east`, `north`, has a `radius` (m) and reaches from height `low` to height `high`.
        """
        near = self.within((east - radius, north - radius, east + radius, north + radius))
        number, ends = near.pieces(0.05)
        here = ends.mean(axis=1)
        spare = 0.5 * near.diameter[number]
        touched = np.hypot(here[:, 0] - east, here[:, 1] - north) <= radius + spare
        touched &= (here[:, 2] >= low - spare) & (here[:, 2] <= high + spare)
        return float(np.max(here[touched, 2], initial=-math.inf))
