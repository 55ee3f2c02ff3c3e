"""The executive: it looks at a place from lower and lower, until the place is a site or is refused.

No I/O and no clock: `tick` takes the situation and returns the order to the vehicle. Far away there are candidates,
near by there are sites. A place is flown to and looked at from beside it: one camera straight above sees no parallax.
It is looked at again from half the height, until the lowest look confirms it. Only then the landing begins.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from alight.arrays import F64
from alight.flight.executive.clear_way import ClearWay
from alight.flight.executive.course import Course
from alight.flight.executive.descent import Descent, is_near_ground, is_too_low_to_abort
from alight.flight.executive.known_places import KnownPlaces
from alight.flight.executive.limits import AttemptLimits, Recovery, held_enough, is_too_weak, patience
from alight.flight.executive.look_leg import LookLeg
from alight.flight.executive.look_outcome import look_outcome
from alight.flight.executive.look_planner import LookPlanner
from alight.flight.executive.opinion import Opinion, Standing, opinion
from alight.flight.executive.search import SearchLanes
from alight.flight.executive.table import AT_A_PLACE, CROSSING, ENDS, JUDGE_EVERY, TABLE
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
LOOK_SPEED = 0.4  # of the cruise speed, across a place


class Executive:
    """One landing. Call `tick` several times a second.

    Args:
        settings: of all stages; `executive`, `sites.margin`, `route` and the lander are used.
    """

    def __init__(self, settings: StageSettings) -> None:
        self._limits, self._recovery = AttemptLimits(settings.executive), Recovery(settings.executive)
        self._held = S.SEARCH  # the state before HOLD
        self._keys, self._route, self._margin = settings.executive, settings.route, settings.sites.margin
        self.state, self.diary = S.SEARCH, FlightDiary()
        self._clear_way = ClearWay(settings)
        self._looks = LookPlanner(settings, self._clear_way)
        self._course = Course(settings, self._clear_way)
        self.target: Site | None = None
        self._begun: float | None = None  # s
        self._since = 0.0  # s, in this state
        self._home: F64 | None = None
        self._frame = 0
        self._ground: float | None = None  # metres up
        self._above: float | None = None  # metres above it, as known last
        self._lanes: SearchLanes | None = None
        self._way: F64 | None = None  # (3,) metres, to fly to in this state
        self._height = 0.0  # metres, of this look above the place
        self._left = math.inf  # metres above the target, as known last
        self._descent = Descent(settings)
        self._sound_at = -math.inf  # s, when the motion was last not degraded
        self._across: F64 | None = None  # (3,) metres, end of the look leg
        self._leg_now: LookLeg | None = None  # the last one planned
        self._leg_done: float | None = None  # s, when the last leg ended
        self._refusals = self._doubts = self._judged = 0
        self._crowded: list[float] = []  # s, verdicts in a row that show something beside the way
        self._places = KnownPlaces(settings)

    @property
    def need(self) -> Need | None:
        """Verdicts that it needs now; None: none. While a look leg is flown they are few: a look counts at its end."""
        crosses = self.state is S.LOOK and self._across is not None
        seconds = CROSSING if crosses else JUDGE_EVERY.get(self.state)
        about = None if self.target is None else np.array([self.target.east, self.target.north])
        return None if seconds is None else Need(seconds, about)

    # -- the step

    def tick(self, now: Situation) -> Order:
        """Decide on the order for now; transitions and looks go into `diary`."""
        if self._begun is None:
            self._begun = self._since = now.t
        self._learn(now)
        event, why = self._event(now)
        if event is not None and (after := TABLE.get((self.state, event))) is not None:
            self._enter(after, event, why, now)
        return self._order(now)

    def _learn(self, now: Situation) -> None:
        """Note the frame, the ground height, and the time when the motion was last not degraded."""
        if now.state is not MotionState.DEGRADED:
            self._sound_at = now.t
        if now.position is not None and self._home is None:
            self._home, self._frame = now.position.copy(), now.frame_id
        if now.position is not None and self.target is not None and now.frame_id == self._frame:
            self._left = float(now.position[2]) - self.target.up
        if (seen := self._seen(now)) is not None:
            self._ground = seen.ground
            self._places.note(seen)
        if now.position is not None and self._ground is not None and now.frame_id == self._frame:
            self._above = float(now.position[2]) - self._ground

    # -- events

    def _event(self, now: Situation) -> tuple[FlightEvent | None, str]:
        """The most urgent event with its reason in words; None: nothing has happened."""
        if self.state in (S.LANDED, S.HANDED_OVER):
            return None, ""
        if now.standing and self.state in (S.COMMIT, S.RETURN):  # before the pilot: motors off, some change the mode
            return E.TOUCHED_DOWN, "the autopilot says so"
        if now.pilot:
            return E.PILOT, "the mode was changed, or the sticks were moved"
        if not now.link:
            return E.LINK_LOST, "no heartbeat"
        if self.state is S.RETURN:
            return None, ""
        if self.state is S.COMMIT and is_too_low_to_abort(self._left, self._keys):
            return (E.UNFELT, unfelt) if (unfelt := self._descent.unfelt(now.t)) else (None, "")
        if (trouble := self._trouble(now)) is not None:
            return trouble
        return self._progress(now)

    def _trouble(self, now: Situation) -> tuple[FlightEvent, str] | None:
        k = self._keys
        over = self._limits.exceeded(now, self._begun)
        if self.state is S.HOLD and (enough := held_enough(now, self._since, over, k)) is not None:
            return enough
        blind = now.picture_age > k.stale
        astray = now.position is None or now.state in (MotionState.LOST, MotionState.INITIALISING)
        flown = self._held if self.state is S.HOLD else self.state
        weak = is_too_weak(now, flown, now.t - self._sound_at, self._left, k)
        if self.state is not S.ABORT:
            if astray or weak or blind:
                self._recovery.missing(now.t)
            if astray or weak:
                lost = now.position is None and now.state not in (MotionState.LOST, MotionState.INITIALISING)
                return E.NAVIGATION_LOST, "no position" if lost else f"the motion is {now.state.name.lower()}"
            if blind:
                frozen = "the cameras have frozen: one picture comes again and again, " if now.frozen else ""
                return E.CAMERA_LOST, f"{frozen}the newest picture is {now.picture_age:.1f} s old"
        if now.frame_id != self._frame and now.position is not None:
            self._follow(now)
            return E.NEW_FRAME, f"frame {now.frame_id}"
        if self.state is S.COMMIT and (why := self._descent.too_long(now.t, self._left)):
            return E.WAITED, why
        return over if over is not None and (self.state, over[0]) in TABLE else None  # else it goes on looking

    def _progress(self, now: Situation) -> tuple[FlightEvent | None, str]:
        assert now.position is not None or self.state is S.ABORT
        if self.state is S.HOLD:
            return (E.RECOVERED, "") if self._recovery.over(now.t) else (None, "")
        if self.state is S.SEARCH:
            return self._searching(now)
        return self._aborting(now) if self.state is S.ABORT else self._at_place(now)

    def _searching(self, now: Situation) -> tuple[FlightEvent | None, str]:
        found = self._places.best(self._is_open(now))
        if found is not None and self._places.worth_a_visit(found):
            return self._found(found)
        assert self._home is not None
        lanes = self._lanes = self._lanes or SearchLanes(self._home, self._keys)
        lanes.fly(now.position, self._ground)
        if lanes.over:
            if found is not None:
                return self._found(found)
            return E.SEARCHED, self._searched_words()
        self._way = lanes.end(self._ground)
        return None, ""

    def _searched_words(self) -> str:
        unseen = "" if self._ground is not None else "; no height could be measured"
        return f"within {self._keys.search_side:.0f} m{self._places.fates}{unseen}"

    def _found(self, place: Site) -> tuple[FlightEvent, str]:
        self.target = place
        return E.FOUND, f"{place.kind}, P(safe) {p_safe_text(place.p_safe)}"

    def _aborting(self, now: Situation) -> tuple[FlightEvent | None, str]:
        waited = now.t - self._since
        if now.position is None:
            return (E.WAITED, "the motion is not known") if waited > patience(now, self._keys) else (None, "")
        if self._way is None:  # the position was not known before: only now it can climb
            self._climb(now)
        if self._way is not None and now.position[2] > self._way[2] - self._keys.arrived:
            return E.CLEAR, ""
        return (E.WAITED, f"it does not climb: {waited:.0f} s") if waited > self._keys.hold else (None, "")

    def _at_place(self, now: Situation) -> tuple[FlightEvent | None, str]:
        assert self.target is not None
        said = self._opinion(now) if self._keys.look_again else None
        if said is not None and self._refusals >= self._keys.refusals_to_abort:
            judged = self.state is S.COMMIT and said.standing is not Standing.NOT_SEEN
            fallen = f"P(safe) has fallen to {p_safe_text(said.p_safe)}" if judged else ""
            return E.REFUSED, ": ".join(filter(None, (fallen, said.why)))
        if said is not None and said.standing in (Standing.SITE, Standing.CANDIDATE):
            landing = self.state is S.COMMIT  # it comes down where it was begun: no step to the side near the ground
            self.target = replace(self.target, p_safe=said.p_safe) if landing else said.place
        if said is not None:
            self._crowded = [*self._crowded, now.t] if self._beside(now) else []
        where = "the way down" if self.state is S.COMMIT else "every way across it"
        if len(self._crowded) >= self._keys.refusals_to_abort or (
            self._crowded and now.t - self._crowded[0] > self._keys.wait
        ):
            return E.REFUSED, f"something stands beside {where}"
        if self.state is S.COMMIT or self._crowded:
            return None, ""
        if self.state is S.LOOK:
            return self._looking(now, said)
        return (E.ARRIVED, "") if self._reached(now, self._way) else self._stuck(now, self._way)

    def _stuck(self, now: Situation, to: F64 | None) -> tuple[FlightEvent | None, str]:
        """The event and reason if it waits in vain at a place: for the end of its way, or for a verdict; else None."""
        if to is None:
            late = now.t - self._since > self._keys.wait
            return (E.WAITED, "something stands beside every way across it") if late else (None, "")
        stuck = now.position is not None and self._course.is_stuck(now.t, now.position)
        return (E.WAITED, f"it comes no nearer for {self._keys.hold:.0f} s") if stuck else (None, "")

    def _looking(self, now: Situation, said: Opinion | None) -> tuple[FlightEvent | None, str]:
        """Event of a look, which is over when a verdict includes the whole leg."""
        if not self._keys.look_again and self.target is not None:
            return E.CONFIRMED, f"P(safe) {p_safe_text(self.target.p_safe)}, not looked at again"
        if self._across is not None:
            if self._reached(now, self._across):
                self._across, self._leg_done = None, now.t
                return None, ""
            return self._stuck(now, self._across)
        assert self.target is not None
        assert now.seen is not None or said is None
        if said is None or self._leg_done is None or (now.seen is not None and now.seen.t < self._leg_done):
            waited = now.t - (self._leg_done or self._since)
            return (E.WAITED, "verdicts on it do not come") if waited > self._keys.wait else (None, "")
        self._note_look(now, said)
        candidate = said.standing is Standing.CANDIDATE
        better = self._places.better(said.place, self._is_open(now)) if candidate else None
        if (outcome := look_outcome(said, self._height, better, self._keys)) is not None:
            return outcome
        self._doubts += candidate
        if candidate and self._doubts < self._keys.patience:
            self._leg_done = None
            self._plan(self._leg(now))  # once more, from the other side
            return None, ""
        if said.standing is Standing.REFUSED and self._refusals < self._keys.refusals_to_abort:
            return None, ""
        return E.REFUSED, f"{said.standing.value} from {self._height:.1f} m: {said.why}"

    def _opinion(self, now: Situation) -> Opinion | None:
        """The opinion of a new verdict on the target; None where there is no new one."""
        seen = self._seen(now)
        if seen is None or seen.number <= self._judged or self.target is None:
            return None
        self._judged = seen.number
        low = self.state is S.COMMIT
        same = self._keys.same_spot if low else max(self._keys.same_place, self._keys.beside * self._height)
        least = self._keys.abort_p_safe if low else self._keys.hopeless
        is_open = self._is_open(now)
        may = (lambda s: True) if low else (lambda s: not self._places.is_refused(s) and is_open(s))
        said = opinion(self.target, seen, same, least, may, self._margin)
        if low and self._descent.judged(seen.t, said, self._left):
            self._refusals = self._keys.refusals_to_abort
        elif said.standing is not Standing.NOT_SEEN:
            fallen = said.standing is Standing.REFUSED or (low and said.p_safe < least)
            self._refusals = self._refusals + 1 if fallen else 0
        return said

    # -- changes of state

    def _enter(self, after: FlightState, event: FlightEvent, why: str, now: Situation) -> None:
        t = self.target
        place = None if t is None else (t.east, t.north, t.up)
        self.diary.transitions.append(
            Transition(now.t, self.state, event, after, why or event.value, place, None if t is None else t.p_safe)
        )
        if event is E.REFUSED or (event is E.WAITED and self.state in AT_A_PLACE) or self.state is S.COMMIT:
            self._places.refuse(self.target)
        before, self.state, self._since = self.state, after, now.t
        self._held = before if after is S.HOLD else self._held
        self._way, self._across, self._leg_done = None, None, None
        self._crowded = []
        self._course.begin()
        if after is S.APPROACH:
            self._begin_place(now)
        elif after in (S.DESCEND, S.LOOK):
            self._height = self._looks.next_height(self._height) if after is S.DESCEND else self._height
            self._plan(self._leg(now))
        elif after is S.COMMIT:
            self._descent.begin(now.t)
        elif after is S.ABORT:
            self._climb(now)
        elif after in (S.SEARCH, S.HOLD, *ENDS) and before is not S.COMMIT:
            self.target = None if after is not S.LANDED else self.target

    def _begin_place(self, now: Situation) -> None:
        assert self.target is not None
        self._refusals = self._doubts = 0
        self._height = self._looks.first_height(self.target, now)
        if self._keys.look_again:
            return self._plan(self._leg(now))
        self._height = self._keys.commit_height
        self._way = np.array([self.target.east, self.target.north, self.target.up + self._height])

    def _climb(self, now: Situation) -> None:
        at, ground = now.position, self.target.up if self.target is not None else (self._ground or 0.0)
        self._way = None if at is None else np.array([*at[:2], max(at[2], ground + 2 * self._keys.commit_height)])

    def _follow(self, now: Situation) -> None:
        """Follow to a new frame: places of the old one are forgotten, and the search begins about here."""
        assert now.position is not None
        self._frame, self._lanes, self.target, self._way = now.frame_id, None, None, None
        self._course.begin()
        self._home = now.position.copy()
        if self._above is not None:  # the height above ground stays the same, in a frame of another height
            self._ground = float(now.position[2]) - self._above
            self._home[2] = self._ground + self._keys.search_height
        self._places.forget()
        if self.state is S.ABORT:
            self._climb(now)
        self._judged = 0 if now.seen is None else now.seen.number

    # -- orders

    def _order(self, now: Situation) -> Order:
        r = self._route
        if self.state in (S.HANDED_OVER, S.LANDED):
            return Order("nothing")
        if self.state is S.RETURN:
            return Order("return")
        if self.state is S.COMMIT:
            assert self.target is not None
            return self._descent.order(now, self.target, self._left, now.frame_id == self._frame)
        if self.state is S.HOLD or now.position is None or self._crowded:
            return Order("hold")
        to = self._across if self.state is S.LOOK and self._across is not None else self._way
        if to is None:
            return Order("hold")
        to = self._course.next_point(now.position, to, self._seen(now), self.state)
        way = to - now.position
        speeds = {S.SEARCH: self._keys.search_speed, S.LOOK: LOOK_SPEED * r.cruise_speed}
        speed = ground_speed(way, now.wind, speeds.get(self.state, r.cruise_speed), r.air_speed)
        sink = r.descent_speed * (1.0 if is_from_behind(way, now.wind, r.calm) else 2.0)
        return Order("fly", to, speed, sink)

    def _plan(self, leg: LookLeg | None) -> None:
        """Fly to the start of a leg, or along it; None: no leg is clear, and the next verdict refuses the place."""
        self._leg_now = leg
        if leg is not None and self.state is S.LOOK:
            self._across = leg.end
        elif leg is not None:
            self._way = leg.start

    def _leg(self, now: Situation) -> LookLeg | None:
        """The leg across the target with no obstacle beside it, else the earlier one; None: there is none."""
        assert self.target is not None
        return self._looks.across(self.target, self._height, now, self._seen(now), self._leg_now)

    def _is_open(self, now: Situation) -> Callable[[Site], bool]:
        return partial(self._looks.is_open, now=now, seen=self._seen(now))

    def _beside(self, now: Situation) -> bool:
        """True if an obstacle stands beside the way to a look or across a place; another leg is planned if possible."""
        seen, t = self._seen(now), self.target
        if not self._keys.look_again or t is None or now.position is None or seen is None:
            return False
        if self.state is S.COMMIT:
            return not (is_near_ground(self._left, self._keys) or self._clear_way.is_free_down(t, seen))
        if self.state is S.LOOK and self._leg_now is not None:
            across = self._across
            return across is not None and not self._clear_way.is_free(now.position, across, t.up, seen)
        leg, flown = self._leg(now), self._leg_now
        if leg is not None and (flown is None or not self._clear_way.is_open(flown, t.up, seen)):
            self._plan(leg)
        return leg is None

    def _seen(self, now: Situation) -> MapVerdict | None:
        """The newest verdict, if it is on a map of this frame."""
        return None if now.seen is None or now.seen.frame_id != self._frame else now.seen

    def _reached(self, now: Situation, point: F64 | None) -> bool:
        left = None if now.position is None or point is None else point - now.position
        return left is not None and float(np.linalg.norm(left)) < self._keys.arrived

    def _note_look(self, now: Situation, said: Opinion) -> None:
        p = said.place
        self.diary.looks.append(
            LookRecord(now.t, (p.east, p.north, p.up), self._height, said.standing.value, said.p_safe, said.why)
        )
