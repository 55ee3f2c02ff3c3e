"""Zones of the ground plane in which, or out of which, a vehicle must stay."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import shapely

from alight.arrays import F64, Mask
from alight.geometry.grid import Grid


@dataclass(frozen=True, eq=False)
class Zone:
    """All points at most `reach` metres from a shape; a vehicle must stay in it (`keeps_in`) or out of it.

    A circle is a point with its radius as `reach`, a road a line with half its width.
    """

    name: str
    shape: shapely.Geometry  # valid, metres
    keeps_in: bool
    reach: float = 0.0  # metres

    @cached_property
    def area(self) -> shapely.Geometry:
        """The zone as polygons; circles are polygons of 256 corners."""
        return self.shape.buffer(self.reach, quad_segs=64) if self.reach else self.shape

    def depth(self, points: F64) -> F64:
        """Return the distance, (N,) metres, of `points`, (N, 2) metres, to the border; outside it is negative.

        Within `reach` of the border of a polygon that is not convex, the depth may be too small.
        """
        border = self.shape.boundary if shapely.get_dimensions(self.shape) == 2 else self.shape
        away = shapely.distance(border, shapely.points(points))
        return np.asarray(self.reach + np.where(shapely.contains_xy(self.shape, points), away, -away))


@dataclass(frozen=True, eq=False)
class Region:
    """Where a vehicle may be: in every zone that keeps it in, and out of every zone that keeps it out."""

    zones: tuple[Zone, ...]

    @cached_property
    def _inner(self) -> shapely.Geometry | None:
        """What all zones that keep it in have in common; None: there is none."""
        areas = [z.area for z in self.zones if z.keeps_in]
        return _prepared(shapely.intersection_all(areas)) if areas else None

    @cached_property
    def _closed(self) -> shapely.Geometry:
        return _prepared(shapely.union_all([z.area for z in self.zones if not z.keeps_in]))

    def with_room(self, points: F64, room: float) -> Mask:
        """Whether a disc of `room` metres about each of `points`, (N, 2) metres, stays in the region; (N,)."""
        out = np.ones(len(points), np.bool_)
        if self._inner is not None:
            out &= shapely.contains_xy(_prepared(self._inner.buffer(-room)), points)
        if not self._closed.is_empty:
            out &= ~shapely.contains_xy(_prepared(self._closed.buffer(room)), points)
        return out

    def has_room(self, start: F64, to: F64, room: float) -> bool:
        """Whether a disc of `room` metres stays in the region all the way from `start` to `to`, (2,) metres."""
        way, inner, closed = shapely.LineString([start, to]), self._inner, self._closed
        if not closed.is_empty and shapely.distance(closed, way) < room:
            return False
        if inner is None:
            return True
        return bool(inner.covers(way)) and bool(shapely.distance(inner.boundary, way) >= room)

    def limit(self, point: F64) -> str:
        """Return the name of the zone that leaves `point`, (2,) metres, the least room; empty: there is no zone."""
        rooms = ((float(z.depth(point[None])[0]) * (1.0 if z.keeps_in else -1.0), z.name) for z in self.zones)
        return min(((-math.inf if math.isnan(r) else r, name) for r, name in rooms), default=(0.0, ""))[1]


EVERYWHERE = Region(())


def united(name: str, zones: Iterable[Zone]) -> Zone:
    """Return one zone that keeps a vehicle in any of `zones`."""
    return Zone(name, shapely.union_all([z.area for z in zones]), True)


def rectangle_of(grid: Grid) -> shapely.Geometry:
    """Return the rectangle that the cells of a grid cover, metres."""
    cell, _, west, _, _, north = grid.transform
    return shapely.box(west, north - grid.rows * cell, west + grid.cols * cell, north)


def _prepared(shape: shapely.Geometry) -> shapely.Geometry:
    shapely.prepare(shape)
    return shape
