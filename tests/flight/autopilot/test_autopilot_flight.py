"""Whole flights with an error of the autopilot's position: guided, and down on a target."""

from __future__ import annotations

import math
from itertools import count

import numpy as np
import pytest
from autopilot_rig import LOCAL, Rig
from length import BOTH, first
from numpy.testing import assert_allclose

from alight.flight.autopilot import EstimateTie, Setpoint
from alight.records import FlightMode, Landed, NoticeKind
from alight_sim.autopilot import PX4_CONTROLLER, EstimateError, FlightLimits, PointMass, Wanted
from alight_sim.autopilot.dialects import Doing

WRONG = (3.0, -2.0, 1.5)  # metres
TARGET = np.array([12.0, 9.0, 0.0])


def over(up: float, east: float = 0.0, north: float = 0.0) -> np.ndarray:
    """Return a point relative to the target."""
    return TARGET + np.array([east, north, up])


def aligned(rig: Rig) -> EstimateTie:
    """Return a tie with our true position (from the cameras); the autopilot's estimate is another."""
    got = rig.vehicle.tie(LOCAL, rig.truth(), rig.now_ns)
    assert got is not None
    return got


def flying(dialect: str, height: float = 15.0, **more: object) -> Rig:
    rig = Rig(dialect, step=0.04, estimate=EstimateError(WRONG), **more)  # type: ignore[arg-type]
    rig.up_and_flying(height)
    return rig


@BOTH
def test_a_guided_target_is_reached_in_our_world(dialect: str) -> None:
    """The autopilot is off by 3.9 m; commands are relative to its own estimate, so the vehicle is not off."""
    rig = flying(dialect)
    goal = np.array([20.0, -14.0, 22.0])
    rig.vehicle.guide(Setpoint(goal, heading=math.radians(120)), aligned(rig))
    rig.run(20)
    assert_allclose(rig.truth(), goal, atol=0.1)
    assert math.remainder(rig.sim.vehicle.heading - math.radians(120), 2 * math.pi) == pytest.approx(0, abs=0.01)
    assert not rig.of(NoticeKind.TAKEOVER)


@BOTH
def test_guided_flight_begins_where_the_vehicle_is(dialect: str) -> None:
    """An order to fly guided on the ground must not bring the vehicle down again after take-off."""
    rig = flying(dialect)
    before = rig.sim.estimated
    rig.run(8)
    assert_allclose(rig.sim.estimated, before, atol=0.6)


@BOTH
def test_a_guided_velocity_is_flown(dialect: str) -> None:
    rig = flying(dialect)
    before = rig.truth()
    for _ in range(4):  # ArduPilot forgets a velocity after three seconds
        rig.vehicle.guide(Setpoint(velocity_world=np.array([1.0, 2.0, -0.5])))
        rig.run(1.0)
    moved = rig.truth() - before
    assert_allclose(moved, [4.0, 8.0, -2.0], atol=0.9)
    assert_allclose(rig.sim.vehicle.velocity, [1.0, 2.0, -0.5], atol=0.05)


@BOTH
def test_a_setpoint_is_flown_to_no_faster_than_it_says(dialect: str) -> None:
    """A set-point keeps its speed although ArduPilot forgets it after take-off and after a hold."""
    rig = flying(dialect)
    goal = Setpoint(np.array([60.0, 0.0, 8.0]), heading=math.radians(-90), speed=2.0, sink=0.5)
    for _ in range(2):
        fastest = sinking = 0.0
        for k in range(60):
            rig.vehicle.guide(goal, aligned(rig))
            rig.run(0.1)
            if k > 2:  # the speed takes effect after a moment
                fastest = max(fastest, float(np.hypot(*rig.sim.vehicle.velocity[:2])))
                sinking = max(sinking, -float(rig.sim.vehicle.velocity[2]))
        assert 1.5 < fastest < 2.15
        assert 0.4 < sinking < 0.6
        assert math.remainder(rig.sim.vehicle.heading + math.pi / 2, 2 * math.pi) == pytest.approx(0, abs=0.01)
        assert rig.answered(rig.vehicle.set_mode(FlightMode.HOLD)).ok
        rig.run(2.0)
        rig.vehicle.set_mode(FlightMode.GUIDED)
        rig.run(2.0)
    assert not [n for n in rig.of(NoticeKind.COMMAND) if not n.ok]


def test_a_speed_is_given_again_where_its_setpoint_was_lost() -> None:
    """ArduPilot forgets the speed when the next set-point starts its controller; so the speed is sent again."""
    rig = flying("ardupilot")
    rig.vehicle.set_mode(FlightMode.HOLD)
    rig.run(2.0)
    rig.vehicle.set_mode(FlightMode.GUIDED)
    rig.run(2.0)
    dropped = count()
    rig.lose("SET_POSITION_TARGET_GLOBAL_INT", lambda m: next(dropped) < 3)
    speeds = []
    for _ in range(60):
        rig.vehicle.guide(Setpoint(np.array([60.0, 0.0, 15.0]), heading=0.0, speed=2.0), aligned(rig))
        rig.run(0.1)
        speeds.append(float(np.hypot(*rig.sim.vehicle.velocity[:2])))
    assert max(speeds) > 2.5  # for a moment
    assert max(speeds[-25:]) < 2.15


def test_ardupilot_turns_its_nose_where_no_heading_is_named() -> None:
    rig = flying("ardupilot")
    assert rig.sim.vehicle.heading == pytest.approx(0.0, abs=0.01)
    rig.vehicle.guide(Setpoint(np.array([60.0, 0.0, 15.0])), aligned(rig))
    rig.run(5)
    assert rig.sim.vehicle.heading == pytest.approx(math.pi / 2, abs=0.1)


@pytest.mark.parametrize("seed", first(1, range(2)))
def test_ardupilot_lands_on_a_target_that_is_reported(seed: int) -> None:
    """In wind and gusts, tilted, with an estimate that is off and wanders, it lands within 0.1 m of the target."""
    body = PointMass(wind_world=np.array([4.0, 2.0, 0.0]), gusts=0.4, seed=seed)
    rig = Rig("ardupilot", step=0.04, vehicle=body, estimate=EstimateError(WRONG, walk=0.05, seed=seed), seed=seed,
              link={"loss": 0.1, "delay": 0.03})  # fmt: skip
    rig.up_and_flying(12.0)
    rig.vehicle.guide(Setpoint(over(8.0, 1.5, -1.0)), aligned(rig))
    rig.run(12)
    rig.vehicle.set_mode(FlightMode.LAND)

    def report() -> None:
        rig.vehicle.land_on(rig.now_ns, TARGET - rig.truth(), rig.sim.vehicle.world_from_body.rotation)

    rig.each_step = report
    assert rig.run(60, lambda: bool(rig.ours.telemetry and rig.ours.telemetry.is_down))
    assert np.hypot(*(rig.truth() - TARGET)[:2]) < 0.1
    assert 0.3 < rig.sim.vehicle.touchdown_speed < 0.9
    assert rig.ours.telemetry is not None
    assert rig.ours.telemetry.landed is Landed.GROUND
    assert not rig.of(NoticeKind.TAKEOVER)


def test_a_target_that_is_reported_in_fast_flight_is_where_it_is() -> None:
    """The reported target must be of the present position: at 5 m/s one that is 0.2 s old would be off by a metre."""
    rig = flying("ardupilot")
    aimed: list[np.ndarray] = []
    rig.sim.logic.aim_landing = lambda target, t: aimed.append(target)  # type: ignore[method-assign]
    for _ in range(3):
        rig.vehicle.guide(Setpoint(velocity_world=np.array([4.0, 3.0, 0.0])))
        rig.run(1.0)
    aimed.clear()
    rig.each_step = lambda: rig.vehicle.land_on(
        rig.now_ns, TARGET - rig.truth(), rig.sim.vehicle.world_from_body.rotation
    )
    rig.run(1.0)
    assert len(aimed) > 20
    late = 5.0 * rig.dt  # the message arrives a step later
    assert np.abs(np.array(aimed) - (TARGET + WRONG)).max() < 0.1 + late


def test_a_wrong_sign_in_the_target_would_show() -> None:
    """With a mirrored target the vehicle lands elsewhere, so that the test above can fail."""
    rig = flying("ardupilot", 8.0)
    rig.vehicle.guide(Setpoint(over(8.0, 1.5, -1.0)), aligned(rig))
    rig.run(12)
    rig.vehicle.set_mode(FlightMode.LAND)

    def report() -> None:
        wrong = (TARGET - rig.truth()) * [-1, 1, 1]
        rig.vehicle.land_on(rig.now_ns, wrong, rig.sim.vehicle.world_from_body.rotation)

    rig.each_step = report
    rig.run(25)
    assert np.hypot(*(rig.truth() - TARGET)[:2]) > 0.5


@BOTH
def test_it_lands_where_it_is_without_a_target(dialect: str) -> None:
    rig = flying(dialect, 6.0)
    before = rig.truth()
    assert rig.answered(rig.vehicle.set_mode(FlightMode.LAND)).ok
    assert rig.run(60, lambda: bool(rig.ours.telemetry and rig.ours.telemetry.is_down))
    assert np.hypot(*(rig.truth() - before)[:2]) < 0.5


def test_a_helicopter_of_ardupilot_is_a_vehicle_too() -> None:
    rig = Rig(step=0.04, kind=4)
    rig.up_and_flying(5.0)
    assert rig.sim.estimated[2] > 4.4
    assert rig.ours.telemetry is not None
    assert rig.ours.telemetry.armed


@BOTH
def test_telemetry_follows_the_true_flight(dialect: str) -> None:
    """Rows of GPS/INS follow attitude, velocity and place of the simulated vehicle in a turn with wind."""
    limits = PX4_CONTROLLER if dialect == "px4" else FlightLimits()
    body = PointMass(limits, wind_world=np.array([-5.0, 3.0, 0.0]))
    rig = Rig(dialect, step=0.02, vehicle=body)
    rig.up_and_flying(10.0)
    truth: dict[int, tuple[np.ndarray, np.ndarray, np.ndarray]] = {}

    def note() -> None:
        pose = rig.sim.vehicle.world_from_body
        truth[rig.now_ns] = (rig.truth(), pose.rotation, rig.sim.vehicle.velocity.copy())

    rig.each_step = note
    rig.vehicle.guide(Setpoint(np.array([25.0, 10.0, 14.0]), heading=2.0), aligned(rig))
    first = len(rig.samples)
    rig.run(6)
    rows = [s for s in rig.samples[first + 5 :] if s.world_from_body is not None]
    assert len(rows) > 40
    times = np.array(sorted(truth))
    places = np.array([truth[int(t)][0] for t in times])
    for s in rows:
        _, rotation, velocity = truth[int(times[np.abs(times - s.t_ns).argmin()])]
        position = np.array([np.interp(s.t_ns, times, axis) for axis in places.T])  # between steps of 20 ms
        speed = float(np.linalg.norm(velocity))
        assert_allclose(s.position_world, position, atol=0.03 + 0.015 * speed)
        assert_allclose(s.world_from_body, rotation, atol=0.06)
        assert_allclose(s.velocity_world, velocity, atol=0.08)
    leans = [math.acos(min(1.0, s.world_from_body[2, 2])) for s in rows]
    assert max(leans) > 0.15  # it does lean: the comparison means something


def test_the_simulated_vehicle_keeps_its_limits() -> None:
    limits = FlightLimits(speed=6.0, climb=2.0, sink=1.0, acceleration=2.5)
    body, dt = PointMass(limits, position=np.array([0.0, 0.0, 40.0])), 0.02
    goals = [np.array([60.0, 20.0, 60.0]), np.array([-30.0, 0.0, 20.0])]
    before = body.velocity.copy()
    for goal in goals:
        for _ in range(2600):
            body.step(dt, Wanted(goal))
            assert np.hypot(*body.velocity[:2]) < 6.01
            assert -1.01 < body.velocity[2] < 2.01
            assert np.linalg.norm(body.velocity - before) / dt < 2.51
            before = body.velocity.copy()
        assert_allclose(body.position, goal, atol=0.05)


def test_the_simulated_vehicle_stands_on_the_ground() -> None:
    body = PointMass(ground=lambda east, north: 0.1 * east, position=np.array([20.0, 0.0, 3.0]))
    for _ in range(300):
        body.step(0.02, Wanted(velocity=np.array([0.0, 0.0, -0.5])))
    assert body.stands
    assert body.position[2] == pytest.approx(2.0)
    assert body.touchdown_speed == pytest.approx(0.5, abs=0.02)
    body.step(0.02, None)
    assert body.position[2] == pytest.approx(2.0)


def test_ardupilot_forgets_a_velocity_and_px4_a_silent_companion() -> None:
    rig = flying("ardupilot")
    rig.vehicle.guide(Setpoint(velocity_world=np.array([2.0, 0.0, 0.0])))
    rig.run(8)
    assert np.linalg.norm(rig.sim.vehicle.velocity) < 0.1
    px4 = flying("px4")
    px4.vehicle.guide(Setpoint(velocity_world=np.array([2.0, 0.0, 0.0])))
    px4.run(5)
    assert np.linalg.norm(px4.sim.vehicle.velocity) > 1.9  # repeated by us
    px4.up.loss = 1.0
    px4.run(3)
    assert px4.sim.logic.doing is Doing.HOLD
