"""The vehicle: every limit, exact derivatives, wind and gusts in closed form, and the patterns that it flies."""

import math
from itertools import pairwise

import numpy as np
import pytest
from pydantic import ValidationError

from alight.geometry import so3_exp, so3_log
from alight_sim import Air, FlightPlan, Limits
from alight_sim.patterns import line
from alight_sim.vehicle import CALM, UPWARDS, VEHICLES, SimulatedVehicle, correlated, fly_through

SMOOTH = {"multirotor": VEHICLES["multirotor"], "helicopter": SimulatedVehicle(0.07, math.radians(2.5))}  # no vibration
PLANS = {
    "transect": FlightPlan(speed=12.0),
    "lawn_mower": FlightPlan(pattern="lawn_mower", speed=9.0),
    "spiral": FlightPlan(pattern="spiral", height=25.0, speed=9.0),
    "descent": FlightPlan(pattern="descent", height=100.0, speed=9.0),
    "hover": FlightPlan(pattern="hover"),
    "waypoints": FlightPlan(waypoints=[(0, 0, 20), (25, 0, 20), (25, 20, 35), (10, 20, 12), (10, 21, 12)], speed=9.0),
}


def flown(plan, air=CALM, vehicle=None, seed=0):
    return fly_through(
        line(plan),
        plan.speed,
        np.random.default_rng(seed),
        plan.limits,
        air=air,
        vehicle=vehicle or SMOOTH[plan.vehicle],
        heading=plan.heading,
        rolling=plan.rolling,
        hold=plan.duration,
    )


def hover(seconds, air=CALM, vehicle=None, limits=None, seed=0):
    plan = FlightPlan(pattern="hover", duration=seconds, course_deg=90.0, limits=limits or Limits())
    return flown(plan, air, vehicle, seed)


def times(flight, n=4000):
    return np.linspace(0.0, flight.duration, n)


def tilt_of(flight, t):
    return np.arccos(flight.rotations(t)[:, 2, 2])


# -- limits


@pytest.mark.parametrize("kind", SMOOTH)
@pytest.mark.parametrize("pattern", PLANS)
@pytest.mark.parametrize(
    "limits", [Limits(), Limits(acceleration=1.0, tilt_deg=16.0, turn_deg_per_s=20.0, climb=1.0, sink=0.8)]
)
def test_every_limit_holds(pattern, kind, limits):
    plan = PLANS[pattern].model_copy(update={"limits": limits, "vehicle": kind})
    flight = flown(plan)
    t = times(flight)
    velocity, acceleration = flight.velocity_world(t), flight.acceleration_world(t)
    assert np.linalg.norm(velocity, axis=1).max() <= plan.speed + 1e-9
    assert np.linalg.norm(acceleration, axis=1).max() <= limits.acceleration + 1e-9
    assert velocity[:, 2].max() <= limits.climb + 1e-9
    assert velocity[:, 2].min() >= -limits.sink - 1e-9
    assert np.degrees(np.abs(flight.heading.derivative()(t))).max() <= limits.turn_deg_per_s + 1e-6
    assert np.degrees(tilt_of(flight, t)).max() <= limits.tilt_deg


def test_limits_are_used_not_only_kept():
    """A flight that stays far below every limit would pass the test above."""
    up_down = FlightPlan(waypoints=[(0, 0, 20), (0, 0, 60), (0, 0, 20), (60, 0, 20), (60, 60, 20)], speed=9.0)
    flight = flown(up_down)
    t = times(flight)
    velocity = flight.velocity_world(t)
    assert velocity[:, 2].max() > 0.98 * 3.0
    assert velocity[:, 2].min() < -0.98 * 2.5
    assert np.linalg.norm(velocity, axis=1).max() > 0.98 * 9.0
    assert np.linalg.norm(flight.acceleration_world(t), axis=1).max() > 0.65 * 2.5
    assert np.degrees(np.abs(flight.heading.derivative()(t))).max() > 0.95 * 45.0


def test_flight_passes_near_its_way_points_and_rests_at_both_ends():
    plan = PLANS["waypoints"]
    flight = flown(plan)
    places = flight.place_world(times(flight, 8000))
    for point in plan.waypoints:
        assert np.linalg.norm(places - point, axis=1).min() < 0.4
    for t in (-0.6, flight.duration + 0.6):
        assert np.linalg.norm(flight.velocity_world(t)) < 1e-6


def test_transect_passes_its_ends_at_full_speed():
    flight = flown(PLANS["transect"])
    for t in (-0.5, 0.0, flight.duration, flight.duration + 0.5):
        assert np.linalg.norm(flight.velocity_world(t)) == pytest.approx(12.0, rel=1e-9)
    assert flight.duration == pytest.approx(8.0)


def test_nose_follows_the_course_of_a_lawn_mower():
    flight = flown(PLANS["lawn_mower"])
    t = times(flight)
    velocity = flight.velocity_world(t)
    fast = np.linalg.norm(velocity, axis=1) > 5.0
    forward = flight.rotations(t)[fast, :, 0]
    along = velocity[fast] / np.linalg.norm(velocity[fast], axis=1, keepdims=True)
    assert fast.mean() > 0.2
    assert np.median((forward * along).sum(axis=1)) > 0.95


@pytest.mark.parametrize("kind", SMOOTH)
def test_gusts_never_lean_it_over_the_tilt_limit(kind):
    storm = Air(wind=4.0, gusts=5.0, wobble_deg=3.0)
    flight = hover(60.0, storm, SMOOTH[kind], Limits(tilt_deg=12.0))
    most = np.degrees(tilt_of(flight, times(flight))).max()
    assert 10.0 < most <= 12.0 + 1e-9


def test_wind_that_it_cannot_hold_is_refused():
    with pytest.raises(ValueError, match="tilt limit of 10 degrees"):
        hover(5.0, Air(wind=15.0), VEHICLES["multirotor"], Limits(tilt_deg=10.0))
    hover(5.0, Air(wind=15.0), VEHICLES["multirotor"], Limits(tilt_deg=30.0))


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.zeros((2, 3))])
def test_lines_that_are_none_are_refused(points):
    with pytest.raises(ValueError, match="way-point"):
        fly_through(points, 5.0, np.random.default_rng(0))


# -- attitude


def test_it_leans_into_acceleration_and_against_the_wind():
    air = Air(wind=6.0, from_deg=0.0, gusts=0.0, wobble_deg=0.0)  # from the north
    flight = flown(FlightPlan(waypoints=[(0, 0, 20), (60, 0, 20)], speed=8.0), air)
    drag = VEHICLES["multirotor"].drag
    for t in (0.9, 0.5 * flight.duration):
        a, v, up = flight.acceleration_world(t), flight.velocity_world(t), flight.rotations(t)[:, 2]
        push = a + UPWARDS + drag * (v - [0.0, -6.0, 0.0])
        assert up == pytest.approx(push / np.linalg.norm(push), abs=2e-4)  # the rest is the tilt limit bending in
    assert up[1] > 0.1  # thrust northwards holds against the air


def test_helicopter_leans_left_in_hover_and_drops_its_nose_with_speed():
    vehicle = VEHICLES["helicopter"]
    still = hover(4.0, vehicle=vehicle).rotations(2.0)
    left, forward = still[:, 1], still[:, 0]
    assert math.degrees(math.asin(-left[2])) == pytest.approx(2.5, abs=0.01)  # left side down
    assert forward[2] == pytest.approx(0.0, abs=1e-6)
    fast = flown(FlightPlan(speed=15.0, vehicle="helicopter")).rotations(4.0)
    assert -fast[2, 0] == pytest.approx(math.sin(math.atan(vehicle.drag * 15.0 / UPWARDS[2])), abs=3e-3)


def test_helicopter_shakes_at_the_frequencies_of_its_rotor():
    flight = hover(4.0, vehicle=VEHICLES["helicopter"])
    rate = 400.0
    force = flight.specific_force_body(np.arange(0, 4.0, 1 / rate))[:, 0]
    spectrum = np.abs(np.fft.rfft(force - force.mean())) * 2 / len(force)
    strongest = np.sort(np.argsort(spectrum)[-2:]) * rate / len(force)
    assert strongest == pytest.approx([24.0, 48.0], abs=0.3)
    assert spectrum.max() == pytest.approx(1.2, rel=0.05)


# -- exactness


@pytest.mark.parametrize("kind", VEHICLES)
def test_derivatives_are_those_of_the_trajectory(kind):
    plan = PLANS["waypoints"].model_copy(update={"vehicle": kind})
    flight = flown(plan, Air(), VEHICLES[kind])
    t, h = np.linspace(1.0, flight.duration - 1.0, 50), 1e-5
    velocity = (flight.place_world(t + h) - flight.place_world(t - h)) / (2 * h)
    acceleration = (flight.velocity_world(t + h) - flight.velocity_world(t - h)) / (2 * h)
    assert np.abs(velocity - flight.velocity_world(t)).max() < 1e-7
    assert np.abs(acceleration - flight.acceleration_world(t)).max() < 2e-5
    for k in (0, 20, 40):
        before, after = flight.rotations(t[k] - 1e-3), flight.rotations(t[k] + 1e-3)
        assert so3_log(before.T @ after) / 2e-3 == pytest.approx(flight.angular_velocity_body(t[k]), abs=1e-4)


@pytest.mark.parametrize(("kind", "rate"), [("multirotor", 200.0), ("helicopter", 2000.0)])
def test_noise_free_inertial_measurements_integrate_back_to_the_trajectory(kind, rate):
    flight = flown(PLANS["waypoints"].model_copy(update={"vehicle": kind}), Air(), VEHICLES[kind])
    t = np.arange(1.0, 5.0, 1.0 / rate)
    turns, forces = flight.angular_velocity_body(t), flight.specific_force_body(t)
    R, p, v, dt = flight.rotations(t[0]), flight.place_world(t[0]), flight.velocity_world(t[0]), 1.0 / rate
    for (w0, f0), (w1, f1) in pairwise(zip(turns, forces, strict=True)):
        after = R @ so3_exp(0.5 * dt * (w0 + w1))
        force = 0.5 * (R @ f0 + after @ f1) - UPWARDS
        p, v, R = p + dt * v + 0.5 * dt * dt * force, v + dt * force, after
    assert np.linalg.norm(p - flight.place_world(t[-1])) < 2e-3
    assert np.linalg.norm(v - flight.velocity_world(t[-1])) < 1e-3
    assert np.linalg.norm(so3_log(R.T @ flight.rotations(t[-1]))) < 1e-4


def test_poses_of_many_times_are_those_of_each():
    flight = flown(PLANS["spiral"], Air())
    t = np.array([0.3, 2.7, 9.1])
    for k, one in enumerate(t):
        assert np.array_equal(flight.rotations(t)[k], flight.pose(float(one)).rotation)
        assert np.array_equal(flight.place_world(t)[k], flight.pose(float(one)).translation)


# -- air


def test_gusts_have_their_deviation_and_correlation_time():
    flight = hover(3000.0, Air(wind=0.0, gusts=1.5, gust_time=4.0, wobble_deg=0.0), seed=3)
    t = np.arange(0.0, 3000.0, 0.5)
    gusts = flight.gusts(t)
    assert gusts.std() == pytest.approx(1.5, rel=0.08)
    lag = (gusts[8:] * gusts[:-8]).mean() / gusts.var()
    assert lag == pytest.approx(math.exp(-1.0), abs=0.06)


def test_gusts_push_a_hover_about_and_it_comes_back():
    wander = [
        hover(600.0, Air(wind=0.0, gusts=g, wobble_deg=0.0)).place_world(np.arange(0, 600, 0.5)) for g in (0.0, 1.0)
    ]
    assert wander[0].std(axis=0).max() < 1e-9
    assert 0.03 < wander[1].std(axis=0).max() < 0.3
    assert np.abs(wander[1].mean(axis=0) - wander[0].mean(axis=0)).max() < 0.05


def test_correlated_noise_is_first_order():
    x = correlated(np.random.default_rng(1), 20000, 3, 0.1)
    assert x.std() == pytest.approx(1.0, rel=0.05)
    assert (x[10:] * x[:-10]).mean() == pytest.approx(math.exp(-1.0), abs=0.05)
    assert x[0].std() > 0.0  # stationary from the start: not from zero


# -- patterns


def test_a_height_alone_is_a_flight():
    points = line(FlightPlan(height=40.0))
    assert points.shape == (2, 3)
    assert np.linalg.norm(points[1] - points[0]) == pytest.approx(40.0)
    assert (points[:, 2] == 40.0).all()
    assert points.mean(axis=0)[:2] == pytest.approx([0.0, 0.0], abs=1e-12)


def test_lawn_mower_lines_are_as_far_apart_and_as_long_as_asked():
    plan = FlightPlan(pattern="lawn_mower", lines=3, length=50.0, spacing=7.0, course_deg=30.0, centre=(5.0, -2.0))
    points = line(plan)[:, :2] - [5.0, -2.0]
    along = np.array([math.sin(math.radians(30)), math.cos(math.radians(30))])
    right = np.array([along[1], -along[0]])
    assert points @ along == pytest.approx([-25, 25, 25, -25, -25, 25])
    assert points @ right == pytest.approx([-7, -7, 0, 0, 7, 7])


def test_spiral_widens_by_its_spacing_each_turn():
    points = line(FlightPlan(pattern="spiral", turns=3.0, spacing=6.0))
    radius = np.hypot(points[:, 0], points[:, 1])
    assert radius[0] == 0.0
    assert radius[-1] == pytest.approx(18.0)
    assert (np.diff(radius) > 0).all()
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    assert steps.max() < 1.1


def test_descent_goes_from_height_to_end_height():
    points = line(FlightPlan(pattern="descent", height=100.0, length=0.0))
    assert points[:, 2].tolist() == [100.0, 5.0]
    assert np.ptp(points[:, :2], axis=0).max() == 0.0
    flight = flown(FlightPlan(pattern="descent", height=100.0, length=0.0))
    assert flight.duration > 95.0 / 2.5


@pytest.mark.parametrize(
    ("wish", "says"),
    [
        ({"pattern": "circle"}, "pattern"),
        ({"pattern": "waypoints"}, "needs waypoints"),
        ({"pattern": "descent", "height": 4.0}, "end_height"),
        ({"speed": -1.0}, "speed"),
        ({"hieght": 30.0}, "hieght"),
        ({"limits": {"tilt_deg": 95.0}}, "tilt_deg"),
    ],
)
def test_plans_that_make_no_sense_are_refused_by_name(wish, says):
    with pytest.raises(ValidationError, match=says):
        FlightPlan.model_validate(wish)
