"""Bodies that appear on command: a car that parks, a person who walks in. Upright boxes with exact positions."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from alight.arrays import F64
from alight_sim.kernels.boxes import NUMBERS
from alight_sim.materials import palette
from alight_sim.movers import NODE, Height, car_boxes

CAR = (4.4, 1.8, 1.5)  # metres: length, width, height
PERSON = (0.30, 0.50, 1.75)  # metres: depth, width, height
HEAD = 0.24  # metres, sides of the head's box
_BRAKING = 2.0  # m/s^2


@dataclass(frozen=True, eq=False)
class Body:
    """A car or person that moves along a straight line, brakes and stays. It does not exist before `since`."""

    car: bool  # False: a person
    start: tuple[float, float]  # east, north, metres
    goal: tuple[float, float]
    since: float  # s of the flight
    speed: float  # m/s
    heading: float  # rad from east to north, used if start and goal are equal
    height_at: Height

    @property
    def size(self) -> tuple[float, float, float]:
        """Length, width and height, metres."""
        return CAR if self.car else PERSON

    @property
    def away(self) -> float:
        """Distance from the start to the goal, metres."""
        return math.dist(self.start, self.goal)

    @property
    def arrives(self) -> float:
        """Time of the flight at which the body stops at its goal, s."""
        reach = min(self.away, self.speed**2 / (2 * _BRAKING))  # under braking
        return self.since + (self.away - reach) / self.speed + math.sqrt(2 * reach / _BRAKING)

    def place_at(self, times: F64) -> F64:
        """Return the (T, 3) centre of the body's base, metres, at times (s)."""
        reach = min(self.away, self.speed**2 / (2 * _BRAKING))
        left = np.maximum(self.arrives - np.asarray(times, float), 0.0)
        braking = math.sqrt(2 * reach / _BRAKING)
        gone = self.away - np.where(left < braking, 0.5 * _BRAKING * left**2, reach + self.speed * (left - braking))
        share = np.clip(gone / self.away, 0.0, 1.0) if self.away > 0 else np.ones(len(left))
        spot = np.array(self.start) + share[:, None] * np.subtract(self.goal, self.start)
        return np.column_stack([spot, np.interp(share, *self._ride)])

    @cached_property
    def _ride(self) -> tuple[F64, F64]:
        nodes = np.linspace(0.0, 1.0, max(2, round(self.away / NODE) + 1))
        way = np.array(self.start) + nodes[:, None] * np.subtract(self.goal, self.start)
        return nodes, np.array([self.height_at(float(e), float(n)) for e, n in way])

    def boxes_at(self, times: F64) -> F64:
        """Return the body's boxes at times (s), (T, 2, 12), as in `kernels.boxes`; their size is 0 before `since`."""
        places = self.place_at(times)[:, None]
        heading = self.heading if self.away == 0 else math.atan2(*np.subtract(self.goal, self.start)[::-1])
        turns = np.full((len(times), 1), heading)
        out = car_boxes(places, turns, CAR, palette("parking_car")) if self.car else _person(places, turns)
        out[np.asarray(times) < self.since, :, 5:8] = 0.0
        return out


def _person(places: F64, heading: F64) -> F64:
    depth, width, height = PERSON
    out = np.zeros((len(places), 2, NUMBERS))
    out[:, :, 3], out[:, :, 4] = np.cos(heading), np.sin(heading)
    out[:, :, :3] = places
    out[:, 1, 2] += height - HEAD
    out[:, 0, 5:8] = 0.5 * depth, 0.5 * width, height - HEAD
    out[:, 1, 5:8] = 0.5 * HEAD, 0.5 * HEAD, HEAD
    out[:, 0, 8:11], out[:, 1, 8:11] = palette("person")
    return out
