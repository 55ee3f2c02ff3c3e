"""Looks at a place: their heights, their legs past it, and what one decides."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from alight.arrays import F64
from alight.flight.executive.places import Opinion, Standing
from alight.flight.executive.ways import ClearWay
from alight.landing.wind import downwind
from alight.records import Site, p_safe_text
from alight.records.executive import FlightEvent, MapVerdict, Situation
from alight.settings import ExecutiveSettings, StageSettings

E = FlightEvent
ABOUT = 1.05  # a look from up to this factor of a height counts as one from there
TURNS = tuple(math.radians(angle) for angle in (0, 45, -45, 90, -90, 135, -135, 180))  # of a look leg, tried in turn
ROOMY = (
    2.0  # times the least distance to obstacles, preferred if some leg has it: a gust carries the vehicle metres off
)


@dataclass(frozen=True, eq=False)
class LookLeg:
    """A leg across a place, at one height, against the wind if there is one; straight above there is no parallax."""

    place: F64  # (3,) metres, at the height of the look
    half: float  # metres, half its length
    position: F64  # (3,) metres, of the vehicle
    downwind: F64 | None  # (2,) unit vector, where the air goes; None: calm, or not known
    turned: float = 0.0  # rad, from the direction that suits the wind and the vehicle best

    @property
    def start(self) -> F64:
        """(3,) metres: downwind of the place, so that the leg leads against the wind; else on the vehicle's side."""
        return self._beside(self._side if self.downwind is None else self._turn(self.downwind))

    @property
    def end(self) -> F64:
        """(3,) metres: on the side of the place opposite to the vehicle."""
        return self._beside(-self._side)

    def is_clear(self, ways: ClearWay, ground: float, seen: MapVerdict, times: float = 1.0) -> bool:
        """True if it is free from end to end, wherever the vehicle joins it; arguments as of `ClearWay.is_free`."""
        return ways.is_free(2 * self.place - self.end, self.end, ground, seen, times)

    def cleared(self, ways: ClearWay, ground: float, seen: MapVerdict) -> LookLeg | None:
        """Turn it as little as possible, so that no obstacle stands beside it, at `ROOMY` times that if possible.

        None: something stands beside it, whichever way it is turned. Arguments as of `ClearWay.is_free`.
        """
        free: LookLeg | None = None
        for turned in (replace(self, turned=turn) for turn in TURNS):
            if turned.is_clear(ways, ground, seen, ROOMY):
                return turned
            if free is None and turned.is_clear(ways, ground, seen):
                free = turned
        return free

    def _beside(self, towards: F64) -> F64:
        return np.array([*(self.place[:2] + self.half * towards), self.place[2]])

    @property
    def _side(self) -> F64:
        """(2,) unit vector from the place to the vehicle's side, along the wind where there is one."""
        away = self.position[:2] - self.place[:2]
        if self.downwind is not None:
            along = self._turn(self.downwind)
            return along if float(along @ away) >= 0.0 else -along
        distance = float(np.hypot(*away))  # within 0.3 m it is straight above
        return self._turn(away / distance if distance > 0.3 else np.array([0.0, 1.0]))

    def _turn(self, v: F64) -> F64:
        c, s = math.cos(self.turned), math.sin(self.turned)
        return np.array([c * v[0] - s * v[1], s * v[0] + c * v[1]])


class LookPlanner:
    """Look legs over the newest map."""

    def __init__(self, settings: StageSettings, clear_way: ClearWay) -> None:
        self._keys, self._route, self._clear_way = settings.executive, settings.route, clear_way
        self._open: dict[Site, bool] = {}  # by the newest verdict
        self._number = -1  # of it

    def first_height(self, place: Site, now: Situation) -> float:
        """Height of the first look at a place, metres above it: of its next view, or a share of the present one."""
        assert now.position is not None
        least, up = self._keys.commit_height, float(now.position[2]) - place.up
        wanted = place.look.height if place.look is not None else up * self._route.look_share
        return float(np.clip(wanted, least, max(up, least)))

    def next_height(self, height: float) -> float:
        """Height of the look after one from `height`, metres: half of it, down to that for a place in doubt."""
        k = self._keys
        least = k.commit_height if height > k.commit_height * ABOUT else k.nearest
        return min(height, max(least, height * self._route.look_share))

    def across(
        self, place: Site, height: float, now: Situation, seen: MapVerdict | None, flown: LookLeg | None = None
    ) -> LookLeg | None:
        """The leg across a place, turned as little as possible, so that no obstacle is beside it; None: none is clear.

        The turns begin at the bearing of the vehicle; while it flies to a leg, other legs are planned.

        Args:
            seen: the newest verdict on a map of this frame; None: no obstacles are known.
            flown: the leg that was planned before: taken where it crosses this place, and no other leg is clear.
        """
        assert now.position is not None
        half = max(self._keys.look_base * height, self._keys.least_base)
        above = np.array([place.east, place.north, place.up + height])
        leg = LookLeg(above, half, now.position, downwind(now.wind, self._route.calm))
        if seen is None:
            return leg
        if (found := leg.cleared(self._clear_way, place.up, seen)) is not None or flown is None:
            return found
        same = float(np.linalg.norm(flown.place - above)) < 0.3  # m
        return flown if same and flown.is_clear(self._clear_way, place.up, seen) else None

    def is_open(self, place: Site, now: Situation, seen: MapVerdict | None) -> bool:
        """True if a place can be crossed at the height of its first look; arguments as of `across`."""
        if seen is None or now.position is None or not self._keys.look_again:
            return True
        if seen.number != self._number:
            self._number, self._open = seen.number, {}
        if place not in self._open:
            self._open[place] = self.across(place, self.first_height(place, now), now, seen) is not None
        return self._open[place]


def look_outcome(
    found: Opinion, height: float, better: Site | None, keys: ExecutiveSettings
) -> tuple[FlightEvent, str] | None:
    """Return the event of a look and its reason; None: the place is refused, or in doubt from the lowest look.

    Args:
        better: a place elsewhere for which one in doubt is left.
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
