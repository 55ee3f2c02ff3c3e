"""The executive over made-up ground: it looks until a place is a site or refused; faults lead to the table's states."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as budget
from hypothesis import strategies as st
from made_up_ground import AWAY, STEP, Flight, Ground, bad_from_below, clearer_from_below, settings
from some_run import elevation as some_elevation
from some_run import site as some_site

from alight.flight.executive.bounds import Bounds
from alight.flight.executive.descent import Descent
from alight.flight.executive.executive import Executive
from alight.flight.executive.looks import LookLeg, LookPlanner
from alight.flight.executive.places import KnownPlaces
from alight.flight.executive.table import JUDGE_EVERY, TABLE
from alight.flight.executive.ways import ClearWay, SearchLanes, square_spiral
from alight.landing.route import Obstructions, way_below
from alight.records import Flag, Hazard, MotionState, MovingBody, Sites, Terrain
from alight.records.executive import FlightEvent, FlightState, MapVerdict, Order, Situation
from alight.settings import Settings, settings_of_run
from alight.settings.user import ExecutiveKeys

S, E = FlightState, FlightEvent
# -- the loop


def test_it_looks_again_from_lower_down_and_lands() -> None:
    f = Flight(Ground({(10.0, 5.0): clearer_from_below}), Executive(settings()))
    assert f.fly() is S.LANDED
    assert f.executive.diary.end == (S.LANDED, "as the autopilot reports")
    looks = f.executive.diary.looks
    assert [round(x.height) for x in looks] == sorted((round(x.height) for x in looks), reverse=True)
    assert looks[-1].height == pytest.approx(6.0)
    assert looks[-1].verdict == "site"
    assert len(looks) >= 2
    commit = next(x for x in f.executive.diary.transitions if x.after is S.COMMIT)
    assert commit.event is E.CONFIRMED
    assert commit.p_safe == pytest.approx(0.97)
    np.testing.assert_allclose(f.position[:2], [10.0, 5.0], atol=0.3)
    assert all(x.reason for x in f.executive.diary.transitions)


def test_a_look_passes_beside_the_place() -> None:
    """One camera straight above a place has no parallax: each leg is at least 0.24 of the height long."""
    f = Flight(Ground({(10.0, 5.0): clearer_from_below}), Executive(settings()))
    assert f.fly() is S.LANDED
    assert f.executive.diary.looks
    for look in f.executive.diary.looks:
        near = [p for s, _, p in f.orders if s is S.LOOK and abs(p[2] - look.height) < 1.2]
        across = max(np.linalg.norm(a[:2] - b[:2]) for a in near for b in near[:: max(1, len(near) // 20)])
        assert across >= 0.24 * look.height


def test_a_look_is_judged_at_the_end_of_its_leg() -> None:
    """Few verdicts are needed while a leg is flown, and every look is recorded at the end of its leg."""
    crossed = list[tuple[float, bool]]()

    def note(now: Situation, executive: Executive) -> Situation:
        if executive.state is S.LOOK:
            assert executive.need is not None
            crossed.append((now.t, executive.need.seconds == JUDGE_EVERY[S.APPROACH]))
        elif executive.need is not None:
            assert executive.need.seconds == JUDGE_EVERY[executive.state]
        return now

    f = Flight(Ground({(10.0, 5.0): clearer_from_below}), Executive(settings()), note)
    assert f.fly() is S.LANDED
    assert {c for _, c in crossed} == {True, False}
    at = dict(crossed)
    assert f.executive.diary.looks
    assert not any(at[x.t] for x in f.executive.diary.looks)


def test_no_verdicts_are_needed_on_the_last_metres() -> None:
    """Below `abort_height`, 1.5 m, no verdict can end a landing; above it, they are needed all the time."""
    heights: dict[bool, list[float]] = {True: [], False: []}

    def note(now: Situation, executive: Executive) -> Situation:
        if executive.state is S.COMMIT:
            heights[executive.need is not None].append(f.position[2])
        return now

    f = Flight(Ground({(10.0, 5.0): clearer_from_below}), Executive(settings()), note)
    assert f.fly() is S.LANDED
    assert min(heights[True]) > max(heights[False])
    assert max(heights[False]) == pytest.approx(1.5, abs=0.25)


def test_a_place_that_falls_gives_way_to_the_next() -> None:
    ground = Ground({(10.0, 5.0): bad_from_below, (-12.0, 0.0): clearer_from_below})
    f = Flight(ground, Executive(settings()))
    assert f.fly() is S.LANDED
    np.testing.assert_allclose(f.position[:2], [-12.0, 0.0], atol=0.3)
    assert E.REFUSED in f.events
    refused = next(x for x in f.executive.diary.transitions if x.event is E.REFUSED)
    assert refused.place is not None
    assert refused.place[:2] == (10.0, 5.0)


def test_a_place_in_much_doubt_waits_until_all_was_searched() -> None:
    """A better place may show in the rest of the search, and is then looked at first."""
    ground = Ground({(-8.0, 2.0): lambda h: 0.6, (22.0, 18.0): lambda h: 0.97 if h < 9 else 0.8}, sees=12.0)
    f = Flight(ground, Executive(settings()))
    assert f.fly() is S.LANDED
    found = [x for x in f.executive.diary.transitions if x.event is E.FOUND]
    assert found[0].place is not None
    assert found[0].place[:2] == (22.0, 18.0)
    searched = np.array([p[:2] for s, _, p in f.orders if s is S.SEARCH])
    assert np.abs(searched).max() > 17.0  # to its end first


def test_a_look_takes_the_better_place_beside() -> None:
    """From 8 m up a better place 2.6 m away is seen; the next look is at that place."""
    ground = Ground({(10.0, 5.0): lambda h: 0.92, (12.4, 6.0): lambda h: 0.97 if h < 9 else 0.0})
    f = Flight(ground, Executive(settings()))
    assert f.fly() is S.LANDED
    np.testing.assert_allclose(f.position[:2], [12.4, 6.0], atol=0.3)
    assert E.REFUSED not in f.events


def test_ground_without_a_place_is_searched_and_left() -> None:
    f = Flight(Ground({}), Executive(settings()))
    assert f.fly() is S.RETURN
    assert f.events == [E.SEARCHED]
    spots, shown = np.array([p[:2] for s, _, p in f.orders if s is S.SEARCH]), 30.0 * 0.75
    for e in np.linspace(-30.0, 30.0, 13):
        for n in np.linspace(-30.0, 30.0, 13):  # every place was in a picture
            assert np.abs(spots - [e, n]).max(axis=1).min() <= 0.5 * shown + 2.0  # the last lane may end 2 m early
    assert np.abs(spots).max() < 20.0  # no farther than that takes


@pytest.mark.parametrize(
    ("shows", "sure", "heights"),
    [(70.0, 0.97, [120, 60]), (70.0, 0.0, [120, 60, 30]), (40.0, 0.0, [120, 60, 30]), (20.0, 0.0, [120, 60, 30])],
)
def test_a_search_that_ends_without_a_site_goes_on_from_half_the_height(
    shows: float, sure: float, heights: list[int]
) -> None:
    """Never below 30 m, as trees of 15 m may stand on ground that is not mapped yet."""
    place = {(22.0, 18.0): lambda h: max(clearer_from_below(h), sure) if h < shows else 0.0}
    f = Flight(Ground(place, sees=99.0), Executive(settings("executive.search_height=120")))
    f.position[2] = 120.0
    assert f.fly() is (S.LANDED if shows > 30.0 else S.RETURN)
    wanted = [o.position for s, o, _ in f.orders if s is S.SEARCH and o.position is not None]
    assert len(wanted) == len([s for s, _, _ in f.orders if s is S.SEARCH])  # no stop between two heights
    assert sorted({round(p[2]) for p in wanted}, reverse=True) == heights
    for height in heights[:-1]:  # one camera straight above sees no parallax
        flown = [p[:2] for s, _, p in f.orders if s is S.SEARCH and abs(p[2] - height) < 2.0]
        assert np.ptp(flown, axis=0).max() >= 0.29 * height


def test_a_search_goes_no_lower_over_ground_whose_height_is_unknown() -> None:
    f = Flight(Ground({}), Executive(settings("executive.search_height=120")), lambda now, _: replace(now, seen=None))
    f.position[2] = 120.0
    assert f.fly() is S.RETURN
    assert f.events == [E.SEARCHED]
    assert min(p[2] for _, _, p in f.orders) > 119.0


def test_a_candidate_that_stays_one_is_not_landed_on() -> None:
    f = Flight(Ground({(10.0, 5.0): lambda h: 0.8}), Executive(settings()))
    assert f.fly() is S.RETURN
    assert S.COMMIT not in f.states
    heights = [round(x.height) for x in f.executive.diary.looks]
    assert heights.count(6) == 1
    assert heights.count(4) == 2


def test_a_place_in_doubt_from_the_lowest_look_is_looked_at_from_lower_still() -> None:
    f = Flight(Ground({(10.0, 5.0): lambda h: 0.97 if h < 5.0 else 0.9}), Executive(settings()))
    assert f.fly() is S.LANDED
    assert [round(x.height) for x in f.executive.diary.looks][-2:] == [6, 4]
    high = Flight(
        Ground({(10.0, 5.0): lambda h: 0.97 if h < 5.0 else 0.9}), Executive(settings("tuning.executive.nearest=6"))
    )
    assert high.fly() is S.RETURN


def test_a_place_in_doubt_is_left_for_a_clearly_better_one() -> None:
    """The first place is left after one look for a clearly better one, but not for a slightly better one."""
    for other, looks in ((0.88, 1), (0.7, 4)):
        ground = Ground(
            {(10.0, 5.0): lambda h: 0.9 if h > 12.0 else 0.6, (-12.0, 0.0): lambda h, p=other: p if h > 9 else 0.97}
        )  # type: ignore[misc]
        f = Flight(ground, Executive(settings()))
        f.fly()
        first = [x for x in f.executive.diary.looks if x.place[0] > 0.0]
        assert len(first) == looks


@pytest.mark.parametrize("first", [0.96, 0.85])
def test_without_looking_again_the_first_good_place_is_landed_on(first: float) -> None:
    """Without looks the vehicle lands also on stones that only a near look shows."""
    stones = {(10.0, 5.0): lambda h: 0.0 if h < 9.0 else first}
    plain = Flight(Ground(stones), Executive(settings("executive.look_again=false")))
    assert plain.fly() is S.LANDED
    assert not plain.executive.diary.looks
    careful = Flight(Ground(stones), Executive(settings()))
    careful.fly()
    assert S.COMMIT not in careful.states


def test_without_looking_again_a_doubtful_place_is_not_taken() -> None:
    flight = Flight(Ground({(10.0, 5.0): lambda h: 0.7}), Executive(settings("executive.look_again=false")))
    assert flight.fly() is S.RETURN
    assert S.APPROACH not in flight.states


def test_it_climbs_over_what_stands_in_the_way() -> None:
    ground = Ground({(28.0, 0.0): clearer_from_below}, sees=40.0, tall=26.0)
    f = Flight(ground, Executive(settings()))
    assert f.fly() is S.LANDED
    over = [p for _, _, p in f.orders if abs(p[0] - 15.0) < 1.0]
    assert over
    assert min(p[2] for p in over) >= 26.0 + 3.0 - 1.0


def test_wind_does_not_carry_it_away_while_it_climbs() -> None:
    """Seen in a campaign: the vehicle climbed for a tree, and a gust blew it into that tree meanwhile."""
    ground = Ground({(28.0, 0.0): clearer_from_below}, sees=40.0, tall=26.0)
    low = list[float]()

    def blow(now: Situation, executive: Executive) -> Situation:
        if executive.state is S.APPROACH:
            if not low:
                f.position[:] = (0.0, 0.0, 8.0)
                low.append(now.t)
            assert now.position is not None
            aside = np.array([0.0, min(0.1 * (now.t - low[0]), 3.0), 0.0])  # a gust that the vehicle does not resist
            return replace(now, position=f.position + aside)
        return now

    f = Flight(ground, Executive(settings()), blow)
    f.fly(60.0)
    climbs = [o.position[:2] for _, o, p in f.orders if o.position is not None and p[2] < 25.0][:20]
    assert len(climbs) == 20
    assert climbs[2][0] < 1.0
    assert np.ptp(np.array(climbs[2:]), axis=0).max() == 0.0


def test_it_comes_down_to_a_look_only_on_its_way() -> None:
    """Seen in a campaign: a gust blew the vehicle 4 m off, into a tree, and it went on down meanwhile."""
    f = Flight(Ground({(10.0, 5.0): clearer_from_below}), Executive(settings()))
    heights, left = list[float](), list[float]()

    def blow(now: Situation, executive: Executive) -> Situation:
        if executive.state is not S.DESCEND:
            return now
        if not left:
            left.append(now.t)
        assert now.position is not None
        if 0.0 < now.t - left[0] < 5.0:
            heights.append(float(f.position[2]))
        aside = 4.0 if 0.0 < now.t - left[0] < 5.0 else 0.0
        return replace(now, position=now.position + aside * np.array([1.0, 1.0, 0.0]))

    f.change = blow
    assert f.fly() is S.LANDED
    assert heights[0] > 6.5
    assert np.ptp(heights) == 0.0


def test_a_return_that_ends_on_the_ground_is_no_landing() -> None:
    """The autopilot lands at home: the diary ends with the reason of the return."""
    f = Flight(Ground({}), Executive(settings()))
    assert f.executive.diary.end is None
    assert f.fly() is S.RETURN
    f.position[2] = 0.0
    f.executive.tick(Situation(f.t, f.position, MotionState.GOOD, 0, None, standing=True))
    assert f.executive.state is S.LANDED
    ended, why = f.executive.diary.end or (None, "")
    assert ended is S.RETURN
    assert why.startswith("within 60 m")


# -- below the commit height


def in_state(wanted: FlightState, change: Callable[[Situation], Situation]) -> Callable[..., Situation]:
    """Return a change of the situation that begins when a state is reached, and stays."""
    hit = []

    def changed(now: Situation, executive: Executive) -> Situation:
        if executive.state is wanted or hit:
            hit.append(1)
            return change(now)
        return now

    return changed


def test_a_car_beside_which_good_ground_is_left_breaks_the_landing_off_too() -> None:
    """Seen in a campaign: the site was refused, and a listed one 1.6 m beside it was taken for it. The vehicle swerved
    to that at a height of two metres and came down on the car's edge. Two verdicts with a lower P(safe) are enough."""
    there = {(10.0, 5.0): clearer_from_below, (-12.0, 0.0): lambda h: 0.97 if h < 9.0 else 0.5}
    ground, since = Ground(there), list[float]()

    def park(now: Situation, executive: Executive) -> Situation:
        if executive.state is S.COMMIT and now.position is not None and now.position[0] > 0:
            since.append(now.t)
            there[10.0, 5.0], there[11.6, 5.0] = (lambda h: 0.0), (lambda h: 0.98)
        return now

    f = Flight(ground, Executive(settings()), park)
    assert f.fly() is S.LANDED
    k = f.events.index(E.REFUSED)
    assert f.states[k : k + 3] == [S.COMMIT, S.ABORT, S.SEARCH]
    assert f.executive.diary.transitions[k].t - since[0] <= 2.5  # two verdicts
    low = [o for s, o, _ in f.orders if s is S.COMMIT and o.position is not None and o.position[0] > 0]
    assert max(abs(o.position[0] - 10.0) for o in low if o.position is not None) < 0.1
    assert f.position[0] < 0


@pytest.mark.parametrize("every", [1, 2])
def test_verdicts_a_little_below_the_limit_do_not_break_a_landing_off(every: int) -> None:
    ground, count = Ground({(10.0, 5.0): lambda h: 0.97 if h < 9.0 else 0.92}), list[int]()

    def waver(now: Situation, executive: Executive) -> Situation:
        if executive.state is S.COMMIT and now.seen is not None and now.seen.number % every == 0:
            count.append(1)
            p, reasons = now.seen.hazards.p_safe.copy(), now.seen.hazards.reasons.copy()
            p[p > 0.0], reasons[p > 0.0] = 0.93, int(Hazard.DOUBT)
            hazards = replace(now.seen.hazards, p_safe=p, reasons=reasons)
            return replace(now, seen=replace(now.seen, hazards=hazards, sites=Sites((), "", 0, ())))
        return now

    f = Flight(ground, Executive(settings()), waver)
    assert f.fly() is S.LANDED
    assert count
    assert S.ABORT not in f.states


@pytest.mark.parametrize(("p_safe", "verdicts"), [(0.88, 5), (0.7, 2)])
def test_a_place_that_comes_into_doubt_and_stays_there_breaks_a_landing_off(p_safe: float, verdicts: int) -> None:
    """Seen in a campaign: from the commit on P(safe) was 0.88 in thirty verdicts, and the vehicle landed on a kerb."""
    taken = set[float]()

    def doubt(now: Situation, executive: Executive) -> Situation:
        if executive.state is S.COMMIT and now.seen is not None:
            taken.add(now.seen.t)
            p = np.minimum(now.seen.hazards.p_safe, np.float32(p_safe))
            hazards = replace(now.seen.hazards, p_safe=p)
            return replace(now, seen=replace(now.seen, hazards=hazards, sites=Sites((), "", 0, ())))
        return now

    f = Flight(Ground({(10.0, 5.0): clearer_from_below}), Executive(settings()), doubt)
    f.fly(100.0)
    first = next(x for x in f.executive.diary.transitions if x.after is S.ABORT)
    assert first.event is FlightEvent.REFUSED
    assert len([t for t in taken if t <= first.t]) in (verdicts, verdicts + 1)  # that of the look may be among them


@pytest.mark.parametrize("p_safe", [0.99, 0.86])
def test_from_low_down_it_waits_for_enough_verdicts_to_break_the_landing_off(p_safe: float) -> None:
    """The last look is from 4 m: down to 3 m there is no time for five verdicts, so that the vehicle waits."""
    ground = Ground({(10.0, 5.0): lambda h: 0.97 if h < 5.0 else 0.92})
    f = Flight(ground, Executive(settings()))

    def doubt(now: Situation, executive: Executive) -> Situation:
        if executive.state is S.COMMIT:
            ground.places[10.0, 5.0] = lambda h: p_safe
        return now

    f.change = doubt
    f.fly(120.0)
    assert f.executive.diary.looks[-1].height == 4.0
    waits = [o for s, o, _ in f.orders if s is S.COMMIT and not o.down]
    assert len({o.height for o in waits}) == 1  # independent of the wind
    assert waits[0].height == pytest.approx(4.0, abs=0.6)
    assert f.states[f.states.index(S.COMMIT) + 1] is (S.LANDED if p_safe > 0.9 else S.ABORT)


def test_one_low_verdict_does_not_break_a_landing_off() -> None:
    """Seen in campaigns: grass sways, and P(safe) of a meadow falls to 0.85 for one verdict."""
    dips = list[int]()

    def dip(now: Situation, executive: Executive) -> Situation:
        if executive.state is S.COMMIT and now.seen is not None and (not dips or now.seen.number == dips[0]):
            dips.append(now.seen.number)
            p = np.minimum(now.seen.hazards.p_safe, np.float32(0.6))
            hazards = replace(now.seen.hazards, p_safe=p)
            return replace(now, seen=replace(now.seen, hazards=hazards, sites=Sites((), "", 0, ())))
        return now

    f = Flight(Ground({(10.0, 5.0): clearer_from_below}), Executive(settings()), dip)
    assert f.fly() is S.LANDED
    assert dips
    assert S.ABORT not in f.states


@pytest.mark.parametrize(("height", "holds", "broken_off"), [(4.5, True, 1), (2.5, True, 0), (4.5, False, 0)])
def test_degraded_motion_ends_a_landing_but_near_the_ground(height: float, holds: bool, broken_off: int) -> None:
    """From 2 m swaying grass fills the picture, and the landing goes on; a climb without a position is worse."""
    f = Flight(Ground({(10.0, 5.0): clearer_from_below}), Executive(settings()))

    def weak(now: Situation, executive: Executive) -> Situation:
        if executive.state is S.COMMIT and f.position[2] < height:
            return replace(now, state=MotionState.DEGRADED, holds=holds)
        return now

    f.change = weak
    f.fly(120.0)
    assert f.states.count(S.ABORT) == broken_off


@pytest.mark.parametrize(
    ("place", "velocity", "height", "stops"),
    [
        ((10.5, 5.0), (0.0, 0.0), 1.2, True),  # at the place
        ((10.5, 5.0), (0.0, 0.0), 0.9, False),  # too late
        ((14.0, 5.0), (-1.4, 0.0), 3.0, True),  # towards it
        ((14.0, 5.0), (1.4, 0.0), 3.0, False),  # away from it
        ((18.0, 5.0), (-1.4, 0.0), 1.2, False),  # the vehicle stands before
        ((14.0, 10.0), (-1.4, 0.0), 3.0, False),  # past it
    ],
)  # fmt: skip
def test_somebody_who_comes_to_the_place_stops_a_landing_at_once(
    place: tuple[float, float], velocity: tuple[float, float], height: float, stops: bool
) -> None:
    f, seen = Flight(Ground({(10.0, 5.0): clearer_from_below}), Executive(settings())), list[float]()

    def come(now: Situation, executive: Executive) -> Situation:
        if executive.state is S.COMMIT and f.position[2] < height and (not seen or not stops):
            seen.append(now.t)
            return replace(now, movers=(MovingBody(np.array(place), np.array(velocity), 0.3),))
        return now

    f.change = come
    f.fly(120.0)
    assert seen
    broken_off = [x for x in f.executive.diary.transitions if x.after is S.ABORT]
    assert bool(broken_off) is stops
    if stops:
        assert broken_off[0].t == seen[0]
        assert "somebody moves" in broken_off[0].reason


def test_a_landing_makes_no_step_to_a_better_spot_beside_it() -> None:
    """Seen in a campaign: the vehicle touched down with 0.59 m/s sideways, where 0.5 is allowed."""
    there = {(10.0, 5.0): clearer_from_below}

    def shift(now: Situation, executive: Executive) -> Situation:
        if executive.state is S.COMMIT and (10.0, 5.0) in there:
            there.clear()
            there[10.0, 5.4] = lambda h: 0.99
        return now

    f = Flight(Ground(there), Executive(settings()), shift)
    assert f.fly() is S.LANDED
    np.testing.assert_allclose(f.position[:2], [10.0, 5.0], atol=0.1)


def test_it_comes_down_above_the_place() -> None:
    """Beside the place the vehicle keeps its height, but not near the ground, where a landing goes on in any case."""
    f = Flight(Ground({(10.0, 5.0): clearer_from_below}), Executive(settings()))
    pushed = set[float]()

    def gust(now: Situation, executive: Executive) -> Situation:
        for height in (3.0, 1.0):
            if executive.state is S.COMMIT and f.position[2] < height and height not in pushed:
                pushed.add(height)
                f.position[0] += 0.9
                return replace(now, position=f.position.copy())
        return now

    f.change = gust
    assert f.fly() is S.LANDED
    assert pushed == {3.0, 1.0}
    landing = [(o.down, np.hypot(*(p[:2] - [10.0, 5.0])), p[2]) for s, o, p in f.orders if s is S.COMMIT]
    assert all(beside < 0.7 or height < 1.5 for down, beside, height in landing if down)
    assert all(beside > 0.4 and height > 1.5 for down, beside, height in landing if not down)
    assert {o.speed <= 0.4 for s, o, _ in f.orders if s is S.COMMIT and o.down} == {True}
    assert {o.speed > 1.0 for s, o, _ in f.orders if s is S.COMMIT and not o.down} == {True}
    kept = [k for k, (down, _, height) in enumerate(landing) if not down and height < 3.0]
    assert kept  # once, after the first gust; the second comes too low
    assert kept == list(range(kept[0], kept[-1] + 1))


def test_after_the_commit_it_never_climbs_but_to_break_off() -> None:
    f = Flight(Ground({(10.0, 5.0): clearer_from_below}), Executive(settings()))
    f.fly()
    low = [(o, p) for s, o, p in f.orders if s is S.COMMIT]
    assert low
    assert all(o.what == "land" and o.position is not None and o.position[2] <= p[2] for o, p in low)
    waits = [(o.height, p[2]) for o, p in low if not o.down]
    assert waits  # until it is over the place
    assert all(height is not None and height <= up + 0.3 for height, up in waits)


def test_a_vehicle_that_turns_out_to_be_lower_is_not_sent_up_again() -> None:
    """The estimate is corrected by a metre while it is beside the place: it keeps its new height."""
    f = Flight(Ground({(10.0, 5.0): clearer_from_below}), Executive(settings()))
    pushed = list[float]()

    def correct(now: Situation, executive: Executive) -> Situation:
        if executive.state is S.COMMIT and f.position[2] < 5.0 and len(pushed) < 2:
            pushed.append(f.t)
            f.position[0] += 0.8 if len(pushed) == 1 else 0.0
            f.position[2] -= 0.0 if len(pushed) == 1 else 1.0
            return replace(now, position=f.position.copy())
        return now

    f.change = correct
    assert f.fly() is S.LANDED
    waits = [(o.height, p[2]) for s, o, p in f.orders if s is S.COMMIT and not o.down]
    assert len(pushed) == 2
    assert all(height is not None and height <= up + 0.3 for height, up in waits)


@pytest.mark.parametrize(("steers", "beside", "down"), [(True, 0.3, True), (False, 0.3, False), (False, 0.19, True)])
def test_a_landing_that_is_not_steered_begins_nearer_to_its_site(steers: bool, beside: float, down: bool) -> None:
    site, descent = replace(some_site(), east=10.0, north=5.0, up=0.0), Descent(settings())
    now = Situation(0.0, np.array([10.0 + beside, 5.0, 8.0]), MotionState.GOOD, steers=steers)
    assert descent.order(now, site, 8.0, True).down is down


@dataclass
class Late:
    """Verdicts that are old when they come."""

    age: float  # s
    waiting: list[MapVerdict] = field(default_factory=list)
    newest: MapVerdict | None = None

    def __call__(self, now: Situation, executive: Executive) -> Situation:
        if now.seen is not None and (not self.waiting or now.seen is not self.waiting[-1]):
            self.waiting.append(now.seen)
        while self.waiting and self.waiting[0].t <= now.t - self.age + 1e-9:
            self.newest = self.waiting[0]
            if len(self.waiting) == 1:
                break
            self.waiting.pop(0)
        return replace(now, seen=self.newest)


@pytest.mark.parametrize(("every", "age"), [(0.4, 0.4), (1.0, 1.0), (2.0, 2.0), (3.0, 1.5)])
@pytest.mark.parametrize("height", [5.5, 4.0, 3.6])
def test_who_comes_is_seen_in_time_however_slow_the_verdicts_are(every: float, age: float, height: float) -> None:
    """What comes while the vehicle is 3.5 m up or more is refused by two verdicts before it is too low to go round."""
    ground = Ground({(10.0, 5.0): clearer_from_below})
    f, late = Flight(ground, Executive(settings())), Late(age)

    def comes(now: Situation, executive: Executive) -> Situation:
        if executive.state is S.COMMIT and f.position[2] < height:
            ground.places[10.0, 5.0] = lambda h: 0.0
        return late(now, executive)

    f.change = comes
    f.fly(120.0, verdict_every=every)
    assert f.states[f.states.index(S.COMMIT) + 1] is S.ABORT
    first = next(x for x in f.executive.diary.transitions if x.after is S.ABORT)
    low = min(p[2] for s, o, p in f.orders if s is S.COMMIT)
    assert low > 1.4, (first, low)


@pytest.mark.parametrize(("age", "most"), [(1.0, 16.0), (2.0, 30.0), (4.0, 60.0), (10.0, 150.0)])
def test_slow_verdicts_make_a_landing_slow_and_do_not_end_it(age: float, most: float) -> None:
    """The computer makes one verdict after the other, and each takes so long."""
    f = Flight(Ground({(10.0, 5.0): clearer_from_below}), Executive(settings()), Late(age))
    assert f.fly(verdict_every=age) is S.LANDED
    assert E.WAITED not in f.events
    took = f.t - next(x.t for x in f.executive.diary.transitions if x.after is S.COMMIT)
    assert took < most


def test_what_the_last_lane_saw_is_judged_before_the_search_ends() -> None:
    """A place below the end of the last lane, by verdicts that take four seconds."""
    empty = Flight(Ground({}), Executive(settings()))
    assert empty.fly() is S.RETURN
    end = float(empty.position[0]), float(empty.position[1])
    f = Flight(Ground({end: lambda h: 0.97}, sees=4.0), Executive(settings()), Late(4.0))
    assert f.fly() is S.LANDED
    assert f.events[0] is E.FOUND


def test_verdicts_that_hang_after_slow_ones_end_a_landing() -> None:
    late = Late(4.0)
    kept: list[Situation] = []

    def hangs(now: Situation, executive: Executive) -> Situation:
        seen = late(now, executive)
        if executive.state is S.COMMIT and not kept:
            kept.append(seen)
        return replace(seen, seen=kept[0].seen) if kept and executive.state is S.COMMIT else seen

    f = Flight(Ground({(10.0, 5.0): clearer_from_below}), Executive(settings()), hangs)
    f.fly(200.0, verdict_every=4.0)
    k = f.states.index(S.COMMIT)
    assert (f.events[k], f.states[k + 1]) == (E.WAITED, S.ABORT)
    assert f.executive.diary.transitions[k].t - f.executive.diary.transitions[k - 1].t < 20.0


def test_verdicts_that_are_too_old_are_none() -> None:
    """They come every second, and tell what was there six seconds ago."""
    late = Late(6.0)

    def behind(now: Situation, executive: Executive) -> Situation:
        seen = late(now, executive)
        return seen if executive.state is S.COMMIT else now

    f = Flight(Ground({(10.0, 5.0): clearer_from_below}), Executive(settings()), behind)
    f.fly(200.0)
    k = f.states.index(S.COMMIT)
    assert (f.events[k], f.states[k + 1]) == (E.WAITED, S.ABORT)
    assert "no verdict for" in f.executive.diary.transitions[k].reason


ALL_ABOUT = [(10.0 + e, 5.0 + n, 12.0) for e in (-3, 0, 3) for n in (-3, 0, 3)]  # trees about a place


def shows(now: Situation, *posts: tuple[float, float, float]) -> Situation:
    """The situation with these posts on the map of its verdict."""
    assert now.seen is not None
    return replace(now, seen=replace(now.seen, elevation=Ground({}, posts=posts).map()))


@pytest.mark.parametrize(("count", "ends"), [(1, S.LANDED), (2, S.ABORT)])
def test_what_turns_out_to_stand_beside_the_way_down_breaks_the_landing_off(count: int, ends: FlightState) -> None:
    """The map shows a tree of 12 m, 2.5 m beside the place, in so many verdicts after the landing has begun."""
    ground, shown = Ground({(10.0, 5.0): clearer_from_below}), set[int]()

    def tree(now: Situation, executive: Executive) -> Situation:
        if executive.state is not S.COMMIT or now.seen is None or not (shown or f.position[2] < 5.5):
            return now
        shown.add(now.seen.number)
        if not 1 < len(shown) < count + 2:  # the first was judged before
            return now
        return shows(now, (12.0, 6.0, 12.0))

    f = Flight(ground, Executive(settings()))
    f.change = tree
    f.fly(120.0)
    k = f.states.index(S.COMMIT)
    assert f.states[k + 1] is ends
    assert ends is S.LANDED or f.executive.diary.transitions[k].reason == "something stands beside the way down"


def test_one_verdict_with_something_beside_the_way_drops_no_place() -> None:
    """The vehicle holds until the next verdict, which shows nothing there."""
    ground, shown = Ground({(10.0, 5.0): clearer_from_below}), set[int]()

    def once(now: Situation, executive: Executive) -> Situation:
        if executive.state is not S.APPROACH or now.seen is None or len(shown | {now.seen.number}) > 2:
            return now
        shown.add(now.seen.number)
        if len(shown) < 2:  # it was judged before
            return now
        return shows(now, *ALL_ABOUT)

    f = Flight(ground, Executive(settings()), once)
    assert f.fly() is S.LANDED
    assert len(shown) == 2
    assert E.REFUSED not in f.events
    assert any(s is S.APPROACH and o.what == "hold" for s, o, _ in f.orders)


def test_motion_that_flickers_ends_no_hold() -> None:
    """It is there for 0.3 s in every 10 s, and the autopilot cannot hold: it is handed over as if there were none."""
    lost_since = list[float]()

    def flicker(now: Situation, executive: Executive) -> Situation:
        if now.t < 5.0 or (now.t - 5.0) % 10.0 > 9.7:
            return now
        lost_since.append(now.t)
        return replace(now, state=MotionState.LOST, position=None, holds=False)

    f = Flight(Ground({}), Executive(settings()), flicker)
    assert f.fly(100.0) is S.HANDED_OVER
    assert f.t - lost_since[0] < 14.0


@pytest.mark.parametrize("begin", [0.0, 100.0])
def test_a_way_that_opens_late_is_not_taken_for_one_that_is_not_flown(begin: float) -> None:
    """Trees stand about the place in the first look's verdict alone; the clock of the flight may say anything."""
    ground, shown = Ground({(10.0, 5.0): clearer_from_below}), set[int]()

    def trees(now: Situation, executive: Executive) -> Situation:
        now = replace(now, t=now.t + begin, seen=None if now.seen is None else replace(now.seen, t=now.seen.t + begin))
        if executive.state is S.DESCEND and now.seen is not None and (not shown or now.seen.number in shown):
            shown.add(now.seen.number)
            return shows(now, *ALL_ABOUT)
        return now

    f = Flight(ground, Executive(settings()), trees)
    assert f.fly() is S.LANDED
    assert shown
    assert E.WAITED not in f.events


def test_a_touchdown_that_nobody_reports_is_handed_over() -> None:
    """It stands, and the autopilot does not say so: nothing is ordered any more, least of all a climb."""
    f = Flight(Ground({(10.0, 5.0): clearer_from_below}), Executive(settings()))
    f.change = lambda now, executive: replace(now, standing=False)
    assert f.fly(400.0) is S.HANDED_OVER
    last = f.executive.diary.transitions[-1]
    assert (last.before, last.event) == (S.COMMIT, E.UNFELT)
    assert f.orders[-1][1].what == "nothing"


@pytest.mark.parametrize("aside", [50.0, 57.0, 62.0])
def test_a_landing_that_waited_long_is_let_touch_down(aside: float) -> None:
    """A gust holds it beside the place; the minute for the touchdown begins on the last metres."""
    f, since = Flight(Ground({(10.0, 5.0): clearer_from_below}), Executive(settings())), list[float]()

    def held(now: Situation, executive: Executive) -> Situation:
        if executive.state is S.COMMIT:
            since.append(now.t)
            if now.t - since[0] < aside:
                f.position[0] = 11.0
                return replace(now, position=f.position.copy())
        return replace(now, standing=now.standing and now.t - since[0] > aside + 25.0) if since else now

    f.change = held
    assert f.fly() is S.LANDED


@pytest.mark.parametrize("height", [9.0, 3.4, 3.0, 2.2])
def test_verdicts_that_end_low_down_break_the_landing_off_soon(height: float) -> None:
    last: list[MapVerdict | None] = []
    f = Flight(Ground({(10.0, 5.0): clearer_from_below}), Executive(settings()))

    def stall(now: Situation, executive: Executive) -> Situation:
        if executive.state is S.COMMIT and f.position[2] < height:
            last.append(now.seen)
        return replace(now, seen=last[0]) if last else now

    f.change = stall
    f.fly(120.0, verdict_every=0.6)
    k = f.states.index(S.COMMIT)
    begun = f.executive.diary.transitions[k - 1].t
    if f.states[k + 1] is S.ABORT:
        assert "no verdict for" in f.executive.diary.transitions[k].reason
    else:
        assert f.states[k + 1] is S.LANDED  # from 2.2 m it is down before
    assert f.executive.diary.transitions[k].t - begun < 20.0


def test_a_landing_from_high_up_has_the_time_that_it_takes() -> None:
    """From 35 m it sinks for more than a minute."""
    high = settings("executive.commit_height=35", "executive.search_height=60")
    f = Flight(Ground({(10.0, 5.0): lambda h: 0.97}), Executive(high))
    assert f.fly() is S.LANDED
    assert f.events[0] is E.FOUND
    assert f.executive.diary.transitions[0].t < 2.0  # a site breaks the search off
    assert S.ABORT not in f.states


@pytest.mark.parametrize("low", ["1.4", "2", "3.49"])
def test_a_landing_that_could_not_be_broken_off_is_refused(low: str) -> None:
    with pytest.raises(ValueError, match=r"executive.commit_height: from .* give 3.5 or more"):
        settings(f"executive.commit_height={low}")
    stored = Settings(executive=ExecutiveKeys(commit_height=float(low)))  # of an earlier flight: it can still be read
    assert settings_of_run(stored.model_dump(mode="json")) == stored


def test_a_battery_that_is_reported_no_more_is_a_low_one() -> None:
    silent = in_state(S.APPROACH, lambda now: replace(now, battery=float("nan")))
    f = Flight(Ground({(10.0, 5.0): clearer_from_below}), Executive(settings()), silent)
    assert f.fly() is S.RETURN
    assert f.executive.diary.end == (S.RETURN, "it is not reported any more")


@pytest.mark.parametrize(
    ("change", "event"),
    [
        (lambda now: replace(now, state=MotionState.LOST, position=None), E.NAVIGATION_LOST),
        (lambda now: replace(now, picture_age=3.0), E.CAMERA_LOST),
        (lambda now: replace(now, wind=np.array([12.0, 0.0, 0.0])), E.WIND),
        (lambda now: replace(now, frame_id=1), E.NEW_FRAME),
    ],
)
def test_what_breaks_a_landing_off(change: Callable[[Situation], Situation], event: FlightEvent) -> None:
    f = Flight(Ground({(10.0, 5.0): clearer_from_below}), Executive(settings()), in_state(S.COMMIT, change))
    f.fly(200.0)
    k = f.events.index(event)
    assert f.states[k + 1] is S.ABORT


@pytest.mark.parametrize("change", [{"wind": np.array([12.0, 0.0, 0.0])}, {"battery": 0.1}])
def test_a_limit_that_is_broken_in_a_landing_lets_it_climb_and_return(change: dict[str, Any]) -> None:
    """Seen in a campaign: wind beyond the limit during an abort kept the vehicle in it until the flight ended."""

    def lasting(now: Situation, executive: Executive) -> Situation:
        state = MotionState.DEGRADED if executive.state is S.COMMIT else now.state
        late = executive.state in (S.COMMIT, S.ABORT) or S.ABORT in [x.after for x in executive.diary.transitions]
        return replace(now, state=state, **change) if late else now

    f = Flight(Ground({(10.0, 5.0): clearer_from_below}), Executive(settings()), lasting)
    assert f.fly(200.0) is S.RETURN
    assert f.states[-4:] == [S.COMMIT, S.ABORT, S.SEARCH, S.RETURN]
    assert f.position[2] > 2 * 6.0 - 2.0


@pytest.mark.parametrize("limit", [{"battery": 0.1}, {"t": 1000.0}])
def test_who_comes_ends_a_landing_that_is_late_or_short_of_battery(limit: dict[str, float]) -> None:
    """A landing is the shortest way down: time and battery neither end it nor the check of the place."""

    def late(now: Situation, executive: Executive) -> Situation:
        return replace(now, **limit | ({"t": now.t + limit["t"]} if "t" in limit else {}))

    ground = Ground({(10.0, 5.0): clearer_from_below})

    def comes(now: Situation, executive: Executive) -> Situation:
        if executive.state is S.COMMIT:
            ground.places[10.0, 5.0] = lambda h: 0.0
            return late(now, executive)
        return now

    f = Flight(ground, Executive(settings()), comes)
    f.fly(200.0)
    assert f.states[f.states.index(S.COMMIT) + 1] is S.ABORT


def test_a_place_that_is_not_seen_any_more_breaks_a_landing_off_while_it_is_high() -> None:
    """Ground is unknown if, for example, something moves on it, and then no verdict refuses it."""
    for low, ends in ((0.0, S.ABORT), (9.0, S.LANDED)):  # the height below which the landing goes on
        ground = Ground({(10.0, 5.0): clearer_from_below})

        def hide(now: Situation, executive: Executive, ground: Ground = ground) -> Situation:
            if executive.state is S.COMMIT:
                ground.places.clear()
            return now

        keys = settings(f"tuning.executive.degraded_height={low}")
        f = Flight(ground, Executive(keys), hide)
        f.fly(200.0)
        k = f.states.index(S.COMMIT)
        assert f.states[k + 1] is ends
        assert ends is S.LANDED or "not seen whole" in f.executive.diary.transitions[k].reason


def test_who_is_down_has_landed_whatever_the_mode_is_then() -> None:
    """PX4 changes its mode when its motors stop."""
    down = in_state(S.COMMIT, lambda now: replace(now, pilot=True) if now.standing else now)
    assert Flight(Ground({(10.0, 5.0): clearer_from_below}), Executive(settings()), down).fly() is S.LANDED


@pytest.mark.parametrize("change", [{"frame_id": 1}, {"state": MotionState.LOST, "position": None}])
def test_too_low_to_go_up_and_lost_it_sinks_straight_down(change: dict[str, Any]) -> None:
    """Positions in another frame would lead the vehicle aside."""

    def lose(now: Situation, executive: Executive) -> Situation:
        low = executive.state is S.COMMIT and now.position is not None and now.position[2] < 1.3
        return replace(now, **change) if low else now

    f = Flight(Ground({(10.0, 5.0): clearer_from_below}), Executive(settings()), lose)
    assert f.fly() is S.LANDED
    blind = [o for s, o, p in f.orders if s is S.COMMIT and p[2] < 1.3]
    assert blind
    assert all(o.what == "land" and o.down and o.position is None for o in blind)


def test_the_last_metres_of_a_landing_go_sideways_still_slower() -> None:
    """A GPS jump just before the touchdown must not make the vehicle drift."""
    f = Flight(Ground({(10.0, 5.0): clearer_from_below}), Executive(settings()))
    assert f.fly() is S.LANDED
    down = [(o.speed, p[2]) for s, o, p in f.orders if s is S.COMMIT and o.down]
    assert {v for v, up in down if up > 1.7} == {0.4}
    assert {v for v, up in down if up < 1.3} == {0.2}


def test_a_landing_that_does_not_come_down_is_broken_off() -> None:
    """An autopilot may refuse to land."""

    class Stubborn(Flight):
        def obey(self, order: Order) -> None:
            if order.what != "land":
                super().obey(order)

    f = Stubborn(Ground({(10.0, 5.0): clearer_from_below}), Executive(settings()))
    f.fly(300.0)
    k = f.states.index(S.COMMIT)
    assert (f.events[k], f.states[k + 1]) == (E.WAITED, S.ABORT)
    assert "does not come down" in f.executive.diary.transitions[k].reason


@pytest.mark.parametrize(("holds", "ends"), [(True, S.RETURN), (False, S.LANDED)])
def test_motion_lost_in_a_landing_is_waited_for_if_the_autopilot_holds(holds: bool, ends: S) -> None:
    """When the motion is known again, the vehicle climbs before it searches. Without a position it goes on down."""
    lost_at: list[float] = []

    def lose(now: Situation, executive: Executive) -> Situation:
        if executive.state is S.COMMIT and now.position is not None and now.position[2] < 4.0:
            lost_at.append(now.t)
        if lost_at and now.t < lost_at[0] + 20.0:
            return replace(now, state=MotionState.LOST, position=None, holds=holds)
        return replace(now, seen=None) if lost_at else now

    f = Flight(Ground({(10.0, 5.0): clearer_from_below}), Executive(settings()), lose)
    assert f.fly(390.0) is ends
    if holds:
        begins = next(p for s, o, p in f.orders if s is S.SEARCH and lost_at and p[2] < 20.0)
        assert begins[2] > 2 * 6.0 - 2.0


@pytest.mark.parametrize("state", [S.LOOK, S.COMMIT])
def test_motion_that_begins_anew_near_the_ground_climbs_before_it_goes_aside(state: S) -> None:
    """The new frame has another height and no verdict yet: nothing is known of the surroundings."""
    ground, anew, up = Ground({(10.0, 5.0): clearer_from_below}), [], 50.0

    def change(now: Situation, executive: Executive) -> Situation:
        if executive.state is state and now.position is not None and now.position[2] < 6.5:
            anew.append(now.t)
        if not anew:
            return now
        assert now.position is not None
        return replace(now, position=now.position + np.array([0.0, 0.0, up]), frame_id=1, seen=None)

    class Shifted(Flight):
        def obey(self, order: Order) -> None:
            if anew and order.position is not None:
                order = replace(order, position=order.position - [0.0, 0.0, up])
            super().obey(order)

    f = Shifted(ground, Executive(settings("executive.search_height=30")), change)
    f.fly(120.0)
    assert anew
    begins = next(k for k, e in enumerate(f.events) if e is E.NEW_FRAME)
    low = [
        (p, o.position)
        for (s, o, p), t in zip(f.orders, np.arange(len(f.orders)) * STEP, strict=True)
        if t > anew[0] and s in (S.SEARCH, S.ABORT) and o.position is not None and p[2] < 25.0
    ]
    assert f.states[begins + 1] in (S.SEARCH, S.ABORT)
    assert low
    assert all(np.hypot(*(to[:2] - at[:2])) < 0.1 and to[2] - up > at[2] for at, to in low)
    assert f.position[2] == pytest.approx(30.0, abs=2.0)


def test_a_vehicle_that_does_not_climb_out_of_a_landing_is_handed_over() -> None:
    stuck = in_state(S.COMMIT, lambda now: replace(now, picture_age=3.0))

    class Heavy(Flight):
        def obey(self, order: Order) -> None:
            if self.executive.state is not S.ABORT:
                super().obey(order)

    f = Heavy(Ground({(10.0, 5.0): clearer_from_below}), Executive(settings()), stuck)
    assert f.fly(300.0) is S.HANDED_OVER
    assert "does not climb" in f.executive.diary.transitions[-1].reason


# -- faults on the way


@pytest.mark.parametrize("state", [S.SEARCH, S.APPROACH, S.LOOK, S.DESCEND, S.COMMIT])
@pytest.mark.parametrize(
    ("change", "event", "end"),
    [
        (lambda now: replace(now, pilot=True), E.PILOT, S.HANDED_OVER),
        (lambda now: replace(now, link=False), E.LINK_LOST, S.HANDED_OVER),
    ],
)
def test_who_else_flies_is_obeyed_at_once(
    state: FlightState, change: Callable[[Situation], Situation], event: FlightEvent, end: FlightState
) -> None:
    f = Flight(Ground({(10.0, 5.0): clearer_from_below}), Executive(settings()), in_state(state, change))
    assert f.fly() is end
    assert f.events[-1] is event
    last = f.executive.diary.transitions[-1]
    assert last.before is state
    assert f.orders[-1][1].what == "nothing"
    assert sum(s is end for s, _, _ in f.orders) == 1


@pytest.mark.parametrize("state", [S.SEARCH, S.APPROACH, S.LOOK, S.DESCEND])
@pytest.mark.parametrize(
    ("change", "event"),
    [
        (lambda now: replace(now, wind=np.array([12.0, 0.0, 0.0])), E.WIND),
        (lambda now: replace(now, battery=0.1), E.BATTERY),
        (lambda now: replace(now, t=now.t + (1000.0 if now.t > 1.0 else 0.0)), E.TIME),
    ],
)
def test_what_ends_the_attempt(
    state: FlightState, change: Callable[[Situation], Situation], event: FlightEvent
) -> None:
    at_once = Executive(settings("tuning.executive.lasting=0"))
    f = Flight(Ground({(10.0, 5.0): clearer_from_below}), at_once, in_state(state, change))
    assert f.fly() is S.RETURN
    assert f.events[-1] is event
    assert f.orders[-1][1].what == "return"


@pytest.mark.parametrize("change", [{"wind": np.array([12.0, 0.0, 0.0])}, {"battery": 0.1}])
@pytest.mark.parametrize("lasting", [2.0, 4.0])
def test_wind_and_battery_end_it_once_they_have_been_beyond_their_limits_for_a_time(
    change: dict[str, Any], lasting: float
) -> None:
    """Gusts and dips of the voltage are tolerated, also one after the other, if each is short."""

    def beyond(now: Situation, executive: Executive) -> Situation:
        return replace(now, **change) if now.t % 5.0 < lasting else now

    f = Flight(Ground({(10.0, 5.0): clearer_from_below}), Executive(settings()), beyond)
    assert f.fly() is (S.LANDED if lasting < 3.0 else S.RETURN)


def test_gusts_do_not_hide_an_empty_battery() -> None:
    """Each limit has its own timer."""

    def gusts(now: Situation, executive: Executive) -> Situation:
        return replace(now, battery=0.02, wind=np.array([12.0 if now.t % 3.0 < 1.0 else 0.0, 0.0, 0.0]))

    f = Flight(Ground({}), Executive(settings()), gusts)
    assert f.fly() is S.RETURN
    assert f.events[-1] is E.BATTERY
    assert f.t < 4.0


@pytest.mark.parametrize(
    ("change", "event"),
    [
        (lambda now: replace(now, state=MotionState.LOST, position=None), E.NAVIGATION_LOST),
        (lambda now: replace(now, picture_age=3.0), E.CAMERA_LOST),
    ],
)
def test_it_waits_for_motion_and_pictures_and_then_hands_over(
    change: Callable[[Situation], Situation], event: FlightEvent
) -> None:
    f = Flight(Ground({(10.0, 5.0): clearer_from_below}), Executive(settings()), in_state(S.APPROACH, change))
    assert f.fly() is S.HANDED_OVER
    assert f.events[-2:] == [event, E.WAITED]
    assert {o.what for s, o, _ in f.orders if s is S.HOLD} == {"hold"}


def at_times(begin: float, end: float, **what: object) -> Callable[[Situation, Executive], Situation]:
    """Return a change of the situation between two times."""
    return lambda now, executive: replace(now, **what) if begin < now.t < end else now  # type: ignore[arg-type]


def test_it_holds_for_its_cameras_and_then_searches_on() -> None:
    """Without pictures for half a minute the autopilot holds; then the interrupted lane is flown to its end."""
    blind = at_times(9.0, 39.0, picture_age=9.0)
    plain, f = (Flight(Ground({}), Executive(settings()), c) for c in (lambda now, executive: now, blind))
    assert plain.fly() is S.RETURN
    assert f.fly() is S.RETURN
    assert f.events == [E.CAMERA_LOST, E.RECOVERED, E.SEARCHED]
    assert f.t == pytest.approx(plain.t + 30.0, abs=2.0)
    ways = [{tuple(o.position.round(1)) for s, o, _ in x.orders if o.position is not None} for x in (plain, f)]
    assert ways[0] == ways[1]


def test_a_vehicle_that_cannot_hold_its_place_is_handed_over_soon() -> None:
    blind = {holds: at_times(9.0, 999.0, picture_age=9.0, holds=holds) for holds in (True, False)}
    waited = {}
    for holds, change in blind.items():
        f = Flight(Ground({}), Executive(settings()), change)
        assert f.fly() is S.HANDED_OVER
        waited[holds] = f.t - 9.0
    assert waited[False] == pytest.approx(12.0, abs=1.0)
    assert waited[True] == pytest.approx(60.0, abs=1.0)


@pytest.mark.parametrize(("limit", "event"), [({"battery": 0.1}, E.BATTERY), ({"wind": np.array([9.0, 0.0])}, E.WIND)])
def test_limits_count_while_it_holds(limit: dict[str, object], event: FlightEvent) -> None:
    def change(now: Situation, executive: Executive) -> Situation:
        return replace(now, picture_age=9.0, **(limit if now.t > 20.0 else {})) if now.t > 9.0 else now  # type: ignore[arg-type]

    f = Flight(Ground({}), Executive(settings()), change)
    assert f.fly() is S.RETURN
    assert f.events == [E.CAMERA_LOST, event]


def test_frozen_cameras_are_named() -> None:
    f = Flight(Ground({}), Executive(settings()), at_times(9.0, 20.0, picture_age=9.0, frozen=True))
    f.fly()
    assert "the cameras have frozen" in f.executive.diary.transitions[0].reason


def test_candidates_that_all_fall_are_not_visited_for_ever() -> None:
    """Of twelve, eight are refused by near looks; then the ninth has a chance of a tenth. A site is still taken."""
    spots = [(12.0 * k - 18.0, 12.0 * m - 18.0) for k in range(4) for m in range(3)]
    ground = Ground(dict.fromkeys(spots, lambda h: 0.7), sees=99.0)
    f = Flight(ground, Executive(settings("executive.time_budget=2000")))
    assert f.fly(2000.0) is S.RETURN
    assert f.events.count(E.REFUSED) == 8
    assert "8 places were refused from near by" in f.executive.diary.transitions[-1].reason
    ground.places[25.0, 25.0] = lambda h: 0.97 if f.events.count(E.REFUSED) >= 7 else 0.01
    f = Flight(ground, Executive(settings("executive.time_budget=2000")))
    assert f.fly(2000.0) is S.LANDED
    np.testing.assert_allclose(f.position[:2], [25.0, 25.0], atol=0.3)


# -- beside obstacles


def ends_of_looks(f: Flight) -> list[np.ndarray]:
    """Ends of the look legs, (2,) each."""
    return [o.position[:2] for s, o, _ in f.orders if s is S.LOOK and o.position is not None]


def test_a_look_leg_turns_away_from_what_stands_beside_it() -> None:
    """A tree stands 2.5 m beyond the end of the leg that suits the vehicle best."""
    place = np.array([10.0, 5.0])
    free = Flight(Ground({(10.0, 5.0): clearer_from_below}), Executive(settings()))
    assert free.fly() is S.LANDED
    end = ends_of_looks(free)[0]
    east, north = np.round(end + 2.5 * (end - place) / np.hypot(*(end - place)))
    f = Flight(Ground({(10.0, 5.0): clearer_from_below}, posts=((east, north, 12.0),)), Executive(settings()))
    assert f.fly() is S.LANDED
    np.testing.assert_allclose(f.position[:2], place, atol=0.3)
    assert min(np.hypot(e[0] - east, e[1] - north) for e in ends_of_looks(f)) > 3.0


def test_a_look_leg_keeps_twice_the_distance_where_it_can() -> None:
    """Seen in a campaign: 3 m are enough beside a tree, but a gust carried the vehicle 2 m off its way."""
    place, posts = np.array([10.0, 5.0]), ((10.0, 9.0, 12.0),)  # beside the place, 4 m
    seen = Ground({(10.0, 5.0): clearer_from_below}, posts=posts).seen(1, 0.0, AWAY)
    leg = LookLeg(np.array([*place, 8.0]), 1.5, np.array([30.0, 5.0, 8.0]), None)
    near = leg.cleared(ClearWay(settings()), 0.0, seen)
    assert near is not None
    assert near.turned == 0.0  # each direction of the leg is 4 m from the tree
    along = replace(leg, place=np.array([10.0, 2.0, 8.0]))  # 7 m: there is room for a leg past the tree, not towards it
    past = along.cleared(ClearWay(settings()), 0.0, seen)
    assert past is not None
    assert past.turned == 0.0
    ahead = replace(along, position=np.array([10.0, 30.0, 8.0]))
    found = ahead.cleared(ClearWay(settings()), 0.0, seen)
    assert found is not None
    assert abs(abs(found.turned) - np.pi / 2) < 1e-6


@pytest.mark.parametrize(
    "wind", [None, *((5.0 * np.cos(a), 5.0 * np.sin(a), 0.0) for a in np.radians(range(0, 360, 30)))]
)
def test_no_leg_passes_a_tree_whichever_way_the_wind_blows(wind: tuple[float, float, float] | None) -> None:
    """A tree stands 3 m from the place, so that each leg of 3 m passes it too near. Once only half a leg was tested."""
    blown = None if wind is None else np.array(wind)
    ground = Ground({(10.0, 5.0): clearer_from_below}, posts=((10.0, 2.0, 12.0),))
    f = Flight(ground, Executive(settings()), lambda now, executive: replace(now, wind=blown))
    f.position[:2] = (-20.0, 12.0)
    assert f.fly() is S.RETURN
    assert S.LOOK not in f.states


def test_a_search_does_not_come_down_beside_what_it_has_climbed_over() -> None:
    """A tree of 38 m stands beside the corner of a lane: the corner counts as reached from above the tree."""
    corner = next(iter(square_spiral(np.zeros(2), 60.0 - 22.5, 0.7 * 22.5)))
    tree = (round(corner[0]) + 1.0, round(corner[1]) + 1.0, 38.0)
    f = Flight(Ground({}, posts=(tree,)), Executive(settings()))
    assert f.fly() is S.RETURN
    near = [p[2] for _, _, p in f.orders if np.hypot(p[0] - tree[0], p[1] - tree[1]) < 2.5]
    assert near
    assert min(near) > 38.0


@pytest.mark.parametrize("off", [0.5, 0.8])
def test_a_steady_error_of_position_does_not_keep_it_from_its_look(off: float) -> None:
    """Beside its way the vehicle keeps its height, but not at the end of its way."""
    aside = np.array([off, 0.0, 0.0])
    f = Flight(Ground({(10.0, 5.0): clearer_from_below}), Executive(settings("tuning.executive.on_way=0.9")))
    f.change = lambda now, executive: replace(now, position=now.position + aside)  # type: ignore[operator]
    f.fly(120.0)
    assert S.COMMIT in f.states


@pytest.mark.parametrize("state", [S.APPROACH, S.LOOK, S.DESCEND])
def test_a_vehicle_that_does_not_get_on_leaves_the_place(state: FlightState) -> None:
    """The vehicle is held in place: after a minute the place is given up, and the search goes on."""
    f = Flight(Ground({(10.0, 5.0): clearer_from_below}), Executive(settings("executive.time_budget=2000")))
    stays = list[np.ndarray]()

    def hold(now: Situation, executive: Executive) -> Situation:
        if executive.state is state and not any(t.event is E.WAITED for t in executive.diary.transitions):
            stays.append(f.position.copy())
            f.position[:] = stays[0]
            return replace(now, position=stays[0].copy())
        return now

    f.change = hold
    f.fly(300.0)
    waited = next(t for t in f.executive.diary.transitions if t.event is E.WAITED)
    assert (waited.before, waited.after) == (state, S.SEARCH)
    assert "nearer" in waited.reason


def test_a_climb_and_a_descent_of_minutes_get_on() -> None:
    """On the way over a wall to another low place, the vehicle gets farther from it for more than a minute."""
    places = {(10.0, 5.0): lambda h: 0.97 if h > 9.0 else 0.1, (25.0, 5.0): lambda h: 0.96}
    keys = settings("executive.search_height=120", "executive.time_budget=2000")
    f = Flight(Ground(places, sees=99.0, tall=110.0), Executive(keys))
    f.position[2] = 120.0
    f.fly(600.0)
    assert E.WAITED not in f.events
    assert f.executive.state is S.LANDED


def test_what_it_keeps_level_at_is_never_below_where_it_has_climbed_to() -> None:
    """Drift begins in the climb over a wall: behind the wall the vehicle stays up as long as it is beside its way."""
    places = {(4.0, 5.0): lambda h: 0.97 if h > 7.5 else 0.1, (35.0, 5.0): lambda h: 0.97}
    f = Flight(Ground(places, sees=60.0, tall=24.0), Executive(settings()))

    def blow(now: Situation, executive: Executive) -> Situation:
        assert now.position is not None
        if executive.state is not S.APPROACH or executive.target is None or executive.target.east < 20.0:
            return now
        aside = 0.0 if now.position[0] > 30.0 else 4.0 if now.position[0] > 17.0 else 1.0
        return replace(now, position=now.position + aside * np.array([0.0, 1.0, 0.0]))

    f.change = blow
    f.fly(90.0)
    past = [p[2] for s, _, p in f.orders if s is S.APPROACH and 18.0 < p[0] < 29.0]
    assert past
    assert min(past) > 26.0


def test_after_a_gap_of_pictures_a_search_goes_on_with_degraded_motion() -> None:
    """Degraded motion is good enough for a search, and the gap interrupted a search."""

    def change(now: Situation, executive: Executive) -> Situation:
        return replace(now, state=MotionState.DEGRADED, picture_age=3.0 if 5.0 < now.t < 7.0 else 0.1, holds=True)

    f = Flight(Ground({}), Executive(settings()), change)
    assert f.fly() is S.RETURN
    assert f.events[:2] == [E.CAMERA_LOST, E.RECOVERED]


def test_a_lane_that_passes_far_below_its_end_goes_on() -> None:
    """The lane begins low, beneath its end: from there the ground around the end is not seen."""
    lanes = SearchLanes(np.array([0.0, 0.0, 30.0]), settings().executive, Bounds(settings()))
    first = lanes.end(0.0)
    lanes.fly(np.array([*first[:2], 4.0]), 0.0)
    assert lanes.end(0.0).tolist() == first.tolist()
    lanes.fly(np.array([*first[:2], 41.0]), 0.0)  # above something tall
    assert lanes.end(0.0).tolist() != first.tolist()


def test_a_leg_that_is_flown_stays_where_no_other_is_clear() -> None:
    """Legs turn by 45 degrees from the vehicle's bearing: on the way to one leg, others would be chosen."""
    keys = settings()
    planner = LookPlanner(keys, ClearWay(keys))
    place = replace(some_site(), east=10.0, north=5.0, up=0.0)
    posts = tuple((10.0 + e, 5.0 + n, 9.0) for e in (-4.0, 4.0) for n in (-2.0, -1.0, 0.0, 1.0, 2.0))
    seen = Ground({}, posts=posts).seen(1, 0.0, AWAY)
    now = Situation(0.0, np.array([10.0, 30.0, 8.0]), MotionState.GOOD, 0, seen)
    along = planner.across(place, 8.0, now, seen)
    assert along is not None
    turned = replace(now, position=np.array([19.0, 26.0, 8.0]))
    assert planner.across(place, 8.0, turned, seen) is None
    assert planner.across(place, 8.0, turned, seen, along) is along
    moved = replace(place, east=11.0)
    assert planner.across(moved, 8.0, turned, seen, along) is None


def test_a_place_among_trees_is_not_flown_to() -> None:
    """Trees on three sides of the first place leave no leg of 3 m across it; the second stands free."""
    trees = tuple((10.0 + e, 5.0 + n, 9.0) for e, n in ((2.5, 0.0), (-1.5, 2.5), (-1.5, -2.5)))
    f = Flight(
        Ground({(10.0, 5.0): lambda h: 0.99, (-12.0, 0.0): clearer_from_below}, posts=trees), Executive(settings())
    )
    assert f.fly() is S.LANDED
    np.testing.assert_allclose(f.position[:2], [-12.0, 0.0], atol=0.3)
    assert E.REFUSED not in f.events
    alone = Flight(Ground({(10.0, 5.0): lambda h: 0.99}, posts=trees), Executive(settings()))
    assert alone.fly() is S.RETURN
    assert "something stands beside" in alone.executive.diary.transitions[-1].reason


def test_a_tree_that_only_a_near_look_shows_breaks_the_look_off() -> None:
    """The vehicle climbs before it goes on to the next place."""
    trees = tuple((10.0 + e, 5.0 + n, 9.0) for e, n in ((2.5, 0.0), (-1.5, 2.5), (-1.5, -2.5)))
    ground = Ground({(10.0, 5.0): lambda h: 0.99, (-12.0, 0.0): clearer_from_below}, posts=trees, posts_show=9.0)
    f = Flight(ground, Executive(settings()))
    assert f.fly() is S.LANDED
    np.testing.assert_allclose(f.position[:2], [-12.0, 0.0], atol=0.3)
    refused = [x for x in f.executive.diary.transitions if x.event is E.REFUSED]
    assert [x.reason for x in refused] == ["something stands beside every way across it"]
    assert refused[0].before in (S.DESCEND, S.LOOK)


def test_a_wider_vehicle_keeps_farther_away() -> None:
    """A tree 4 m beside the way leaves room for a radius of 1.5 m, not for a rotor of 2.5 m."""
    seen = Ground({}, posts=((0.0, 4.0, 9.0),)).seen(1, 0.0, AWAY)
    start, to = np.array([-2.0, 0.0, 6.0]), np.array([2.0, 0.0, 6.0])
    assert ClearWay(settings()).is_free(start, to, 0.0, seen)
    assert not ClearWay(settings("lander.rotor_radius=2.5")).is_free(start, to, 0.0, seen)


def test_a_low_bush_beside_a_leg_leaves_it_as_it_is() -> None:
    """The bush is lower than half the height of a look; so the look keeps its height."""
    bush = (13.0, 6.0, 1.5)
    f = Flight(Ground({(10.0, 5.0): clearer_from_below}, posts=(bush,)), Executive(settings()))
    free = Flight(Ground({(10.0, 5.0): clearer_from_below}), Executive(settings()))
    assert f.fly() is free.fly() is S.LANDED
    ways = [[tuple(o.position) for s, o, _ in x.orders if s is S.LOOK and o.position is not None] for x in (f, free)]
    assert ways[0] == ways[1]
    lowest = [p[2] for s, _, p in f.orders if s is S.LOOK][-1]
    assert lowest == pytest.approx(6.0, abs=0.5)


# -- wind


def test_looks_lead_against_the_wind() -> None:
    wind = np.array([0.0, 5.0, 0.0])  # the air goes north
    f = Flight(Ground({(10.0, 5.0): clearer_from_below}), Executive(settings()), at_times(-1.0, 999.0, wind=wind))
    assert f.fly() is S.LANDED
    looks = [(o, p) for s, o, p in f.orders if s is S.LOOK and o.position is not None]
    first = [looks[0], *(b for a, b in pairwise(looks) if np.linalg.norm(b[0].position - a[0].position) > 0.5)]
    assert len(first) >= 2
    for order, at in first:
        assert order.position is not None
        assert at[1] > 5.0 > order.position[1]  # begins in the north, leads south
        assert order.position[0] == pytest.approx(10.0, abs=0.1)


def test_speed_through_the_air_is_limited() -> None:
    wind = np.array([-6.0, 0.0, 0.0])
    f = Flight(
        Ground({(25.0, 0.0): lambda h: 0.97 if h < 9.0 else 0.92}, sees=40.0),
        Executive(settings("tuning.route.air_speed=8")),
        at_times(-1.0, 999.0, wind=wind),
    )  # fmt: skip
    assert f.fly() is S.LANDED
    for _, o, p in f.orders:
        if o.what != "fly" or o.position is None or (away := np.hypot(*(o.position - p)[:2])) < 0.1:
            continue
        through_air = (o.position - p)[:2] / away * o.speed - wind[:2]
        assert np.hypot(*through_air) <= 8.0 + 1e-6 or o.speed <= 0.5
        assert o.sink == (1.0 if (o.position - p)[0] / away * -6.0 > 2.0 else 2.0)
    assert min(o.speed for s, o, _ in f.orders if s is S.APPROACH) == pytest.approx(2.0, abs=0.05)


def test_a_short_loss_costs_time_only() -> None:
    def lost(now: Situation, executive: Executive) -> Situation:
        return replace(now, state=MotionState.LOST, position=None) if 12.0 < now.t < 16.0 else now

    f = Flight(Ground({(10.0, 5.0): clearer_from_below}), Executive(settings()), lost)
    assert f.fly() is S.LANDED
    assert E.NAVIGATION_LOST in f.events
    assert E.RECOVERED in f.events


def test_degraded_motion_is_good_enough_to_search_and_not_to_look() -> None:
    weak = in_state(S.SEARCH, lambda now: replace(now, state=MotionState.DEGRADED))
    f = Flight(Ground({(10.0, 5.0): clearer_from_below}), Executive(settings()), weak)
    f.fly(200.0)
    assert S.APPROACH in f.states
    assert S.COMMIT not in f.states
    assert f.executive.state is S.HANDED_OVER


def test_no_verdict_no_landing() -> None:
    """No landing begins if verdicts stop when the first look begins."""
    frozen: list[MapVerdict | None] = []

    def stop(now: Situation, executive: Executive) -> Situation:
        if executive.state is S.LOOK or frozen:
            frozen.append(now.seen)
            return replace(now, seen=frozen[0])
        return now

    f = Flight(Ground({(10.0, 5.0): clearer_from_below}), Executive(settings()), stop)
    assert f.fly() is S.RETURN
    assert E.WAITED in f.events
    assert S.COMMIT not in f.states


# -- the table


@given(st.lists(st.tuples(st.sampled_from(list(MotionState)), st.booleans(), st.booleans(), st.booleans(),
                          st.floats(0, 20), st.floats(0, 1), st.floats(0, 4), st.integers(0, 2),
                          st.floats(-1, 40), st.floats(0, 1)), min_size=20, max_size=60))  # fmt: skip
@budget(max_examples=40, deadline=None)
def test_whatever_happens_it_stays_in_its_table(moments: list[tuple]) -> None:  # type: ignore[type-arg]
    """In random situations there is no exception, no transition outside the table, and no order after the end."""
    executive, ground, t = Executive(settings()), Ground({(1.0, 1.0): clearer_from_below}), 0.0
    for state, link, pilot, stands, wind, battery, age, frame, up, p in moments:
        t += 1.0
        ground.frame_id, ground.places[1.0, 1.0] = frame, lambda h, p=p: p
        at = np.array([1.0, 0.0, up])
        lost = state in (MotionState.LOST, MotionState.INITIALISING)
        ended = executive.state in (S.LANDED, S.HANDED_OVER)
        order = executive.tick(
            Situation(t, None if lost else at, state, frame, ground.seen(int(t), t, at), age, wind > 10,
                      link=link or wind > 3, pilot=pilot and wind > 18, standing=stands and up < 1, battery=battery,
                      wind=np.array([wind, -wind]), holds=battery > 0.5)
        )  # fmt: skip
        assert not ended or order.what == "nothing"
        assert order.position is None or np.isfinite(order.position).all()
    for x in executive.diary.transitions:
        assert TABLE[x.before, x.event] is x.after


def test_every_state_can_be_left_and_every_event_leads_somewhere() -> None:
    assert {before for before, _ in TABLE} == set(S) - {S.LANDED, S.HANDED_OVER}
    assert {event for _, event in TABLE} == set(E)
    assert all(TABLE[s, E.PILOT] is S.HANDED_OVER for s in set(S) - {S.LANDED, S.HANDED_OVER})
    assert {after for (before, _), after in TABLE.items() if before is S.COMMIT} <= {S.LANDED, S.ABORT, S.HANDED_OVER}


# -- parts


def test_the_spiral_covers_the_square() -> None:
    for side in (40.0, 46.0, 52.0, 7.0, 0.0):
        corners = np.array(list(square_spiral(np.array([3.0, 4.0]), side, 10.0)))
        assert np.abs(corners[0] - [3.0, 4.0]).max() <= 5.0
        assert (np.abs(np.diff(corners, axis=0)).min(axis=1) == 0).all()  # along the axes
        np.testing.assert_allclose(corners.max(axis=0) - [3.0, 4.0], 0.5 * side, atol=1e-9)  # to the rim, not beyond
        np.testing.assert_allclose(corners.min(axis=0) - [3.0, 4.0], -0.5 * side, atol=1e-9)
        way = np.concatenate([np.linspace(a, b, 50) for a, b in pairwise(corners)])
        for e in 3.0 + np.linspace(-0.5, 0.5, 20) * side:
            for n in 4.0 + np.linspace(-0.5, 0.5, 20) * side:
                assert np.abs(way - [e, n]).max(axis=1).min() <= 5.0 + 0.5


def test_a_place_that_fell_is_not_taken_for_one_beside_it() -> None:
    """A stays in doubt and is left. C, 3.1 m beside it, is looked at: A is better from 8 m, but is not taken again."""
    ground = Ground({(10.0, 5.0): lambda h: 0.8, (13.1, 5.0): lambda h: 0.97 if h < 7.0 else 0.7})
    f = Flight(ground, Executive(settings()))
    assert f.fly() is S.LANDED
    assert f.events.count(E.REFUSED) == 1
    np.testing.assert_allclose(f.position[:2], [13.1, 5.0], atol=0.3)


def test_good_ground_that_is_not_listed_is_not_dropped_on_the_way() -> None:
    """A better place elsewhere can keep it off the list; its cell has a P(safe) of 0.9, which is no refusal."""
    ground = Ground({(10.0, 5.0): lambda h: 0.97 if h < 9.0 else 0.92}, unlisted=(9.5, 26.0))
    f = Flight(ground, Executive(settings()))
    assert f.fly() is S.LANDED
    assert E.REFUSED not in f.events


@pytest.mark.parametrize(("room", "landed"), [(9.0, True), (0.3, False)])
def test_a_place_that_is_not_listed_is_a_site_only_with_room_about_it(room: float, landed: bool) -> None:
    """A listed site has no refused touchdown within `sites.margin`; this holds for a place off the list, too."""
    ground = Ground({(10.0, 5.0): clearer_from_below}, unlisted=(1.0, 9.0), room=room)
    f = Flight(ground, Executive(settings()))
    f.fly(120.0)
    assert (S.COMMIT in f.states) is landed
    if not landed:
        assert "another is refused within 0.5 m" in f.executive.diary.looks[-1].doubt


def test_after_four_refusals_the_search_goes_on_to_its_end() -> None:
    """After the search the best place is next, wherever it is; climbing back to it each time took most of the time."""
    doubtful = [(2.0, 5.0), (-5.0, 3.0), (-4.0, -7.0), (5.0, -3.0), (1.0, -9.0)]
    places = {where: lambda h: 0.91 for where in doubtful} | {(18.0, 18.0): lambda h: 0.97 if h < 9.0 else 0.94}
    f = Flight(Ground(places, sees=12.0), Executive(settings()))
    assert f.fly() is S.LANDED
    assert f.events.count(E.REFUSED) == 4
    np.testing.assert_allclose(f.position[:2], [18.0, 18.0], atol=0.3)


def test_the_lowest_clear_height_is_that_of_the_highest_thing_on_the_way() -> None:
    m = Ground({}, tall=12.0).map()
    start, ways = np.array([0.0, 0.0, 5.0]), Obstructions.of(m)
    over, beside = (way_below(start, np.array([e, 0.0, 5.0]), m.grid, ways, 3.0, 3.0, 3.0) for e in (30.0, 10.0))
    assert over == (pytest.approx(12.0 + 2 * 0.02 + 3.0, abs=1e-4), pytest.approx(0.0, abs=0.02), 0.0)
    assert beside == (pytest.approx(3.04, abs=1e-4), pytest.approx(0.0, abs=0.02), 0.0)
    away = way_below(start, np.array([300.0, 0.0, 5.0]), m.grid, ways, 3.0, 3.0, 3.0)
    assert away.unmapped > 0.5  # most of it is not on the map


def test_a_crown_in_doubt_stands_in_the_way_and_a_single_doubtful_cell_does_not() -> None:
    m = some_elevation()
    height, flags = np.zeros_like(m.height), np.zeros_like(m.flags)
    half = round(1.0 / m.grid.cell)
    crown, speck = (slice(20, 20 + 2 * half), slice(20, 20 + 2 * half)), (5, 5)
    for where in (crown, speck):
        height[where], flags[where] = 9.0, Flag.UNSURE
    doubted = replace(m, height=height, flags=flags, sigma=np.full_like(height, 0.02))
    found = Obstructions.of(doubted)
    assert found.top[20 + half, 20 + half] == 9.0
    assert found.top[speck] < 1.0
    assert (found.rise[crown] > 3.0).all()
    assert (found.rise > 3.0).sum() == 4 * half * half
    assert not (Obstructions.of(replace(doubted, flags=np.zeros_like(flags))).rise > 3.0).any()


@pytest.mark.parametrize("length", [6.0, 30.0])
def test_a_way_past_a_crown_in_doubt_is_flown_at_the_height_of_the_search(length: float) -> None:
    """The map had 4 m for trees of 12 m, so even a short way is flown high, except between looks at one place."""
    ground = Ground({}, posts=tuple((e, n, 4.0) for e in (-1.0, 0.0, 1.0) for n in (2.0, 3.0)))
    seen = ground.seen(1, 0.0, AWAY)
    flags = np.where(seen.elevation.height > 3.0, np.uint16(Flag.UNSURE), np.uint16(0))
    doubted = replace(seen, elevation=replace(seen.elevation, flags=flags))
    keys = settings()
    start, to = np.array([-0.5 * length, 0.0, 6.0]), np.array([0.5 * length, 0.0, 6.0])
    assert ClearWay(keys).level(start, to, doubted) == keys.executive.search_height
    assert ClearWay(keys).level(start, to, doubted, at_a_place=True) == pytest.approx(7.0, abs=0.1)
    assert ClearWay(keys).level(start, to, seen) == pytest.approx(7.0, abs=0.1)  # nothing in doubt


@pytest.mark.parametrize("mapped", [True, False])
def test_a_long_way_over_unmapped_ground_is_flown_at_the_height_of_the_search(mapped: bool) -> None:
    """Between a place that a low look refused and the next one, obstacles may stand that no map shows."""
    places = {(10.0, 5.0): lambda h: 0.92 if h > 9.0 else 0.1, (-15.0, 5.0): lambda h: 0.91}
    f = Flight(Ground(places, sees=60.0, gap=not mapped), Executive(settings()))
    f.fly()
    assert min(p[2] for state, _, p in f.orders if state is S.LOOK and p[0] > 5.0) < 10.0
    between = [p[2] for state, _, p in f.orders if state is S.APPROACH and -5.0 < p[0] < 0.0]
    assert between
    assert (min(between) > 25.0) is not mapped


@pytest.mark.parametrize("trouble", ["motion", "pictures", "frame", "wind", "verdict"])
def test_just_above_the_ground_it_lands_whatever_comes(trouble: str) -> None:
    """A climb without sight, or from a gust near the ground, is worse than the last metre."""

    def change(now: Situation, executive: Executive) -> Situation:
        assert now.position is not None
        if executive.state is not S.COMMIT or now.position[2] > 1.2 or now.standing:
            return now
        return {
            "motion": replace(now, state=MotionState.LOST, position=None),
            "pictures": replace(now, picture_age=9.0),
            "frame": replace(now, frame_id=now.frame_id + 1),
            "wind": replace(now, wind=30.0),
            "verdict": now,
        }[trouble]

    ground = Ground({(10.0, 5.0): lambda h: 0.0 if trouble == "verdict" and h < 1.2 else clearer_from_below(h)})
    f = Flight(ground, Executive(settings()), change)
    assert f.fly() is S.LANDED
    assert S.ABORT not in f.states


@pytest.mark.parametrize("state", [S.COMMIT, S.ABORT])
def test_after_contact_there_is_no_climb_whatever_height_is_estimated(state: FlightState) -> None:
    """A vehicle that stood was 3.4 m up by the estimate, without motion: only down is right from then on."""
    after = list[float]()  # s, times since the contact

    def change(now: Situation, executive: Executive) -> Situation:
        assert now.position is not None
        low = executive.state is S.COMMIT and now.position[2] < 4.0
        if after or (executive.state is state and (low or state is S.ABORT)):
            after.append(now.t)
            lost = replace(now, position=None, state=MotionState.LOST, picture_age=9.0, holds=False)
            return replace(lost, contact=len(after) == 1, standing=len(after) > 50)
        return replace(now, frame_id=1) if low else now

    f = Flight(Ground({(10.0, 5.0): clearer_from_below}), Executive(settings()), change)
    assert f.fly(200.0) is S.LANDED
    assert (S.ABORT in f.states) is (state is S.ABORT)
    assert {(o.what, o.down) for _, o, _ in f.orders[-51:-1]} == {("land", True)}


@pytest.mark.parametrize(("lasting", "aborted"), [(0.6, False), (4.0, True)])
def test_motion_that_is_degraded_for_a_moment_breaks_no_landing_off(lasting: float, aborted: bool) -> None:
    """Near the ground features change fast: a short degradation is no reason to climb, a longer one is."""
    began: list[float] = []

    def change(now: Situation, executive: Executive) -> Situation:
        assert now.position is not None
        if executive.state is S.COMMIT and now.position[2] < 5.0:
            began.append(now.t)
        if began and now.t - began[0] < lasting:
            return replace(now, state=MotionState.DEGRADED)
        return now

    f = Flight(Ground({(10.0, 5.0): clearer_from_below}), Executive(settings()), change)
    f.fly()
    assert began
    assert (S.ABORT in f.states) is aborted


def test_of_places_alike_the_plain_one_is_visited_first() -> None:
    """Near looks settle paved ground and leave most grass in doubt; a site comes before both."""
    grass = replace(some_site(), east=20.0, doubt="relief", p_safe=0.91, terrain=Terrain.SHORT_GRASS)
    paved = replace(grass, east=40.0, p_safe=0.87, terrain=Terrain.PAVED)
    site = replace(grass, east=60.0, p_safe=0.95, doubt=None)
    sure = replace(grass, p_safe=0.98)
    for listed, first in (((grass, paved), paved), ((grass, paved, site), site), ((sure, paved), sure)):
        places = KnownPlaces(settings())
        seen = Ground({}).seen(1, 0.0, AWAY)
        sites = tuple(s for s in listed if s.kind == "site")
        places.note(replace(seen, sites=Sites(sites, "", 0, tuple(s for s in listed if s.kind != "site"))))
        assert places.best() == first
