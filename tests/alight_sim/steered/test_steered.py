"""Steered flights: set-points are reached, sensors have the claimed errors, and objects on command are real."""

import math
from itertools import pairwise

import numpy as np
import pytest
from quiet_imaging import QUIET

from alight.geometry import Grid, so3_exp, so3_log
from alight.records import Frame, ImuSample, InputError, NavSample
from alight_sim import Imaging, ImuErrors, NavErrors, Scene, build, world_of
from alight_sim.autopilot import SimulatedAutopilot
from alight_sim.movers import Traffic
from alight_sim.oracle import OracleLander, judge_touchdown
from alight_sim.scene import SceneGround
from alight_sim.steered import FlownEstimate, SteeredFlight, TrueBattery, Wanted

PERFECT_NAV = NavErrors(
    position=(0, 0, 0), position_white=0, attitude_deg=(0, 0, 0), attitude_white_deg=0, velocity_white=0,
    rate_white_deg=0,
)  # fmt: skip
PERFECT_IMU = ImuErrors(
    gyroscope_noise_density=0, gyroscope_random_walk=0, accelerometer_noise_density=0, accelerometer_random_walk=0,
    gyroscope_bias=0, accelerometer_bias=0,
)  # fmt: skip
SMALL = {"size": (64, 48), "gusts": 0.0}
BLIND = {**SMALL, "rate_hz": 0.01, "stereo": False}  # one picture at the start only
LEVEL = Scene(ground=SceneGround(size=(60, 60), relief=()), imaging=Imaging(**QUIET))


@pytest.fixture(scope="module")
def level():
    """Build a level meadow with noise-free pictures."""
    return build(LEVEL)


def hold(flight, seconds, wanted=None, dt=0.1):
    """Events of a flight that stays in place, or follows `wanted`."""
    wanted = wanted or Wanted(position=flight.true_pose.translation)
    return [e for _ in range(round(seconds / dt)) for e in flight.step(dt, wanted)]


def of(events, kind):
    return [e for e in events if isinstance(e, kind)]


def bits(events):
    """Bytes of all numbers of all events."""
    out = []
    for e in events:
        values = [*e.images, e.t_ns] if isinstance(e, Frame) else vars(e).values()
        out += [np.asarray(v).tobytes() for v in values if v is not None]
    return out


# -- the vehicle


def test_set_points_are_reached(level):
    flight = SteeredFlight(level, 1, start=(0, 0, 20), **BLIND)
    goal = flight.true_pose.translation + np.array([12.0, -5.0, 4.0])
    hold(flight, 15.0, Wanted(position=goal, heading=1.0))
    assert flight.true_pose.translation == pytest.approx(goal, abs=0.02)
    forward = flight.true_pose.rotation[:, 0]
    assert math.atan2(forward[0], forward[1]) == pytest.approx(1.0, abs=1e-3)
    hold(flight, 4.0, Wanted(velocity=np.array([1.0, 0.5, -0.7])))
    assert flight.body.velocity == pytest.approx([1.0, 0.5, -0.7], abs=0.01)


def test_an_autopilot_steers_by_the_navigation_solution(level):
    """Its position is off by the error of GPS, and so is the vehicle; without GPS it is lost after a while."""
    flight = SteeredFlight(level, 1, start=(0, 0, 20), nav=PERFECT_NAV, **BLIND)
    sim = SimulatedAutopilot(vehicle=flight, estimate=FlownEstimate(flight))
    sim.hover()
    goal = flight.true_pose.translation
    flight.jump_gps((2.0, 0.0, -1.0))
    for _ in range(300):
        sim.step(0.05)
    assert flight.true_pose.translation == pytest.approx(goal - (2.0, 0.0, -1.0), abs=0.02)
    assert sim.estimated == pytest.approx(goal, abs=0.02)
    assert sim.attitude == pytest.approx(flight.true_pose.rotation, abs=1e-6)
    flight.lose_gps(60.0)
    located = []
    for _ in range(100):
        sim.step(0.1)
        located.append(sim.located)
    assert 7.0 < 0.1 * sum(located) < 8.0
    assert not located[-1]


def test_an_autopilot_reports_the_imu_and_the_battery_of_the_flight(level):
    flight = SteeredFlight(level, 1, start=(0, 0, 20), **BLIND)
    flight.step(0.5, Wanted())
    rates, force = flight.imu
    assert np.linalg.norm(force) == pytest.approx(9.8, abs=0.5)
    assert 0.0 < np.linalg.norm(rates) < 0.1  # noise and bias
    assert flight.battery < 1.0
    flight.lose_imu(1.0)
    flight.step(0.5, Wanted())
    assert flight.imu is None


def test_a_landing_ends_on_the_ground_at_the_speed_that_was_flown(level):
    flight = SteeredFlight(level, 1, start=(3, 2, 4), **BLIND)
    assert not flight.landed
    hold(flight, 9.0, Wanted(velocity=np.array([0.2, 0.0, -0.6])))
    assert flight.landed
    assert flight.height_above_ground == pytest.approx(0.0, abs=0.02)
    assert flight.contact.velocity_world == pytest.approx([0.2, 0.0, -0.6], abs=0.01)
    assert flight.contact.pose.translation[2] - flight.standing == pytest.approx(level.height_at(4, 2), abs=0.02)
    verdict = judge_touchdown(
        flight.world, OracleLander(), flight.contact.pose, flight.contact.velocity_world, flight.seconds
    )
    assert (verdict.safe, verdict.sink) == (True, pytest.approx(0.6, abs=0.01))
    assert hold(flight, 0.5, Wanted())  # the sensors continue


def posts(*things):
    """Build a level meadow with square objects: east, north, half a side, height, metres."""
    n = 600
    height = np.zeros((n, n), np.float32)
    grid = Grid(-30.0 + 0.05, 30.0 - 0.05, 0.1, n, n)
    x, y = grid.xy()
    for east, north, half, up in things:
        height[np.ix_(np.abs(y - north) <= half, np.abs(x - east) <= half)] = up
    return world_of(grid, height)


def test_what_stands_beside_the_way_is_struck_once():
    """The way passes 1.0 m beside a post that reaches 2 m above the feet; a vehicle of 0.8 m does not touch it."""
    world = posts((6.0, 1.1, 0.15, 12.0))
    struck = []
    for radius in (1.5, 0.8, 0.0):
        flight = SteeredFlight(world, 1, start=(0, 0, 10), radius=radius, **BLIND)
        hold(flight, 8.0, Wanted(position=flight.true_pose.translation + np.array([12.0, 0.0, 0.0])))
        struck.append([c.struck for c in flight.contacts])
    assert struck == [[pytest.approx(2.0, abs=0.05)], [], []]


def test_a_car_of_the_scene_is_as_solid_as_one_that_comes_on_command():
    """A car 1.5 m high drives below a vehicle whose feet are 1.3 m above the street."""
    traffic = Traffic(path=((-25.0, 0.0), (25.0, 0.0)), speed=5.0, gap=100.0)
    scene = Scene(ground=SceneGround(size=(60, 60), relief=()), imaging=Imaging(**QUIET), traffic=(traffic,))
    flight = SteeredFlight(build(scene), 1, start=(0, 0, 1.3), radius=0.5, **BLIND)
    hold(flight, 10.0)
    assert flight.contacts
    assert not SteeredFlight(build(LEVEL), 1, start=(0, 0, 1.3), radius=0.5, **BLIND).contacts


def test_the_last_metre_is_the_touchdowns():
    """A kerb of 0.8 m beside the touchdown is its roughness; an object 3 m high is struck on the way down."""
    for up, count in ((0.8, 1), (3.0, 2)):
        flight = SteeredFlight(posts((1.2, 0.0, 0.1, up)), 1, start=(0, 0, 5), radius=1.5, **BLIND)
        hold(flight, 12.0, Wanted(velocity=np.array([0.0, 0.0, -0.6])))
        assert flight.landed
        assert len(flight.contacts) == count
        assert [c.struck is None for c in flight.contacts] == [False, True][2 - count :]


def test_the_gap_is_that_to_the_highest_thing_within_the_radius():
    flight = SteeredFlight(posts((1.2, 0.0, 0.1, 3.0)), 1, start=(0, 0, 10), radius=1.5, **BLIND)
    assert flight.gap == pytest.approx(7.0, abs=0.05)
    assert flight.height_above_ground == pytest.approx(10.0, abs=0.05)
    flight.park(-1.0, 0.0)  # a car: lower than the post
    hold(flight, 0.3)
    assert flight.gap == pytest.approx(7.0, abs=0.1)
    bare = SteeredFlight(posts(), 1, start=(0, 0, 10), radius=1.5, **BLIND)
    bare.walk_in(1.6, 0.0, start=(1.6, 0.0))
    hold(bare, 0.3)
    assert 8.0 < bare.gap < 8.6  # a person whose shoulder lies within the radius


def test_a_new_wind_moves_it_until_the_autopilot_has_learned_it(level):
    flight = SteeredFlight(level, 1, start=(0, 0, 20), **BLIND)
    place = flight.true_pose.translation
    flight.wind(10.0, 0.0)
    away = []
    for _ in range(60):
        flight.step(0.2, Wanted(position=place))
        away.append(flight.true_pose.translation - place)
    assert 0.1 < max(a[0] for a in away) < 2.0
    assert away[-1] == pytest.approx([0, 0, 0], abs=0.03)
    lean = flight.true_pose.rotation[:, 2]
    assert lean[0] < -0.1  # into the wind


def test_a_gust_pushes_for_its_time(level):
    calm, blown = (SteeredFlight(level, 1, start=(0, 0, 20), **BLIND) for _ in range(2))
    place = calm.true_pose.translation
    blown.gust((0.0, 2.0, 0.0), 1.0)
    for flight in (calm, blown):
        hold(flight, 1.0, Wanted(position=place))
    assert calm.true_pose.translation == pytest.approx(place, abs=1e-9)
    assert 0.1 < (blown.true_pose.translation - place)[1] < 1.0
    hold(blown, 6.0, Wanted(position=place))
    assert blown.true_pose.translation == pytest.approx(place, abs=0.02)


def test_a_gust_that_lasts_is_learned_as_a_wind_is(level):
    """The limits of the autopilot just suffice to hold against 3 m/s^2; once the vehicle was blown 7 m away."""
    flight = SteeredFlight(level, 1, start=(0, 0, 20), **BLIND)
    place, away = flight.true_pose.translation, []
    flight.gust((0.0, 3.0, 0.0), 9.0)
    for _ in range(44):
        flight.step(0.2, Wanted(position=place))
        away.append((flight.true_pose.translation - place)[1])
    assert 0.3 < max(away) < 2.0
    assert abs(away[-1]) < 0.05


def test_the_battery_pays_for_hovering_and_climbing_and_its_end_is_a_fall(level):
    cost = TrueBattery(share=0.9, endurance=100.0, climb=0.01)
    flight = SteeredFlight(level, 1, start=(0, 0, 5), battery=cost, **BLIND)
    hold(flight, 5.0)
    assert flight.battery == pytest.approx(0.9 - 5.0 / 100.0, abs=1e-6)
    hold(flight, 8.0, Wanted(position=flight.true_pose.translation + np.array([0, 0, 6.0])))
    assert flight.battery == pytest.approx(0.9 - 13.0 / 100.0 - 6.0 * 0.01, abs=0.002)
    flight.drain(1.0)
    assert flight.battery == 0.0
    hold(flight, 3.0)
    assert flight.landed
    assert flight.contact.velocity_world[2] == pytest.approx(-math.sqrt(2 * 9.80665 * 11.0), rel=0.02)
    assert "sink" in judge_touchdown(level, OracleLander(), flight.contact.pose, flight.contact.velocity_world).reasons


# -- measurements


def test_same_seed_and_set_points_give_the_same_bits_and_another_seed_does_not():
    def flown(seed, cut=0.1):
        flight = SteeredFlight("demo", seed, start=(12, 12, 8), size=(64, 48), wind=(2, 1, 0), gusts=0.5)
        out = hold(flight, 0.6, Wanted(velocity=np.array([1.0, 0.0, -0.5])), dt=cut)
        flight.park(13.0, 13.0, start=(27.0, 12.0))
        flight.gust((1.0, 0, 0), 0.3)
        return bits(out + hold(flight, 0.6, Wanted(velocity=np.zeros(3)), dt=cut))

    one = flown(4)
    assert one == flown(4) == flown(4, 0.05)
    assert one != flown(5)


def test_events_come_in_order_at_their_rates(level):
    flight = SteeredFlight(level, 2, start=(0, 0, 10), size=(64, 48))
    events = hold(flight, 4.5)
    assert [len(of(events, kind)) for kind in (Frame, NavSample, ImuSample)] == [21, 90, 450]
    times = [e.t_ns for e in events]
    assert times == sorted(times)
    assert times[-1] <= flight.time_ns
    frames = of(events, Frame)
    assert {b.t_ns - a.t_ns for a, b in pairwise(frames)} == {200_000_000}
    assert all(len(f.images) == 2 and f.images[0].shape == (48, 64, 3) for f in frames)


def test_noise_is_as_claimed(level):
    nav = NavErrors(position=(0, 0, 0), position_white=0.3, attitude_deg=(0, 0, 0))
    imu = ImuErrors(gyroscope_bias=0.02, gyroscope_random_walk=0)
    flight = SteeredFlight(level, 3, start=(0, 0, 20), nav=nav, imu=imu, **BLIND)
    place = flight.true_pose.translation
    events = hold(flight, 30.0, dt=1.0)
    position = np.array([e.position_world for e in of(events, NavSample)]) - place
    assert position.std(axis=0) == pytest.approx(0.3, rel=0.12)
    assert of(events, NavSample)[0].sigma_position == pytest.approx([0.3] * 3)
    rates = np.array([e.angular_velocity_body for e in of(events, ImuSample)])
    assert rates.std(axis=0) == pytest.approx(4e-4 * math.sqrt(200.0), rel=0.05)
    assert 0.001 < np.abs(rates.mean(axis=0)).max() < 0.08  # the bias


def test_the_drift_of_gps_has_the_claimed_deviation_over_seeds(level):
    last = []
    for seed in range(60):
        flight = SteeredFlight(level, seed, start=(0, 0, 20), **BLIND)
        row = of(flight.step(0.1, Wanted(velocity=np.zeros(3))), NavSample)[-1]
        last.append(row.position_world - flight.true_pose.translation)
    assert np.std(last, axis=0) == pytest.approx([1.0, 1.0, 1.5], rel=0.3)


def test_a_perfect_imu_integrates_back_to_the_true_pose(level):
    flight = SteeredFlight(level, 3, start=(0, 0, 20), imu=PERFECT_IMU, wind=(3, 0, 0), **{**BLIND, "gusts": 0.5})
    pose = flight.true_pose
    R, p, v, h = pose.rotation, pose.translation.copy(), np.zeros(3), 1.0 / 200.0
    events = hold(flight, 3.0, Wanted(velocity=np.array([2.0, 1.0, -0.5]), heading=0.8))
    events += hold(flight, 3.0, Wanted(velocity=np.array([-1.0, 2.0, 0.5]), heading=-0.8))
    for e in of(events, ImuSample):
        a = R @ so3_exp(0.5 * h * e.angular_velocity_body) @ e.specific_force_body - (0, 0, 9.80665)
        p, v, R = p + v * h + 0.5 * a * h * h, v + a * h, R @ so3_exp(h * e.angular_velocity_body)
    assert p == pytest.approx(flight.true_pose.translation, abs=1e-6)
    assert v == pytest.approx(flight.body.velocity, abs=1e-6)
    assert np.abs(so3_log(R.T @ flight.true_pose.rotation)).max() < 1e-6


# -- objects on command


def picture(flight):
    return of(hold(flight, 0.4), Frame)[-1].images[0].astype(float)


def test_a_parked_car_is_in_the_pictures_and_in_the_truth(level):
    flight = SteeredFlight(level, 1, start=(0, 0, 12), **SMALL)
    hold(flight, 0.5)
    before, pose = picture(flight), flight.true_pose
    lander = OracleLander(radius=1.0)
    assert judge_touchdown(level, lander, pose, seconds=flight.seconds, bodies=flight.bodies).safe
    car = flight.park(0.0, 0.0, start=(20.0, 0.0))
    safe = judge_touchdown(level, lander, pose, seconds=flight.seconds, bodies=flight.bodies).safe
    assert safe  # the car is still on its way
    hold(flight, car.arrives - flight.seconds + 0.1)
    after = picture(flight)
    changed = (np.abs(after - before).max(axis=2) > 25).mean()
    share = 4.4 * 1.8 / (64 * 48 * (12.0 / 48.1) ** 2)  # of the picture that a car covers
    assert 0.6 * share < changed < 2.5 * share
    assert not judge_touchdown(level, lander, pose, seconds=flight.seconds, bodies=flight.bodies).safe
    assert not SteeredFlight(level, 1, **BLIND).bodies  # of another flight over the same world
    hold(flight, 9.0, Wanted(velocity=np.array([0.0, 0.0, -1.5])))
    assert flight.contact.pose.translation[2] == pytest.approx(level.height_at(0, 0) + 1.5 + flight.standing, abs=0.1)


def test_a_person_walks_to_the_spot_and_stays(level):
    flight = SteeredFlight(level, 1, start=(0, 0, 12), **SMALL)
    person = flight.walk_in(2.0, 1.0)
    places = person.place_at(np.array([person.since, person.since + 3.0, person.arrives, person.arrives + 50.0]))
    assert places[0, :2] == pytest.approx([2.0, -9.0])
    assert places[1, 1] == pytest.approx(-9.0 + 3 * 1.4)
    assert places[2:, :2] == pytest.approx(np.array([[2.0, 1.0], [2.0, 1.0]]), abs=1e-9)
    assert person.arrives == pytest.approx(person.since + 10.0 / 1.4 + 1.4 / 4.0)
    boxes = person.boxes_at(np.array([person.arrives]))[0]
    assert (boxes[:, 2] + boxes[:, 7]).max() - places[-1, 2] == pytest.approx(1.75)


def test_a_camera_freezes_is_lost_and_is_covered(level):
    flight = SteeredFlight(level, 1, start=(0, 0, 10), **SMALL)
    moving = Wanted(velocity=np.array([2.0, 0.0, 0.0]))
    hold(flight, 1.5, moving)
    flight.freeze_camera(0.5, camera=0)
    frozen = of(hold(flight, 0.5, moving), Frame)
    assert np.array_equal(frozen[0].images[0], frozen[1].images[0])
    assert not np.array_equal(frozen[0].images[1], frozen[1].images[1])
    flight.lose_camera(0.55, camera=1)
    assert all(f.images[1] is None and f.images[0] is not None for f in of(hold(flight, 0.5, moving), Frame))
    flight.lose_camera(0.55)
    assert not of(hold(flight, 0.5, moving), Frame)
    flight.cover_camera(0.55)
    assert of(hold(flight, 0.5, moving), Frame)[-1].images[0].mean() < 60
    flight.delay_frames(0.25, 0.5)  # one exposure
    late = hold(flight, 1.0, moving)
    stamps = [f.t_ns for f in of(late, Frame)]
    assert stamps != sorted(stamps)


def test_navigation_and_inertial_samples_are_lost_on_command(level):
    flight = SteeredFlight(level, 1, start=(0, 0, 10), **BLIND)
    hold(flight, 0.5)
    flight.lose_gps(1.0)
    rows = of(hold(flight, 1.0), NavSample)
    assert len(rows) == 20
    assert all(r.position_world is None and r.world_from_body is not None for r in rows)
    flight.lose_gps(1.0, "rows")
    flight.lose_imu(0.5)
    events = hold(flight, 1.0)
    assert not of(events, NavSample)
    assert len(of(events, ImuSample)) == pytest.approx(50, abs=1)


def test_a_lens_in_the_ground_sees_nothing_and_the_flight_goes_on():
    grid = Grid(-5.0, 5.0, 0.1, 101, 101)
    hill = np.zeros(grid.shape, np.float32)
    hill[48:53, 45:50] = 1.0  # left of the vehicle's place
    flight = SteeredFlight(world_of(grid, hill), 1, start=(0.0, 0.0, 0.0), **SMALL)
    image = of(hold(flight, 1.0), Frame)[-1].images
    assert image[0].mean() < 40 < image[1].mean() or image[1].mean() < 40 < image[0].mean()


def test_the_shape_of_the_pictures_must_be_that_of_the_rig():
    with pytest.raises(InputError, match="320 x 240"):
        SteeredFlight("demo", size=(320, 200))
