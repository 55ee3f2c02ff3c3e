"""The last metres: straight down if the place is unknown, and contact with ground that is higher than estimated."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from length import BOTH, EITHER, in_turn
from made_up_ground import Ground, clearer_from_below
from pilot_rig import PLACE, PilotRig, flying, raised
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from alight.flight.autopilot.firmware import ArduPilotFirmware, Px4Firmware
from alight.flight.session.orders import Contact
from alight.geometry import Pose
from alight.records import FlightMode, Landed, Motion, MotionState, Telemetry
from alight.records.executive import FlightState, Order
from alight_sim.autopilot.dialects import Doing
from alight_sim.point_mass import FlightLimits, PointMass

S = FlightState
SECOND = 1_000_000_000


def high_rig(dialect: str, up: float, error: float = 0.0) -> PilotRig:
    """Return a rig over a hill whose top is estimated too low by `error`."""
    hill = PointMass(
        FlightLimits(lag=0.1),
        ground=lambda east, north: up if np.hypot(east - PLACE[0], north - PLACE[1]) < 6.0 else 0.0,
    )
    return flying(dialect, see=raised(Ground({PLACE: clearer_from_below}), up - error), vehicle=hill)


def go_astray(r: PilotRig, state: MotionState, frame_id: int, off: tuple[float, float, float]) -> None:
    """From now on, add an offset in metres to the motions."""
    moved = r.pilot.inputs.add_motion

    def astray(m: Motion) -> None:
        pose = Pose(np.eye(3), m.world_from_body.translation + off)
        moved(Motion(m.t_ns, pose, (), np.eye(6), state=state, frame_id=frame_id))

    r.pilot.inputs.add_motion = astray


# -- straight down


ASTRAY = [(0.0, "lost"), (15.0, "new frame"), (0.0, "new frame"), (15.0, "lost")]


@pytest.mark.parametrize(("dialect", "up", "what"), in_turn(2, ASTRAY))
def test_it_comes_straight_down_where_the_place_is_not_known_any_more(dialect: str, up: float, what: str) -> None:
    """Near the ground a landing is not broken off: a motion that is lost or of another frame must not steer it."""
    r = high_rig(dialect, up)
    assert r.fly(S.COMMIT)
    assert r.run(60.0, lambda: r.truth()[2] < up + 1.2)
    state = MotionState.LOST if what == "lost" else MotionState.GOOD
    go_astray(r, state, 0 if what == "lost" else 1, (4.0, -3.0, 0.3))
    r.run(0.3)
    at, t, sinks = r.truth(), r.t, [0.0]
    each = r.each_step
    r.each_step = lambda: (each(), sinks.append(-r.sim.vehicle.velocity[2]))  # type: ignore[func-returns-value]
    assert r.run(20.0, lambda: r.state is S.LANDED)
    assert np.hypot(*(r.truth() - at)[:2]) < 0.3
    assert not r.sent_since(t, "LANDING_TARGET")
    assert not r.sent_since(t, "SET_POSITION_TARGET_GLOBAL_INT")
    assert bool(r.sent_since(t, "SET_POSITION_TARGET_LOCAL_NED")) is (up > 0)
    assert max(sinks) < 0.7


@BOTH
def test_an_order_to_land_without_a_place_is_carried_out_from_any_mode(dialect: str) -> None:
    """After the order alone, in guided flight at 3 m, the vehicle lands, without commands that lead aside."""
    r = flying(dialect)
    assert r.fly(S.COMMIT)
    r.ticks = False
    assert r.run(5.0, lambda: r.doing is Doing.GUIDED)
    each, sender, t, at = r.each_step, r.pilot.orders, r.t, r.truth()

    def obey() -> None:
        each()
        r.orders.append(sender.obey(Order("land", None, 2.0, 0.5, True), S.COMMIT, r.pilot.inputs.motion, r.now_ns))

    r.each_step = obey
    assert r.run(30.0, lambda: r.vehicle.telemetry.is_down)
    assert r.doing is Doing.LAND or dialect == "px4"
    assert np.hypot(*(r.truth() - at)[:2]) < 1.5  # because it was moving
    assert not r.sent_since(t, "LANDING_TARGET")
    assert not r.sent_since(t + 0.2, "SET_POSITION_TARGET_GLOBAL_INT")


def test_a_motion_that_is_lost_is_not_obeyed(monkeypatch: pytest.MonkeyPatch) -> None:
    r, motions = flying(), list[Motion | None]()
    assert r.fly(S.APPROACH)
    sender = r.pilot.orders
    obey = sender.obey
    monkeypatch.setattr(sender, "obey", lambda o, s, m, t: (motions.append(m), obey(o, s, m, t))[1])
    r.run(1.0)
    assert None not in motions
    r.motion_state = MotionState.LOST
    r.run(0.5)
    motions.clear()
    r.run(1.0)
    assert set(motions) == {None}


# -- contact


@pytest.mark.parametrize(("dialect", "error"), in_turn(2, [[2.5], [-0.5], [0.0], [1.2]]))
def test_a_high_site_that_is_not_where_it_was_believed_is_felt(dialect: str, error: float) -> None:
    """PX4 does not report GROUND in Offboard by position: without contact detection its motors would keep running."""
    r = high_rig(dialect, 15.0, error)
    assert r.fly(S.COMMIT)
    assert r.run(40.0, lambda: r.doing is Doing.LAND)
    assert r.truth()[2] - 15.0 < 0.05
    assert r.fly(S.LANDED, 10.0)


def test_the_height_of_a_high_site_is_that_of_the_firmware() -> None:
    """PX4 slows down from 10 m to 5 m above home, and ArduPilot at 10 m."""
    assert (ArduPilotFirmware().high_site, Px4Firmware().high_site) == (8.0, 4.0)


@pytest.mark.parametrize(("dialect", "guided"), [("ardupilot", False), ("px4", True)])
def test_a_site_six_metres_up_is_high_for_px4_alone(dialect: str, guided: bool) -> None:
    r = high_rig(dialect, 6.0)
    assert r.fly(S.COMMIT)
    assert r.run(60.0, lambda: r.doing is Doing.LAND)
    assert bool(r.truth()[2] - 6.0 < 0.05) is guided
    assert r.fly(S.LANDED, 60.0)


def heard(velocity_up: float, mode: FlightMode = FlightMode.GUIDED, landed: Landed = Landed.AIR) -> Telemetry:
    return Telemetry("PX4", armed=True, mode=mode, landed=landed, velocity_world=np.array([0.0, 0.0, velocity_up]))


def felt_after(height: float | None, said: Telemetry) -> float:
    """Seconds until contact is detected; inf: not within ten."""
    contact = Contact()
    for tenth in range(100):
        if contact.is_felt(height, 0.5, said, tenth * SECOND // 10):
            return tenth * 0.1
    return np.inf


def test_contact_takes_a_while_of_not_sinking() -> None:
    assert felt_after(0.5, heard(0.0)) == pytest.approx(0.8)
    assert felt_after(2.9, heard(0.0)) == pytest.approx(2.0)
    assert felt_after(None, heard(0.0)) == pytest.approx(2.0)
    assert felt_after(5.0, replace(heard(0.0, landed=Landed.GROUND), grounded=0.6)) == 0.0
    assert felt_after(5.0, replace(heard(-0.5, landed=Landed.GROUND), grounded=0.2)) == np.inf
    for height, said in (
        (3.1, heard(0.0)), (0.5, heard(-0.4)), (0.5, heard(np.nan)), (0.5, heard(0.0, FlightMode.HOLD)),
    ):  # fmt: skip
        assert felt_after(height, said) == np.inf


def test_contact_begins_anew_when_it_sinks_again() -> None:
    contact, still, sinks = Contact(), heard(0.0), heard(-0.5)
    assert not contact.is_felt(2.0, 0.5, still, 0)
    assert not contact.is_felt(2.0, 0.5, sinks, 1 * SECOND)
    assert not contact.is_felt(2.0, 0.5, still, 2 * SECOND)
    assert not contact.is_felt(2.0, 0.5, still, 3 * SECOND)
    assert contact.is_felt(2.0, 0.5, still, 4 * SECOND)
    contact.forget()
    assert not contact.is_felt(2.0, 0.5, still, 5 * SECOND)


# -- the motors after a landing


def orders_to_stop(r: PilotRig, t: float) -> list[float]:
    """Times of the orders to disarm since `t`."""
    longs = r.sent_since(t, "COMMAND_LONG")
    assert all(m.param1 == 0.0 and m.param2 == 0.0 for m in longs if m.command == 400)  # never to arm, never by force
    return [then for then, m in r.wire if then > t and m.get_type() == "COMMAND_LONG" and m.command == 400]


@BOTH
def test_motors_that_turn_on_after_a_landing_are_ordered_to_stop(dialect: str) -> None:
    """PX4 with COM_DISARM_LAND below 0 never disarms by itself: the landing would never be over."""
    r = flying(dialect)
    r.sim.logic.disarms = False
    assert r.fly(S.COMMIT)
    t = r.t
    assert r.run(60.0, lambda: r.vehicle.telemetry.landed is Landed.GROUND)
    stood = r.t
    assert r.fly(S.LANDED, 10.0)
    orders = orders_to_stop(r, t)
    assert len(orders) == 1
    assert 4.5 < orders[0] - stood < 6.0
    assert not r.vehicle.telemetry.armed


@EITHER
def test_a_person_is_told_when_the_motors_do_not_stop(dialect: str, monkeypatch: pytest.MonkeyPatch) -> None:
    r = flying(dialect)
    r.sim.logic.disarms = False
    monkeypatch.setattr(r.sim.logic, "arm", lambda wanted: False)
    assert r.fly(S.COMMIT)
    t = r.t
    assert r.run(90.0, lambda: any("stop them by hand" in x for x in r.orders))
    r.run(8.0)
    assert r.state is S.COMMIT
    assert len({round(x) for x in orders_to_stop(r, t)}) == 3
    said = [x for x in r.orders if "stop them by hand" in x]
    assert len(said) == 1


@EITHER
def test_no_motor_is_stopped_where_the_autopilot_does_it_or_somebody_else_flies(dialect: str) -> None:
    r = flying(dialect)
    assert r.fly(S.COMMIT)
    t = r.t
    assert r.fly(S.LANDED, 60.0)
    assert not orders_to_stop(r, t)
    r = flying(dialect)
    r.sim.logic.disarms = False
    assert r.fly(S.COMMIT)
    t = r.t
    assert r.run(60.0, lambda: r.vehicle.telemetry.landed is Landed.GROUND)
    r.sim.logic.enter(Doing.PILOT, r.t)
    r.run(20.0)
    assert r.state is S.HANDED_OVER
    assert not orders_to_stop(r, t)


# -- reports of the ground


def report_ground(r: PilotRig, messages: float = np.inf) -> None:
    """Let the next `messages` of EXTENDED_SYS_STATE report the ground, wherever the vehicle is."""
    made, false = r.sim.reports.makers["EXTENDED_SYS_STATE"], [messages]

    def report(now: Any) -> Any:
        false[0] -= 1
        return made(now) if false[0] < 0 else mavlink.MAVLink_extended_sys_state_message(0, 1)

    r.sim.reports.makers["EXTENDED_SYS_STATE"] = report


def in_state(dialect: str, state: FlightState) -> PilotRig:
    """Return a rig a second after the begin of a landing, of its abort, or of a return."""
    r = flying(dialect)
    assert r.fly(S.APPROACH if state is S.RETURN else S.COMMIT)
    if state is S.ABORT:
        r.frame_id = 1
    elif state is S.RETURN:
        r.sim.vehicle.body.battery = 0.05
    assert r.fly(state, 20.0)
    r.run(1.0)
    return r


@BOTH
def test_no_climb_is_ordered_after_the_touchdown(dialect: str) -> None:
    """A real PX4 stood with its motors on, 3.4 m up by the estimate: the landing was aborted, and a climb ordered."""
    r = flying(dialect)
    r.sim.logic.disarms = False
    assert r.fly(S.COMMIT)
    assert r.run(60.0, lambda: r.sim.vehicle.body.stands)
    t = r.t
    r.run(1.0)
    go_astray(r, MotionState.GOOD, 0, (0.0, 0.0, 3.4))
    r.run(0.5)
    r.pictures = r.judges = False
    assert r.run(30.0, lambda: r.state is S.LANDED)
    assert S.ABORT not in [x.after for x in r.pilot.diary.transitions]
    assert not r.targets_since(t + 0.5)


@pytest.mark.parametrize(("dialect", "state"), in_turn(3, [[S.ABORT], [S.COMMIT], [S.RETURN]]))
def test_a_lasting_report_of_the_ground_ends_every_climb(dialect: str, state: FlightState) -> None:
    """The vehicle goes down where it is; set-points end when it is disarmed on the ground."""
    r = in_state(dialect, state)
    report_ground(r)
    r.run(2.0)
    t = r.t
    assert r.run(90.0, lambda: not r.sim.logic.armed)
    assert r.sim.vehicle.body.stands
    assert not r.targets_since(t)
    assert r.doing is Doing.LAND or dialect == "px4"
    off = r.t
    assert r.fly(S.LANDED, 5.0)
    r.run(5.0)
    assert not r.moving_since(off + 1.5)


@pytest.mark.parametrize(("dialect", "state"), in_turn(3, [[S.ABORT], [S.COMMIT], [S.RETURN]]))
def test_a_single_false_report_of_the_ground_changes_nothing(dialect: str, state: FlightState) -> None:
    flown = []
    for messages in (0, 1):
        r = in_state(dialect, state)
        report_ground(r, messages)
        r.run(5.0)
        flown.append((r.state, r.doing, *np.round(r.truth(), 6)))
    assert flown[0] == flown[1]


def test_set_points_end_when_the_vehicle_is_disarmed_on_the_ground() -> None:
    """Whoever arms it again must not see it fly to an old set-point."""
    r = flying("px4")
    assert r.fly(S.COMMIT)
    r.ticks = False
    r.sim.logic.armed, r.sim.vehicle.body.position[2] = False, 0.0
    r.run(3.0)
    t = r.t
    r.run(3.0)
    assert not r.moving_since(t)
