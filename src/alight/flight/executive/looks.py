"""Looks at a location: their heights, their legs across it, and the decision after each look."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from alight.arrays import F64
from alight.flight.executive.places import Opinion, Standing
from alight.flight.executive.table import Event
from alight.flight.executive.ways import ClearWay
from alight.landing.wind import downwind
from alight.records import Site, p_safe_text
from alight.records.executive import FlightEvent, MapVerdict, Situation
from alight.settings import ExecutiveSettings, StageSettings

E = FlightEvent
ABOUT = 1.05  # a look from up to this multiple of a height is treated as a look from that height
TURNS = tuple(math.radians(angle) for angle in (0, 45, -45, 90, -90, 135, -135, 180))  # turns of a leg, tried in order
ROOMY = (
    2.0  # times the least distance to obstacles, preferred if a leg has it: a gust may displace the vehicle by metres
)


@dataclass(frozen=True, eq=False)
class LookLeg:
    """The level path of a look across a location, against the wind if there is any."""

    place: F64  # (3,) metres, location at the height of the look
    half: float  # metres, half the length of the leg
    position: F64  # (3,) metres, position of the vehicle
    downwind: F64 | None  # (2,) unit vector of the motion of the air; None: calm, or unknown
    turned: float = 0.0  # rad, turn from the direction that best suits the wind and the vehicle

    @property
    def start(self) -> F64:
        """Start of the leg, (3,) metres: downwind of the location; without wind, the end nearer to the vehicle."""
        return self._beside(self._side if self.downwind is None else self._turn(self.downwind))

    @property
    def end(self) -> F64:
        """End of the leg, (3,) metres: beyond the location as seen from the vehicle."""
        return self._beside(-self._side)

    def is_clear(self, ways: ClearWay, ground: float, seen: MapVerdict, times: float = 1.0) -> bool:
        """Whether the whole leg is free, wherever the vehicle joins it; see `ClearWay.is_free` for the arguments."""
        return ways.is_free(2 * self.place - self.end, self.end, ground, seen, times)

    def cleared(self, ways: ClearWay, ground: float, seen: MapVerdict) -> LookLeg | None:
        """Return the leg, turned as little as possible so that no obstacle is beside it; None: no turn is clear.

        Both ends must be inside the bounds. Turns that keep `ROOMY` times the least distance to obstacles are
        preferred. Arguments: see `ClearWay.is_free`.
        """
        free: LookLeg | None = None
        turns = (replace(self, turned=turn) for turn in TURNS)
        for turned in (t for t in turns if ways.bounds.is_inside(t.start) and ways.bounds.is_inside(t.end)):
            if turned.is_clear(ways, ground, seen, ROOMY):
                return turned
            if free is None and turned.is_clear(ways, ground, seen):
                free = turned
        return free

    def _beside(self, towards: F64) -> F64:
        return np.array([*(self.place[:2] + self.half * towards), self.place[2]])

    @property
    def _side(self) -> F64:
        """Unit vector (2,) from the location towards the vehicle; with wind, the nearer of upwind and downwind."""
        away = self.position[:2] - self.place[:2]
        if self.downwind is not None:
            along = self._turn(self.downwind)
            return along if float(along @ away) >= 0.0 else -along
        distance = float(np.hypot(*away))  # within 0.3 m the vehicle is treated as straight above
        return self._turn(away / distance if distance > 0.3 else np.array([0.0, 1.0]))

    def _turn(self, v: F64) -> F64:
        c, s = math.cos(self.turned), math.sin(self.turned)
        return np.array([c * v[0] - s * v[1], s * v[0] + c * v[1]])


class LookPlanner:
    """Plans look legs over the newest map."""

    def __init__(self, settings: StageSettings, clear_way: ClearWay) -> None:
        self._keys, self._route, self.clear_way = settings.executive, settings.route, clear_way
        self._radius = settings.lander.radius  # m
        self._open: dict[Site, bool] = {}  # whether a location can be crossed, by the newest verdict
        self._number = -1  # number of that verdict

    def first_height(self, place: Site, now: Situation) -> float:
        """Return the height of the first look, metres above `place`: the height of its next view, or lower than now."""
        assert now.position is not None
        least, up = self._keys.commit_height, float(now.position[2]) - place.up
        wanted = place.look.height if place.look is not None else up * self._route.look_share
        return float(np.clip(wanted, least, max(up, least)))

    def next_height(self, height: float) -> float:
        """Return the height, metres above the location, of the look that follows a look from `height`.

        It is a share of `height`, but at least `commit_height`; after a look from `commit_height`, at least `nearest`.
        """
        k = self._keys
        least = k.commit_height if height > k.commit_height * ABOUT else k.nearest
        return min(height, max(least, height * self._route.look_share))

    def across(
        self, place: Site, height: float, now: Situation, seen: MapVerdict | None, flown: LookLeg | None = None
    ) -> LookLeg | None:
        """Return the leg across a location, turned as little as possible so that it is clear; None: no leg is clear.

        Unturned, the leg lies along the wind or, in calm, along the bearing of the vehicle; so it may change in flight.

        Args:
            place: site or candidate to look at.
            height: height of the look above the location, metres.
            now: present situation, which must have a position.
            seen: newest verdict on a map of this frame; None: no obstacles are known.
            flown: leg planned before; returned if it crosses this location and no other leg is clear.
        """
        assert now.position is not None
        half = max(self._keys.look_base * height, self._radius)
        above = np.array([place.east, place.north, place.up + height])
        leg = LookLeg(above, half, now.position, downwind(now.wind, self._route.calm))
        if seen is None:
            return leg
        if (found := leg.cleared(self.clear_way, place.up, seen)) is not None or flown is None:
            return found
        same = float(np.linalg.norm(flown.place - above)) < 0.3  # m
        return flown if same and flown.is_clear(self.clear_way, place.up, seen) else None

    def is_open(self, place: Site, now: Situation, seen: MapVerdict | None) -> bool:
        """Whether a location can be crossed at the height of its first look; see `across` for the arguments."""
        if seen is None or now.position is None or not self._keys.look_again:
            return True
        if seen.number != self._number:
            self._number, self._open = seen.number, {}
        if place not in self._open:
            inside = self.clear_way.bounds.is_inside(place.position_world)
            self._open[place] = inside and self.across(place, self.first_height(place, now), now, seen) is not None
        return self._open[place]


def look_outcome(found: Opinion, height: float, better: Site | None, keys: ExecutiveSettings) -> Event | None:
    """Return the event of a look and its reason; None: the location is refused, or in doubt from the lowest look.

    Args:
        found: opinion on the location after the look.
        height: height of the look above the location, metres.
        better: another location, for which a location in doubt is given up; None: there is none.
    """
    seen_from = f"P(safe) {p_safe_text(found.p_safe)} from {height:.1f} m"
    candidate, lowest = found.standing is Standing.CANDIDATE, height <= keys.commit_height * ABOUT
    if candidate and better is not None:
        return E.REFUSED, f"{seen_from}, and {p_safe_text(better.p_safe)} elsewhere"
    if found.standing is Standing.SITE and lowest:
        return E.CONFIRMED, seen_from
    if found.standing in (Standing.SITE, Standing.CANDIDATE) and not lowest:
        return E.LOWER, f"{found.standing.value}, {seen_from}"
    if candidate and height > keys.nearest * ABOUT:
        return E.LOWER, f"in doubt, {seen_from}"
    return None
