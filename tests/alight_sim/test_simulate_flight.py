"""The assembled flight: one source of events for any faults, truth beside it, and a log that reads back the same."""

import dataclasses
import math

import numpy as np
import pytest
import rasterio
import yaml

from alight.geometry import Camera, Pose, so3_log
from alight.records import Frame, ImuSample, InputError, NavSample, OutputError, Rig, RigCamera, Terrain
from alight.runner.opening import open_source
from alight.settings import Settings
from alight_sim import (  # fmt: skip
    Faults,
    FlightPlan,
    Imaging,
    ImuErrors,
    NavErrors,
    RigModel,
    Scene,
    TrueFootprint,
    build,
    default_rig,
    fly,
    read_scene,
    write,
)
from alight_sim.flight import START_NS
from alight_sim.truth import safe_mask

EVERYTHING = {
    "dropped": 0.15, "dropped_one": 0.2, "jitter": 0.004, "time_offset": 0.02, "mounting_deg": (0.4, -0.3, 1.0),
    "calibration": {"focal": 0.004, "toe_deg": 0.1}, "covered": [{"at": 0.6, "seconds": 0.4, "camera": 1}],
}  # fmt: skip
HOLES = {"outages": [{"at": 0.2, "seconds": 0.3}, {"at": 1.0, "seconds": 0.2, "what": "rows"}], "yaw_start_deg": 4.0}


@pytest.fixture(scope="module")
def small_rig():
    lens = Camera(64, 48, 48.0, 48.0, 31.7, 23.6, "radial-tangential", (-0.09, 0.02, -0.0008, 0.0006))
    return Rig(tuple(RigCamera(c.name, lens, c.body_from_cam) for c in default_rig().cameras))


@pytest.fixture(scope="module")
def world():
    return build("demo", 3)


def of(flight, kind):
    return [e for e in flight.events() if isinstance(e, kind)]


def same(a, b):
    """Return whether two records are equal, bit for bit."""
    if type(a) is not type(b):
        return False
    for f in dataclasses.fields(a):
        x, y = getattr(a, f.name), getattr(b, f.name)
        x, y = (x, y) if isinstance(x, tuple) else ((x,), (y,))
        if not all((i is None and j is None) or np.array_equal(i, j) for i, j in zip(x, y, strict=True)):
            return False
    return True


# -- the flight


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


@pytest.mark.parametrize(
    ("wish", "touched"),
    [
        ({"imu": ImuErrors(gyroscope_noise_density=1e-2, rate_hz=100.0)}, ImuSample),
        ({"nav": NavErrors(position=(5, 5, 5), rate_hz=5.0)}, NavSample),
        ({"imaging": Imaging(noise=2.0, gain_drift=0.3)}, Frame),
        ({"faults": Faults(covered=[{"at": 0.0, "seconds": 9.0}])}, Frame),
    ],
)
def test_each_sensor_has_streams_of_its_own(world, small_rig, wish, touched):
    a, b = fly(world, 1, 0.3, rig=small_rig), fly(world, 1, 0.3, rig=small_rig, **wish)
    for kind in (NavSample, ImuSample, Frame):
        first, second = of(a, kind), of(b, kind)
        equal = len(first) == len(second) and all(same(x, y) for x, y in zip(first, second, strict=True))
        assert equal == (kind is not touched), kind


def test_a_lost_exposure_leaves_the_other_pictures_bit_for_bit(world, small_rig):
    whole = {f.t_ns: f for f in of(fly(world, 1, 1.0, rate_hz=10, rig=small_rig), Frame)}
    left = of(fly(world, 1, 1.0, rate_hz=10, rig=small_rig, faults=Faults(dropped=0.4)), Frame)
    assert 3 <= len(left) < len(whole)
    assert all(same(f, whole[f.t_ns]) for f in left)


def test_same_seed_same_events_and_they_are_in_order(world, small_rig):
    flight = fly(world, 4, 0.5, rig=small_rig)
    first, second = list(flight.events()), list(flight.events())
    times = [e.t_ns for e in first]
    assert times == sorted(times)
    assert sum(isinstance(e, Frame) for e in first) == flight.length == 5
    assert all(same(a, b) for a, b in zip(first, second, strict=True))
    other = fly(world, 5, 0.5, rig=small_rig)
    assert not np.array_equal(flight.image(0, 0), other.image(0, 0))


def test_late_frames_come_late_and_keep_their_stamp(world, small_rig):
    flight = fly(world, 2, 3.0, rate_hz=5, rig=small_rig, faults=Faults(late=0.4, late_by=0.5))
    events = list(flight.events())
    stamps = [e.t_ns for e in events if isinstance(e, Frame)]
    assert sorted(stamps) == flight.frame_times.tolist()
    assert stamps != sorted(stamps)
    clock = 0
    for e in events:  # only frames may be behind the clock
        assert isinstance(e, Frame) or e.t_ns >= clock
        clock = max(clock, e.t_ns)


def test_stamps_are_off_by_the_time_offset_and_pictures_are_not(world, small_rig):
    right, off = (fly(world, 2, 0.5, rig=small_rig, faults=Faults(time_offset=o)) for o in (0.0, 0.25))
    for a, b in zip(of(right, Frame), of(off, Frame), strict=True):
        assert b.t_ns - a.t_ns == 250_000_000
        assert all(np.array_equal(x, y) for x, y in zip(a.images, b.images, strict=True))


def test_wrong_calibration_is_claimed_and_not_drawn(world, small_rig):
    wrong = Faults(calibration={"focal": 0.02}, mounting_deg=(1.0, 0.0, 0.0))
    a, b = fly(world, 2, 0.2, rig=small_rig), fly(world, 2, 0.2, rig=small_rig, faults=wrong)
    assert np.array_equal(a.image(0, 1), b.image(0, 1))
    assert all(x.camera == y.camera for x, y in zip(b.true_rig.cameras, small_rig.cameras, strict=True))
    assert b.rig.cameras[0].camera.fu == pytest.approx(1.02 * 48.0)


def test_covered_lens_is_dark_for_its_time_and_its_camera(world, small_rig):
    faults = Faults(covered=[{"at": 0.5, "seconds": 0.5, "camera": 1}])
    means = [
        [i.mean() for i in f.images] for f in of(fly(world, 2, 1.4, rate_hz=5, rig=small_rig, faults=faults), Frame)
    ]
    dark = np.array(means) < 40
    assert dark.tolist() == [[False, 0.5 <= k * 0.2 < 1.0] for k in range(8)]


def test_lost_pictures_are_counted(world, small_rig):
    flight = fly(world, 2, 4.0, rate_hz=10, rig=small_rig, faults=Faults(dropped=0.3, dropped_one=0.3))
    seen = flight.exposures.seen
    assert flight.counts["exposures"] == flight.length == seen.any(axis=1).sum() < 41
    assert flight.counts["cam1 images lost"] == (~seen[:, 1]).sum()
    assert "cam0 images lost" not in fly(world, 2, 1.0, rig=small_rig).counts


def test_everything_that_the_cameras_see_lies_in_the_box_of_the_truth(world, small_rig):
    flight = fly(world, 2, 2.0, rate_hz=2, rig=small_rig)
    west, south, east, north = flight.seen
    u, v = np.meshgrid(np.arange(64.0), np.arange(48.0))
    for t_ns in flight.frame_times:
        for eye, cam in zip(flight.eyes, small_rig.cameras, strict=True):
            pose = flight.pose(int(t_ns)) @ cam.body_from_cam
            depth = eye.depth(world, pose)
            points = pose.apply(cam.camera.rays(np.stack([u, v], -1)) * depth[..., None])[depth > 0]
            assert (points[:, 0] > west).all()
            assert (points[:, 0] < east).all()
            assert (points[:, 1] > south).all()
            assert (points[:, 1] < north).all()
    assert (east - west) * (north - south) < 0.75 * 72**2  # it is a box about the flight, not the world
    grid = flight.truth.grid
    assert grid.east - west < 1.5 * grid.cell
    assert grid.rows * grid.cell == pytest.approx(north - south, abs=2 * grid.cell)


def test_heights_count_from_the_ground_under_the_start_or_from_the_origin(world):
    start = [-15.0, 2.0]
    ground = np.array([[world.height_at(start[0] + e, start[1] + n) for e in range(-5, 6)] for n in range(-5, 6)])
    above = fly(world, 0, waypoints=[[*start, 30.0], [0.0, 0.0, 30.0]]).pose(START_NS).translation
    plain = fly(world, 0, plan=FlightPlan(above="origin", waypoints=[[*start, 30.0], [0.0, 0.0, 30.0]]))
    difference = above[2] - plain.pose(START_NS).translation[2]
    assert ground.min() <= difference <= np.median(ground)


def test_way_points_start_and_end_at_rest(world, small_rig):
    flight = fly(world, 0, waypoints=[[-5, 0, 25], [5, 0, 25], [5, 0, 12]], rig=small_rig, nav=NavErrors(rate_hz=5.0))
    assert flight.seconds > 5.0
    for t in (-0.4, flight.seconds + 0.4):
        assert np.linalg.norm(flight.trajectory.velocity_world(t)) < 0.5


# -- truth


def flat(n=41):
    return np.zeros((n, n), np.float32), np.full((n, n), Terrain.SHORT_GRASS, np.uint8)


def test_safe_is_the_plane_within_the_slope_limit():
    _, label = flat()
    x = 0.1 * np.arange(41) - 2.0
    for degrees, heading, safe in ((9.9, 0.3, True), (10.1, 0.3, False), (9.9, 2.1, True), (10.1, 2.1, False)):
        ramp = math.tan(math.radians(degrees)) * (math.cos(heading) * x[None] + math.sin(heading) * x[:, None])
        mask = safe_mask(ramp.astype(np.float32), label, 0.1, TrueFootprint())
        assert mask[15:26, 15:26].all() == safe
        assert mask[15:26, 15:26].any() == safe


def test_safe_ends_where_the_footprint_meets_a_stone_or_the_edge():
    height, label = flat(81)
    height[40, 40] = 0.17
    mask = safe_mask(height, label, 0.1, TrueFootprint())
    rows, cols = np.mgrid[:81, :81]
    away = np.hypot(rows - 40, cols - 40) * 0.1
    inside = (np.minimum(rows, cols) >= 15) & (np.maximum(rows, cols) <= 65)
    assert np.array_equal(mask, inside & (away > 1.5 + 1e-9))
    height[40, 40] = 0.14
    assert np.array_equal(safe_mask(height, label, 0.1, TrueFootprint()), inside)


@pytest.mark.parametrize("kind", list(Terrain))
def test_safe_asks_for_an_allowed_class_in_the_whole_footprint(kind):
    height, label = flat()
    label[20, 34] = kind
    mask = safe_mask(height, label, 0.1, TrueFootprint())
    assert mask[20, 20] == (kind in (Terrain.BARE, Terrain.SHORT_GRASS, Terrain.PAVED))
    assert mask[20, 18]


def test_safe_fraction_of_the_sample_flight_agrees_with_its_maker(shared_data):
    truth = shared_data / "sample" / "truth"
    with rasterio.open(truth / "dem.tif") as dem, rasterio.open(truth / "class.tif") as kinds:
        height, label = dem.read(1), kinds.read(1)
    expected = yaml.safe_load((truth / "scene.yaml").read_text())["safety"]["safe_fraction"]
    assert safe_mask(height, label, 0.1, TrueFootprint()).mean() == pytest.approx(expected, abs=2e-6)


# -- the log


@pytest.fixture(scope="module", params=["sound", "damaged"])
def written(request, world, small_rig, tmp_path_factory):
    """Write a flight of four exposures that all arrive, and one with nearly every fault."""
    out = tmp_path_factory.mktemp("simulated") / "flight"
    damage = {"faults": Faults.model_validate(EVERYTHING), "nav": NavErrors.model_validate(HOLES)}
    wishes = damage if request.param == "damaged" else {}
    flight = fly(world, 7, 1.5, rate_hz=8.0 if wishes else 2.0, rig=small_rig, **wishes)
    seen = []
    write(flight, out, lambda done, total: seen.append((done, total)), image="png")
    assert seen == [(k + 1, flight.length) for k in range(flight.length)]
    return flight, out


def test_written_log_reads_back_the_same(written):
    flight, out = written
    source = open_source(out, Settings())
    assert (source.kind, source.georeferenced, source.length) == ("flight", True, flight.length)
    assert source.local == flight.local
    for a, b in zip(source.rig.cameras, flight.rig.cameras, strict=True):
        assert a.camera == b.camera
        assert np.abs(a.body_from_cam.matrix - b.body_from_cam.matrix).max() < 1e-12
    theirs, ours = list(source.events()), list(flight.events())
    assert [type(e) for e in theirs] == [type(e) for e in ours]
    for a, b in zip(theirs, ours, strict=True):
        assert a.t_ns == b.t_ns
        if isinstance(a, Frame):
            assert all(np.array_equal(x, y) for x, y in zip(a.images, b.images, strict=True))
        elif isinstance(a, NavSample):
            assert (a.position_world is None) == (b.position_world is None) == (a.sigma_position is None)
            if a.position_world is not None:
                assert np.abs(a.position_world - b.position_world).max() < 2e-4
                assert np.abs(a.sigma_position - b.sigma_position).max() < 1e-6
            assert np.abs(a.world_from_body - b.world_from_body).max() < 1e-8
        else:
            assert np.abs(a.specific_force_body - b.specific_force_body).max() < 1e-8
    lost = {k.replace(" lost", " left out"): n for k, n in flight.counts.items() if k != "exposures"}
    for name, count in lost.items():  # missing rows at the ends of the log are an excerpt
        assert 0 < source.counts.get(name, 0) <= count
    assert bool(source.warnings) == bool(lost)


def test_log_with_late_and_repeated_frames_is_in_order_and_readable(world, small_rig, tmp_path):
    faults = Faults(late=0.5, late_by=0.5, repeated=0.3)
    flight = fly(world, 3, 2.0, rate_hz=5.0, rig=small_rig, faults=faults)
    write(flight, tmp_path / "flight", image="png")
    rows = (tmp_path / "flight" / "mav0" / "cam0" / "data.csv").read_text().splitlines()[1:]
    stamps = [int(r.split(",")[0]) for r in rows]
    assert stamps == sorted(stamps)
    assert len(set(stamps)) < len(stamps) == len({r.split(",")[1] for r in rows})
    source = open_source(tmp_path / "flight", Settings())
    assert [e.t_ns for e in source.events() if isinstance(e, Frame)] == sorted(set(stamps))
    table = np.loadtxt(tmp_path / "flight" / "truth" / "exposures.csv", delimiter=",", dtype=np.int64)
    assert np.array_equal(table[:, 0], flight.exposures.true_ns)
    assert np.array_equal(table[:, 2], flight.exposures.arrival_ns)


def test_written_truth_reads_back_the_same(written):
    flight, out = written
    times, poses = open_source(out, Settings()).truth_trajectory
    for frame_ns in flight.frame_times:
        there = poses[int(np.flatnonzero(times == frame_ns)[0])]
        assert np.abs(there.matrix - flight.pose(int(frame_ns)).matrix).max() < 1e-8
    with rasterio.open(out / "truth" / "dem.tif") as dem:
        height, corner = dem.read(1), dem.xy(0, 0)
        assert dem.crs == rasterio.crs.CRS.from_string(flight.local.crs)
    assert corner == pytest.approx((flight.truth.grid.east, flight.truth.grid.north), abs=1e-9)
    assert np.abs(height - flight.local.height - flight.truth.height).max() < 3e-4
    with rasterio.open(out / "truth" / "class.tif") as kinds:
        assert np.array_equal(kinds.read(1), flight.truth.label)
    scene = yaml.safe_load((out / "truth" / "scene.yaml").read_text())
    assert scene["safety"]["safe_fraction"] == pytest.approx(flight.truth.safe().mean(), abs=1e-6)
    assert scene["frames"] == flight.length
    assert scene["true_rig"]["cam0"]["intrinsics"][0] == 48.0
    assert scene["faults"] == flight.faults.model_dump(mode="json")


def test_pictures_and_truth_agree_through_the_written_files(written):
    """The depth by the log's poses, the true calibration and the DEM is the drawn depth."""
    flight, out = written
    times, poses = open_source(out, Settings()).truth_trajectory
    t, cam = int(flight.frame_times[1]), flight.true_rig.cameras[1]
    pose = poses[int(np.flatnonzero(times == t)[0])] @ cam.body_from_cam
    drawn = flight.eyes[1].depth(flight.world, flight.pose(t) @ cam.body_from_cam)
    u, v = np.meshgrid(np.arange(64.0), np.arange(48.0))
    points = pose.apply(cam.camera.rays(np.stack([u, v], -1)) * drawn[..., None])
    for r, c in ((5, 5), (20, 30), (40, 60)):
        assert flight.world.height_at(points[r, c, 0], points[r, c, 1]) == pytest.approx(points[r, c, 2], abs=1e-3)


def test_the_scene_that_was_used_makes_the_same_flight_again(small_rig, tmp_path):
    wishes = {"faults": Faults.model_validate(EVERYTHING), "nav": NavErrors.model_validate(HOLES), "rig": small_rig}
    flight = fly("demo", 6, 0.5, height=31.0, rate_hz=4.0, imaging=Imaging(hot_pixels=0.01), **wishes)
    write(flight, tmp_path / "flight")
    again = fly(tmp_path / "flight" / "truth" / "scene-used.yaml", 6)
    assert again.scene == flight.scene
    assert again.repeatable
    first, second = list(flight.events()), list(again.events())
    assert len(first) == len(second)
    assert all(same(a, b) for a, b in zip(first, second, strict=True))


def test_a_flight_that_its_scene_does_not_make_again_says_so(written):
    flight, out = written
    assert not flight.repeatable  # another seed than the world's was given in Python
    assert not (out / "truth" / "scene-used.yaml").exists()


def test_writer_refuses_what_is_there_and_leaves_nothing_half_done(world, small_rig, tmp_path):
    flight, out = fly(world, 7, 0.5, rate_hz=4.0, rig=small_rig), tmp_path / "flight"
    write(flight, out)
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
    assert sorted(p.name for p in tmp_path.iterdir()) == ["flight", "mine"]
    write(flight, out, image="png", overwrite=True)
    assert (out / "truth" / "scene.yaml").is_file()


# -- invalid wishes


@pytest.mark.parametrize(
    ("wish", "says"),
    [
        ({"scene": "moon"}, "demo"),
        ({"duration": 60.0}, "leaves the world"),
        ({"height": 1.0}, "fly higher"),
        ({"height": -5.0}, "height"),
        ({"waypoints": [[0, 0, 30], [200, 0, 30]]}, "way-point 2 is at east 200"),
        ({"waypoints": [[0, 0, 30], [0, 0, 30]]}, "same place"),
        ({"waypoints": [[0, 0, 30], [0, 0, -20]]}, "way-point 2 .* is inside the ground"),
        ({"waypoints": [[0, 0, 30, 4]]}, "waypoints"),
        (
            {"plan": FlightPlan(pattern="descent", height=40.0, end_height=0.5, length=0)},
            "comes within 2 m of the ground",
        ),
        ({"plan": FlightPlan(pattern="hover", duration=9000.0)}, "2.5 hours"),
        ({"plan": FlightPlan(air={"wind": 40.0})}, "tilt limit"),
        ({"plan": FlightPlan(pattern="lawn_mower", spacing=30.0)}, "leaves the world"),
    ],
)
def test_flights_that_cannot_be_flown_are_refused(wish, says):
    with pytest.raises(InputError, match=says) as refusal:
        fly(**wish)
    assert "\n" not in str(refusal.value)


def test_a_way_point_inside_a_tree_or_house_is_named_so(world):
    truth = world.truth()
    for kind, word in ((Terrain.TREE, "a tree"), (Terrain.STRUCTURE, "a building")):
        rows, cols = np.nonzero((truth.label == kind) & (truth.height > 3.0))
        k = int(np.argmax(truth.height[rows, cols]))
        east, north = truth.grid.xy()[0][cols[k]], truth.grid.xy()[1][rows[k]]
        inside = [float(east), float(north), float(truth.height[rows[k], cols[k]]) - 0.5]
        plan = FlightPlan(above="origin", waypoints=[[0, 0, 30], inside])
        with pytest.raises(InputError, match=f"way-point 2 .* is inside {word}"):
            fly(world, plan=plan)


def test_camera_below_the_ground_is_refused(world, small_rig):
    eye = fly(world, 0, 0.2, rig=small_rig).eyes[0]
    with pytest.raises(InputError, match="below the ground"):
        eye.depth(world, Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, -50.0])))


def test_a_scene_file_says_how_to_fly(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("ground: {size: [60, 60]}\nflight: {height: 25, speed: 3}\nimaging: {rate_hz: 4}\n")
    flight = fly(path, 1)
    assert (flight.plan.height, flight.plan.speed, flight.rate_hz) == (25.0, 3.0, 4.0)
    assert isinstance(read_scene(path), Scene)
    assert fly(path, 1, speed=2.0).plan.speed == 2.0
    assert math.isclose(flight.seconds, 8.0)
    path.write_text("flight: {hight: 25}\n")
    with pytest.raises(InputError, match="hight"):
        fly(path)


# -- the shutter


def sharpness(picture, axis):
    return float(np.abs(np.diff(picture.astype(float).mean(axis=2), axis=axis)).mean())


def test_an_open_shutter_blurs_along_the_flight_and_not_across(world, small_rig):
    """2 m/s, 10 m up, f = 48 px: 0.5 s is 5 px along the rows' normal (the image's top is forward)."""
    calm = FlightPlan(height=10.0, speed=2.0, duration=2.0, air={"wind": 0.0, "gusts": 0.0, "wobble_deg": 0.0})
    clear = {"blur_px": 0.0, "noise": 0.0, "gain_drift": 0.0, "white_balance": 0.0}
    sharp, open_long, still = (
        fly(world, 1, plan=plan, rig=small_rig, imaging=Imaging(**clear, exposure_time=t, moments=16)).image(6, 0)
        for plan, t in (
            (calm, 0.0),
            (calm, 0.5),
            (calm.model_copy(update={"pattern": "hover", "centre": (0.5, 0.1)}), 0.5),
        )
    )
    assert sharpness(open_long, 0) < 0.5 * sharpness(sharp, 0)
    assert sharpness(open_long, 1) > sharpness(open_long, 0)
    assert sharpness(still, 0) > 0.7 * sharpness(sharp, 0)


def test_a_rolling_shutter_reads_each_row_at_its_own_time(world, small_rig):
    calm = FlightPlan(height=15.0, speed=4.0, duration=2.0, air={"wind": 0.0, "gusts": 0.0, "wobble_deg": 0.0})
    clear = {"noise": 0.0, "gain_drift": 0.0, "white_balance": 0.0, "blur_px": 0.0}
    line_time = 2e-3
    rolled = fly(world, 1, plan=calm, rig=small_rig, imaging=Imaging(**clear, line_time=line_time)).image(8, 0)
    rows = fly(world, 1, plan=calm, rig=small_rig, imaging=Imaging(**clear, rate_hz=1000.0))
    for r in (3, 40):  # each row of the picture is exposed at that row's time
        index = round(1000 + (r - 23.5) * line_time * 1000)
        ours, theirs = rows.image(index, 0)[r].astype(int), rolled[r].astype(int)
        assert np.abs(ours - theirs).mean() < 1.0
        assert np.abs(rows.image(1000, 0)[r].astype(int) - theirs).mean() > 3.0


def test_exposure_control_settles_on_its_target_and_follows(world, small_rig):
    wishes = {
        "auto": True,
        "auto_target": 0.3,
        "gain_drift": 0.0,
        "white_balance": 0.0,
        "gamma": 1.0,
        "vignetting": 0.0,
    }
    means = []
    for gain in (0.7, 2.0):
        flight = fly(world, 1, 3.0, rate_hz=4.0, rig=small_rig, imaging=Imaging(**wishes, gain=gain))
        means.append(np.mean([flight.image(k, 0).mean() / 255 for k in (0, 6, 11)]))
    assert means[0] == pytest.approx(0.3, rel=0.2)
    assert means[0] == pytest.approx(means[1], rel=0.02)


# -- rigs


def test_a_rig_survives_its_description_bit_for_bit():
    for name in ("pair", "single", "wide", "oblique"):
        rig = RigModel.model_validate(name).rig
        tree = yaml.safe_load(yaml.safe_dump(RigModel.of(rig).model_dump(mode="json")))
        for a, b in zip(RigModel.model_validate(tree).rig.cameras, rig.cameras, strict=True):
            assert (a.name, a.camera) == (b.name, b.camera)
            assert np.array_equal(a.body_from_cam.matrix, b.body_from_cam.matrix)


def test_a_sensor_yaml_may_be_pasted_into_a_scene(written):
    flight, out = written
    trees = [yaml.safe_load((out / "mav0" / c / "sensor.yaml").read_text()) for c in ("cam0", "cam1")]
    rig = RigModel.model_validate({"cameras": trees}).rig
    for a, b in zip(rig.cameras, flight.rig.cameras, strict=True):
        assert a.camera == b.camera
        assert np.abs(a.body_from_cam.matrix - b.body_from_cam.matrix).max() < 1e-12


def test_a_camera_is_its_field_of_view_and_its_tilt():
    cam = RigModel.model_validate(
        {"cameras": [{"resolution": [320, 240], "field_deg": 90, "tilt_deg": 30}]}
    ).rig.cameras[0]
    assert cam.camera.fu == pytest.approx(160.0)
    axis = cam.body_from_cam.rotation[:, 2]
    assert axis == pytest.approx([math.cos(math.radians(30)), 0.0, -0.5])
    assert cam.body_from_cam.rotation[:, 0] == pytest.approx([0.0, -1.0, 0.0])  # the image's right is the body's right
    assert np.linalg.det(cam.body_from_cam.rotation) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("rig", "says"),
    [
        ("trio", "rig.name"),
        ({"cameras": [{"intrinsics": [-1, 1, 1, 1]}]}, "focal lengths"),
        ({"cameras": [{"T_BS": {"data": [1] * 16}}]}, "not a rotation"),
        ({"cameras": [{"focal": 3}]}, "focal"),
    ],
)
def test_rigs_that_are_none_are_refused(tmp_path, rig, says):
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump({"rig": rig}))
    with pytest.raises(InputError, match=says) as refusal:
        fly(tmp_path / "mine.yaml")
    assert "\n" not in str(refusal.value)
