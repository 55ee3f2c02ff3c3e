"""The true surface under a vehicle (the ground, objects on it, commanded bodies), and contacts with it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from alight.arrays import F64
from alight.geometry import Pose
from alight_sim.movers import Moving, boxes_at
from alight_sim.point_mass import PointMass
from alight_sim.spans import TrueSpans
from alight_sim.world import World

STRIKE_STEPS = 5  # IMU samples between two checks for objects beside the vehicle
LAST = 1.0  # metres above the ground; a contact below is a touchdown
_WINDOW = 4.0  # metres around the position for which heights are held
_NEAR = 8.0  # metres within which bodies are considered


def tops(boxes: F64, east: float, north: float, within: float = 0.0) -> float:
    """Return the height of the highest of boxes (M, 12) within `within` metres of a position; -inf: no box is."""
    dx, dy = east - boxes[:, 0], north - boxes[:, 1]
    along = np.maximum(np.abs(boxes[:, 3] * dx + boxes[:, 4] * dy) - boxes[:, 5], 0.0)
    across = np.maximum(np.abs(boxes[:, 3] * dy - boxes[:, 4] * dx) - boxes[:, 6], 0.0)
    near = (np.hypot(along, across) <= within) & (boxes[:, 7] > 0)
    return float(np.max(boxes[near, 2] + boxes[near, 7], initial=-math.inf))


class GroundBelow:
    """Ground heights for queries at successive, close positions. The surface is bilinear between cell centres.

    Args:
        bodies: bodies that have appeared on command.
        radius: metres around a position that `highest` covers.
    """

    def __init__(self, world: World, bodies: Sequence[Moving] = (), radius: float = 0.0) -> None:
        self._world, self._bodies, self.radius = world, bodies, radius
        self._cell, self._movers = world.cell, world.movers
        self._box = (0.0, 0.0, 0.0, 0.0)
        self._rows: list[list[float]] = []
        self._place = (0.0, 0.0)  # of the south-west cell's centre
        self._heights = np.empty((0, 0))  # the rows as an array
        self._spans = TrueSpans()  # above these heights
        self.seconds = 0.0  # time of the flight, for the positions of cars and persons
        self._boxes, self._boxes_of = np.empty((0, 12)), (-1, 0.0)  # (M, 12), with their number of bodies and time
        self._height, self._height_of = 0.0, (0.0, 0.0, -1, 0.0)  # the last height, needed nine times a step

    def height(self, east: float, north: float) -> float:
        """Return the height of the surface, including moving objects, metres above the origin."""
        query = (east, north, len(self._bodies), self.seconds)
        if query != self._height_of:
            self._height, self._height_of = self._height_at(east, north), query
        return self._height

    def _height_at(self, east: float, north: float) -> float:
        self._hold(east, north)
        x = (east - self._place[0]) / self._cell
        y = (north - self._place[1]) / self._cell
        i, j = int(x), int(y)
        u, v = x - i, y - j
        low, high = self._rows[j], self._rows[j + 1]
        ground = (1 - v) * ((1 - u) * low[i] + u * low[i + 1]) + v * ((1 - u) * high[i] + u * high[i + 1])
        return max(ground, self._top(east, north))

    def highest(self, east: float, north: float) -> float:
        """Return the height of the highest ground or object within the radius of a position, above the origin (m)."""
        self._hold(east, north)
        cell, radius, (west, south) = self._cell, self.radius, self._place
        col, row = int((east - radius - west) / cell), int((north - radius - south) / cell)
        size = int(2 * radius / cell) + 2
        part = self._heights[row : row + size, col : col + size]
        x = west + cell * (col + np.arange(part.shape[1])) - east
        y = south + cell * (row + np.arange(part.shape[0])) - north
        ground = float(np.max(part[x[None, :] ** 2 + y[:, None] ** 2 <= radius**2], initial=-math.inf))
        below = self.height(east, north)
        return max(ground, below, self._top(east, north, radius))

    def highest_span(self, east: float, north: float, low: float, high: float) -> float:
        """Return the highest height of spans between `low` and `high` within the radius of a position; -inf: none."""
        self._hold(east, north)
        return self._spans.highest(east, north, self.radius, low, high) if len(self._spans) else -math.inf

    def _top(self, east: float, north: float, within: float = 0.0) -> float:
        """Return the height of the highest moving object within `within` metres of a position; -inf: there is none."""
        movers, now = (*self._movers, *self._bodies), (len(self._bodies), self.seconds)
        if not movers:
            return -math.inf
        if self._boxes_of != now:
            self._boxes_of = now
            self._boxes = boxes_at(movers, np.array([self.seconds]))[0]
        boxes = self._boxes
        near = np.hypot(boxes[:, 0] - east, boxes[:, 1] - north) < _NEAR + within
        return tops(boxes[near], east, north, within) if near.any() else -math.inf

    def _hold(self, east: float, north: float) -> None:
        west, south, right, top = self._box
        if not (west < east < right and south < north < top):
            self._load(east, north)

    def _load(self, east: float, north: float) -> None:
        spare = _WINDOW + self.radius + 2.0 * self._cell
        truth = self._world.truth((east - spare, north - spare, east + spare, north + spare))
        rows = truth.grid.rows
        self._heights = truth.height[::-1].astype(np.float64)
        self._rows = self._heights.tolist()
        self._spans = truth.spans
        self._place = truth.grid.east, truth.grid.north - (rows - 1) * truth.grid.cell
        self._box = east - _WINDOW, north - _WINDOW, east + _WINDOW, north + _WINDOW


@dataclass(frozen=True, eq=False)
class TrueContact:
    """Contact of the vehicle with the ground or an object: time, pose, velocity."""

    t_ns: int
    pose: Pose  # world_from_body at the contact; its origin is `standing` above the ground
    velocity_world: F64  # (3,) m/s just before
    standing: float  # metres from the plane of the feet to the body's origin
    struck: float | None = None  # metres above its feet: top of the object struck in flight; None: a touchdown


class ContactWatch:
    """Detector of the contacts of a vehicle that moves in steps.

    Args:
        below: ground and objects; within its radius the vehicle strikes objects higher than its feet; 0: none.
        standing: height of the body's origin above the plane of the feet, metres.
    """

    def __init__(self, below: GroundBelow, standing: float, vehicle: PointMass) -> None:
        self.below, self._standing, self._vehicle = below, standing, vehicle
        self.found: list[TrueContact] = []
        self._stood, self._strikes, self._steps = vehicle.stands, False, 0

    @property
    def height(self) -> float:
        """Height of the plane of the feet above the surface below, metres."""
        east, north, up = self._vehicle.position
        return float(up - (self.below.height(float(east), float(north)) + self._standing))

    @property
    def gap(self) -> float:
        """Height of the feet's plane above the highest ground or object within the radius, metres."""
        east, north, up = (float(c) for c in self._vehicle.position)
        return up - self._standing - self.below.highest(east, north)

    @property
    def _span_gap(self) -> float:
        """Height of the feet above the highest span that touches the vehicle, metres; inf: no span touches it."""
        east, north, up = (float(c) for c in self._vehicle.position)
        feet = up - self._standing
        return feet - self.below.highest_span(east, north, feet, up + self._standing)

    def observe(self, t_ns: int, velocity_before: F64) -> None:
        """Record a contact if the step that ends at `t_ns` has one; `velocity_before`: (3,) m/s before the step."""
        stood, self._stood = self._stood, self._vehicle.stands  # last step; a body may drive in under it
        if self._stood and not stood:
            self._add(t_ns, velocity_before)
        self._steps += 1
        if self.below.radius > 0.0 and self._steps % STRIKE_STEPS == 0:
            gap = min(self.gap, self._span_gap) if self.height > LAST else math.inf  # lower, the touchdown is judged
            if gap < 0.0 and not self._strikes:
                self._add(t_ns, self._vehicle.velocity.copy(), -gap)
            self._strikes = gap < 0.0

    def _add(self, t_ns: int, velocity: F64, struck: float | None = None) -> None:
        self.found.append(TrueContact(t_ns, self._vehicle.world_from_body, velocity, self._standing, struck))
