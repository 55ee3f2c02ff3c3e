"""The flight: limits, inertial consistency, honest noise, truth in closed form, and a log that reads back the same."""

import math
from itertools import pairwise

import numpy as np
import pytest
import rasterio
import yaml

from alight.geometry import Camera, Pose, so3_exp, so3_log
from alight.records import Frame, ImuSample, InputError, NavSample, OutputError, Rig, RigCamera, Terrain
from alight.settings import Settings
from alight.simulate import Footprint, Imaging, ImuErrors, Limits, NavErrors, build, default_rig, fly, write
from alight.simulate.flight import START_NS
from alight.simulate.sensors import gauss_markov
from alight.simulate.truth import safe_mask
from alight.simulate.vehicle import GRAVITY, fly_through
from alight.sources import open_source

QUIET = ImuErrors(200.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def small_rig():
    lens = Camera(64, 48, 48.0, 48.0, 31.7, 23.6, "radial-tangential", (-0.09, 0.02, -0.0008, 0.0006))
    return Rig(tuple(RigCamera(c.name, lens, c.body_from_cam) for c in default_rig().cameras))


@pytest.fixture(scope="module")
def world():
    return build("demo", 3)


# -- vehicle


def test_flight_keeps_its_limits_and_passes_near_its_way_points():
    points = [[0, 0, 20], [25, 0, 20], [25, 20, 20], [10, 20, 12]]
    limits = Limits(speed=6.0, acceleration=2.0, wobble=0.0, drift=0.0)
    flight = fly_through(points, limits, np.random.default_rng(0))
    t = np.linspace(0, flight.duration, 600)
    assert np.linalg.norm(flight.position.derivative(1)(t), axis=1).max() <= 6.0 + 1e-9
    assert np.linalg.norm(flight.position.derivative(2)(t), axis=1).max() <= 2.0 * math.sqrt(2) + 1e-6
    places = flight.position(t)
    for p in points:
        assert np.linalg.norm(places - p, axis=1).min() < 0.5
    assert np.linalg.norm(flight.velocity_world(flight.duration + 0.6)) < 1e-9


def test_multirotor_leans_into_its_acceleration():
    flight = fly_through(
        [[0, 0, 20], [40, 0, 20]], Limits(acceleration=3.0, wobble=0.0, drift=0.0), np.random.default_rng(0)
    )
    t = 0.9
    up = flight.pose(t).rotation[:, 2]
    a = flight.acceleration_world(t)
    assert a[0] > 1.0
    assert up[0] / up[2] == pytest.approx(a[0] / (GRAVITY + a[2]), rel=1e-9)
    assert flight.pose(t).rotation[:, 0] @ [1, 0, 0] > 0.9


def test_imu_integrates_back_to_the_trajectory(world, small_rig):
    flight = fly(world, 5, 3.0, rig=small_rig, imu=QUIET)
    samples = [e for e in flight.events() if isinstance(e, ImuSample)]
    pose, dt = flight.pose(samples[0].t_ns), 1 / 200.0
    R, p = pose.rotation, np.array(pose.translation)
    v = np.array(flight.trajectory.velocity_world((samples[0].t_ns - START_NS) * 1e-9))
    for a, b in pairwise(samples):
        R_next = R @ so3_exp(0.5 * dt * (a.angular_velocity_body + b.angular_velocity_body))
        force = 0.5 * (R @ a.specific_force_body + R_next @ b.specific_force_body) - [0, 0, GRAVITY]
        p, v, R = p + dt * v + 0.5 * dt * dt * force, v + dt * force, R_next
    end = flight.pose(samples[-1].t_ns)
    assert np.linalg.norm(p - end.translation) < 2e-3
    assert np.linalg.norm(so3_log(R.T @ end.rotation)) < 1e-4


# -- noise


def test_drift_has_the_claimed_deviation_and_correlation_time():
    t = np.arange(0, 4000, 1.0)
    x = gauss_markov(np.random.default_rng(2), t, np.array([1.0, 2.0] * 20), 60.0)
    assert x[:, ::2].std() == pytest.approx(1.0, rel=0.05)
    assert x[:, 1::2].std() == pytest.approx(2.0, rel=0.05)
    lag = (x[60:, ::2] * x[:-60, ::2]).mean() / x[:, ::2].var()
    assert lag == pytest.approx(math.exp(-1), abs=0.06)


def test_navigation_sigmas_are_true(world, small_rig):
    errors = []
    for seed in range(60):
        flight = fly(world, seed, 0.2, rig=small_rig)
        s = next(e for e in flight.events() if isinstance(e, NavSample))
        pose = flight.pose(s.t_ns)
        position = (s.position_world - pose.translation) / s.sigma_position
        attitude = so3_log(pose.rotation.T @ s.world_from_body) / s.sigma_attitude
        velocity = s.velocity_world - flight.trajectory.velocity_world((s.t_ns - START_NS) * 1e-9)
        errors.append([*position, *attitude, *(velocity / s.sigma_velocity)])
    deviation = np.sqrt(np.mean(np.square(errors), axis=0))
    assert (np.abs(deviation - 1) < 0.3).all(), deviation


def test_each_noise_has_its_own_stream(world, small_rig):
    """Changing the IMU leaves navigation and pictures as they were."""
    a = fly(world, 1, 0.3, rig=small_rig)
    b = fly(world, 1, 0.3, rig=small_rig, imu=ImuErrors(gyroscope_noise_density=1e-2, rate_hz=100.0))
    for kind in (NavSample, Frame):
        first, second = ([e for e in f.events() if isinstance(e, kind)] for f in (a, b))
        assert len(first) == len(second) > 0
        for x, y in zip(first, second, strict=True):
            if isinstance(x, Frame):
                assert all(np.array_equal(i, j) for i, j in zip(x.images, y.images, strict=True))
            else:
                assert np.array_equal(x.position_world, y.position_world)


def test_same_seed_same_events_and_they_are_in_order(world, small_rig):
    flight = fly(world, 4, 0.5, rig=small_rig)
    first, second = list(flight.events()), list(flight.events())
    times = [e.t_ns for e in first]
    assert times == sorted(times)
    assert sum(isinstance(e, Frame) for e in first) == flight.length == 5
    for a, b in zip(first, second, strict=True):
        if isinstance(a, Frame):
            assert all(np.array_equal(x, y) for x, y in zip(a.images, b.images, strict=True))
        if isinstance(a, ImuSample):
            assert np.array_equal(a.specific_force_body, b.specific_force_body)
    other = fly(world, 5, 0.5, rig=small_rig)
    assert not np.array_equal(flight.image(0, 0), other.image(0, 0))


# -- truth


def flat(n=41):
    return np.zeros((n, n), np.float32), np.full((n, n), Terrain.SHORT_GRASS, np.uint8)


def test_safe_is_the_plane_within_the_slope_limit():
    _, label = flat()
    x = 0.1 * np.arange(41) - 2.0
    for degrees, heading, safe in ((9.9, 0.3, True), (10.1, 0.3, False), (9.9, 2.1, True), (10.1, 2.1, False)):
        ramp = math.tan(math.radians(degrees)) * (math.cos(heading) * x[None] + math.sin(heading) * x[:, None])
        mask = safe_mask(ramp.astype(np.float32), label, 0.1, Footprint())
        assert mask[15:26, 15:26].all() == safe
        assert mask[15:26, 15:26].any() == safe


def test_safe_ends_where_the_footprint_meets_a_stone_or_the_edge():
    height, label = flat(81)
    height[40, 40] = 0.17
    mask = safe_mask(height, label, 0.1, Footprint())
    rows, cols = np.mgrid[:81, :81]
    away = np.hypot(rows - 40, cols - 40) * 0.1
    inside = (np.minimum(rows, cols) >= 15) & (np.maximum(rows, cols) <= 65)
    assert np.array_equal(mask, inside & (away > 1.5 + 1e-9))
    height[40, 40] = 0.14
    assert np.array_equal(safe_mask(height, label, 0.1, Footprint()), inside)


@pytest.mark.parametrize("kind", list(Terrain))
def test_safe_asks_for_an_allowed_class_in_the_whole_footprint(kind):
    height, label = flat()
    label[20, 34] = kind
    mask = safe_mask(height, label, 0.1, Footprint())
    assert mask[20, 20] == (kind in (Terrain.BARE, Terrain.SHORT_GRASS, Terrain.PAVED))
    assert mask[20, 18]


def test_safe_fraction_of_the_sample_flight_agrees_with_its_maker(shared_data):
    truth = shared_data / "sample" / "truth"
    with rasterio.open(truth / "dem.tif") as dem, rasterio.open(truth / "class.tif") as kinds:
        height, label = dem.read(1), kinds.read(1)
    expected = yaml.safe_load((truth / "scene.yaml").read_text())["safety"]["safe_fraction"]
    assert safe_mask(height, label, 0.1, Footprint()).mean() == pytest.approx(expected, abs=2e-6)


def test_demo_has_room_to_land_and_hazards_and_hopeless_has_no_room():
    demo, hopeless = fly("demo", 0), fly("hopeless", 0)
    assert 0.05 < demo.truth.safe().mean() < 0.5
    assert set(np.unique(demo.world.label)) == set(range(1, 9))
    assert demo.truth.safe(Footprint(radius=2.5)).any()
    assert not hopeless.truth.safe().any()


# -- the log


@pytest.fixture(scope="module")
def written(world, small_rig, tmp_path_factory):
    out = tmp_path_factory.mktemp("simulated") / "flight"
    flight = fly(world, 7, 0.5, rate_hz=6.0, rig=small_rig)
    seen = []
    write(flight, out, lambda done, total: seen.append((done, total)), image="png")
    assert seen == [(1, 4), (2, 4), (3, 4), (4, 4)]
    return flight, out


def test_written_log_reads_back_the_same(written):
    flight, out = written
    source = open_source(out, Settings())
    assert (source.kind, source.georeferenced, source.length) == ("flight", True, 4)
    assert source.local == flight.local
    for a, b in zip(source.rig.cameras, flight.rig.cameras, strict=True):
        assert a.camera == b.camera
        assert np.abs(a.body_from_cam.matrix - b.body_from_cam.matrix).max() < 1e-12
    theirs, ours = list(source.events()), list(flight.events())
    assert not source.warnings
    assert [type(e) for e in theirs] == [type(e) for e in ours]
    for a, b in zip(theirs, ours, strict=True):
        assert a.t_ns == b.t_ns
        if isinstance(a, Frame):
            assert all(np.array_equal(x, y) for x, y in zip(a.images, b.images, strict=True))
        elif isinstance(a, NavSample):
            assert np.abs(a.position_world - b.position_world).max() < 2e-4
            assert np.abs(a.world_from_body - b.world_from_body).max() < 1e-8
            assert np.abs(a.sigma_position - b.sigma_position).max() < 1e-6
        else:
            assert np.abs(a.specific_force_body - b.specific_force_body).max() < 1e-8


def test_written_truth_reads_back_the_same(written):
    flight, out = written
    times, poses = open_source(out, Settings()).truth_trajectory
    for frame_ns in flight.frame_times:
        there = poses[int(np.flatnonzero(times == frame_ns)[0])]
        assert np.abs(there.matrix - flight.pose(int(frame_ns)).matrix).max() < 1e-8
    with rasterio.open(out / "truth" / "dem.tif") as dem:
        height, corner = dem.read(1), dem.xy(0, 0)
        assert dem.crs == rasterio.crs.CRS.from_string(flight.local.crs)
    assert corner == pytest.approx((flight.world.grid.east, flight.world.grid.north), abs=1e-9)
    assert np.abs(height - flight.local.height - flight.world.height).max() < 3e-4
    with rasterio.open(out / "truth" / "class.tif") as kinds:
        assert np.array_equal(kinds.read(1), flight.world.label)
    scene = yaml.safe_load((out / "truth" / "scene.yaml").read_text())
    assert scene["safety"]["safe_fraction"] == pytest.approx(flight.truth.safe().mean(), abs=1e-6)
    assert scene["frames"] == 4


def test_pictures_and_truth_agree_through_the_written_files(written):
    """The depth that the log's own poses, calibration and DEM give is the depth that was drawn."""
    flight, out = written
    source = open_source(out, Settings())
    times, poses = source.truth_trajectory
    t = int(flight.frame_times[1])
    pose = poses[int(np.flatnonzero(times == t)[0])] @ source.rig.cameras[1].body_from_cam
    eye = flight.eyes[1]
    drawn = eye.depth(flight.world, flight.pose(t) @ flight.rig.cameras[1].body_from_cam)
    u, v = np.meshgrid(np.arange(64.0), np.arange(48.0))
    points = pose.apply(source.rig.cameras[1].camera.rays(np.stack([u, v], -1)) * drawn[..., None])
    for r, c in ((5, 5), (20, 30), (40, 60)):
        assert flight.world.height_at(points[r, c, 0], points[r, c, 1]) == pytest.approx(points[r, c, 2], abs=1e-3)


def test_writer_refuses_what_is_there_and_leaves_nothing_half_done(written, tmp_path):
    flight, out = written
    with pytest.raises(OutputError, match="exists already"):
        write(flight, out)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter.txt").write_text("dear")
    with pytest.raises(OutputError, match="mine"):
        write(flight, tmp_path / "mine", overwrite=True)

    def interrupt(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write(flight, tmp_path / "new", interrupt)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["mine"]
    write(flight, out, image="png", overwrite=True)
    assert (out / "truth" / "scene.yaml").is_file()


# -- bad wishes


@pytest.mark.parametrize(
    ("wish", "says"),
    [
        ({"scene": "moon"}, "demo"),
        ({"duration": 60.0}, "leaves the world"),
        ({"height": 1.0}, "fly higher"),
        ({"waypoints": [[0, 0, 20]]}, "two way-points"),
        ({"waypoints": [[0, 0, 30], [0, 0, -20]]}, "fly higher"),
    ],
)
def test_flights_that_cannot_be_flown_are_refused(wish, says):
    with pytest.raises(InputError, match=says):
        fly(**wish)


def test_camera_below_the_ground_is_refused(world):
    from alight.simulate.cameras import Eye

    eye = Eye(Camera(8, 6, 6.0, 6.0, 3.5, 2.5), Imaging())
    with pytest.raises(InputError, match="below the ground"):
        eye.depth(world, Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, -50.0])))


def test_way_points_start_and_end_at_rest(world, small_rig):
    flight = fly(world, 0, waypoints=[[-5, 0, 25], [5, 0, 25], [5, 0, 12]], rig=small_rig, nav=NavErrors(rate_hz=5.0))
    assert flight.seconds > 5.0
    for t in (-0.4, flight.seconds + 0.4):
        assert np.linalg.norm(flight.trajectory.velocity_world(t)) < 0.5
