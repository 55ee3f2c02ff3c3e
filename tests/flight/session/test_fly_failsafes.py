"""Lost GPS, refused holds, failsafes: down beats a climb without a position, and each end has its own name."""

from __future__ import annotations

import pytest
from length import EITHER, in_turn
from pilot_rig import PilotRig, flying

from alight.records import MotionState, NoticeKind
from alight.records.executive import FlightEvent, FlightState
from alight_sim.autopilot.dialects import Doing

S, E = FlightState, FlightEvent


def lose_gps_at(height: float, dialect: str, degraded_after: float) -> PilotRig:
    """Return a landing whose receiver is lost at a height, m, and whose motion is degraded some seconds later."""
    r = flying(dialect)
    assert r.fly(S.COMMIT)
    assert r.run(30.0, lambda: r.truth()[2] < height)
    r.sim.estimate.receives = False
    r.run(degraded_after)
    r.motion_state = MotionState.DEGRADED
    return r


@pytest.mark.parametrize(("dialect", "height"), in_turn(2, [[5.9], [4.5]]))
def test_gps_lost_in_a_landing_ends_on_the_ground(dialect: str, height: float) -> None:
    """A real Copter was ordered to climb at 4.1 m, refused to hold at 9.5 m, and was 7 m up 20 s later."""
    r = lose_gps_at(height, dialect, 3.7)
    heights = [r.truth()[2]]
    each = r.each_step
    r.each_step = lambda: (each(), heights.append(r.truth()[2]))  # type: ignore[func-returns-value]
    assert r.fly(S.LANDED, 20.0)
    assert S.ABORT not in [x.after for x in r.pilot.diary.transitions]
    assert max(heights) < height + 0.1


@EITHER
def test_gps_lost_while_it_climbs_ends_the_climb(dialect: str) -> None:
    r = flying(dialect)
    assert r.fly(S.COMMIT)
    r.frame_id = 1
    assert r.fly(S.ABORT, 5.0)
    r.sim.estimate.receives = False
    assert r.run(4.0, lambda: r.doing is Doing.HOLD)


@EITHER
def test_gps_lost_high_up_is_held_until_it_is_back(dialect: str) -> None:
    """Offboard was ordered anew 3.5 s after the fix was lost: guided flight waits for a fix."""
    r = flying(dialect)
    assert r.fly(S.LOOK)
    r.sim.estimate.receives = False
    r.run(1.0)
    r.motion_state = MotionState.DEGRADED
    assert r.fly(S.HOLD, 5.0)
    r.motion_state = MotionState.GOOD
    assert r.run(2.0, lambda: r.doing is Doing.HOLD)  # PX4 is guided until it has changed its mode
    t = r.t
    r.run(5.0)
    assert r.doing is Doing.HOLD
    assert not r.targets_since(t)
    r.sim.estimate.receives = True
    assert r.fly(S.LANDED)


# -- a refused hold


@EITHER
def test_where_a_hold_is_refused_it_lands(dialect: str) -> None:
    """Without a position BRAKE is refused: `Mode change to BRAKE failed: requires position`."""
    r = flying(dialect)
    assert r.fly(S.LOOK)
    r.sim.healthy = False
    assert r.run(12.0, lambda: r.doing is Doing.LAND)
    assert any("hold was refused: it is ordered to land" in line for line in r.orders)
    assert r.run(60.0, lambda: r.sim.vehicle.body.stands)


@pytest.mark.parametrize(("height", "after"), [(14.0, S.SEARCH), (5.0, S.HOLD)])
def test_a_landing_after_a_refused_hold_is_left_only_high_up(height: float, after: FlightState) -> None:
    r = flying()
    assert r.fly(S.LOOK)
    r.sim.healthy = False
    assert r.run(12.0, lambda: r.doing is Doing.LAND)
    r.sim.vehicle.body.position[2] = height
    r.sim.healthy = True
    assert r.run(6.0, lambda: r.state is not S.HOLD) is (after is S.SEARCH)
    r.run(1.5)
    assert r.doing is (Doing.GUIDED if after is S.SEARCH else Doing.LAND)
    assert r.fly(S.LANDED, 120.0)


@EITHER
def test_after_hold_and_land_were_refused_nothing_is_ordered(dialect: str) -> None:
    r = flying(dialect)
    assert r.fly(S.LOOK)
    r.sim.refuse_modes(60.0)
    r.sim.healthy = False
    assert r.run(12.0, lambda: any("land was refused 3 times" in x for x in r.orders))
    t = r.t
    r.run(10.0)
    assert not r.moving_since(t + 2 * r.dt)
    assert "nothing: hold and land were refused" in r.orders
    assert r.fly(S.HANDED_OVER, 15.0)


# -- failsafes of the autopilot

FAILSAFES = [
    ("ardupilot", Doing.RETURN, ("Battery 1 is low 10.30V used 900 mAh", "Battery Failsafe")),
    ("ardupilot", Doing.LAND, ("EKF Failsafe: changed to LAND Mode",)),
    ("px4", Doing.PILOT, ("Failsafe activated",)),
    ("px4", Doing.RETURN, ()),
]


@pytest.mark.parametrize(("dialect", "doing", "texts"), FAILSAFES)
def test_a_failsafe_is_called_by_its_name(dialect: str, doing: Doing, texts: tuple[str, ...]) -> None:
    r = flying(dialect)
    assert r.fly(S.LOOK)
    r.sim.fail_safe(doing, *texts)
    assert r.fly(S.HANDED_OVER, 5.0)
    last = r.pilot.diary.transitions[-1]
    assert (last.event, last.reason) == (E.FAILSAFE, "; ".join(texts) or "its state is critical")
    assert "failsafe" in r.of(NoticeKind.TAKEOVER)[-1].text


def test_a_pilot_who_moves_a_stick_in_a_critical_state_is_a_pilot() -> None:
    r = flying()
    assert r.fly(S.LOOK)
    r.sim.logic.failsafe = True
    r.run(1.5)
    r.sim.reports.sticks = [1500, 1900, 1100, 1500]
    assert r.fly(S.HANDED_OVER, 3.0)
    assert r.events[-1] is E.PILOT
