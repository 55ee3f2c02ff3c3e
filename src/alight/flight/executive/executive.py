"""The executive: it looks at a location from lower and lower, until the location is a site or is refused.

No I/O and no clock: `tick` takes the situation and returns the order to the vehicle. From far away the map shows
candidates, from near by it shows sites. The vehicle flies to a location and looks at it from beside it, as a single
camera straight above sees no parallax. It looks again from half the height, until the lowest look confirms the
location. Only then the landing begins.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from alight.arrays import F64
from alight.flight.executive.bounds import Bounds
from alight.flight.executive.descent import Descent, is_near_ground, is_too_low_to_abort
from alight.flight.executive.limits import AttemptLimits
from alight.flight.executive.looks import LookLeg, LookPlanner, look_outcome
from alight.flight.executive.places import KnownPlaces, Opinion, Standing, opinion
from alight.flight.executive.search import Goal, Search
from alight.flight.executive.table import AT_A_PLACE, CROSSING, DOWN, ENDS, JUDGE_EVERY, TABLE
from alight.flight.executive.ways import ClearWay, Course
from alight.landing.wind import ground_speed, is_from_behind
from alight.records import MotionState, Site, p_safe_text
from alight.records.executive import (
    FlightDiary,
    FlightEvent,
    FlightState,
    LookRecord,
    MapVerdict,
    Need,
    Order,
    Situation,
    Transition,
)
from alight.settings import StageSettings

S, E = FlightState, FlightEvent
LOOK_SPEED = 0.4  # share of the cruise speed, along a look leg
Event = tuple[FlightEvent | None, str]  # event and its reason in words; None: nothing has happened


@dataclass
class _Frame:
    id: int = 0
    home: F64 | None = None  # (3,) metres, where the search begins
    ground: float | None = None  # metres up
    above: float | None = None  # metres, last known height above the ground


@dataclass
class _Visit:
    place: Site
    height: float  # metres above the location, of the present look
    left: float = math.inf  # metres above the location, last known
    refusals: int = 0  # consecutive verdicts that refuse the location
    doubts: int = 0  # lowest looks after which it was in doubt


@dataclass
class _Stage:
    since: float  # s
    way: F64 | None = None  # (3,) metres, point to fly to
    across: F64 | None = None  # (3,) metres, end of the look leg
    leg_done: float | None = None  # s, when the last leg ended
    crowded: list[float] = field(default_factory=list)  # s, consecutive verdicts that show an obstacle beside the path


class Executive:
    """Decides on the orders of one landing. Call `tick` several times per second."""

    def __init__(self, settings: StageSettings) -> None:
        self._keys, self._route, self._margin = settings.executive, settings.route, settings.sites.margin
        self.state, self.diary = S.SEARCH, FlightDiary()
        self._clear_way = ClearWay(settings)
        self._looks, self._course = LookPlanner(settings, self._clear_way), Course(settings, self._clear_way)
        self._limits, self._places = AttemptLimits(settings.executive), KnownPlaces(settings)
        self._search = Search(settings, self._places, self._clear_way)
        self._descent = Descent(settings)
        self._frame, self._stage = _Frame(), _Stage(math.inf)
        self._visit: _Visit | None = None
        self._leg: LookLeg | None = None  # leg planned last
        self._held = S.SEARCH  # the state before HOLD
        self._judged = 0  # number of the newest verdict that was used
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
        """Verdicts needed now; None: no verdicts. Few are needed along a look leg, as a look is judged at its end."""
        crosses, place = self.state is S.LOOK and self._stage.across is not None, self.target
        seconds = CROSSING if crosses else JUDGE_EVERY.get(self.state)
        about = None if place is None else np.array([place.east, place.north])
        return None if seconds is None else Need(seconds, about)

    # -- the step

    def tick(self, now: Situation) -> Order:
        """Return the order for the present situation; add transitions and looks to `diary`."""
        if math.isinf(self._stage.since):
            self._stage.since = now.t
        self._limits.observe(now)
        self._observe(now)
        event, why = self._event(now)
        if event is not None and (after := TABLE.get((self.state, event))) is not None:
            self._enter(after, event, why, now)
        return self._order(now)

    def _observe(self, now: Situation) -> None:
        frame, at, bounds = self._frame, now.position, self._clear_way.bounds
        bounds.shift = bounds.shift if now.offset is None else now.offset
        self._touched |= now.contact and self.state in DOWN
        if at is not None and frame.home is None:
            frame.home, frame.id = at.copy(), now.frame_id
        if at is not None and self._visit is not None and now.frame_id == frame.id:
            self._visit.left = float(at[2]) - self._visit.place.up
        if (seen := self._seen(now)) is not None:
            frame.ground = seen.ground
            self._places.note(seen)
        if at is not None and frame.ground is not None and now.frame_id == frame.id:
            frame.above = float(at[2]) - frame.ground

    @property
    def _left(self) -> float:
        """Last known height above the visited location, m; 0 after contact; inf: unknown, or no location is visited."""
        return 0.0 if self._touched else math.inf if self._visit is None else self._visit.left

    def _seen(self, now: Situation) -> MapVerdict | None:
        return None if now.seen is None or now.seen.frame_id != self._frame.id else now.seen

    # -- events

    def _event(self, now: Situation) -> Event:
        if self.state in (S.LANDED, S.HANDED_OVER):
            return None, ""
        if now.standing and self.state in DOWN:  # before the pilot: some change the mode as motors stop
            return E.TOUCHED_DOWN, "the autopilot says so"
        if not now.link:  # before the pilot: control is given away with the link
            return E.LINK_LOST, "no heartbeat"
        if now.pilot:
            return (E.FAILSAFE, now.failsafe) if now.failsafe else (E.PILOT, "by the mode, or by the sticks")
        if self.state is S.RETURN:
            return None, ""
        # without a position the autopilot soon lands by its own failsafe: a climb would only make its way down longer
        if self.state is S.COMMIT and (is_too_low_to_abort(self._left, self._keys) or not now.holds):
            return (E.UNFELT, unfelt) if (unfelt := self._descent.unfelt(now.t)) else (None, "")
        if self._touched and self.state in (S.ABORT, S.HOLD):
            late = now.t - self._stage.since > self._keys.hold
            return (E.WAITED, "it stands, and its motors do not stop") if late else (None, "")
        return self._trouble(now) or self._progress(now)

    def _trouble(self, now: Situation) -> Event | None:
        over = self._limits.exceeded(now)
        if self.state is S.HOLD:
            if (waited := now.t - self._stage.since) > self._limits.patience(now):
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
        if self.state is S.COMMIT and (why := self._descent.too_long(now.t, self._left, self._limits.verdict_time)):
            return E.WAITED, why
        return over if over is not None and (self.state, over[0]) in TABLE else None  # else no effect in this state

    def _progress(self, now: Situation) -> Event:
        assert now.position is not None or self.state is S.ABORT
        if self.state is S.HOLD:
            recovered = now.t - self._limits.missing_at >= self._keys.degraded  # a brief recovery does not end a hold
            nearly_down = now.lands and (self._frame.above or math.inf) < self._keys.commit_height
            return (E.RECOVERED, "") if recovered and not nearly_down else (None, "")
        if self.state is S.SEARCH:
            return self._searching(now)
        if self.state is S.ABORT:
            return self._aborting(now)
        assert self._visit is not None
        return self._at_place(now, self._visit)

    def _searching(self, now: Situation) -> Event:
        assert self._frame.home is not None
        step = self._search.step(now, self._frame.home, self._frame.ground, self._seen(now), self._is_open(now))
        self.diary.looks += [] if step.look is None else [step.look]
        if step.place is not None:
            self._visit = _Visit(step.place, self._keys.commit_height)
            return E.FOUND, step.why
        self._stage.way = step.way
        return (E.SEARCHED, step.why) if step.way is None else (None, "")

    def _aborting(self, now: Situation) -> Event:
        waited = now.t - self._stage.since
        if now.position is None:
            return (E.WAITED, "the motion is not known") if waited > self._limits.patience(now) else (None, "")
        if self._stage.way is None:  # the position was unknown before: the climb is planned now
            self._climb(now)
        if self._stage.way is not None and now.position[2] > self._stage.way[2] - self._keys.arrived:
            return E.CLEAR, ""
        return (E.WAITED, f"it does not climb: {waited:.0f} s") if waited > self._keys.hold else (None, "")

    def _at_place(self, now: Situation, visit: _Visit) -> Event:
        k, stage, lands = self._keys, self._stage, self.state is S.COMMIT
        found = self._opinion(now, visit) if k.look_again else None
        if found is not None:
            if visit.refusals >= k.refusals_to_abort:
                judged = lands and found.standing is not Standing.NOT_SEEN
                fallen = f"P(safe) has fallen to {p_safe_text(found.p_safe)}" if judged else ""
                return E.REFUSED, ": ".join(filter(None, (fallen, found.why)))
            if found.standing in (Standing.SITE, Standing.CANDIDATE):
                # a landing keeps its location: no step to the side near the ground
                visit.place = replace(visit.place, p_safe=found.p_safe) if lands else found.place
            stage.crowded = [*stage.crowded, now.t] if self._is_beside(now, visit) else []
        if len(stage.crowded) >= k.refusals_to_abort or (stage.crowded and now.t - stage.crowded[0] > k.wait):
            return E.REFUSED, f"something stands beside {'the way down' if lands else 'every way across it'}"
        if lands or stage.crowded:
            return None, ""
        if self.state is S.LOOK:
            return self._looking(now, visit, found)
        return (E.ARRIVED, "") if self._reached(now, stage.way) else self._stuck(now, stage.way)

    def _stuck(self, now: Situation, to: F64 | None) -> Event:
        """Return the event if the vehicle comes no nearer to `to`, (3,) metres, or has no clear leg (`to` is None)."""
        if to is None:
            late = now.t - self._stage.since > self._keys.wait
            return (E.WAITED, "something stands beside every way across it") if late else (None, "")
        stuck = now.position is not None and self._course.is_stuck(now.t, now.position)
        return (E.WAITED, f"it comes no nearer for {self._keys.hold:.0f} s") if stuck else (None, "")

    def _looking(self, now: Situation, visit: _Visit, found: Opinion | None) -> Event:
        stage, k = self._stage, self._keys
        if not k.look_again:
            return E.CONFIRMED, f"P(safe) {p_safe_text(visit.place.p_safe)}, not looked at again"
        if stage.across is not None:
            if self._reached(now, stage.across):
                stage.across, stage.leg_done = None, now.t
                return None, ""
            return self._stuck(now, stage.across)
        if found is None or stage.leg_done is None or (now.seen is not None and now.seen.t < stage.leg_done):
            waited = now.t - (stage.leg_done or stage.since)
            late = waited > k.wait + self._limits.verdict_time
            return (E.WAITED, "verdicts on it do not come") if late else (None, "")
        at, standing = found.place, found.standing
        look = LookRecord(now.t, (at.east, at.north, at.up), visit.height, standing.value, found.p_safe, found.why)
        self.diary.looks.append(look)
        candidate = standing is Standing.CANDIDATE
        better = self._places.better(at, self._is_open(now)) if candidate else None
        if (outcome := look_outcome(found, visit.height, better, k)) is not None:
            return outcome
        visit.doubts += candidate
        if candidate and visit.doubts < k.refusals_to_abort:
            stage.leg_done = None
            self._plan(self._leg_across(now, visit))  # look once more, from the other side
            return None, ""
        if standing is Standing.REFUSED and visit.refusals < k.refusals_to_abort:
            return None, ""
        return E.REFUSED, f"{standing.value} from {visit.height:.1f} m: {found.why}"

    def _opinion(self, now: Situation, visit: _Visit) -> Opinion | None:
        seen, k, low = self._seen(now), self._keys, self.state is S.COMMIT
        if seen is None or seen.number <= self._judged:
            return None
        self._judged = seen.number
        same = k.same_spot if low else max(k.same_place, k.beside * visit.height)
        least, is_open = k.probable if low else k.hopeless, self._is_open(now)
        may = (lambda s: True) if low else (lambda s: not self._places.is_refused(s) and is_open(s))
        found = opinion(visit.place, seen, same, least, may, self._margin)
        if low and self._descent.judged(seen.t, found, visit.left):
            visit.refusals = k.refusals_to_abort
        elif found.standing is not Standing.NOT_SEEN:
            fallen = found.standing is Standing.REFUSED or (low and found.p_safe < least)
            visit.refusals = visit.refusals + 1 if fallen else 0
        return found

    # -- changes of state

    def _enter(self, after: FlightState, event: FlightEvent, why: str, now: Situation) -> None:
        t, before = self.target, self.state
        place, p_safe = (None, None) if t is None else ((t.east, t.north, t.up), t.p_safe)
        self.diary.transitions.append(Transition(now.t, before, event, after, why or event.value, place, p_safe))
        if event is E.REFUSED or (event is E.WAITED and before in AT_A_PLACE) or before is S.COMMIT:
            self._places.refuse(t)
        self.state, self._stage = after, _Stage(now.t)
        self._held = before if after is S.HOLD else self._held
        self._course.begin()
        if after is S.COMMIT:
            self._descent.begin(now.t)
        elif after is S.ABORT:
            self._climb(now)
        elif after in (S.SEARCH, S.HOLD, *ENDS) and before is not S.COMMIT and after is not S.LANDED:
            self._visit = None
        if self._visit is not None and after in AT_A_PLACE:
            self._begin_look(now, self._visit)

    def _begin_look(self, now: Situation, visit: _Visit) -> None:
        if self.state is S.APPROACH and not self._keys.look_again:
            self._stage.way = np.array([visit.place.east, visit.place.north, visit.place.up + visit.height])
            return
        if self.state is S.APPROACH:
            visit.height = self._looks.first_height(visit.place, now)
        elif self.state is S.DESCEND:
            visit.height = self._looks.next_height(visit.height)
        self._plan(self._leg_across(now, visit))

    def _climb(self, now: Situation) -> None:
        at, ground = now.position, self.target.up if self.target is not None else (self._frame.ground or 0.0)
        up = ground + 2 * self._keys.commit_height
        self._stage.way = None if at is None else np.array([*at[:2], max(at[2], up)])

    def _follow(self, now: Situation) -> None:
        """Continue in a new map frame: forget all locations, and search around the present position."""
        assert now.position is not None
        self._frame = frame = replace(self._frame, id=now.frame_id, home=now.position.copy())
        if frame.above is not None and frame.home is not None:  # the height above ground stays
            frame.ground = float(now.position[2]) - frame.above
            frame.home[2] = frame.ground + self._keys.search_height
        self._visit, self._stage.way = None, None
        self._course.begin()
        self._places.forget()
        self._search.restart()
        if self.state is S.ABORT:
            self._climb(now)
        self._judged = 0 if now.seen is None else now.seen.number

    # -- orders

    def _order(self, now: Situation) -> Order:
        r, stage = self._route, self._stage
        if self.state in (S.HANDED_OVER, S.LANDED):
            return Order("nothing")
        if self._touched and self.state is not S.COMMIT:
            return Order("land", None, self._keys.aside_speed, self._keys.landing_speed, down=True)
        if self.state is S.RETURN:
            return Order("return")
        if self.state is S.COMMIT:
            assert self._visit is not None
            same_frame = now.frame_id == self._frame.id
            return self._descent.order(now, self._visit.place, self._left, same_frame)
        to = stage.across if self.state is S.LOOK and stage.across is not None else stage.way
        climbs_blind = self.state is S.ABORT and not now.holds
        if self.state is S.HOLD or climbs_blind or now.position is None or stage.crowded or to is None:
            return Order("hold")
        to = self._course.next_point(now.position, to, self._seen(now), self.state)
        way = to - now.position
        speeds = {S.SEARCH: self._keys.search_speed, S.LOOK: LOOK_SPEED * r.cruise_speed}
        speed = ground_speed(way, now.wind, speeds.get(self.state, r.cruise_speed), r.air_speed)
        sink = r.descent_speed * (1.0 if is_from_behind(way, now.wind, r.calm) else 2.0)
        return Order("fly", to, speed, sink)

    def _plan(self, leg: LookLeg | None) -> None:
        self._leg = leg
        if leg is not None and self.state is S.LOOK:
            self._stage.across = leg.end
        elif leg is not None:
            self._stage.way = leg.start

    def _leg_across(self, now: Situation, visit: _Visit) -> LookLeg | None:
        """Return the look leg over the newest map; see `LookPlanner.across`. None: no leg is clear."""
        return self._looks.across(visit.place, visit.height, now, self._seen(now), self._leg)

    def _is_open(self, now: Situation) -> Callable[[Site], bool]:
        return partial(self._looks.is_open, now=now, seen=self._seen(now))

    def _is_beside(self, now: Situation, visit: _Visit) -> bool:
        """Whether an obstacle is beside the descent of a landing, the leg of a look or, before a look, every leg.

        Before a look, a planned leg that is not clear is replaced by a clear leg.
        """
        seen, ground, across = self._seen(now), visit.place.up, self._stage.across
        if now.position is None or seen is None:
            return False
        if self.state is S.COMMIT:
            return not (is_near_ground(visit.left, self._keys) or self._clear_way.is_free_down(visit.place, seen))
        if self.state is S.LOOK and self._leg is not None:
            return across is not None and not self._clear_way.is_free(now.position, across, ground, seen)
        leg, flown = self._leg_across(now, visit), self._leg
        if leg is not None and (flown is None or not flown.is_clear(self._clear_way, ground, seen)):
            self._plan(leg)
        return leg is None

    def _reached(self, now: Situation, point: F64 | None) -> bool:
        left = None if now.position is None or point is None else point - now.position
        return left is not None and float(np.linalg.norm(left)) < self._keys.arrived
