"""The visit of one place: looks from lower and lower, then the landing; each new verdict is judged for the place."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from alight.arrays import F64
from alight.flight.executive.descent import Descent, is_near_ground
from alight.flight.executive.limits import AttemptLimits
from alight.flight.executive.looks import LookLeg, LookPlanner, look_outcome
from alight.flight.executive.places import KnownPlaces, Opinion, Standing, opinion
from alight.flight.executive.table import Event
from alight.records import Site, p_safe_text
from alight.records.executive import FlightEvent, FlightState, LookRecord, MapVerdict, Situation
from alight.settings import StageSettings

S, E = FlightState, FlightEvent


class Visit:
    """One visit of a place. Call `begin` at each change between the states at a place, and `step` at every tick.

    Args:
        place: site or candidate to visit.
        looks, places, limits: of the executive.
        on_look: called with the record of each look.
    """

    def __init__(
        self, place: Site, settings: StageSettings, looks: LookPlanner, places: KnownPlaces, limits: AttemptLimits,
        on_look: Callable[[LookRecord], None],
    ) -> None:  # fmt: skip
        self._keys, self._margin = settings.executive, settings.sites.margin
        self._looks, self._places, self._limits, self._on_look = looks, places, limits, on_look
        self.place = place
        self.descent = Descent(settings)
        self.left = math.inf  # metres above the place, last known
        self._height = self._keys.commit_height  # metres above the place, of the present look
        self._refusals = 0  # consecutive verdicts that refuse the place
        self._doubts = 0  # lowest looks after which it was in doubt
        self._judged = 0  # number of the newest verdict that was used
        self._leg: LookLeg | None = None  # planned last
        self._enter(S.APPROACH, 0.0)

    def _enter(self, state: FlightState, t: float) -> None:
        self._state, self._since = state, t
        self._to: F64 | None = None  # (3,) metres, point to fly to: in a look the end of its leg, else its start
        self._leg_done: float | None = None  # s, when the leg of this look ended
        self._crowded: list[float] = []  # s, consecutive verdicts that show an obstacle beside the path

    @property
    def to(self) -> F64 | None:
        """Point to fly to, (3,) metres; None: stay in place."""
        return None if self._crowded else self._to

    @property
    def crosses(self) -> bool:
        """Whether the leg of a look is flown."""
        return self._state is S.LOOK and self._to is not None

    def begin(self, state: FlightState, now: Situation, seen: MapVerdict | None) -> None:
        """Begin the approach, a look, the descent to the next look, or the landing.

        `seen`: newest verdict on a map of this frame; None: there is none.
        """
        self._enter(state, now.t)
        if state is S.COMMIT:
            self.descent.begin(now.t)
            return
        if state is S.APPROACH and not self._keys.look_again:
            self._to = np.array([self.place.east, self.place.north, self.place.up + self._height])
            return
        if state is S.APPROACH:
            self._height = self._looks.first_height(self.place, now)
        elif state is S.DESCEND:
            self._height = self._looks.next_height(self._height)
        self._plan(self._leg_across(now, seen))

    def step(self, now: Situation, seen: MapVerdict | None) -> Event | None:
        """Judge the place by a new verdict; return the event that ends the present state; None: it goes on.

        `seen`: see `begin`.
        """
        k, lands = self._keys, self._state is S.COMMIT
        found = self._opinion(now, seen) if k.look_again else None
        if found is not None:
            if self._refusals >= k.refusals_to_abort:
                judged = lands and found.standing is not Standing.NOT_SEEN
                fallen = f"P(safe) has fallen to {p_safe_text(found.p_safe)}" if judged else ""
                return E.REFUSED, ": ".join(filter(None, (fallen, found.why)))
            if found.standing in (Standing.SITE, Standing.CANDIDATE):
                # a landing keeps its location: no step to the side near the ground
                self.place = replace(self.place, p_safe=found.p_safe) if lands else found.place
            self._crowded = [*self._crowded, now.t] if self._is_beside(now, seen) else []
        crowded = self._crowded
        if len(crowded) >= k.refusals_to_abort or (crowded and now.t - crowded[0] > k.wait):
            return E.REFUSED, f"something stands beside {'the way down' if lands else 'every way across it'}"
        if lands or crowded:
            return None
        if self._state is S.LOOK:
            return self._looking(now, seen, found)
        if self._to is None:
            late = now.t - self._since > k.wait
            return (E.WAITED, "something stands beside every way across it") if late else None
        return (E.ARRIVED, "") if self._is_reached(now, self._to) else None

    def _looking(self, now: Situation, seen: MapVerdict | None, found: Opinion | None) -> Event | None:
        k = self._keys
        if not k.look_again:
            return E.CONFIRMED, f"P(safe) {p_safe_text(self.place.p_safe)}, not looked at again"
        if self._to is not None:
            if self._is_reached(now, self._to):
                self._to, self._leg_done = None, now.t
            return None
        if found is None or self._leg_done is None or (seen is not None and seen.t < self._leg_done):
            late = self._limits.is_overdue(now.t, self._leg_done or self._since)
            return (E.WAITED, "verdicts on it do not come") if late else None
        at, standing = found.place, found.standing
        self._on_look(
            LookRecord(now.t, (at.east, at.north, at.up), self._height, standing.value, found.p_safe, found.why)
        )
        candidate = standing is Standing.CANDIDATE
        better = self._places.better(at, self._is_open(now, seen)) if candidate else None
        if (outcome := look_outcome(found, self._height, better, k)) is not None:
            return outcome
        self._doubts += candidate
        if candidate and self._doubts < k.refusals_to_abort:
            self._leg_done = None
            self._plan(self._leg_across(now, seen))  # look once more, from the other side
            return None
        if standing is Standing.REFUSED and self._refusals < k.refusals_to_abort:
            return None
        return E.REFUSED, f"{standing.value} from {self._height:.1f} m: {found.why}"

    def _opinion(self, now: Situation, seen: MapVerdict | None) -> Opinion | None:
        k, low = self._keys, self._state is S.COMMIT
        if seen is None or seen.number <= self._judged:
            return None
        self._judged = seen.number
        same = k.same_spot if low else max(k.same_place, k.beside * self._height)
        least, is_open = k.probable if low else k.hopeless, self._is_open(now, seen)
        may = (lambda s: True) if low else (lambda s: not self._places.is_refused(s) and is_open(s))
        found = opinion(self.place, seen, same, least, may, self._margin)
        if low and self.descent.judged(seen.t, found, self.left):
            self._refusals = k.refusals_to_abort
        elif found.standing is not Standing.NOT_SEEN:
            fallen = found.standing is Standing.REFUSED or (low and found.p_safe < least)
            self._refusals = self._refusals + 1 if fallen else 0
        return found

    def _plan(self, leg: LookLeg | None) -> None:
        self._leg = leg
        if leg is not None:
            self._to = leg.end if self._state is S.LOOK else leg.start

    def _leg_across(self, now: Situation, seen: MapVerdict | None) -> LookLeg | None:
        """Return the look leg over the newest map; see `LookPlanner.across`. None: no leg is clear."""
        return self._looks.across(self.place, self._height, now, seen, self._leg)

    def _is_open(self, now: Situation, seen: MapVerdict | None) -> Callable[[Site], bool]:
        return partial(self._looks.is_open, now=now, seen=seen)

    def _is_beside(self, now: Situation, seen: MapVerdict | None) -> bool:
        """Whether an obstacle is beside the descent of a landing, the leg of a look or, before a look, every leg.

        Before a look, a planned leg that is not clear is replaced by a clear leg.
        """
        ways, ground = self._looks.clear_way, self.place.up
        if now.position is None or seen is None:
            return False
        if self._state is S.COMMIT:
            return not (is_near_ground(self.left, self._keys) or ways.is_free_down(self.place, seen))
        if self._state is S.LOOK and self._leg is not None:
            return self._to is not None and not ways.is_free(now.position, self._to, ground, seen)
        leg, flown = self._leg_across(now, seen), self._leg
        if leg is not None and (flown is None or not flown.is_clear(ways, ground, seen)):
            self._plan(leg)
        return leg is None

    def _is_reached(self, now: Situation, point: F64) -> bool:
        return now.position is not None and float(np.linalg.norm(point - now.position)) < self._keys.arrived
