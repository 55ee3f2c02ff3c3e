"""Rare faults of a flight: a pilot's quiet takeover, impossible positions."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from autopilot_rig import HERE, LOCAL, Rig, accepted, report
from length import BOTH, EITHER, first
from pilot_rig import PilotRig, flying
from telemetry_messages import attitude, fed, gps

from alight.flight.autopilot import Setpoint, TelemetryEvents
from alight.flight.autopilot.control import ControlWatch
from alight.flight.autopilot.firmware import ArduPilotFirmware, Px4Firmware
from alight.flight.autopilot.vehicle_state import VehicleState
from alight.records import FlightMode, NoticeKind
from alight.records.executive import FlightState
from alight_sim.autopilot.dialects import Doing

S = 1_000_000_000


# -- a pilot's quiet takeover


def test_a_pilot_who_holds_during_our_landing_of_px4_takes_over() -> None:
    """PX4 changes to Hold by itself at the end of a landing, but only on the ground; in the air a pilot did it."""
    rig = Rig("px4")
    rig.up_and_flying(15.0)
    assert rig.answered(rig.vehicle.set_mode(FlightMode.LAND)).ok
    rig.run(4)
    rig.sim.pilot(Doing.HOLD)
    assert rig.run(2, lambda: bool(rig.of(NoticeKind.TAKEOVER)))
    assert not rig.vehicle.in_control


def test_px4_that_holds_after_its_landing_is_no_takeover() -> None:
    rig = Rig("px4")
    rig.up_and_flying(5.0)
    rig.vehicle.set_mode(FlightMode.LAND)
    assert rig.run(60, lambda: rig.telemetry.is_down)
    rig.sim.pilot(Doing.HOLD)
    rig.run(3)
    assert rig.telemetry.mode is FlightMode.HOLD
    assert not rig.of(NoticeKind.TAKEOVER)


@pytest.mark.parametrize("order", [FlightMode.LAND, FlightMode.RETURN])
def test_px4_that_leaves_the_mode_of_its_landing_as_it_stops_the_motors_is_no_takeover(order: FlightMode) -> None:
    """Since 1.14 PX4 goes back to the last mode in which it can be armed: the disarmed heartbeat has OFFBOARD."""
    rig = Rig("px4")
    rig.up_and_flying(5.0)
    rig.vehicle.set_mode(order)
    assert rig.run(60, lambda: rig.telemetry.is_down)
    assert rig.run(2, lambda: rig.telemetry.mode_name == "OFFBOARD")
    rig.run(2)
    assert not rig.of(NoticeKind.TAKEOVER)


def test_a_change_of_mode_at_the_end_of_a_landing_is_natural_on_the_ground_only() -> None:
    control = ControlWatch(Px4Firmware())
    for armed, natural in ((True, False), (False, True)):
        control.ordered(FlightMode.LAND, 10 * S)
        assert not control.mode(FlightMode.LAND, "AUTO.LAND", 11 * S)
        why = control.mode(FlightMode.PILOT, "POSCTL", 20 * S, on_ground=True, armed=armed)
        assert (why == "") is natural
    assert not control.mode(FlightMode.HOLD, "AUTO.LOITER", 21 * S, on_ground=True, armed=False)
    control.ordered(FlightMode.GUIDED, 30 * S)  # for the next flight: from here on a switch is a pilot's
    assert control.mode(FlightMode.PILOT, "POSCTL", 40 * S, on_ground=True, armed=False)


@pytest.mark.parametrize("early", [0.0, 0.3, 0.6])
@pytest.mark.parametrize("seen", [True, False])
def test_a_pilot_may_choose_the_mode_that_we_asked_for_before_the_last(seen: bool, early: float) -> None:
    """After our BRAKE and GUIDED, a BRAKE 1.5 s later is the pilot's, whether heartbeats showed our BRAKE or not."""
    rig = Rig()
    rig.up_and_flying(15.0)
    rig.run(3 + early)
    rig.vehicle.set_mode(FlightMode.HOLD)
    assert rig.run(3, lambda: rig.sim.logic.doing is Doing.HOLD)
    if seen:
        assert rig.run(3, lambda: rig.telemetry.mode is FlightMode.HOLD)
    rig.vehicle.set_mode(FlightMode.GUIDED)
    rig.run(1.5)
    assert rig.sim.logic.doing is Doing.GUIDED
    assert not rig.of(NoticeKind.TAKEOVER)
    rig.sim.pilot(Doing.HOLD)
    assert rig.run(2, lambda: bool(rig.of(NoticeKind.TAKEOVER)))


def watch() -> ControlWatch:
    """Return a watch that is in control of a Copter in GUIDED."""
    found = ControlWatch(ArduPilotFirmware())
    found.ordered(FlightMode.GUIDED, 0)
    assert not found.mode(FlightMode.GUIDED, "GUIDED", 1 * S)
    return found


def test_a_heartbeat_that_was_under_way_settles_nothing() -> None:
    """A heartbeat that left before BRAKE took effect uses up no order: our BRAKE and GUIDED may still follow it."""
    control = watch()
    control.ordered(FlightMode.HOLD, 10 * S)
    control.ordered(FlightMode.GUIDED, 10 * S + 300_000_000)
    assert not control.mode(FlightMode.GUIDED, "GUIDED", 10 * S + 400_000_000)
    assert not control.mode(FlightMode.HOLD, "BRAKE", 11 * S)
    assert not control.mode(FlightMode.GUIDED, "GUIDED", 12 * S)
    assert control.mode(FlightMode.HOLD, "BRAKE", 13 * S)


def test_an_order_that_waits_for_its_answer_may_take_effect_again() -> None:
    """An order whose answer was lost is sent again, and each try may bring its mode again."""
    control = watch()
    control.ordered(FlightMode.HOLD, 10 * S)
    assert not control.mode(FlightMode.HOLD, "BRAKE", 11 * S)
    assert not control.mode(FlightMode.GUIDED, "GUIDED", 12 * S, unanswered={FlightMode.GUIDED})
    assert control.mode(FlightMode.HOLD, "BRAKE", 13 * S)


def test_an_order_that_is_accepted_late_is_ours() -> None:
    """A mode that is accepted after a second of set-points and five lost tries is still ours."""
    control = ControlWatch(Px4Firmware())
    control.mode(FlightMode.HOLD, "AUTO.LOITER", 0)
    control.ordered(FlightMode.GUIDED, 0)
    for t in range(1, 6):
        assert not control.mode(FlightMode.HOLD, "AUTO.LOITER", t * S, unanswered={FlightMode.GUIDED})
    control.accepted(FlightMode.GUIDED, 6 * S)
    assert not control.mode(FlightMode.GUIDED, "OFFBOARD", 6 * S + 300_000_000)
    assert control.mode(FlightMode.HOLD, "AUTO.LOITER", 8 * S)
    control.ordered(FlightMode.HOLD, 10 * S)
    assert not control.mode(FlightMode.HOLD, "AUTO.LOITER", 11 * S)
    control.accepted(FlightMode.HOLD, 12 * S)  # it was seen already: that opens no new window
    assert control.mode(FlightMode.GUIDED, "OFFBOARD", 13 * S)


def test_a_mode_whose_first_tries_are_lost_makes_no_takeover() -> None:
    rig = Rig("px4")
    rig.up_and_flying(15.0)
    rig.answered(rig.vehicle.set_mode(FlightMode.HOLD))
    rig.run(8)
    until = rig.t + 5.9
    rig.lose("COMMAND_LONG", lambda m: m.command == 176 and rig.t <= until)
    rig.vehicle.set_mode(FlightMode.GUIDED)
    rig.each_step = lambda: rig.vehicle.guide(Setpoint(velocity_world=np.zeros(3)))  # type: ignore[assignment]
    assert rig.run(10, lambda: rig.telemetry.mode is FlightMode.GUIDED)
    rig.run(2)
    assert not rig.of(NoticeKind.TAKEOVER)


def test_a_lost_answer_makes_no_takeover_of_the_next_try() -> None:
    rig = Rig("px4")
    rig.up_and_flying(15.0)
    rig.down.loss = 0.5
    for mode in (FlightMode.HOLD, FlightMode.GUIDED, FlightMode.HOLD, FlightMode.GUIDED):
        rig.vehicle.set_mode(mode)
        rig.run(3)
    assert not rig.of(NoticeKind.TAKEOVER)


# -- impossible positions

MAX = 2**31 - 1
WILD = {
    "null": (0, 0, 530_000, 30_000),
    "no value": (MAX, MAX, 530_000, 30_000),
    "off the Earth": (910_000_000, 134_000_000, 530_000, 30_000),
    "no height": (476_000_000, 134_000_000, MAX, 30_000),
    "no height above home": (476_000_000, 134_000_000, 530_000, -MAX),
    "another country": (486_000_000, 134_000_000, 530_000, 30_000),
    "a street away": (476_012_000, 134_000_000, 530_000, 30_000),
}


@pytest.mark.parametrize("wild", WILD.values(), ids=WILD)
def test_one_report_that_cannot_be_changes_no_place(wild: tuple[int, int, int, int]) -> None:
    state = VehicleState(ArduPilotFirmware())
    assert accepted(state, report(1000, HERE), report(1100, wild), report(1200, HERE)) == [True, False, True]
    found = state.positions.at(1_150_000_000)
    assert found is not None
    assert (found.latitude, found.altitude_msl) == (pytest.approx(47.6), pytest.approx(530.0))


@pytest.mark.parametrize("wild", list(WILD.values())[:5], ids=list(WILD)[:5])
def test_a_first_report_off_the_earth_is_no_place(wild: tuple[int, int, int, int]) -> None:
    state = VehicleState(ArduPilotFirmware())
    assert accepted(state, *(report(1000 + 100 * k, wild) for k in range(30))) == [False] * 30
    assert state.newest.place is None
    (row,) = fed(TelemetryEvents(), gps(), report(1000, wild), attitude(1000, 0.0))
    assert row.position_world is None  # type: ignore[union-attr]


def test_a_velocity_that_cannot_be_is_not_carried_on() -> None:
    state = VehicleState(ArduPilotFirmware())
    assert accepted(state, report(1000, HERE), report(1100, HERE, (32767, 0, 0))) == [True, False]


def test_a_place_that_jumps_is_unknown_until_reports_agree() -> None:
    """A position that jumps is unknown until the new reports agree: a restarted estimator must not lock us out."""
    state, away = VehicleState(ArduPilotFirmware()), WILD["a street away"]
    accepted(state, report(1000, HERE))
    assert not any(accepted(state, *(report(1100 + 100 * k, away) for k in range(10))))
    assert state.newest.place is None
    assert np.isnan(state.telemetry(0).velocity_world).all()
    assert all(state.positions.at(ms * 1_000_000) is None for ms in (1000, 1500, 2000))
    assert accepted(state, report(2100, away)) == [True]
    assert state.newest.place is not None
    assert state.newest.place.latitude == pytest.approx(47.6012)
    assert state.positions.at(1_000_000_000) is None  # the old place is of another estimate


def test_reports_that_agree_with_nothing_are_never_a_place() -> None:
    state = VehicleState(ArduPilotFirmware())
    accepted(state, report(1000, HERE))
    wild = [report(1100 + 100 * k, (476_000_000 + 100_000 * (k % 7 + 1), *HERE[1:])) for k in range(50)]
    assert not any(accepted(state, *wild))
    assert state.newest.place is None


def test_a_vehicle_that_was_not_heard_for_a_while_may_have_flown_on() -> None:
    state = VehicleState(ArduPilotFirmware())
    there = (476_027_000, *HERE[1:])  # 300 m
    assert accepted(state, report(1000, HERE, (1500, 0, 0)), report(21_000, there, (1500, 0, 0))) == [True, True]


def farthest(r: PilotRig) -> float:
    """Metres from the home to the farthest set-point that was sent."""
    found = [0.0]
    for _, m in r.wire:
        if m.get_type() == "SET_POSITION_TARGET_GLOBAL_INT":
            found.append(float(np.linalg.norm(r.sim.home.metres(m.lat_int * 1e-7, m.lon_int * 1e-7, m.alt))))
    return max(found)


def lie(r: Rig, numbers: tuple[int, int, int, int]) -> Callable[[], None]:
    """Make the autopilot report this place, until the returned function is called."""
    makers, name = r.sim.reports.makers, "GLOBAL_POSITION_INT"
    true = makers[name]
    makers[name] = lambda now: report(now.boot_ms, numbers)
    return lambda: makers.__setitem__(name, true)


@EITHER
@pytest.mark.parametrize("wild", first(1, reversed(WILD.values())), ids=reversed(WILD))
def test_no_setpoint_is_made_of_a_place_that_cannot_be(dialect: str, wild: tuple[int, int, int, int]) -> None:
    r = flying(dialect)
    assert r.fly(FlightState.APPROACH)
    for _ in range(5):
        r.run(1.0)
        truth = lie(r, wild)
        r.run(0.15)
        truth()
    assert farthest(r) < 100.0
    assert not r.of(NoticeKind.TAKEOVER)
    assert r.fly(FlightState.LANDED)


@BOTH
def test_an_estimate_that_jumps_and_stays_is_taken_after_a_second(dialect: str) -> None:
    rig = Rig(dialect, step=0.05)
    rig.up_and_flying(15.0)
    rig.run(2)
    rig.sim.estimate.error = np.array([200.0, 0.0, 0.0])
    assert rig.run(0.5, lambda: rig.telemetry.place is None)
    assert rig.vehicle.tie(LOCAL, np.zeros(3), rig.now_ns) is None
    assert rig.run(1.5, lambda: rig.telemetry.place is not None)
    rig.run(0.5)
    assert rig.vehicle.tie(LOCAL, np.zeros(3), rig.now_ns) is not None


def test_px4_gets_no_farther_setpoint_while_its_place_is_unknown() -> None:
    """PX4 flies to a far set-point at full speed: while its place is unknown, it gets none that is farther."""
    rig = Rig("px4")
    rig.up_and_flying(15.0)
    tie = rig.vehicle.tie(LOCAL, rig.truth(), rig.now_ns)
    rig.vehicle.guide(Setpoint(np.array([90.0, 0.0, 15.0]), heading=0.0, speed=2.0), tie)
    rig.run(3)
    lie(rig, WILD["another country"])
    fastest = 0.0
    for _ in range(10):
        rig.run(0.1)
        fastest = max(fastest, math.hypot(*rig.sim.vehicle.velocity[:2]))
    assert fastest < 2.2
    assert rig.sim.logic.doing is Doing.GUIDED  # set-points go on
