"""Control of the vehicle: unplanned ends of a flight, takeovers, refused orders, near targets."""

from __future__ import annotations

import threading
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from length import BOTH, EITHER, first, in_turn
from made_up_ground import Ground, clearer_from_below
from pilot_rig import PLACE, PilotRig, flying, raised
from session_rig import session_of
from some_run import site

from alight.cli import call
from alight.cli.flown import facts
from alight.flight.autopilot.firmware import ArduPilotFirmware
from alight.flight.session.flight import TAKEN, UNCONFIRMED
from alight.flight.session.pilot import PilotView
from alight.flight.session.request import FlightStatus
from alight.geometry import Pose
from alight.records import FlightMode, Motion, MotionState
from alight.records.executive import FlightEvent, FlightState, Order
from alight_sim.autopilot.dialects import Doing
from alight_sim.point_mass import PointMass, Wanted

S, E = FlightState, FlightEvent
SET_MODE = 176


def test_the_page_never_calls_a_place_certain() -> None:
    situation = SimpleNamespace(state=MotionState.GOOD, picture_age=0.1)
    place = replace(site(), east=1.0, north=2.0, up=0.0, p_safe=0.99999, doubt=None)
    view = PilotView(1.0, S.LOOK, "stay", situation, place)  # type: ignore[arg-type]
    shown = dict(facts(FlightStatus("landing", view=view)))
    assert shown["place"] == "site at east 1.0 m north 2.0 m, P(safe) > 0.999"


def speed_of(r: PilotRig) -> float:
    return float(np.linalg.norm(r.sim.vehicle.velocity))


def modes_asked(r: PilotRig, since: float) -> int:
    return sum(t > since and m.get_type() == "COMMAND_LONG" and m.command == SET_MODE for t, m in r.wire)


# -- unplanned ends


@pytest.mark.parametrize(("dialect", "error"), in_turn(2, [[KeyboardInterrupt], [RuntimeError]]))
def test_a_landing_that_ends_early_leaves_the_vehicle_holding(
    dialect: str, error: type[BaseException], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The order to hold waits for a heartbeat: it is repeated until it is sent and the mode is flown."""
    r, lines, ends = flying(dialect), list[str](), list[np.ndarray]()

    def on_status(status: FlightStatus) -> None:
        if speed_of(r) > 3.0 and not ends:
            ends.append(r.truth())
            raise error

    session = session_of(r, monkeypatch, lines, on_status)
    if error is KeyboardInterrupt:
        outcome = session.fly(threading.Event())
        assert outcome.why == "ended by the user; the vehicle holds its place"
        assert session.run.live.warnings == ["fly: ended by Ctrl-C; the vehicle holds its place"]
    else:
        with pytest.raises(error):
            session.fly(threading.Event())
        assert lines[-1] == "fly: the vehicle holds its place"
    assert not r.vehicle.in_control
    r.run(5.0)
    assert r.doing is Doing.HOLD
    assert speed_of(r) < 0.1
    assert np.linalg.norm(r.truth() - ends[0]) < 15.0


def test_a_hold_that_is_refused_is_asked_for_again_and_is_not_claimed(monkeypatch: pytest.MonkeyPatch) -> None:
    r = flying()
    assert r.fly(S.APPROACH)
    session, t = session_of(r, monkeypatch, []), r.t
    r.sim.logic.enter = lambda doing, t: False  # type: ignore[method-assign]
    assert session.hold() == UNCONFIRMED
    assert modes_asked(r, t) >= 2
    assert not r.vehicle.in_control


def test_a_pilot_who_takes_over_meanwhile_is_not_told_to_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    r = flying()
    assert r.fly(S.APPROACH)
    session, t = session_of(r, monkeypatch, []), r.t
    r.sim.pilot(Doing.PILOT)
    assert session.hold() == TAKEN
    assert modes_asked(r, t) == 0
    assert r.doing is Doing.PILOT


# -- takeovers


@BOTH
def test_a_pilot_who_takes_over_after_the_take_off_keeps_the_vehicle(dialect: str) -> None:
    r = PilotRig(Ground({PLACE: clearer_from_below}).seen, dialect)
    r.up_and_flying(30.0)
    r.sim.pilot(Doing.PILOT)
    assert r.run(2.0, lambda: not r.vehicle.in_control)
    t = r.t
    r.begin(flying=True)
    r.run(5.0)
    assert r.state is S.HANDED_OVER
    assert r.events == [E.PILOT]
    assert not r.moving_since(t)
    assert r.doing is Doing.PILOT


def test_the_wait_for_the_motion_ends_when_a_pilot_takes_over(monkeypatch: pytest.MonkeyPatch) -> None:
    """The take-off is done, the motion is unknown, and the pilot switches: no landing begins."""
    r, phases = PilotRig(Ground({}).seen), list[str]()
    r.ready()
    r.begin()

    def on_status(status: FlightStatus) -> None:
        phases.append(status.phase)
        if status.phase == "checks" and phases.count("checks") == 15:
            r.sim.pilot(Doing.PILOT)

    session = session_of(r, monkeypatch, [], on_status, take_off=12.0)
    begun = r.t
    outcome = session.fly(threading.Event())
    assert outcome.why == TAKEN
    assert [c.name for c in outcome.checks] == ["link", "motion", "throttle"]
    assert "take-off" in phases
    assert r.t - begun < 45.0
    t = r.t
    r.run(5.0)
    assert not r.moving_since(t)
    assert r.doing is Doing.PILOT


@EITHER
def test_a_mode_that_is_not_the_one_ordered_is_a_takeover(dialect: str) -> None:
    """A pilot switches to Hold just after we have ordered and left it, so that it looks like our own order."""
    r = flying(dialect)
    assert r.fly(S.APPROACH)
    r.freeze = True
    assert r.run(6.0, lambda: r.doing is Doing.HOLD)
    r.freeze = False
    assert r.run(6.0, lambda: r.doing is Doing.GUIDED)
    r.run(1.2)
    r.sim.pilot(Doing.HOLD)
    assert r.run(8.0, lambda: r.state is S.HANDED_OVER)
    t = r.t
    r.run(5.0)
    assert not r.moving_since(t + 2 * r.dt)
    assert r.doing is Doing.HOLD


def test_every_order_of_a_mode_waits_for_a_heartbeat_of_its_own() -> None:
    """After LAND and GUIDED, a second LAND must not use the heartbeat of the first one."""
    r = flying()
    assert r.fly(S.APPROACH)
    r.run(3.0)
    r.ticks = False
    sender = r.pilot.orders
    beat = lambda: r.vehicle.telemetry.ages["HEARTBEAT"] < 0.01  # noqa: E731
    assert r.run(2.0, beat)
    r.run(0.1)
    assert not sender.order_mode(FlightMode.LAND, r.now_ns)
    assert sender.order_mode(FlightMode.GUIDED, r.now_ns)
    assert r.run(2.0, beat)
    r.run(0.3)
    assert not sender.order_mode(FlightMode.LAND, r.now_ns)
    assert r.run(2.0, beat)
    assert sender.order_mode(FlightMode.LAND, r.now_ns)


# -- a refused landing


@EITHER
def test_a_landing_that_is_refused_is_asked_for_again(dialect: str) -> None:
    r, refused = flying(dialect), list[float]()
    enter = r.sim.logic.enter

    def stubborn(doing: Doing, t: float) -> bool:
        if doing is Doing.LAND and len(refused) < 3:
            refused.append(t)
            return False
        return enter(doing, t)

    r.sim.logic.enter = stubborn  # type: ignore[method-assign]
    assert r.fly(S.LANDED)
    assert len(refused) == 3
    assert min(np.diff(refused)) > 1.5
    assert any("land was refused 3 times" in line for line in r.orders)


def test_a_landing_that_is_not_answered_is_asked_for_again() -> None:
    r = flying()
    assert r.fly(S.COMMIT)
    until = r.t + 12.0
    r.lose("COMMAND_LONG", lambda m: m.command == SET_MODE and r.t <= until)
    assert r.fly(S.LANDED, 60.0)


# -- high sites


@BOTH
def test_a_site_high_above_home_is_met_slowly(dialect: str) -> None:
    """LAND descends at 1.5 m/s at more than 10 m above the autopilot's home."""
    up = 15.0
    hill = PointMass(ground=lambda east, north: up if np.hypot(east - PLACE[0], north - PLACE[1]) < 4.0 else 0.0)
    r = flying(dialect, see=raised(Ground({PLACE: clearer_from_below}), up), vehicle=hill)
    step = r.sim.logic.step

    def by_height_above_home(t: float, here: np.ndarray, stands: bool) -> Wanted | None:
        wanted = step(t, here, stands)
        lands = r.doing in (Doing.LAND, Doing.RETURN) and wanted is not None
        if lands and wanted.velocity is not None and wanted.velocity[2] < 0.0 and here[2] > 10.0:
            wanted.velocity[2] = -1.5
        return wanted

    r.sim.logic.step = by_height_above_home  # type: ignore[method-assign]
    assert r.fly(S.COMMIT)
    each, sinks = r.each_step, [0.0]
    r.each_step = lambda: (each(), sinks.append(-hill.velocity[2]))  # type: ignore[func-returns-value]
    assert r.run(60.0, lambda: r.doing is Doing.LAND)
    assert hill.position[2] - up < 0.05  # guided to the ground: within 1 m LAND is fast again
    assert r.fly(S.LANDED)
    assert 0.3 < max(sinks) < 0.6
    assert np.hypot(*(r.truth()[:2] - PLACE)) < 0.4


# -- near targets


def test_ardupilot_stops_soon_after_a_takeover_by_the_sticks() -> None:
    """The autopilot's mode stays GUIDED, in which it flies on to its last target."""
    r = flying("ardupilot", "executive.search_side=300", see=Ground({}).seen)
    orders = r.executive_orders()

    def left() -> float:
        to = orders[-1].position if orders else None
        return 0.0 if to is None else float(np.linalg.norm(to - r.truth()))

    assert r.run(120.0, lambda: left() > 60.0 and speed_of(r) > 6.8)  # near targets do not slow it down
    r.run(2.0)
    assert speed_of(r) > 6.8
    r.sim.reports.sticks = [1500, 1900, 1100, 1500]
    assert r.run(2.0, lambda: r.state is S.HANDED_OVER)
    at = r.truth()
    r.run(15.0)
    assert r.doing is Doing.GUIDED
    assert speed_of(r) < 0.1
    assert np.linalg.norm(r.truth() - at) < 26.0


@pytest.mark.parametrize("speed", [0.2, 0.5, 2.0, 5.0, 7.0, 12.0])
def test_a_near_target_is_beyond_where_the_vehicle_brakes(speed: float) -> None:
    """The distance follows ArduPilot's law of speed, with half of its usual accelerations, half a second later."""

    def law(distance: float, braking: float) -> float:
        return distance if distance < braking / 2 else (braking * (distance - braking / 4)) ** 0.5

    over, down = (ArduPilotFirmware().reach(speed, upright) for upright in (False, True))
    assert law(over - 0.49 * speed, 2.5) >= speed
    assert law(down - 0.49 * speed, 1.0) >= speed
    assert over < 0.7 + 0.5 * speed + 0.4 * speed**2  # 24 m at 7 m/s


# -- impossible positions


@EITHER
@pytest.mark.parametrize("jump", first(1, [[1000.0, 0.0, 0.0], [0.0, 0.0, 400.0], [-30.0, 20.0, 0.0]]))
def test_a_jump_of_the_autopilots_position_makes_no_far_target(dialect: str, jump: list[float]) -> None:
    r = flying(dialect)
    assert r.fly(S.APPROACH)
    assert r.run(10.0, lambda: speed_of(r) > 3.0)
    before, t = r.sim.estimated, r.t
    r.sim.estimate.error = r.sim.estimate.error + jump
    after = r.sim.estimated
    r.run(3.0)
    sent = r.targets_since(t + r.dt)
    assert max(min(np.linalg.norm(at - before), np.linalg.norm(at - after)) for at in sent) < 30.0
    assert r.fly(S.LANDED)


@pytest.mark.parametrize(
    "to",
    first(2, [[500.0, 0.0, 30.0], [np.nan, 0.0, 30.0], [0.0, 0.0, 150.0], [np.inf, 0.0, 30.0], [0.0, 0.0, np.nan]]),
)
@pytest.mark.parametrize("what", ["fly", "land"])
def test_a_far_target_is_not_flown_to(to: list[float], what: str) -> None:
    r = flying()
    assert r.fly(S.APPROACH)
    r.ticks = False
    r.run(2.0)
    t, sender = r.t, r.pilot.orders
    each = r.each_step

    def obey() -> None:
        each()
        sender.obey(Order(what, np.array(to)), S.APPROACH, r.pilot.inputs.motion, r.now_ns)

    r.each_step = obey
    r.run(4.0)
    assert r.doing is Doing.HOLD
    at = r.sim.estimated
    assert all(np.linalg.norm(target - at) < 40.0 for target in r.targets_since(t))
    assert "LANDING_TARGET" not in {m.get_type() for then, m in r.wire if then > t}


def test_a_motion_that_is_no_number_moves_nothing() -> None:
    r = flying()
    assert r.fly(S.APPROACH)
    moved = r.pilot.inputs.add_motion
    lost = Pose(np.eye(3), np.full(3, np.nan))
    r.pilot.inputs.add_motion = lambda m: moved(Motion(m.t_ns, lost, (), np.eye(6)))
    r.run(0.5)
    t = r.t
    r.run(6.0)
    assert r.state is S.HOLD
    assert r.doing is Doing.HOLD
    assert not r.targets_since(t)


@pytest.mark.parametrize(
    ("state", "why", "dry", "code", "word"),
    [
        (S.LANDED, "as the autopilot reports", False, 0, "LANDED  as the autopilot reports"),
        (S.RETURN, "all was searched", False, 4, "RETURNED  all was searched"),
        (S.HANDED_OVER, "by the switch", False, 4, "HANDED OVER  by the switch"),
        (S.LOOK, "ended by the user", False, 4, "ENDED  ended by the user"),
        (S.RETURN, "the time is over", True, 0, "DRY RUN  nothing was flown; the time is over"),
        (None, "checks", False, 3, "NOT FLOWN  checks"),
    ],
)
def test_a_script_learns_how_a_flight_ended(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], state: S | None, why: str, dry: bool,
    code: int, word: str,
) -> None:  # fmt: skip
    from alight.cli import flown as command
    from alight.flight.session import flight as fly

    left: list[object] = []
    result: Any = None if state is None else SimpleNamespace()
    monkeypatch.setattr(fly, "fly_vehicle", lambda *_: fly.FlightOutcome((), why, state, result))
    monkeypatch.setattr(command, "save_result", lambda *given: left.append(given[0]))
    options = ["--link", "udp:127.0.0.1:9", "--camera", "x", "--out", "x", *(["--dry-run"] if dry else [])]
    assert call(["fly", *options]) == code
    assert capsys.readouterr().out.splitlines() == [word]
    assert left == ([] if result is None else [result])  # results are kept however it ended
