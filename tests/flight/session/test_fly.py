"""A landing as it is flown: orders reach an autopilot, faults lead to the right state, a take-over ends all."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from length import BOTH, EITHER, first_rows
from made_up_ground import Ground, clearer_from_below
from pilot_rig import PLACE, VERDICT, PilotRig, flying

from alight.flight.session.dry_run import DryRunVehicle
from alight.records import NoticeKind
from alight.records.executive import FlightEvent, FlightState
from alight_sim.autopilot.dialects import Doing

S, E = FlightState, FlightEvent
# -- the loop


@pytest.mark.parametrize(("dialect", "height"), [("ardupilot", 30.0), ("px4", 16.0)])
def test_it_searches_looks_and_lands_where_it_looked(dialect: str, height: float) -> None:
    """The autopilot's place is off by metres and ours is true: the touchdown is at our place."""
    r = flying(dialect, height=height)
    assert r.fly(S.LANDED)
    assert not r.sim.logic.armed
    assert np.hypot(*(r.truth()[:2] - PLACE)) < 0.3
    assert r.sim.vehicle.touchdown_speed < 0.9
    assert {E.FOUND, E.LOWER, E.CONFIRMED, E.TOUCHED_DOWN} <= set(r.events)
    assert not r.of(NoticeKind.TAKEOVER)
    assert len(r.entries) == len(r.pilot.diary.transitions) + len(r.pilot.diary.looks)
    assert len(r.pilot.diary.pictures) == len(r.pilot.diary.looks)
    late = list(r.pilot.delays["image to way-point"])
    assert late
    assert max(late) <= VERDICT + r.dt + 1e-6  # every verdict is used in the tick after its arrival
    t = r.t
    r.run(5.0)
    assert not r.moving_since(t + 0.1)


@EITHER
def test_a_wait_between_two_looks_is_flown_under_guidance(dialect: str) -> None:
    """While no verdict comes, the vehicle stays in place, in guided mode."""
    r = flying(dialect)
    assert r.fly(S.LOOK)
    r.judges = False
    assert r.run(20.0, lambda: r.view is not None and r.view.order == "stay")
    r.run(1.5)
    before = r.truth()
    r.run(4.0)
    assert np.linalg.norm(r.truth() - before) < 0.3
    assert r.doing is Doing.GUIDED
    assert r.state is S.LOOK


# -- faults


def lose_gps(r: PilotRig) -> None:
    r.sim.healthy = False


def freeze_camera(r: PilotRig) -> None:
    r.freeze = True


def stop_camera(r: PilotRig) -> None:
    r.pictures = False


def lose_link(r: PilotRig) -> None:
    r.up.loss = r.down.loss = 1.0


def reboot(r: PilotRig) -> None:
    r.sim.reboot()


def take_over(r: PilotRig) -> None:
    r.sim.pilot(Doing.PILOT)


def move_sticks(r: PilotRig) -> None:
    r.sim.reports.sticks = [1500, 1900, 1100, 1500]


def restart_filter(r: PilotRig) -> None:
    r.frame_id += 1


def blow(r: PilotRig) -> None:
    r.sim.vehicle.wind_world = np.array([9.0, 0.0, 0.0])


def drain(r: PilotRig) -> None:
    r.sim.vehicle.battery = 1.0 - 1000.0 / 1200.0


FAULTS: dict[Callable[[PilotRig], None], tuple[FlightEvent, FlightState, FlightState]] = {
    # the event, the state that it leads to from an approach, and from a commit
    lose_gps: (E.NAVIGATION_LOST, S.HOLD, S.COMMIT),
    freeze_camera: (E.CAMERA_LOST, S.HOLD, S.ABORT),
    stop_camera: (E.CAMERA_LOST, S.HOLD, S.ABORT),
    lose_link: (E.LINK_LOST, S.HANDED_OVER, S.HANDED_OVER),
    reboot: (E.LINK_LOST, S.HANDED_OVER, S.HANDED_OVER),
    take_over: (E.PILOT, S.HANDED_OVER, S.HANDED_OVER),
    move_sticks: (E.PILOT, S.HANDED_OVER, S.HANDED_OVER),
    blow: (E.WIND, S.RETURN, S.ABORT),
    drain: (E.BATTERY, S.RETURN, S.COMMIT),
}
GONE = (take_over, move_sticks, lose_link, reboot)  # after which nothing may move the vehicle


MOMENTS = [(S.APPROACH, "px4"), (S.COMMIT, "ardupilot"), (S.APPROACH, "ardupilot"), (S.COMMIT, "px4")]
# the executive is the same for both autopilots: each fault at one moment on one of them, then at the other three
CASES = [(fault, *MOMENTS[(k + turn) % 4]) for turn in range(4) for k, fault in enumerate(FAULTS)]


@pytest.mark.parametrize(
    ("fault", "when", "dialect"), first_rows(len(FAULTS), CASES), ids=lambda x: getattr(x, "__name__", None)
)
def test_a_fault_leads_to_the_right_state(fault: Callable[[PilotRig], None], when: FlightState, dialect: str) -> None:
    """After a take-over, a lost link or a reboot nothing is sent that moves the vehicle, not even when it is back."""
    event, above, below = FAULTS[fault]
    r = flying(dialect)
    assert r.fly(when)
    r.run(1.0)
    count = len(r.events)
    fault(r)
    if when is S.COMMIT and below is S.COMMIT:  # a landing that has begun is the shortest way down
        r.run(3.0)
        assert event not in r.events[count:]
        assert r.state in (S.COMMIT, S.LANDED)
        return
    seen = {event, E.PILOT} if fault is reboot else {event}  # its first heartbeat may show another mode
    assert r.run(12.0, lambda: bool(seen & set(r.events[count:])))
    new = next(t for t in r.pilot.diary.transitions[count:] if t.event in seen)
    assert new.after is (below if when is S.COMMIT else above)
    if fault not in GONE:
        return
    t = r.t
    r.up.loss = r.down.loss = 0.0
    r.run(25.0)
    assert not r.moving_since(t + 2 * r.dt)
    assert r.state is S.HANDED_OVER


@EITHER
def test_the_autopilot_holds_while_something_is_missing_and_goes_on_after_it(dialect: str) -> None:
    r = flying(dialect)
    assert r.fly(S.APPROACH)
    freeze_camera(r)
    assert r.run(6.0, lambda: r.state is S.HOLD)
    r.run(2.0)
    assert r.doing is Doing.HOLD
    r.freeze = False
    assert r.fly(S.LANDED)


@EITHER
def test_gps_that_stays_away_ends_in_a_landing_of_the_autopilot(dialect: str) -> None:
    r = flying(dialect)
    assert r.fly(S.APPROACH)
    lose_gps(r)
    assert r.run(30.0, lambda: r.state is S.HANDED_OVER)
    assert E.WAITED in r.events
    assert any("no position on Earth" in line for line in r.orders)
    t = r.t
    r.run(20.0)
    assert not r.moving_since(t + 2 * r.dt)
    assert r.doing is Doing.LAND  # a hold needs a position


@EITHER
def test_a_filter_that_begins_anew_gives_the_place_up_and_searches_on(dialect: str) -> None:
    ground = Ground({PLACE: clearer_from_below})
    r = flying(dialect, see=ground.seen)
    assert r.fly(S.LOOK)
    restart_filter(r)
    assert r.run(3.0, lambda: E.NEW_FRAME in r.events)
    ground.frame_id = r.frame_id
    assert r.fly(S.LANDED)


@EITHER
def test_a_car_on_the_place_stops_the_descent(dialect: str) -> None:
    """After two verdicts that refuse the place the vehicle climbs; there is no other place, so that it returns home."""
    ground = Ground({PLACE: clearer_from_below})
    r = flying(dialect, "executive.search_side=30", see=ground.seen)
    assert r.fly(S.COMMIT)
    ground.places[PLACE] = lambda height: 0.0
    assert r.run(10.0, lambda: r.state is S.ABORT)
    assert r.run(30.0, lambda: r.state is S.SEARCH)
    assert r.sim.vehicle.position[2] > 8.0
    assert r.fly(S.RETURN)
    r.run(5.0)
    assert r.doing is Doing.RETURN


@EITHER
def test_a_vehicle_that_is_blown_off_the_place_is_led_back_above_it(dialect: str) -> None:
    r = flying(dialect)
    assert r.fly(S.COMMIT)
    assert r.run(60.0, lambda: r.sim.vehicle.position[2] < 3.0)
    assert r.doing is Doing.LAND
    r.sim.vehicle.position[0] += 1.5
    assert r.run(5.0, lambda: r.doing is Doing.GUIDED)
    assert sum("the descent waits" in x for x in r.orders) == 1
    low = r.sim.vehicle.position[2]
    assert r.run(20.0, lambda: r.doing is Doing.LAND)
    assert r.sim.vehicle.position[2] > low - 0.3
    assert r.fly(S.LANDED)
    assert np.hypot(*(r.truth()[:2] - PLACE)) < 0.4
    assert not r.of(NoticeKind.TAKEOVER)


def test_the_nose_stays_and_the_speeds_are_those_of_the_orders() -> None:
    """ArduPilot by itself would turn its nose into the direction of flight, and choose its own speeds."""
    r = flying()
    before, turned, rushed, orders = r.sim.vehicle.heading, [0.0], [0.0], r.executive_orders()

    def look() -> None:
        turned.append(abs(r.sim.vehicle.heading - before))
        if orders and orders[-1].what == "fly":
            rushed.append(-float(r.sim.vehicle.velocity[2]) - orders[-1].sink)

    step = r.each_step
    r.each_step = lambda: (step(), look())  # type: ignore[func-returns-value]
    assert r.fly(S.COMMIT)
    assert max(turned) < 0.1  # the lean changes the heading where guidance began
    assert max(rushed) < 0.3


def test_the_target_is_reported_before_the_landing_begins() -> None:
    """ArduPilot needs the target for two seconds, and PX4 searches if it has none."""
    r = flying()
    assert r.fly(S.COMMIT)
    assert r.run(20.0, lambda: r.doing is Doing.LAND)
    begun = next(t for t, m in reversed(r.wire) if m.get_type() == "COMMAND_LONG" and m.command == 176)
    early = [t for t, m in r.wire if m.get_type() == "LANDING_TARGET" and t < begun]
    assert len(early) > 5
    assert r.run(3.0, lambda: r.sim.vehicle.velocity[2] < -0.2)  # it would wait for seven seconds without a target


def test_a_pilot_who_switches_just_before_an_order_is_not_switched_back() -> None:
    """The mode is known once a second, by the heartbeat: an order that changes it waits for the next one."""
    r = flying()
    assert r.fly(S.COMMIT)
    assert r.run(3.0, lambda: r.ours.telemetry is not None and 0.5 < r.ours.telemetry.ages["HEARTBEAT"] < 0.7)
    assert r.doing is Doing.GUIDED  # the order to land is due any moment
    take_over(r)
    assert r.run(2.0, lambda: r.state is S.HANDED_OVER)
    assert r.doing is Doing.PILOT
    assert "LAND" not in {n.text for n in r.heard}


def test_a_mode_that_is_refused_is_asked_for_again() -> None:
    r = flying()
    assert r.fly(S.SEARCH)
    enter = r.sim.logic.enter
    r.sim.logic.enter = lambda doing, t: False  # type: ignore[method-assign]
    freeze_camera(r)
    r.run(5.0)
    assert r.doing is Doing.GUIDED
    r.sim.logic.enter = enter  # type: ignore[method-assign]
    assert r.run(6.0, lambda: r.doing is Doing.HOLD)


# -- taking off, and not sending


@BOTH
def test_it_takes_off(dialect: str) -> None:
    r = PilotRig(Ground({}).seen, dialect)
    climb = r.take_off(12.0)
    assert r.run(60, lambda: climb.done)
    assert r.sim.estimated[2] > 11.0
    r.run(5.0)
    assert r.sim.estimated[2] == pytest.approx(12.0, abs=0.5)


def test_a_helicopter_waits_for_its_interlock_and_says_so() -> None:
    r = PilotRig(Ground({}).seen, kind=4)
    climb = r.take_off(12.0)
    assert r.run(10, lambda: "interlock" in climb.hint)
    r.run(4.0)
    r.sim.logic.interlock = True
    assert r.run(60, lambda: climb.done)
    assert not climb.hint


def test_motors_that_somebody_stops_are_not_started_again() -> None:
    """A helicopter without its interlock is disarmed after 10 s, and a pilot may stop the motors at any time."""
    r = PilotRig(Ground({}).seen, kind=4)
    climb = r.take_off(12.0)
    assert r.run(30, lambda: bool(climb.failed))
    assert "stopped" in climb.failed
    r.run(8.0)
    assert not r.sim.logic.armed


def test_a_take_off_ends_when_somebody_else_flies() -> None:
    r = PilotRig(Ground({}).seen)
    climb = r.take_off(30.0)
    assert r.run(30, lambda: r.sim.estimated[2] > 3.0)
    take_over(r)
    assert r.run(5.0, lambda: bool(climb.failed))
    assert "somebody else" in climb.failed
    t = r.t
    r.run(10.0)
    assert not r.moving_since(t + 2 * r.dt)


def test_it_is_ordered_once_to_take_off_although_the_lift_off_is_reported_late() -> None:
    r = PilotRig(Ground({}).seen)
    climb = r.take_off(12.0)
    assert r.run(60, lambda: climb.done)
    assert sum(m.get_type() == "COMMAND_LONG" and m.command == 22 for _, m in r.wire) == 1


def test_a_refusal_to_arm_ends_the_take_off_with_the_reason() -> None:
    """Tried again, it would start the motors when a person lowers the stick, without a word."""
    r = PilotRig(Ground({}).seen)
    r.sim.reports.sticks[2] = 1500
    climb = r.take_off(12.0)
    assert r.run(10, lambda: bool(climb.failed))
    assert climb.failed == "arm: failed; Arm: Throttle (RC3) is not neutral"
    r.sim.reports.sticks[2] = 1100
    r.run(5.0)
    assert not r.sim.logic.armed


@EITHER
def test_a_dry_run_says_its_orders_and_sends_none(dialect: str) -> None:
    """Only heartbeats, requests for streams and time leave on the wire."""
    r = PilotRig(Ground({PLACE: lambda height: 0.97}).seen, dialect)
    r.up_and_flying(30.0)
    r.vehicle.release()
    said: list[str] = []
    begin = r.t
    r.begin(DryRunVehicle(said.append))
    assert r.fly(S.APPROACH)
    r.run(20.0)
    assert not r.moving_since(begin)
    assert {m.get_type() for t, m in r.wire if t > begin} >= {"HEARTBEAT", "TIMESYNC"}
    assert said[0] == "mode: guided"
    assert any(line.startswith("fly to 47.6") and "above the sea" in line for line in said)
    assert any(line.startswith("speed") for line in said)


def test_spoken_orders_are_said_once_until_they_change() -> None:
    r = PilotRig(Ground({}).seen)
    r.up_and_flying(30.0)
    said: list[str] = []
    r.begin(DryRunVehicle(said.append))
    r.run(20.0)
    places = [line for line in said if line.startswith("fly to")]
    assert 1 <= len(places) < 10
    assert all(a != b for a, b in pairwise(said))
