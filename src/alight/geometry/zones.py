"""Zones of the ground plane: discs and polygons in which, or out of which, a vehicle must stay."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from alight.arrays import F64


class Shape(Protocol):
    """A part of the plane."""

    def depth(self, points: F64) -> F64:
        """Return the distance, (N,) metres, of `points`, (N, 2) metres, to the border; outside it is negative."""


@dataclass(frozen=True, eq=False)
class Circle:
    """All points at most `radius` metres from `centre`, (2,) metres."""

    centre: F64
    radius: float

    def depth(self, points: F64) -> F64:
        """See `Shape.depth`."""
        return np.asarray(self.radius - np.linalg.norm(points - self.centre, axis=1))


@dataclass(frozen=True, eq=False)
class Polygon:
    """All points within an odd number of its closed `rings`, each (V, 2) metres; so a ring within a ring is a hole."""

    rings: tuple[F64, ...]

    def depth(self, points: F64) -> F64:
        """See `Shape.depth`."""
        a = np.concatenate(self.rings)
        way = np.concatenate([np.roll(ring, -1, axis=0) for ring in self.rings]) - a
        to = points[:, None] - a  # (N, V, 2)
        share = np.clip((to * way).sum(axis=2) / np.maximum((way**2).sum(axis=1), 1e-12), 0.0, 1.0)
        away = np.linalg.norm(to - share[..., None] * way, axis=2).min(axis=1)
        spans = (to[..., 1] < 0.0) != (to[..., 1] < way[:, 1])
        rise = np.where(way[:, 1] == 0.0, 1.0, way[:, 1])  # a level edge spans no height
        crossed = spans & (to[..., 0] < to[..., 1] * way[:, 0] / rise)
        return np.asarray(np.where(crossed.sum(axis=1) % 2 == 1, away, -away))


@dataclass(frozen=True, eq=False)
class Union:
    """All points of at least one of `shapes`; the depth is that of the one that reaches farthest."""

    shapes: tuple[Shape, ...]

    def depth(self, points: F64) -> F64:
        """See `Shape.depth`."""
        return np.asarray(np.max([shape.depth(points) for shape in self.shapes], axis=0))


@dataclass(frozen=True, eq=False)
class Zone:
    """A shape with its name; a vehicle must stay in it (`keeps_in`) or out of it."""

    name: str
    shape: Shape
    keeps_in: bool


@dataclass(frozen=True, eq=False)
class Region:
    """Where a vehicle may be: in every zone that keeps it in, and out of every zone that keeps it out."""

    zones: tuple[Zone, ...]

    def _rooms(self, points: F64) -> F64:
        """Return the room that each zone leaves, (Z, N) metres."""
        return np.array([z.shape.depth(points) * (1.0 if z.keeps_in else -1.0) for z in self.zones])

    def room(self, points: F64) -> F64:
        """Return the radius, (N,) metres, of a disc about each of `points`, (N, 2) metres, that stays in the region.

        Negative: the point itself is outside; infinite: there is no zone. On a metre of way it changes by at most a
        metre.
        """
        return np.asarray(np.min(self._rooms(points), axis=0)) if self.zones else np.full(len(points), np.inf)

    def has_room(self, start: F64, to: F64, room: float) -> bool:
        """Whether a disc of `room` metres stays in the region all the way from `start` to `to`, (2,) metres.

        Samples lie a tenth of `room` apart; a corner that juts in between two of them costs 5 % of it.
        """
        if not self.zones:
            return True
        count = 2 + math.ceil(10.0 * math.dist(start, to) / max(room, 1.0))
        return bool((self.room(np.linspace(start, to, count)) >= room).all())

    def limit(self, point: F64) -> str:
        """Return the name of the zone that leaves `point`, (2,) metres, the least room; empty: there is no zone."""
        return self.zones[int(self._rooms(point[None])[:, 0].argmin())].name if self.zones else ""


EVERYWHERE = Region(())
