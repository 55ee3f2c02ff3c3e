"""Next point to fly to on the way to a point: up before aside, and down only on the way."""

from __future__ import annotations

import math

import numpy as np

from alight.arrays import F64
from alight.flight.executive.clear_way import ClearWay
from alight.records.executive import FlightState, MapVerdict
from alight.settings import StageSettings

DOWN_TO_A_LOOK = (FlightState.APPROACH, FlightState.DESCEND)
NEARER = 0.5  # m, least progress towards a point


class Course:
    """The way that is flown now.

    Args:
        settings: of all stages; `executive` is used.
        clear_way: for the height at which a way must be flown.
    """

    def __init__(self, settings: StageSettings, clear_way: ClearWay) -> None:
        self._keys, self._clear_way = settings.executive, clear_way
        self.begin()

    def begin(self) -> None:
        """Begin another way, and forget the one before."""
        self._rises: F64 | None = None  # (2,) metres, place where it climbs to be clear
        self._from: F64 | None = None  # (2,) metres, start of the way
        self._to = np.full(2, np.nan)  # and its end
        self._level: float | None = None  # metres up, kept while the vehicle is beside it
        self._next = np.full(3, np.inf)  # metres, last point that it was ordered to
        self._nearest = math.inf  # m, least distance from there
        self._nearer_at: float | None = None  # s, when it last came nearer; None: it was not ordered anywhere yet

    def next_point(self, position: F64, to: F64, seen: MapVerdict | None, state: FlightState) -> F64:
        """Next point to fly to, (3,) metres.

        Args:
            position: (3,) metres, of the vehicle.
            to: (3,) metres, end of the way.
            seen: the newest verdict on a map of this frame; None: no obstacles are known.
            state: of the executive.
        """
        told = self._next_point(position, to, seen, state)
        if not float(np.linalg.norm(told - self._next)) < NEARER:
            self._next, self._nearest = told, math.inf
        return told

    def _next_point(self, position: F64, to: F64, seen: MapVerdict | None, state: FlightState) -> F64:
        """(3,) metres; no obstacle stands beside a look leg or about its start, but one may at the end of a lane."""
        if state in DOWN_TO_A_LOOK:
            to = self._downwards(position, to)
        near = math.hypot(*(to[:2] - position[:2])) < 2 * self._keys.arrived
        if state is FlightState.LOOK or (near and state is not FlightState.SEARCH):
            return to
        return self._upwards(position, to, seen, state is FlightState.DESCEND)

    def is_stuck(self, t: float, position: F64) -> bool:
        """True if the vehicle has come no nearer to the ordered point for `executive.hold` seconds.

        Args:
            t: s.
            position: (3,) metres, of the vehicle.
        """
        left = float(np.linalg.norm(self._next - position))
        if self._nearer_at is None or left < self._nearest - NEARER:
            self._nearest, self._nearer_at = left, t
        return t - self._nearer_at > self._keys.hold

    def _upwards(self, position: F64, to: F64, seen: MapVerdict | None, at_a_place: bool) -> F64:
        """Next point, up first where a mapped obstacle is in the way: above the start of the climb, against any wind.

        `at_a_place`: it leads from one look at a place to the next.
        """
        level = float(to[2])
        if seen is not None:
            level = max(level, self._clear_way.level(position, to, seen, at_a_place))
        if position[2] < level - self._keys.arrived:
            self._rises = position[:2].copy() if self._rises is None else self._rises
            return np.array([*self._rises, level])
        self._rises = None
        return np.array([*to[:2], level])

    def _downwards(self, position: F64, to: F64) -> F64:
        """Next point on a way down to a place: level to its end, while the vehicle is beside the way.

        Obstacles beside the way were looked for within a few metres, and a gust may carry the vehicle as far.
        """
        if self._from is None or not np.array_equal(to[:2], self._to):
            self._from, self._to, self._level = position[:2].copy(), to[:2].copy(), None
        way, flown = self._to - self._from, position[:2] - self._from
        share = float(np.clip((flown @ way) / max(float(way @ way), 1e-12), 0.0, 1.0))
        within = self._keys.off_way if self._level is None else self._keys.on_way
        at_the_end = math.hypot(*(way - flown)) < self._keys.arrived
        if at_the_end or math.hypot(*(flown - share * way)) <= within:
            self._level = None
            return to
        self._level = max(float(position[2]), -math.inf if self._level is None else self._level)
        return np.array([*to[:2], max(float(to[2]), self._level)])
