"""The executive: it looks at a location from lower and lower, until the location is a site or is refused.

No I/O and no clock: `tick` takes the situation and returns the order to the vehicle. From far away the map shows
candidates, from near by it shows sites. The vehicle flies to a location and looks at it from beside it, as a single
camera straight above sees no parallax. It looks again from half the height, until the lowest look confirms the
location. Only then the landing begins.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from alight.arrays import F64
from alight.flight.executive.bounds import Bounds
from alight.flight.executive.descent import Descent, is_too_low_to_abort
from alight.flight.executive.limits import AttemptLimits
from alight.flight.executive.looks import LookPlanner
from alight.flight.executive.places import KnownPlaces
from alight.flight.executive.search import Goal, Search
from alight.flight.executive.table import AT_A_PLACE, DOWN, ENDS, JUDGE_EVERY, TABLE, Event
from alight.flight.executive.visit import Visit
from alight.flight.executive.ways import ClearWay, Course
from alight.landing.wind import ground_speed, is_from_behind
from alight.records import MotionState, Site, p_safe_text
from alight.records.executive import (
    FlightDiary,
    FlightEvent,
    FlightState,
    MapVerdict,
    Need,
    Order,
    Situation,
    Transition,
)
from alight.settings import StageSettings

S, E = FlightState, FlightEvent
LOOK_SPEED = 0.4  # share of the cruise speed, along a look leg


@dataclass
class _Frame:
    id: int = 0
    home: F64 | None = None  # (3,) metres, where the search begins
    ground: float | None = None  # metres up
    above: float | None = None  # metres, last known height above the ground


class Executive:
    """Decides on the orders of one landing. Call `tick` several times per second."""

    def __init__(self, settings: StageSettings) -> None:
        self._settings, self._keys, self._route = settings, settings.executive, settings.route
        self.state, self.diary = S.SEARCH, FlightDiary()
        self._clear_way = ClearWay(settings)
        self._looks, self._course = LookPlanner(settings, self._clear_way), Course(settings, self._clear_way)
        self._limits, self._places = AttemptLimits(settings.executive), KnownPlaces(settings)
        self._search = Search(settings, self._places, self._clear_way, self._limits)
        self._frame, self._since = _Frame(), math.inf  # s, begin of the present state
        self._way: F64 | None = None  # (3,) metres, point to fly to in a search or a climb
        self._visit: Visit | None = None
        self._held = S.SEARCH  # the state before HOLD
        self._by_sight = False  # whether it flew by sight at the last step
        self._touched = False  # whether the ground was reported in a state of `DOWN`: no climb from then on

    def confine(self, bounds: Bounds, goals: Sequence[Goal] = ()) -> None:
        """Keep the vehicle within `bounds`, and begin the search with `goals`. Call it before the first tick."""
        self._clear_way.bounds, self._search.goals = bounds, list(goals)

    @property
    def target(self) -> Site | None:
        """Site or candidate that is visited; None: no location is visited."""
        return None if self._visit is None else self._visit.place

    @property
    def need(self) -> Need | None:
        """Verdicts needed now; None: none, as in a landing too low to abort: they would have no effect.

        Few are needed along a look leg: a look is judged at its end.
        """
        if self._landing is not None and is_too_low_to_abort(self._left, self._keys):
            return None
        place, crosses = self.target, self._visit is not None and self._visit.crosses
        seconds = JUDGE_EVERY.get(FlightState.APPROACH if crosses else self.state)
        about = None if place is None else np.array([place.east, place.north])
        return None if seconds is None else Need(seconds, about)

    # -- the step

    def tick(self, now: Situation) -> Order:
        """Return the order for the present situation; add transitions and looks to `diary`."""
        if math.isinf(self._since):
            self._since = now.t
        self._limits.observe(now)
        self._observe(now)
        event = self._event(now)
        if event is not None and (after := TABLE.get((self.state, event[0]))) is not None:
            self._enter(after, event, now)
        return self._order(now)

    def _observe(self, now: Situation) -> None:
        frame, at, bounds = self._frame, now.position, self._clear_way.bounds
        bounds.shift = bounds.shift if now.offset is None else now.offset
        self._touched |= now.contact and self.state in DOWN
        if at is not None and frame.home is None:
            frame.home, frame.id = at.copy(), now.frame_id
        if at is not None and self._visit is not None and now.frame_id == frame.id:
            self._visit.left = float(at[2]) - self._visit.place.up
        seen = self._seen(now)
        bounds.observe(seen)
        if seen is not None:
            frame.ground = seen.ground
            self._places.note(seen)
        if at is not None and frame.ground is not None and now.frame_id == frame.id:
            frame.above = float(at[2]) - frame.ground

    @property
    def _left(self) -> float:
        """Last known height above the visited location, m; 0 after contact; inf: unknown, or no location is visited."""
        return 0.0 if self._touched else math.inf if self._visit is None else self._visit.left

    @property
    def _landing(self) -> Descent | None:
        """The landing that is flown; None: none is."""
        return self._visit.descent if self._visit is not None and self.state is S.COMMIT else None

    def _seen(self, now: Situation) -> MapVerdict | None:
        return None if now.seen is None or now.seen.frame_id != self._frame.id else now.seen

    # -- events

    def _event(self, now: Situation) -> Event | None:
        if self.state in (S.LANDED, S.HANDED_OVER):
            return None
        if now.standing and self.state in DOWN:  # before the pilot: some change the mode as motors stop
            return E.TOUCHED_DOWN, "as the autopilot reports"
        if not now.link:  # before the pilot: control is given away with the link
            return E.LINK_LOST, "no heartbeat"
        if now.pilot:
            return (E.FAILSAFE, now.failsafe) if now.failsafe else (E.PILOT, "by the mode, or by the sticks")
        if self.state is S.RETURN:
            return None
        # without a position the autopilot soon lands by its own failsafe: a climb would only make its way down longer
        landing = self._landing
        place, left = self.target, self._left
        if landing is not None and place is not None and now.holds and landing.must_stop(now.movers, place, left):
            return E.REFUSED, "somebody moves at the place, or towards it"
        if landing is not None and (is_too_low_to_abort(self._left, self._keys) or not now.holds):
            return (E.UNFELT, unfelt) if (unfelt := landing.unfelt(now.t)) else None
        if self._touched and self.state in (S.ABORT, S.HOLD):
            late = now.t - self._since > self._keys.hold
            return (E.WAITED, "it stands, and its motors do not stop") if late else None
        return self._trouble(now) or self._progress(now)

    def _trouble(self, now: Situation) -> Event | None:
        over = self._limits.exceeded(now)
        if self.state is S.HOLD:
            if (waited := now.t - self._since) > self._limits.patience(now):
                return E.WAITED, f"nothing to fly by for {waited:.0f} s"
            if over is not None and now.holds:
                return over
        lost = now.state in (MotionState.LOST, MotionState.INITIALISING)
        flown = self._held if self.state is S.HOLD else self.state
        astray = now.position is None or lost or self._limits.is_too_weak(now, flown, self._left)
        blind = now.picture_age > self._keys.stale
        if self.state is not S.ABORT and (astray or blind):
            self._limits.missing_at = now.t
            if astray:
                known = now.position is not None or lost
                return E.NAVIGATION_LOST, f"the motion is {now.state.name.lower()}" if known else "no position"
            frozen = "the cameras have frozen: one picture comes again and again, " if now.frozen else ""
            return E.CAMERA_LOST, f"{frozen}the newest picture is {now.picture_age:.1f} s old"
        if now.frame_id != self._frame.id and now.position is not None:
            self._follow(now)
            return E.NEW_FRAME, f"frame {now.frame_id}"
        landing = self._landing
        if landing is not None and (why := landing.too_long(now.t, self._left, self._limits.verdict_time)):
            return E.WAITED, why
        return over if over is not None and (self.state, over[0]) in TABLE else None  # else no effect in this state

    def _progress(self, now: Situation) -> Event | None:
        assert now.position is not None or self.state is S.ABORT
        if self.state is S.HOLD:
            recovered = now.t - self._limits.missing_at >= self._keys.degraded  # a brief recovery does not end a hold
            nearly_down = now.lands and (self._frame.above or math.inf) < self._keys.commit_height
            return (E.RECOVERED, "") if recovered and not nearly_down else None
        if self.state is S.SEARCH:
            return self._searching(now)
        if self.state is S.ABORT:
            return self._aborting(now)
        assert self._visit is not None
        return self._at_place(now, self._visit)

    def _searching(self, now: Situation) -> Event | None:
        assert self._frame.home is not None
        if (near := self._near_site(now)) is not None:
            self._begin_visit(near)
            return E.FOUND, f"the nearest site, as GPS is lost, P(safe) {p_safe_text(near.p_safe)}"
        step = self._search.step(now, self._frame.home, self._frame.ground, self._seen(now), self._is_open(now))
        self.diary.looks += [] if step.look is None else [step.look]
        if step.place is not None:
            self._begin_visit(step.place)
            return E.FOUND, step.why
        self._way = step.way
        if step.way is None:
            return E.SEARCHED, step.why
        return (E.LOWER, step.why) if step.why else None

    def _begin_visit(self, place: Site) -> None:
        self._visit = Visit(place, self._settings, self._looks, self._places, self._limits, self.diary.looks.append)

    def _near_site(self, now: Situation) -> Site | None:
        """Return the nearest site that can be reached in flight by sight; None: there is none, or GPS is there."""
        if now.sight is None or now.position is None:
            return None
        return self._places.nearest_site(now.position, self._is_open(now))

    def _can_reach(self, place: Site, now: Situation) -> bool:
        """Whether the vehicle is above a place before its position, by sight, is as uncertain as the place is wide."""
        if now.sight is None or now.position is None:
            return True
        way, r = place.position_world - now.position, self._route
        seconds = math.hypot(way[0], way[1]) / r.cruise_speed + abs(float(way[2])) / r.descent_speed
        return now.sight.sigma_after(seconds) < place.radius

    def _aborting(self, now: Situation) -> Event | None:
        waited = now.t - self._since
        if now.position is None:
            return (E.WAITED, "the motion is not known") if waited > self._limits.patience(now) else None
        if self._way is None:  # the position was unknown before: the climb is planned now
            self._climb(now)
        if self._way is not None and now.position[2] > self._way[2] - self._keys.arrived:
            return E.CLEAR, ""
        return (E.WAITED, f"it does not climb: {waited:.0f} s") if waited > self._keys.hold else None

    def _at_place(self, now: Situation, visit: Visit) -> Event | None:
        began, self._by_sight = now.sight is not None and not self._by_sight, now.sight is not None
        goes_on = visit.place.kind == "site" and self._can_reach(visit.place, now)
        if began and not goes_on and self.state in AT_A_PLACE and (near := self._near_site(now)) is not None:
            self._begin_visit(near)
            return E.GPS_LOST, f"P(safe) {p_safe_text(near.p_safe)}"
        event = visit.step(now, self._seen(now))
        if event is not None or visit.to is None or now.position is None:
            return event
        stuck = self._course.is_stuck(now.t, now.position)
        return (E.WAITED, f"it comes no nearer for {self._keys.hold:.0f} s") if stuck else None

    # -- changes of state

    def _enter(self, after: FlightState, because: Event, now: Situation) -> None:
        t, before, (event, why) = self.target, self.state, because
        place, p_safe = (None, None) if t is None else ((t.east, t.north, t.up), t.p_safe)
        self.diary.transitions.append(Transition(now.t, before, event, after, why or event.value, place, p_safe))
        if event is E.REFUSED or (event is E.WAITED and before in AT_A_PLACE) or before is S.COMMIT:
            self._places.refuse(t)
        self.state, self._since = after, now.t
        self._way = self._way if after is before else None
        self._held = before if after is S.HOLD else self._held
        self._course.begin()
        if after is S.ABORT:
            self._climb(now)
        elif after in (S.SEARCH, S.HOLD, *ENDS) and before is not S.COMMIT and after is not S.LANDED:
            self._visit = None
        elif self._visit is not None and after in (*AT_A_PLACE, S.COMMIT):
            self._visit.begin(after, now, self._seen(now))

    def _climb(self, now: Situation) -> None:
        at, ground = now.position, self.target.up if self.target is not None else (self._frame.ground or 0.0)
        up = ground + 2 * self._keys.commit_height
        self._way = None if at is None else np.array([*at[:2], max(at[2], up)])

    def _follow(self, now: Situation) -> None:
        """Continue in a new map frame: forget all locations, and search around the present position."""
        assert now.position is not None
        self._frame = frame = replace(self._frame, id=now.frame_id, home=now.position.copy())
        if frame.above is not None and frame.home is not None:  # the height above ground stays
            frame.ground = float(now.position[2]) - frame.above
            frame.home[2] = frame.ground + self._keys.search_height
        self._visit = self._way = None
        self._course.begin()
        self._places.forget()
        self._search.restart()
        if self.state is S.ABORT:
            self._climb(now)

    # -- orders

    def _order(self, now: Situation) -> Order:
        r, visit = self._route, self._visit
        if self.state in (S.HANDED_OVER, S.LANDED):
            return Order("nothing")
        if self._touched and self.state is not S.COMMIT:
            return Order("land", None, self._keys.aside_speed, self._keys.landing_speed, down=True)
        if self.state is S.RETURN:
            return Order("return")
        if self.state is S.COMMIT:
            assert visit is not None
            same_frame = now.frame_id == self._frame.id
            return visit.descent.order(now, visit.place, self._left, same_frame)
        to = visit.to if visit is not None and self.state in AT_A_PLACE else self._way
        climbs_blind = self.state is S.ABORT and not now.holds
        if self.state is S.HOLD or climbs_blind or now.position is None or to is None:
            return Order("hold")
        to = self._course.next_point(now.position, to, self._seen(now), self.state)
        way = to - now.position
        speeds = {S.SEARCH: self._keys.search_speed, S.LOOK: LOOK_SPEED * r.cruise_speed}
        speed = ground_speed(way, now.wind, speeds.get(self.state, r.cruise_speed), r.air_speed)
        sink = r.descent_speed * (1.0 if is_from_behind(way, now.wind, r.calm) else 2.0)
        return Order("fly", to, speed, sink)

    def _is_open(self, now: Situation) -> Callable[[Site], bool]:
        is_open = partial(self._looks.is_open, now=now, seen=self._seen(now))
        return lambda place: self._can_reach(place, now) and is_open(place)
