"""The fence of the autopilot, and what else it stores: read before a flight, and kept while it lasts."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest
from length import BOTH, in_turn
from made_up_ground import Ground, clearer_from_below
from over_a_link import free_port
from pilot_rig import PLACE, PilotRig
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from alight.checks.result import CheckResult, Judged
from alight.flight.live.telemetry import TelemetryFeed
from alight.flight.session import preflight as p
from alight.flight.session.dry_run import report_parameters
from alight.records import GpsState, MotionState
from alight.records.executive import FlightState
from alight.records.telemetry import FirmwareName
from alight.settings import Settings
from alight_sim.autopilot import DIALECTS, SimulatedAutopilot, UdpServer
from alight_sim.autopilot.memory import MissionItem, fence_circle, fence_polygon

S = FlightState
DISC = 1.5  # m, lander.radius
FENCE = mavlink.MAV_MISSION_TYPE_FENCE


def rig(dialect: FirmwareName, fence: list[MissionItem], ground: Ground | None = None, **more: Any) -> PilotRig:
    """A vehicle on the ground, whose fence was read."""
    r = PilotRig((ground or Ground({})).seen, dialect, **more)
    r.sim.memory.plans[FENCE] = fence
    return read(r)


def read(r: PilotRig) -> PilotRig:
    """Wait until a vehicle is ready, and everything that it stores was read."""
    r.ready()
    p.judge_parameters(r.vehicle)  # begins to read
    assert r.run(20.0, lambda: r.vehicle.onboard.over)
    return r


def cut(rng: np.random.Generator, r: PilotRig) -> tuple[list[MissionItem], Any]:
    """A fence that cuts the search area about the home: its items, and the room of a point by another formula."""
    degrees, angle = r.sim.home.degrees, rng.uniform(0, 2 * np.pi)
    along, ahead = np.array([-np.sin(angle), np.cos(angle)]), np.array([np.cos(angle), np.sin(angle)])
    edge = rng.uniform(6.0, 14.0)  # m from home
    corners = [edge * ahead - 50 * along, edge * ahead + 50 * along, -50 * ahead + 50 * along, -50 * ahead - 50 * along]
    centre, radius = rng.uniform(11.0, 16.0) * along - 3.0 * ahead, rng.uniform(3.0, 5.0)
    items = [*fence_polygon(corners, degrees, True), *fence_circle(centre, radius, degrees, False)]

    def room(at: np.ndarray) -> float:
        return float(min(edge - at @ ahead, np.linalg.norm(at - centre) - radius))

    return items, room


@pytest.mark.parametrize(("dialect", "seed"), in_turn(1, [(seed,) for seed in range(20)]))
def test_the_disc_never_leaves_the_fence(dialect: FirmwareName, seed: int) -> None:
    """Good places lie on both sides of the fence; the autopilot's own position is what its fence acts on."""
    rng = np.random.default_rng(seed)
    places = {tuple(place): clearer_from_below for place in rng.uniform(-24.0, 24.0, (8, 2))}
    r = rig(dialect, [], Ground(places))
    r.sim.memory.plans[FENCE], room = cut(rng, r)
    r.vehicle.onboard.rebooted()
    r.up_and_flying(30.0)
    r.begin()
    rooms, fly = list[float](), r.each_step

    def watched() -> None:
        fly()
        rooms.append(room(r.sim.estimated[:2]))

    r.each_step = watched
    assert r.run(400.0, lambda: r.pilot.over)
    assert r.state is S.LANDED
    assert min(rooms) > DISC


def test_a_position_that_is_led_away_does_not_move_the_fence() -> None:
    """PX4 goes on fusing it: by its position the place is soon far outside a fence that it lies within."""
    r = rig("px4", [], Ground({PLACE: clearer_from_below}), odometry=True)
    r.sim.memory.plans[FENCE] = fence_circle((0.0, 0.0), 27.0, r.sim.home.degrees, True)
    r.vehicle.onboard.rebooted()
    r.up_and_flying(30.0)
    r.begin()
    assert r.fly(S.APPROACH)
    r.sim.estimate.led = (1.0, 0.5, 0.0)
    r.run(3.0)
    r.gps, r.motion_state = GpsState.DRIFTS, MotionState.DEGRADED
    assert r.fly(S.LANDED, 200.0)
    assert np.hypot(*r.sim.estimated[:2]) > 40.0
    assert np.hypot(*(r.truth()[:2] - PLACE)) < 0.5


def test_where_nothing_is_left_inside_the_fence_it_returns_and_names_it() -> None:
    r = rig("ardupilot", [], Ground({PLACE: clearer_from_below}), settings=("executive.search_side=30",))
    r.sim.memory.plans[FENCE] = fence_circle(PLACE, 5.0, r.sim.home.degrees, False)
    r.vehicle.onboard.rebooted()
    r.up_and_flying(30.0)
    r.begin()
    assert r.fly(S.RETURN)
    assert "1 are outside the fence (exclusion circle 1)" in r.pilot.diary.transitions[-1].reason
    assert not r.pilot.diary.looks


def judged(r: PilotRig, plan: list[MissionItem] | None) -> CheckResult:
    """The check of a fence that the vehicle stores now; None: its build has no fences."""
    r.sim.memory.plans[FENCE] = plan or []
    if plan is None:
        del r.sim.memory.plans[FENCE]
    r.vehicle.onboard.rebooted()
    first = p.judge_fence(r.vehicle, Settings())[0]
    assert (first.verdict, first.lasts) == (Judged.BAD, False)  # until it is read
    assert r.run(20.0, lambda: r.vehicle.onboard.over)
    found = p.judge_fence(r.vehicle, Settings())[0]
    assert found.lasts is (found.verdict is Judged.BAD)
    return found


def test_the_check_names_the_fence_and_what_it_leaves() -> None:
    r = rig("px4", [])
    degrees = r.sim.home.degrees
    half = fence_polygon([(5.0, -200.0), (200.0, -200.0), (200.0, 200.0), (5.0, 200.0)], degrees, False)
    for plan, verdict, words in (
        ([], Judged.GOOD, "the autopilot has none; 0 rally points"),
        (fence_circle((0.0, 0.0), 100.0, degrees, True), Judged.GOOD, "inclusion circle 1; 100 %"),
        (half, Judged.WARNING, "exclusion polygon 1; 4"),
        (fence_circle((60.0, 0.0), 20.0, degrees, True), Judged.BAD, "outside"),
        (fence_circle((0.0, 0.0), 3.0, degrees, True), Judged.BAD, "no room"),
        ([MissionItem(mavlink.MAV_CMD_NAV_WAYPOINT, 0.0, 47.6, 13.4)], Judged.BAD, "command 16"),
    ):
        found = judged(r, plan)
        assert (found.verdict, words in found.evidence) == (verdict, True), found


def test_a_fence_that_is_announced_and_cannot_be_had_is_refused() -> None:
    r = rig("ardupilot", [])
    circle = fence_circle((0.0, 0.0), 100.0, r.sim.home.degrees, True)
    for plan, lost, verdict, words in (
        (1001 * circle, "", Judged.BAD, "(items: 1001), and it cannot be had: 1000 items are read at most"),
        (circle, "MISSION_REQUEST_INT", Judged.BAD, "(items: 1), and it cannot be had: no answer"),
        (circle, "MISSION_REQUEST_LIST", Judged.WARNING, "it cannot be had (no answer"),
        (None, "", Judged.WARNING, "it cannot be had (the autopilot answers MAV_MISSION_UNSUPPORTED"),
    ):
        r.lose(lost, lambda m: True)
        found = judged(r, plan)
        assert (found.verdict, words in found.evidence) == (verdict, True), found


@pytest.mark.parametrize(
    ("dialect", "name", "value", "verdict"),
    [
        ("ardupilot", "PLND_STRICT", 1, Judged.WARNING),
        ("ardupilot", "FS_EKF_ACTION", 0, Judged.BAD),
        ("ardupilot", "WPNAV_ACCEL", 100.0, Judged.WARNING),
        ("px4", "COM_OBL_RC_ACT", 0, Judged.BAD),
        ("px4", "COM_OF_LOSS_T", 30.0, Judged.BAD),
        ("px4", "COM_DISARM_LAND", -1.0, Judged.WARNING),
    ],
)
def test_a_parameter_that_differs_is_named(dialect: FirmwareName, name: str, value: float, verdict: Judged) -> None:
    r = PilotRig(Ground({}).seen, dialect)
    r.sim.memory.parameters[name] = value
    del r.sim.memory.parameters["MPC_LAND_SPEED" if dialect == "px4" else "LAND_SPEED"]
    found = {c.name: c for c in p.judge_parameters(read(r).vehicle)}
    assert {n: c.verdict for n, c in found.items()} == {name: verdict, "parameters": Judged.UNKNOWN}
    assert f"it is {value:g}" in found[name].evidence
    assert found[name].mend.startswith(f"set {name} to ")
    assert "LAND_SPEED" in found["parameters"].evidence
    assert found[name].lasts is (verdict is Judged.BAD)


@BOTH
def test_a_dry_run_prints_the_parameters_within_five_seconds(dialect: FirmwareName) -> None:
    sim, lines = SimulatedAutopilot(DIALECTS[dialect]), list[str]()
    name = "PLND_STRICT" if dialect == "ardupilot" else "COM_RC_OVERRIDE"
    sim.memory.parameters[name] = 1
    port = free_port()
    feed, begin, printed = TelemetryFeed(f"udp:127.0.0.1:{port}"), time.monotonic(), list[float]()

    def keep(line: str) -> None:
        lines.append(line)
        printed.append(time.monotonic() - begin)

    try:
        with UdpServer(sim, ("127.0.0.1", port), step=0.05):
            report_parameters(feed, keep)
    finally:
        feed.close()
    assert any(line.startswith("WARNING") and f"{name}: it is 1" in line for line in lines), lines
    assert max(printed) < 5.0
