"""Wires in the air: what hangs above the ground and is in no raster of heights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from alight.arrays import F32, F64
from alight.geometry import Grid

BEYOND = 4.0  # metres by which a wire may go on at either end of what was found of it


@dataclass(frozen=True, eq=False)
class Wire:
    """A straight stretch of a wire that was found."""

    start: F64  # (3,) metres: east, north, up
    end: F64  # (3,) metres
    chance: float  # probability that it is a wire: the rest are lines on the ground and luck

    @property
    def is_found(self) -> bool:
        """Whether it is more likely a wire than not; if not, it is a doubt."""
        return self.chance >= 0.5

    def moved(self, shift: F64) -> Wire:
        """Return the wire moved by `shift`, (3,) metres."""
        return replace(self, start=self.start + shift, end=self.end + shift)

    @property
    def length(self) -> float:
        """Horizontal length, metres."""
        return float(np.hypot(*(self.end - self.start)[:2]))

    def covers(self, other: Wire, beside: float = 1.5, along: float = 2.0) -> bool:
        """Whether both ends of another wire lie within `beside` metres of this one, continued by `along` metres."""
        whole, ends = self.longer(along), np.array([other.start, other.end])[:, :2]
        start, way = whole.start[:2], (whole.end - whole.start)[:2]
        share = np.clip((ends - start) @ way / max(float(way @ way), 1e-12), 0.0, 1.0)
        return bool((np.linalg.norm(ends - start - share[:, None] * way, axis=1) <= beside).all())

    def longer(self, by: float) -> Wire:
        """Return the wire continued by `by` metres at both ends."""
        way = np.asarray((self.end - self.start) * (by / max(self.length, 1e-9)))
        return replace(self, start=self.start - way, end=self.end + way)


def nearest_wire(wires: Sequence[Wire], grid: Grid) -> tuple[F32, F32]:
    """Compute the horizontal distance to the nearest wire, and the height of its nearest point, (R, C) metres.

    Without a wire the distance is infinite and the height NaN.
    """
    distance, up = np.full(grid.shape, np.inf, np.float32), np.full(grid.shape, np.nan, np.float32)
    east, north = grid.xy()
    for w in wires:
        x, y = east[None, :] - w.start[0], north[:, None] - w.start[1]
        way = w.end - w.start
        share = np.clip((x * way[0] + y * way[1]) / max(way[0] ** 2 + way[1] ** 2, 1e-12), 0.0, 1.0)
        away = np.hypot(x - share * way[0], y - share * way[1])
        nearer = away < distance
        distance[nearer], up[nearer] = away[nearer], (w.start[2] + share * way[2])[nearer]
    return distance, up
