"""Paths free of obstacles, the next point on the present path, and the lanes of a search."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from alight.arrays import F64
from alight.flight.executive.bounds import Bounds
from alight.landing.route import Obstructions, along_way, way_below
from alight.records import Site
from alight.records.executive import FlightState, MapVerdict
from alight.settings import ExecutiveSettings, StageSettings

LOW = 0.5  # share of its height: greatest clearance of a look leg above obstacles beside it
NEARER = 0.5  # m, least progress towards a point


class ClearWay:
    """Finds paths that are within `bounds`, and clear of the obstacles on the newest map.

    A path over obstacles of doubtful height is flown as high as the lowest search or higher: a map once showed 3 m for
    most of a tree of 10 m, and a landing flew into it. The same holds for a long path over partly unmapped ground.
    """

    def __init__(self, settings: StageSettings) -> None:
        self._keys, self._clearance, lander = settings.executive, settings.route.clearance, settings.lander
        self._long = settings.route.approach_height  # m: a view from there shows no more to one side
        self._beside = max(self._clearance, 2.0 * max(lander.radius, lander.rotor_radius or 0.0))  # m
        self.bounds = Bounds(settings)
        self._number = -1  # number of the verdict
        self._obstructions: Obstructions | None = None  # on the map of that verdict

    def level(self, start: F64, to: F64, seen: MapVerdict, at_a_place: bool = False) -> float:
        """Return the height, metres up, at which a level path from above `start` (3,) to above `to` (3,) is clear.

        Args:
            seen: verdict on the map that shows the obstacles.
            at_a_place: whether the path joins two looks at one location; then only mapped obstacles are avoided.
        """
        grid, k = seen.elevation.grid, self._keys
        below = way_below(start, to, grid, self._obstructions_of(seen), self._clearance, self._beside, k.rise)
        is_long = math.hypot(to[0] - start[0], to[1] - start[1]) > self._long
        unsure = below.doubtful > k.risen or (is_long and below.unmapped > k.unmapped)
        sure = seen.ground + min(self.bounds.search_height, self.bounds.lowest)
        return max(below.clear, sure) if unsure and not at_a_place else below.clear

    def is_free(self, start: F64, to: F64, ground: float, seen: MapVerdict, times: float = 1.0) -> bool:
        """Whether a level path from `start` to `to`, (3,) metres, near a location is free and within bounds.

        All obstacles on the map of `seen` within `times` times the larger of `route.clearance` and twice the lander's
        radius must rise at most `executive.rise` above `ground`, metres up, and must stay well below the path.
        """
        return self.bounds.is_free(start, to) and self._is_unobstructed(start, to, ground, seen, times)

    def _is_unobstructed(self, start: F64, to: F64, ground: float, seen: MapVerdict, times: float) -> bool:
        grid, width = seen.elevation.grid, times * self._beside
        reach = width + 0.5 * math.hypot(to[0] - start[0], to[1] - start[1])
        middle = 0.5 * (start + to)
        k = math.ceil(reach / grid.cell) + 1
        at = (int(i) for i in grid.index(middle[0], middle[1]))
        rows, cols = (slice(max(i - k, 0), max(i + k + 1, 0)) for i in at)
        top = self._obstructions_of(seen).top[rows, cols]
        _, near = along_way(start, to, grid.window(rows.start, cols.start, *top.shape), width)
        spare = min(self._clearance, LOW * (float(start[2]) - ground))
        highest = float(np.max(top[near & np.isfinite(top)], initial=-math.inf))
        return highest <= min(ground + self._keys.rise, float(start[2]) - spare)

    def is_free_down(self, place: Site, seen: MapVerdict) -> bool:
        """Whether the disc is within bounds, and no tall obstacle beside it, on the way down; see `is_free`."""
        above = np.array([place.east, place.north, place.up + self._keys.commit_height])
        return self.bounds.has_disc(above) and self._is_unobstructed(above, above, place.up, seen, 1.0)

    def _obstructions_of(self, seen: MapVerdict) -> Obstructions:
        if self._obstructions is None or seen.number != self._number:
            self._number, self._obstructions = seen.number, Obstructions.of(seen.elevation, seen.hazards.wires)
        return self._obstructions


class Course:
    """The path that is flown now, and the next point on it."""

    def __init__(self, settings: StageSettings, clear_way: ClearWay) -> None:
        self._keys, self._clear_way = settings.executive, clear_way
        self.begin()

    def begin(self) -> None:
        """Begin another path, and forget the previous path."""
        self._rises: F64 | None = None  # (2,) metres, where the vehicle climbs to be clear
        self._from: F64 | None = None  # (2,) metres, start of the path
        self._to = np.full(2, np.nan)  # (2,) metres, end of the path
        self._level: float | None = None  # metres up, held while the vehicle is beside the path
        self._next = np.full(3, np.inf)  # (3,) metres, last ordered point
        self._nearest = math.inf  # m, least distance to that point so far
        self._nearer_at: float | None = None  # s, when the vehicle last came nearer; None: no point was ordered

    def next_point(self, position: F64, to: F64, seen: MapVerdict | None, state: FlightState) -> F64:
        """Return the next point to fly to, (3,) metres.

        Args:
            position: position of the vehicle, (3,) metres.
            to: end of the path, (3,) metres.
            seen: newest verdict on a map of this frame; None: no obstacles are known.
            state: state of the executive, which decides how the path avoids obstacles.
        """
        to = self._clear_way.bounds.next_point(position, to)
        if state in (FlightState.APPROACH, FlightState.DESCEND):
            to = self._downwards(position, to)
        near = math.hypot(*(to[:2] - position[:2])) < 2 * self._keys.arrived
        # look legs and their starts are clear of obstacles, but the end of a lane may not be
        if state is not FlightState.LOOK and not (near and state is not FlightState.SEARCH):
            to = self._upwards(position, to, seen, state is FlightState.DESCEND)
        if not float(np.linalg.norm(to - self._next)) < NEARER:
            self._next, self._nearest = to, math.inf
        return to

    def is_stuck(self, t: float, position: F64) -> bool:
        """Whether at `t`, s, the vehicle has come no nearer to the ordered point for `executive.hold` seconds."""
        left = float(np.linalg.norm(self._next - position))
        if self._nearer_at is None or left < self._nearest - NEARER:
            self._nearest, self._nearer_at = left, t
        return t - self._nearer_at > self._keys.hold

    def _upwards(self, position: F64, to: F64, seen: MapVerdict | None, at_a_place: bool) -> F64:
        """Return `to`, raised to clear the path; if the vehicle is lower, the point above the start of its climb.

        `at_a_place`: see `ClearWay.level`.
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
        """Return the next point of a descent, (3,) metres: `to`; off the path, at least as high as where it was left.

        Only obstacles within a few metres of the path were checked, and a gust may displace the vehicle as far.
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


class SearchLanes:
    """The lanes of a search, flown one after the other.

    The outermost lane lies so far inside the searched square that its pictures reach the edge of the square. A lane is
    at least as long as the leg of a look from its height: without motion, a single camera measures no heights.

    Args:
        home: middle of the square, (3,) metres, at the first search height above the ground, as far as that is known.
        bounds: bounds of the vehicle; a corner outside moves to the nearest position inside. Lanes are flown at its
            `search_height`.
    """

    def __init__(self, home: F64, keys: ExecutiveSettings, bounds: Bounds) -> None:
        self._height, self._ground = bounds.search_height, float(home[2]) - keys.search_height
        shown = 0.75 * self._height  # m, shorter side of a picture on the ground
        side = max(keys.search_side - shown, 2.0 * keys.look_base * self._height)
        corners = square_spiral(home, side, keys.lane * shown)
        self._corners = (bounds.nearest(np.array(corner)) for corner in corners)
        self._arrived = keys.arrived
        self._corner = next(self._corners)
        self.over = False  # whether the whole square was searched

    def end(self, ground: float | None) -> F64:
        """Return the end of the present lane, (3,) metres, at the search height above `ground` (None: unknown)."""
        return np.array([*self._corner, (self._ground if ground is None else ground) + self._height])

    def fly(self, position: F64 | None, ground: float | None) -> None:
        """Begin the next lane, or end the search, if the vehicle is at the end of the present lane or above that end.

        Args:
            position: position of the vehicle, (3,) metres; None: unknown.
            ground: ground height, metres up; None: unknown.
        """
        if position is None:
            return
        left, near = self.end(ground) - position, self._arrived
        if math.hypot(left[0], left[1]) < near and left[2] < near:
            corner = next(self._corners, None)
            self._corner, self.over = self._corner if corner is None else corner, corner is None


def square_spiral(centre: F64, side: float, lane: float) -> Iterator[tuple[float, float]]:
    """Yield the corners (east, north) of a square spiral from the middle of a square outwards to its edge.

    Args:
        centre: centre of the square, (2,) or (3,) metres.
        side: side of the square, metres.
        lane: greatest distance between neighbouring turns, metres; the turns are spread evenly.
    """
    turns = max(1, math.ceil(side / lane - 1e-9))
    lane = side / turns
    begin = -0.5 * lane if turns % 2 else 0.0  # with an odd number of turns, the end lies half a lane off the start
    east, north = float(centre[0]) + begin, float(centre[1]) + begin
    yield east, north
    steps = [(0.0, 1.0), (1.0, 0.0), (0.0, -1.0), (-1.0, 0.0)]
    for k, length in enumerate([lane * n for n in range(1, turns + 1) for _ in range(2)] + [side]):
        east, north = east + steps[k % 4][0] * length, north + steps[k % 4][1] * length
        yield east, north
