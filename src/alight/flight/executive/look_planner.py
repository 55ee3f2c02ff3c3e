"""Height of the first look at a place, and a leg across it with no obstacle beside it."""

from __future__ import annotations

import numpy as np

from alight.flight.executive.clear_way import ClearWay
from alight.flight.executive.look_leg import LookLeg
from alight.flight.executive.look_outcome import ABOUT
from alight.landing.wind import downwind
from alight.records import Site
from alight.records.executive import MapVerdict, Situation
from alight.settings import StageSettings

SAME = 0.3  # m between two middles of a leg across one place


class LookPlanner:
    """Look legs over the newest map.

    Args:
        settings: of all stages; `executive` and `route` are used.
        clear_way: for obstacles beside a way.
    """

    def __init__(self, settings: StageSettings, clear_way: ClearWay) -> None:
        self._keys, self._calm, self._clear_way = settings.executive, settings.route.calm, clear_way
        self._open: dict[Site, bool] = {}  # by the newest verdict
        self._number = -1  # of it

    def first_height(self, place: Site, now: Situation) -> float:
        """Height of the first look at a place, metres above it: of its next view, or a share of the present one."""
        assert now.position is not None
        least, up = self._keys.commit_height, float(now.position[2]) - place.up
        wanted = place.look.height if place.look is not None else up * self._keys.lower
        return float(np.clip(wanted, least, max(up, least)))

    def next_height(self, height: float) -> float:
        """Height of the look after one from `height`, metres: half of it, down to that for a place in doubt."""
        k = self._keys
        least = k.commit_height if height > k.commit_height * ABOUT else k.nearest
        return min(height, max(least, height * k.lower))

    def across(
        self, place: Site, height: float, now: Situation, seen: MapVerdict | None, flown: LookLeg | None = None
    ) -> LookLeg | None:
        """The leg across a place, turned as little as possible, so that no obstacle is beside it; None: none is clear.

        The turns begin at the bearing of the vehicle; while it flies to a leg, other legs are planned.

        Args:
            place: that is looked at.
            height: metres above it.
            now: position of the vehicle, and the wind.
            seen: the newest verdict on a map of this frame; None: no obstacles are known.
            flown: the leg that was planned before: taken where it crosses this place, and no other leg is clear.
        """
        assert now.position is not None
        half = max(self._keys.look_base * height, self._keys.least_base)
        above = np.array([place.east, place.north, place.up + height])
        leg = LookLeg(above, half, now.position, downwind(now.wind, self._calm))
        if seen is None:
            return leg
        if (found := self._clear_way.turned(leg, place.up, seen)) is not None or flown is None:
            return found
        same = float(np.linalg.norm(flown.place - above)) < SAME
        return flown if same and self._clear_way.is_open(flown, place.up, seen) else None

    def is_open(self, place: Site, now: Situation, seen: MapVerdict | None) -> bool:
        """True if a place can be crossed at the height of its first look; arguments as of `across`."""
        if seen is None or now.position is None or not self._keys.look_again:
            return True
        if seen.number != self._number:
            self._number, self._open = seen.number, {}
        if place not in self._open:
            self._open[place] = self.across(place, self.first_height(place, now), now, seen) is not None
        return self._open[place]
