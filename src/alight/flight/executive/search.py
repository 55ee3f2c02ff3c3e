"""The search: where to fly until a place is worth a visit; the sites of an earlier run come first, if there are any."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from alight.arrays import F64
from alight.flight.executive.limits import AttemptLimits
from alight.flight.executive.places import KnownPlaces, Standing, opinion
from alight.flight.executive.ways import ClearWay, SearchLanes
from alight.records import Hazard, Site, p_safe_text
from alight.records.executive import LookRecord, MapVerdict, Situation
from alight.settings import StageSettings


class Goal(NamedTuple):
    """A place to look at before the search begins: its name, and (2,) metres in the plane of the bounds."""

    name: str
    position: F64


class SearchStep(NamedTuple):
    """The next step: a place to visit, or a point to fly to; neither: the search is over."""

    place: Site | None = None
    way: F64 | None = None  # (3,) metres
    why: str = ""  # reason for the place, for a search from lower, or for the end of the search
    look: LookRecord | None = None  # a goal that is refused from above it


class Search:
    """Flies to each of the `goals`, then along the lanes of the search; without a place, from half the height.

    A goal is judged by the verdicts from above it, like any place: then it is visited, or refused. It counts as refused
    too if the place that is visited for it is.
    """

    def __init__(
        self, settings: StageSettings, places: KnownPlaces, clear_way: ClearWay, limits: AttemptLimits
    ) -> None:
        self._keys, self._margin = settings.executive, settings.sites.margin
        self._places, self._clear_way, self._limits = places, clear_way, limits
        self._share = settings.route.look_share
        self.goals: list[Goal] = []
        self._lanes: SearchLanes | None = None
        self._above_at: float | None = None  # s, when the vehicle was first above the goal
        self._over_at: float | None = None  # s, when the last lane ended
        self._sinks = False  # whether the vehicle comes down to the lanes of a lower height
        self._refusals: int | None = None  # places refused before the goal was visited; None: it was not visited yet

    def restart(self) -> None:
        """Begin anew in another map frame; the goals remain."""
        self._lanes = self._above_at = self._over_at = self._refusals = None

    def step(
        self, now: Situation, home: F64, ground: float | None, seen: MapVerdict | None, is_open: Callable[[Site], bool]
    ) -> SearchStep:
        """Return the next step.

        Args:
            now: present situation, which must have a position.
            home: (3,) metres, where the search begins.
            ground: ground height, metres up; None: unknown.
            seen: newest verdict on a map of this frame; None: there is none.
            is_open: returns whether a location can be visited.
        """
        bounds = self._clear_way.bounds
        if self._refusals is not None and self._places.refusals > self._refusals:
            self._next_goal()
        if self.goals:
            level = home[2] if ground is None else ground + bounds.search_height
            return self._to_goal(now, float(level), seen, is_open)
        found, lower = self._places.best(is_open), self._share * bounds.search_height
        can_go_lower = ground is not None and lower >= bounds.lowest
        if (can_go_lower or self._sinks) and found is not None and found.kind != "site":
            found = None  # a search from lower judges all candidates at once; a visit judges one
        if found is None or not self._places.worth_a_visit(found):
            lanes = self._lanes = self._lanes or SearchLanes(home, self._keys, bounds)
            self._sinks = self._sinks and not self._is_down(now, lanes.end(ground), seen)
            if self._sinks:
                return SearchStep(way=lanes.end(ground))
            lanes.fly(now.position, ground)
            if lanes.over and self._over_at is None:
                self._over_at = now.t
            if self._over_at is None or not self._is_judged(now, self._over_at, seen):
                return SearchStep(way=lanes.end(ground))
        if found is None and can_go_lower:
            before, bounds.search_height = bounds.search_height, lower
            self._over_at, self._lanes, self._sinks = None, SearchLanes(home, self._keys, bounds), True
            why = f"no site is left from {before:.0f} m, so the search goes on from {bounds.search_height:.0f} m"
            return SearchStep(way=self._lanes.end(ground), why=why)
        if found is None:
            unseen = "" if ground is not None else "; no height could be measured"
            fates = self._places.fates(bounds)
            zones = [] if seen is None else seen.hazards.zones_behind(Hazard.ZONE)
            refused = f"; ground is refused by {', '.join(zones)}" if zones else ""
            return SearchStep(why=f"within {self._keys.search_side:.0f} m{fates}{refused}{unseen}")
        return SearchStep(found, why=f"{found.kind}, P(safe) {p_safe_text(found.p_safe)}")

    def _is_judged(self, now: Situation, t: float, seen: MapVerdict | None) -> bool:
        """Whether a verdict on what was seen until `t`, s, has come, or is overdue."""
        return (seen is not None and seen.t >= t) or self._limits.is_overdue(now.t, t)

    def _is_down(self, now: Situation, end: F64, seen: MapVerdict | None) -> bool:
        """Whether the vehicle is at `end`, (3,) metres, or above it as low as obstacles on the map allow."""
        assert now.position is not None
        level = -math.inf if seen is None else self._clear_way.level(now.position, end, seen)
        left = now.position - np.array([*end[:2], max(float(end[2]), level)])
        return float(np.linalg.norm(left)) < self._keys.arrived

    def _next_goal(self) -> None:
        self.goals.pop(0)
        self._above_at = self._refusals = None

    def _to_goal(
        self, now: Situation, level: float, seen: MapVerdict | None, is_open: Callable[[Site], bool]
    ) -> SearchStep:
        assert now.position is not None
        goal, k = self.goals[0], self._keys
        at = goal.position - self._clear_way.bounds.shift
        way = np.array([*at, level])
        if self._above_at is None and float(np.linalg.norm(way - now.position)) < k.arrived:
            self._above_at = now.t
        if self._above_at is None or seen is None or seen.t < self._above_at:
            return SearchStep(way=way)
        up = float(seen.elevation.grid.nearest_at(seen.elevation.height, at[:1], at[1:])[0])
        place = Site.unjudged(at[0], at[1], up if math.isfinite(up) else seen.ground)
        may = lambda s: is_open(s) and not self._places.is_refused(s)  # noqa: E731
        from_above = level - place.up
        same = max(k.same_place, k.beside * from_above)  # as at a look, which takes a better place near by
        found = opinion(place, seen, same, k.hopeless, may, self._margin)
        if found.standing is Standing.NOT_SEEN and not self._limits.is_overdue(now.t, self._above_at):
            return SearchStep(way=way)
        if found.standing in (Standing.SITE, Standing.CANDIDATE) and is_open(found.place):
            self._refusals, self._above_at = self._places.refusals, None
            p_safe = p_safe_text(found.p_safe)
            return SearchStep(found.place, why=f"{goal.name}: {found.standing.value}, P(safe) {p_safe}")
        why = f"{goal.name}: {found.why or 'something stands beside every way across it'}"
        self._places.refuse(place)
        self._next_goal()
        spot = place.east, place.north, place.up
        return SearchStep(way=way, look=LookRecord(now.t, spot, from_above, found.standing.value, found.p_safe, why))
