"""Where to fly next on the way to a point: up before aside, and down only on the way."""

from __future__ import annotations

import math

import numpy as np

from alight.arrays import F64
from alight.landing.executive.clear_way import ClearWay
from alight.records.executive import FlightState, Seen
from alight.settings import StageSettings

DOWN_TO_A_LOOK = (FlightState.APPROACH, FlightState.DESCEND)
NEARER = 0.5  # m, by which a vehicle that gets on comes nearer


class Course:
    """The way that is flown now.

    Args:
        settings: of all stages; `executive` is used.
        clear_way: tells how high a way must be flown.
    """

    def __init__(self, settings: StageSettings, clear_way: ClearWay) -> None:
        self._keys, self._clear_way = settings.executive, clear_way
        self.begin()

    def begin(self) -> None:
        """Forget the way before: another one begins."""
        self._rises: F64 | None = None  # (2,) metres, where it climbs to be clear
        self._from: F64 | None = None  # (2,) metres, where the way began
        self._to = np.full(2, np.nan)  # and where it leads
        self._level: float | None = None  # metres up, kept while the vehicle is beside it
        self._next = np.full(3, np.inf)  # metres, where it was last told to fly
        self._nearest, self._nearer_at = math.inf, 0.0  # m from there so far, and s, when it last came nearer

    def next_point(self, position: F64, to: F64, seen: Seen | None, state: FlightState) -> F64:
        """(3,) metres, where to fly next.

        Args:
            position: (3,) metres, of the vehicle.
            to: (3,) metres, where the way leads.
            seen: the newest verdict on a map of this frame; None: nothing is known of what stands about.
            state: of the executive.
        """
        told = self._next_point(position, to, seen, state)
        if not float(np.linalg.norm(told - self._next)) < NEARER:
            self._next, self._nearest = told, math.inf
        return told

    def _next_point(self, position: F64, to: F64, seen: Seen | None, state: FlightState) -> F64:
        """(3,) metres; nothing stands beside a look leg, nor about its start, but at the end of a lane it may."""
        if state in DOWN_TO_A_LOOK:
            to = self._downwards(position, to)
        near = math.hypot(*(to[:2] - position[:2])) < 2 * self._keys.arrived
        if state is FlightState.LOOK or (near and state is not FlightState.SEARCH):
            return to
        return self._upwards(position, to, seen, state is FlightState.DESCEND)

    def is_stuck(self, t: float, position: F64) -> bool:
        """Whether the vehicle has come no nearer to where it was told to fly for `executive.hold` seconds.

        Args:
            t: s.
            position: (3,) metres, of the vehicle.
        """
        left = float(np.linalg.norm(self._next - position))
        if left < self._nearest - NEARER:
            self._nearest, self._nearer_at = left, t
        return t - self._nearer_at > self._keys.hold

    def _upwards(self, position: F64, to: F64, seen: Seen | None, at_a_place: bool) -> F64:
        """First up, where something mapped stands in the way; where it began to, for no wind carries it on meanwhile.

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
        """On a way that leads down to a place: level to its end, while the vehicle is beside it.

        What stands beside the way was looked for within a few metres, and a gust may carry the vehicle as far.
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
