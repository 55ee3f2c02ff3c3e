"""The true surface under a vehicle: the ground and what stands on it, bodies that came on command included."""

from __future__ import annotations

import math

import numpy as np

from alight.arrays import F64
from alight_sim.world import World

_WINDOW = 4.0  # metres about the place for which heights are held
_NEAR = 8.0  # metres within which bodies are looked for


def tops(boxes: F64, east: float, north: float) -> float:
    """Height of the highest of boxes (M, 12) that lies under a place, metres; -inf: none does."""
    dx, dy = east - boxes[:, 0], north - boxes[:, 1]
    along = np.abs(boxes[:, 3] * dx + boxes[:, 4] * dy)
    across = np.abs(boxes[:, 3] * dy - boxes[:, 4] * dx)
    under = (along <= boxes[:, 5]) & (across <= boxes[:, 6]) & (boxes[:, 7] > 0)
    return float(np.max(boxes[under, 2] + boxes[under, 7], initial=-math.inf))


class GroundBelow:
    """Heights asked for one after the other, near each other. The surface is bilinear between cell centres."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._box = (0.0, 0.0, 0.0, 0.0)
        self._rows: list[list[float]] = []
        self._place = (0.0, 0.0)  # of the south-west cell's centre
        self.seconds = 0.0  # of the flight: where bodies are

    def height(self, east: float, north: float) -> float:
        """Of the surface, metres above the origin."""
        west, south, right, top = self._box
        if not (west < east < right and south < north < top):
            self._load(east, north)
        x = (east - self._place[0]) / self._world.cell
        y = (north - self._place[1]) / self._world.cell
        i, j = int(x), int(y)
        u, v = x - i, y - j
        low, high = self._rows[j], self._rows[j + 1]
        ground = (1 - v) * ((1 - u) * low[i] + u * low[i + 1]) + v * ((1 - u) * high[i] + u * high[i + 1])
        return max(ground, self._bodies(east, north)) if self._world.bodies else ground

    def _bodies(self, east: float, north: float) -> float:
        boxes = np.concatenate([b.boxes_at(np.array([self.seconds]))[0] for b in self._world.bodies])
        near = np.hypot(boxes[:, 0] - east, boxes[:, 1] - north) < _NEAR
        return tops(boxes[near], east, north) if near.any() else -math.inf

    def _load(self, east: float, north: float) -> None:
        spare = _WINDOW + 2.0 * self._world.cell
        truth = self._world.truth((east - spare, north - spare, east + spare, north + spare))
        rows = truth.grid.rows
        self._rows = truth.height[::-1].astype(np.float64).tolist()
        self._place = truth.grid.east, truth.grid.north - (rows - 1) * truth.grid.cell
        self._box = east - _WINDOW, north - _WINDOW, east + _WINDOW, north + _WINDOW
