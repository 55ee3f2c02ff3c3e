"""GPS fails in flight: the autopilot flies by our odometry, and the landing goes on to a place that was judged."""

from __future__ import annotations

from contextlib import nullcontext
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from autopilot_rig import LOCAL, Rig
from length import EITHER, in_turn
from made_up_ground import Ground, clearer_from_below
from pilot_rig import PLACE, PilotRig, flying
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from session_rig import Clock

from alight.checks.result import Judged
from alight.flight.live.sight import SightNavigation
from alight.flight.session import flight
from alight.flight.session.dry_run import DryRunVehicle
from alight.flight.session.pilot import SessionLog
from alight.flight.session.preflight import judge_odometry, judge_parameters
from alight.geometry import Pose
from alight.records import GpsState, Motion, MotionState, Odometry
from alight.records.executive import FlightEvent, FlightState
from alight.settings import Settings
from alight_sim.autopilot.dialects import Doing

S, E = FlightState, FlightEvent
STATES = (S.SEARCH, S.APPROACH, S.LOOK, S.DESCEND, S.COMMIT)


def sources(r: PilotRig) -> list[float]:
    """Sets of sources that were ordered, in order, without repetitions of a command."""
    commands = [m for _, m in r.wire if m.get_type() == "COMMAND_LONG"]
    number = mavlink.MAV_CMD_SET_EKF_SOURCE_SET
    return [m.param1 for m in commands if m.command == number and m.confirmation == 0]


def lose_gps(r: PilotRig) -> None:
    """Take the receiver's fix away; the filter notices."""
    r.sim.estimate.receives = False
    r.gps, r.motion_state = GpsState.LOST, MotionState.DEGRADED


def off_place(r: PilotRig) -> float:
    """Distance of the vehicle from the place that was judged, metres."""
    return float(np.hypot(*(r.truth()[:2] - PLACE)))


@pytest.mark.parametrize(("dialect", "when"), in_turn(3, [[s] for s in STATES]))
def test_gps_lost_at_any_moment_ends_on_the_judged_place(dialect: str, when: FlightState) -> None:
    r = flying(dialect, odometry=True)
    assert r.fly(when)
    r.run(1.0)
    assert r.state is not S.LANDED
    lose_gps(r)
    count = len(r.events)
    assert r.fly(S.LANDED, 200.0)
    assert not {E.NAVIGATION_LOST, E.WAITED, E.FAILSAFE} & set(r.events[count:])
    assert off_place(r) < 1.0
    assert r.sim.vehicle.touchdown_speed < 0.9
    assert sources(r) == ([2.0] if dialect == "ardupilot" else [])
    assert "autopilot: it flies by sight: the receiver of GPS has no fix" in r.orders
    assert not r.sim.estimator.rejected


@EITHER
def test_gps_lost_in_the_last_metres_never_climbs(dialect: str) -> None:
    r = flying(dialect, odometry=True)
    assert r.fly(S.COMMIT)
    assert r.run(30.0, lambda: r.truth()[2] < 5.0)
    lose_gps(r)
    heights = [r.truth()[2]]
    each = r.each_step
    r.each_step = lambda: (each(), heights.append(r.truth()[2]))  # type: ignore[func-returns-value]
    assert r.fly(S.LANDED, 40.0)
    assert max(heights) < heights[0] + 0.1
    assert off_place(r) < 1.0


@EITHER
def test_sight_that_fails_above_the_place_does_not_end_the_landing(dialect: str) -> None:
    """As over bare sand two metres up, without GPS: a climb would end in the autopilot's failsafe."""
    r = flying(dialect, odometry=True)
    assert r.fly(S.COMMIT)
    lose_gps(r)
    assert r.run(30.0, lambda: r.truth()[2] < 2.5)
    assert r.state is S.COMMIT
    r.quality = 0.0
    assert r.fly(S.LANDED, 40.0)
    assert E.NAVIGATION_LOST not in r.events
    assert off_place(r) < 1.0


@EITHER
def test_where_sight_fails_too_it_ends_as_without_odometry(dialect: str) -> None:
    r = flying(dialect, odometry=True)
    assert r.fly(S.APPROACH)
    lose_gps(r)
    r.run(2.0)
    r.quality = 0.0
    assert r.run(5.0, lambda: r.state is S.HOLD)
    assert r.run(20.0, lambda: r.doing is Doing.LAND)


def test_a_target_is_not_reported_where_the_pictures_show_no_motion() -> None:
    """In the last half metre a pose that diverged would lead the vehicle away: it comes straight down."""
    r = flying("ardupilot", odometry=True)
    assert r.fly(S.COMMIT)
    lose_gps(r)
    assert r.run(30.0, lambda: r.truth()[2] < 1.0)
    r.quality = 0.0
    r.run(0.3)
    before = len(r.wire)
    assert r.run(20.0, lambda: r.state is S.LANDED)
    assert not [m for _, m in r.wire[before:] if m.get_type() == "LANDING_TARGET"]
    assert off_place(r) < 1.0


@EITHER
def test_pictures_that_show_no_motion_are_sent_as_failed_or_not_at_all(dialect: str) -> None:
    """ArduPilot does not arm without odometry, and on the ground the pictures show nothing. A real PX4 fused failed
    poses after its touchdown, saw no landing, and dragged itself 40 m over the ground."""
    r = flying(dialect, odometry=True)
    r.quality = 0.0
    r.run(1.0)
    before = len(r.wire)
    r.run(2.0)
    sent = [m.quality for _, m in r.wire[before:] if m.get_type() == "ODOMETRY"]
    assert (len(sent) > 5) is (dialect == "ardupilot")
    assert set(sent) == ({-1} if dialect == "ardupilot" else set())


def test_a_source_that_is_refused_is_not_used() -> None:
    r = flying(odometry=True)
    r.sim.estimator.select = lambda number: False  # type: ignore[method-assign]
    assert r.fly(S.APPROACH)
    lose_gps(r)
    r.run(2.0)
    assert not r.telemetry.by_sight
    assert any("it does not fly by sight any more: source set 2: denied" in line for line in r.orders)
    assert r.run(10.0, lambda: r.state is S.HOLD)


def commanded(r: PilotRig) -> list[tuple[float, np.ndarray]]:
    """Record from now on where, in truth, each set-point leads: (s, (3,) metres)."""
    out: list[tuple[float, np.ndarray]] = []
    receive = r.sim.receive
    reader = mavlink.MAVLink(None)

    def listen(data: bytes) -> None:
        for m in reader.parse_buffer(data) or ():
            if m.get_type() == "SET_POSITION_TARGET_GLOBAL_INT":
                at = r.sim.home.metres(m.lat_int * 1e-7, m.lon_int * 1e-7, m.alt)
                out.append((r.t, at - r.sim.estimator.error))
        receive(data)

    r.sim.receive = listen  # type: ignore[method-assign]
    return out


@pytest.mark.parametrize(("dialect", "away"), in_turn(2, [[5.0], [20.0]]))
def test_gps_that_is_back_moves_no_target(dialect: str, away: float) -> None:
    """The autopilot's estimate jumps by metres as it takes GPS again; a place in our map stays where it is."""
    r = flying(dialect, odometry=True, height=30.0)
    assert r.fly(S.SEARCH)
    r.judges = False
    lose_gps(r)
    r.run(1.0)
    r.sim.estimate.error = r.sim.estimate.error + np.array([1.5, -1.0, 0.0])
    targets = commanded(r)
    r.run(away)
    r.sim.estimate.receives = True
    r.gps = GpsState.RETURNING
    r.run(2.0)
    r.gps, r.motion_state = GpsState.USED, MotionState.GOOD
    assert r.run(10.0, lambda: not r.telemetry.by_sight)
    switched = r.t
    r.run(3.0)
    assert sources(r) == ([2.0, 1.0] if dialect == "ardupilot" else [])
    near = [target for t, target in targets if abs(t - switched) < 1.0]  # on a straight lane
    steps = [float(np.hypot(*(b - a)[:2])) for a, b in pairwise(near)]
    assert len(steps) > 10
    assert max(steps) < 0.1 * 7.0 + 0.5  # a target moves on with the vehicle, at 7 m/s
    assert np.linalg.norm(r.sim.estimator.error[:2] - r.sim.estimate.error[:2]) < 0.01


@pytest.mark.parametrize(("dialect", "when"), in_turn(2, [[S.SEARCH], [S.APPROACH], [S.COMMIT]]))
def test_a_position_that_is_led_away_is_left(dialect: str, when: FlightState) -> None:
    """PX4 goes on fusing it: set-points in its coordinates must allow for the velocity at which it is led away."""
    r = flying(dialect, odometry=True)
    assert r.fly(when)
    r.sim.estimate.led = (1.0, 0.0, 0.0)
    r.run(3.0)
    r.gps, r.motion_state = GpsState.DRIFTS, MotionState.DEGRADED
    assert r.run(1.0, lambda: r.telemetry.by_sight)
    drift: list[float] = []  # m/s over the ground, in the air
    each = r.each_step

    def watch() -> None:
        each()
        if not r.sim.vehicle.body.stands:
            drift.append(float(np.hypot(*r.sim.vehicle.body.velocity[:2])))

    r.each_step = watch
    assert r.fly(S.LANDED, 200.0)
    assert drift[-1] < 0.1
    assert off_place(r) < 0.5


@EITHER
def test_with_gps_the_orders_are_the_same_as_without_odometry(dialect: str) -> None:
    flights = [flying(dialect, odometry=odometry) for odometry in (False, True)]
    for r in flights:
        assert r.fly(S.LANDED)
    plain, aided = ([w for w in r.orders if not w.startswith("autopilot: mode")] for r in flights)
    assert plain == aided
    targets = [np.array(r.targets_since(0.0)) for r in flights]
    assert np.array_equal(*targets)
    assert sources(flights[1]) == []
    sent = flights[1].sent_since(0.0, "ODOMETRY")
    assert len(sent) > 100
    assert len({m.reset_counter for m in sent}) == 1


def test_autopilots_without_the_parameters_take_no_odometry() -> None:
    r = flying(odometry=True)
    r.sim.memory.parameters["VISO_TYPE"] = 0
    assert r.fly(S.APPROACH)
    lose_gps(r)
    assert r.run(30.0, lambda: r.doing is Doing.LAND or r.state is S.HANDED_OVER)


def test_after_a_takeover_no_source_is_ordered() -> None:
    """Odometry is sent on, as it moves nothing by itself."""
    r = flying(odometry=True)
    assert r.fly(S.APPROACH)
    r.sim.pilot(Doing.PILOT)
    assert r.fly(S.HANDED_OVER, 3.0)
    lose_gps(r)
    t = r.t
    r.run(3.0)
    assert sources(r) == []
    assert r.sent_since(t, "ODOMETRY")
    assert not r.moving_since(t)


def test_a_dry_run_prints_the_odometry_and_each_source() -> None:
    r = PilotRig(Ground({PLACE: clearer_from_below}).seen, odometry=True)
    r.up_and_flying(16.0)
    printed: list[str] = []
    r.begin(DryRunVehicle(printed.append))
    assert r.fly(S.APPROACH)
    t = r.t
    lose_gps(r)
    r.run(1.0)
    assert any(line.startswith("odometry, for each exposure from here on: ") for line in printed)
    assert printed.count("source of the position: odometry") == 1
    assert not r.sent_since(t, "ODOMETRY")
    assert sources(r) == []


# -- checks before a flight


def test_the_parameters_of_odometry_matter_only_with_it() -> None:
    r = Rig(odometry=True)
    r.ready()
    r.sim.memory.parameters |= {"EK3_SRC2_POSXY": 0, "EK3_SRC_OPTIONS": 1}
    judge_parameters(r.vehicle, odometry=True)
    r.run(3.0)
    found = {c.name: c.verdict for c in judge_parameters(r.vehicle, odometry=True)}
    assert found == {"EK3_SRC2_POSXY": Judged.BAD, "EK3_SRC_OPTIONS": Judged.BAD, "parameters": Judged.GOOD}
    assert [c.name for c in judge_parameters(r.vehicle)] == ["parameters"]


@pytest.mark.parametrize(
    ("rate", "late", "verdict"),
    [(15.0, 0.06, Judged.GOOD), (6.0, 0.06, Judged.WARNING), (15.0, 0.2, Judged.WARNING), (3.0, 0.06, Judged.BAD)],
)
def test_odometry_is_judged_by_its_rate_and_delay(rate: float, late: float, verdict: Judged) -> None:
    r = Rig(odometry=True)
    r.ready()
    sight = SightNavigation(r.vehicle, r.vehicle, lambda lane, words: None)
    assert judge_odometry(sight).verdict is Judged.BAD
    odometry = Odometry(np.eye(9), np.zeros(3), 0.8)
    for k in range(30):
        t_ns = r.now_ns + round(k * 1e9 / rate)
        motion = Motion(t_ns, Pose(np.eye(3), np.zeros(3)), (), np.eye(6), np.zeros(3), odometry=odometry)
        sight.on_motion(motion, t_ns + round(late * 1e9))
    found = judge_odometry(sight)
    assert found.verdict is verdict
    assert f"{rate:.1f} a second, sent {1e3 * late:.0f} ms after the exposure" in found.evidence


# -- the session


@pytest.mark.parametrize("odometry", [False, True])
def test_the_session_sends_the_motion_of_each_exposure(odometry: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    r = PilotRig(Ground({}).seen, odometry=True)
    r.up_and_flying(16.0)
    made: dict[str, Any] = {}
    run = SimpleNamespace(recorder=None)
    monkeypatch.setattr(flight, "LiveRun", lambda *a: made.update(listener=a[2]) or run)
    monkeypatch.setattr(flight, "CalibratedFolder", SimpleNamespace)
    opened: Any = SimpleNamespace(source=SimpleNamespace(locate=lambda local: None), events=iter(()))
    feed: Any = SimpleNamespace(
        lock=nullcontext(), autopilot=r.ours, flush=lambda: None, events=lambda: iter(()),
        events_of=SimpleNamespace(local=LOCAL),
    )  # fmt: skip
    plan = flight.FlightRequest("udp:x", "camera:0", Path("out"), Settings(), odometry=odometry)
    checks = flight.FlightChecks(plan, feed, [])
    monkeypatch.setattr(flight, "time", Clock(r))
    session = flight.open_session(plan, opened, feed, checks, SessionLog(r.orders.append), lambda status: None)
    t, facts = r.t, Odometry(np.eye(9), np.zeros(3), 0.8)
    pose = Pose(np.eye(3), np.zeros(3))
    made["listener"].motion(Motion(r.now_ns, pose, (), np.eye(6), np.zeros(3), odometry=facts))
    r.run(0.2)
    assert len(r.sent_since(t - 0.1, "ODOMETRY")) == int(odometry)
    assert session.pilot.inputs.motion is not None
    assert checks.sight is session.pilot.sight
    assert (checks.sight is not None) is odometry
