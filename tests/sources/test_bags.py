"""Bags of ROS 1 and ROS 2: the same events as from the flight log, and damage in named ways."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterable, Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any

import damage as d
import numpy as np
import pytest
from drawn_bags import (
    FORMATS,
    Drawn,
    compressed,
    covariance,
    header,
    image,
    messages_of_flight,
    transform,
    vector,
    write_bag,
)
from refusal import Refused

from alight.cli import call
from alight.geometry import Pose
from alight.records import Event, Frame, ImuSample, InputError, NavSample
from alight.runner.opening import open_source
from alight.settings import load_settings
from alight.sources import Source

Write = Callable[..., Path]


@pytest.fixture
def bag(flight: Path, tmp_path: Path) -> Write:
    """Return a function that writes the flight log as a bag, its messages changed."""

    def write(form: str = "ros1", change: Callable[[Drawn], Iterable[Drawn]] | None = None, **options: Any) -> Path:
        messages: Iterable[Drawn] = messages_of_flight(flight, **options)
        if change is not None:
            messages = [new for m in messages for new in change(m)]
        return write_bag(tmp_path / f"bag_{form}", form, messages)

    return write


def opened(path: Path, *assignments: str) -> Source:
    return open_source(path, load_settings("", assignments))


def assert_same(found: Iterable[Event], wanted: Iterable[Event]) -> None:
    """Every number is the same to the bit."""
    for event, want in zip(found, wanted, strict=True):
        assert type(event) is type(want)
        for name in (f.name for f in fields(want) if f.name != "name"):
            a, b = getattr(event, name), getattr(want, name)
            for one, other in zip(a, b, strict=True) if name == "images" else [(a, b)]:
                np.testing.assert_array_equal(one, other, err_msg=name)


@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize("picture", [image, compressed])
def test_a_bag_has_the_events_of_the_flight_log(bag: Write, flight: Path, form: str, picture: Any) -> None:
    source = opened(bag(form, picture=picture, age_ns=20_000_000))
    assert_same(source.events(), opened(flight).events())
    assert_same(source.events(), opened(flight).events())  # once more
    assert source.warnings == []
    assert (source.length, source.georeferenced) == (6, True)
    assert source.notes["log"] == [
        "topics: left=/cam0/image_raw (10 Hz, 20 ms old), right=/cam1/image_raw (10 Hz, 20 ms old), "
        "position=/ins/fix (20 Hz, 20 ms old), attitude=/ins/imu (20 Hz, 20 ms old), "
        "velocity=/ins/velocity (20 Hz, 20 ms old), imu=/imu (100 Hz, 20 ms old)"
    ]
    for cam, want in zip(source.rig.cameras, opened(flight).rig.cameras, strict=True):
        np.testing.assert_allclose(cam.body_from_cam.matrix, want.body_from_cam.matrix, atol=1e-12)
        np.testing.assert_array_equal(cam.camera.coefficients, want.camera.coefficients)
        np.testing.assert_array_equal(cam.camera.K, want.camera.K)


def test_a_calibration_by_kalibr_replaces_camera_info_and_tf(bag: Write, flight: Path, tmp_path: Path) -> None:
    """Its topics decide which cameras are used, in its order; the flight log with the same file has the same rig."""
    cameras = opened(flight).rig.cameras
    chain = {
        f"cam{k}": {
            "rostopic": f"/cam{1 - k}/image_raw", "T_cam_imu": cam.body_from_cam.inverse.matrix.tolist(),
            "intrinsics": [60.0, 60.5, 31.0, 24.0], "distortion_model": "radtan", "distortion_coeffs": [0.0] * 4,
            "resolution": list(d.SIZE), "camera_model": "pinhole", "timeshift_cam_imu": -0.004,
        }
        for k, cam in enumerate(cameras)
    }  # fmt: skip
    d.write_yaml(tmp_path / "camchain.yaml", chain)

    def without_calibration(m: Drawn) -> Iterator[Drawn]:
        if m.topic != "/tf_static" and "camera_info" not in m.topic:
            yield m

    path = bag("mcap", without_calibration)
    d.write_yaml(tmp_path / "bare.yaml", {k: {n: v for n, v in c.items() if "T_" not in n} for k, c in chain.items()})
    with pytest.raises(InputError, match="tf does not connect 'cam1' of /cam1/image_raw"):
        opened(path, f"sources.calibration={tmp_path / 'bare.yaml'}")
    with pytest.raises(InputError, match=r"tf does not connect 'cam0' of /cam0/image_raw with 'base_link'.*T_cam_imu"):
        opened(path)
    calibration = f"sources.calibration={tmp_path / 'camchain.yaml'}"
    source, want = opened(path, calibration), opened(flight, calibration)
    assert source.notes["log"][0].startswith("topics: left=/cam1/image_raw (10 Hz, 0 ms old), right=/cam0/image_raw")
    for cam, other in zip(source.rig.cameras, want.rig.cameras, strict=True):
        np.testing.assert_array_equal(cam.body_from_cam.matrix, other.body_from_cam.matrix)
        assert cam.camera == other.camera
    assert source.length == 6
    assert next(e.t_ns for e in source.events() if isinstance(e, Frame)) == d.T0 - 4_000_000


def mosaic(pattern: str) -> Any:
    """A Bayer picture of one colour: red 200, green 100, blue 50."""
    levels = {"r": 200, "g": 100, "b": 50}
    cell = np.array([levels[c] for c in pattern], np.uint8).reshape(2, 2)
    return np.tile(cell, (d.SIZE[1] // 2, d.SIZE[0] // 2))


GREY = np.full(d.SIZE[::-1], 7, np.uint8)
COLOUR = np.broadcast_to(np.array([200, 100, 50], np.uint8), (*d.SIZE[::-1], 3))
YUV = np.broadcast_to(np.array([90, 128], np.uint8), (*d.SIZE[::-1], 2))  # without colour
ENCODED = {
    "mono8": (GREY, GREY), "rgb8": (COLOUR, COLOUR), "bgr8": (COLOUR[..., ::-1], COLOUR),
    "bgra8": (np.dstack([COLOUR[..., ::-1], GREY]), COLOUR),
    **{f"bayer_{p}8": (mosaic(p), COLOUR) for p in ("rggb", "bggr", "gbrg", "grbg")},
    "yuv422_yuy2": (YUV, np.full((*d.SIZE[::-1], 3), 86, np.uint8)),
    "yuv422": (YUV[..., ::-1], np.full((*d.SIZE[::-1], 3), 86, np.uint8)),
    "mono8, padded": (GREY, GREY),
}  # fmt: skip


@pytest.mark.parametrize("encoding", ENCODED)
def test_pictures_of_every_encoding(bag: Write, encoding: str) -> None:
    stored, want = ENCODED[encoding]
    rows = stored.reshape(d.SIZE[1], -1)
    padded = np.pad(rows, ((0, 0), (0, 9 if "padded" in encoding else 0)))
    name = encoding.partition(",")[0]

    def encode(m: Drawn) -> Iterator[Drawn]:
        new = {"encoding": name, "data": padded.ravel(), "step": padded.shape[1]}
        yield m.with_fields(new) if m.topic == "/cam0/image_raw" else m

    frames = [e for e in opened(bag(change=encode)).events() if isinstance(e, Frame)]
    assert len(frames) == 6
    left = np.asarray(frames[0].images[0])
    assert left.shape == want.shape
    assert np.abs(left[2:-2, 2:-2].astype(int) - want[2:-2, 2:-2]).max() <= 2


def sixteen_bits(m: Drawn) -> Iterator[Drawn]:
    """The left camera gives 16 bits, raw or as PNG."""
    if m.topic != LEFT:
        yield m
    elif m.type.endswith("CompressedImage"):
        yield compressed(LEFT, m.t_ns, "cam0", np.full(d.SIZE[::-1], 900, np.uint16))
    else:
        step, data = 2 * d.SIZE[0], np.zeros(2 * d.SIZE[0] * d.SIZE[1], np.uint8)
        yield m.with_fields({"encoding": "mono16", "step": step, "data": data})


@pytest.mark.parametrize(("picture", "why"), [(image, "encoding 'mono16'"), (compressed, "format 'png' of 16 bits")])
def test_pictures_of_sixteen_bits_are_refused_by_name(bag: Write, picture: Any, why: str) -> None:
    path = bag("mcap", sixteen_bits, picture=picture)
    words = f"--topic left={LEFT}: {why} is not read; record 8 bits a colour, such as mono8 or rgb8"
    with pytest.raises(InputError, match=re.escape(words)):
        open_source(path, topics={"left": LEFT})
    assert "topics: left=/cam1/image_raw (" in open_source(path).notes["log"][0]
    path = bag("ros1", lambda m: sixteen_bits(m) if m.topic != RIGHT else (), picture=picture)
    with pytest.raises(InputError, match=re.escape(f"no pictures that can be read ({LEFT}: {why}); record 8 bits")):
        open_source(path)


def info(**new: Any) -> Callable[[Drawn], Iterator[Drawn]]:
    """Return a change of the calibration of the left camera."""

    def change(m: Drawn) -> Iterator[Drawn]:
        yield m.with_fields(new) if m.topic == "/cam0/camera_info" else m

    return change


def test_rectified_pictures_have_the_lens_and_the_axes_of_the_projection(bag: Write, flight: Path) -> None:
    turn = Pose.from_quaternion((np.cos(0.05), 0.0, np.sin(0.05), 0.0), np.zeros(3)).rotation

    def rectify(m: Drawn) -> Iterator[Drawn]:
        new = {"P": [40.0, 0, 30.0, 0, 0, 41.0, 20.0, 0, 0, 0, 1, 0], "R": turn.ravel()}
        m = m._replace(topic="/cam0/image_rect") if m.topic == LEFT else m
        yield m.with_fields(new) if m.topic == "/cam0/camera_info" else m

    got, want = opened(bag(change=rectify)).rig.cameras[0], opened(flight).rig.cameras[0]
    assert (got.camera.model, got.camera.fu, got.camera.cv) == ("none", 40.0, 20.0)
    np.testing.assert_allclose(got.body_from_cam.rotation, want.body_from_cam.rotation @ turn.T, atol=1e-12)


RATIONAL = [0.45, 0.03, 1e-4, -1e-4, 0.001, 0.52, 0.05, 0.003]  # k1 k2 p1 p2 k3 k4 k5 k6


def test_a_rational_lens_becomes_the_closest_that_is_read(bag: Write) -> None:
    import cv2

    lens = opened(bag(change=info(distortion_model="rational_polynomial", D=RATIONAL))).rig.cameras[0].camera
    pixels = np.array([[0.0, 0.0], [63.0, 10.0], [30.0, 47.0], [63.0, 47.0]])
    want = cv2.undistortPoints(pixels[:, None], lens.K, np.array(RATIONAL), None, None)[:, 0]
    np.testing.assert_allclose(lens.rays(pixels)[:, :2], want, atol=0.2 / lens.fu)


@pytest.mark.parametrize(
    ("new", "words"),
    [
        ({"distortion_model": "equidistant", "D": [0.01, 0.0, 0.0, 0.0]}, ""),
        ({"distortion_model": "rational_polynomial", "D": [0, 0, 0, 0, 0, 40, -90, 70]}, "cannot be inverted"),
        ({"distortion_model": "ours", "D": [0.1]}, "unknown distortion model"),
        ({"D": [0.1, 0.2]}, "distortion takes"),
        ({"K": [0.0] * 9}, "no CameraInfo with a calibration belongs to /cam0/image_raw"),
        ({"width": 128, "height": 96}, ""),
        ({"width": 128, "height": 64}, "it is for 128x64, and the images are 64x48"),
    ],
)  # fmt: skip
def test_calibrations_of_a_driver(bag: Write, new: dict[str, Any], words: str) -> None:
    path = bag(change=info(**new))
    if not words:
        lens = opened(path).rig.cameras[0].camera
        assert lens.model == new.get("distortion_model", "radial-tangential")
        assert lens.fu == (25.0 if "width" in new else 50.0)
        return
    with pytest.raises(InputError, match=words):
        opened(path)


def of_kind(source: Source, kind: type[Event]) -> list[Any]:
    return [e for e in source.events() if isinstance(e, kind)]


NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
BOOTED = d.T0 - 500 * 10**9  # ns, when the autopilot's clock began


def px4(flight: Path) -> Iterator[Drawn]:
    """The flight as PX4 publishes it over DDS: NED, FRD, stamps of its own clock in microseconds since boot."""
    for m in messages_of_flight(flight):
        if not m.topic.startswith(("/ins", "/imu", "/gp")):
            yield m
    for event in opened(flight).events():
        stamp = {"timestamp": (event.t_ns - BOOTED) // 1000}
        if isinstance(event, ImuSample):
            turned = {k: v * [1, -1, -1] for k, v in (("gyro_rad", event.angular_velocity_body),
                                                      ("accelerometer_m_s2", event.specific_force_body))}  # fmt: skip
            yield Drawn("/fmu/out/sensor_combined", "px4_msgs/msg/SensorCombined", event.t_ns, stamp | turned)
        elif isinstance(event, NavSample):
            lat, lon, height = map(float, opened(flight).local.to_geodetic(event.position_world))
            place = {"lat": lat, "lon": lon, "alt": height - 46.5, "alt_ellipsoid": height, "eph": 1.0, "epv": 1.5}
            R = np.asarray(event.world_from_body)
            attitude = Pose(NED @ R @ np.diag([1.0, -1.0, -1.0])).quaternion
            speed = dict(zip(("vx", "vy", "vz"), NED @ np.asarray(event.velocity_world), strict=True))
            for name, fields in (("GlobalPosition", place), ("Attitude", {"q": attitude}), ("LocalPosition", speed)):
                topic = "/fmu/out/vehicle_" + re.sub("([A-Z])", r"_\1", name).lower().lstrip("_")
                yield Drawn(topic, f"px4_msgs/msg/Vehicle{name}", event.t_ns, stamp | fields)


def test_an_autopilot_of_px4_with_its_own_clock(flight: Path, tmp_path: Path) -> None:
    source = opened(write_bag(tmp_path / "px4", "mcap", sorted(px4(flight), key=lambda m: m.t_ns)))
    got, want = of_kind(source, NavSample), of_kind(opened(flight), NavSample)
    assert [s.t_ns for s in got] == [s.t_ns for s in want]
    move = source.local.to_enu(d.LATITUDE, d.LONGITUDE, d.HEIGHT)
    for a, b in zip(got[1:-1], want[1:-1], strict=True):
        np.testing.assert_allclose(a.position_world - move, b.position_world, atol=1e-4)
        np.testing.assert_allclose(a.world_from_body, b.world_from_body, atol=1e-6)
        np.testing.assert_allclose(a.velocity_world, b.velocity_world, atol=1e-6)
        np.testing.assert_allclose(a.angular_velocity_body, [0.1, 0.2, 0.3], atol=1e-6)  # of the IMU
        np.testing.assert_allclose(a.sigma_position, [1.0, 1.0, 1.5])
    for sample in of_kind(source, ImuSample):
        np.testing.assert_allclose(sample.specific_force_body, [1.0, 2.0, 9.8], atol=1e-6)
    words = [w for w in source.warnings if "by another clock or late: that is added to its stamps" in w]
    assert len(words) == 4
    assert set(words) <= source.findings.contradictions


def odometry(m: Drawn) -> Iterator[Drawn]:
    """Only odometry, in a frame of its own: no place on Earth."""
    if m.topic == "/ins/imu":
        k = (m.t_ns - d.T0) // (d.STEP // 2)
        pose = {"position": vector((1.0 * k, 0.0, 30.0)), "orientation": vector((0.8, 0, 0, 0.6), "wxyz")}
        twist = {"linear": vector((5.0, 0.0, 0.0)), "angular": vector((0.0, 0.0, 0.1))}
        fields = {
            "header": header(m.t_ns, "odom"), "child_frame_id": "base_link", "twist": {"twist": twist},
            "pose": {"pose": pose, "covariance": covariance((0.1, 0.1, 0.2), 6) + covariance((0.01, 0.01, 0.02), 6, 3)},
        }  # fmt: skip
        yield Drawn("/vio/odometry", "nav_msgs/msg/Odometry", m.t_ns, fields)
    elif not m.topic.startswith(("/ins", "/gp")):
        yield m


def test_odometry_alone_gives_relative_positions(bag: Write) -> None:
    source = opened(bag(change=odometry))
    rows = of_kind(source, NavSample)
    assert not source.georeferenced
    assert source.warnings == [
        "the bag has no GPS (NavSatFix): heights and places are relative, and nothing can be put on a map"
    ]
    assert len(rows) == 12
    np.testing.assert_allclose(rows[3].position_world, [3.0, 0.0, 30.0], atol=1e-6)
    np.testing.assert_allclose(rows[3].velocity_world, [1.4, 4.8, 0.0], atol=1e-9)  # turned by 73.7 degrees
    np.testing.assert_allclose(rows[3].sigma_position, [0.1, 0.1, 0.2])
    np.testing.assert_allclose(rows[3].sigma_attitude, [0.01, 0.01, 0.02])


@pytest.mark.parametrize("first", ["/gp_origin", "/ins/fix"])
def test_a_place_that_is_none_on_earth_is_no_origin(bag: Write, first: str) -> None:
    """The first message that has a place is damaged."""
    left = [{"latitude": 1e200}]

    def change(m: Drawn) -> Iterator[Drawn]:
        if m.topic == first and left:
            wrong = left.pop()
            m = m.with_fields({"position": wrong} if "position" in m.fields else wrong)
        if m.topic != "/gp_origin" or first == "/gp_origin":
            yield m

    source = opened(bag(change=change))
    assert source.local is not None
    assert source.local.latitude == pytest.approx(48.0, abs=1.0)
    assert len(of_kind(source, NavSample)) == (12 if first == "/gp_origin" else 11)


def stamped(topic: str, change: Callable[[Drawn], dict[str, Any]]) -> Callable[[Drawn], Iterator[Drawn]]:
    """Return a change of the fields of a topic's messages."""

    def apply(m: Drawn) -> Iterator[Drawn]:
        yield m.with_fields(change(m)) if m.topic == topic else m

    return apply


def later(topic: str, seconds: float) -> Callable[[Drawn], Iterator[Drawn]]:
    """Return a change: a topic's messages arrive later, with the same stamps."""

    def apply(m: Drawn) -> Iterator[Drawn]:
        yield m._replace(t_ns=m.t_ns + round(1e9 * seconds)) if m.topic == topic else m

    return apply


def turned_camera(m: Drawn) -> Iterator[Drawn]:
    yield m
    if m.topic == "/ins/fix":
        yield transform(m.t_ns, "base_link", "cam0", (0.0, 1.0, 0.0, 0.0), (0, 0, 1e-11 * (m.t_ns - d.T0)), "/tf")


LEFT, RIGHT = "/cam0/image_raw", "/cam1/image_raw"
CLOCKS: dict[str, tuple[Callable[[Drawn], Iterator[Drawn]], str, int]] = {  # change, warning or error, whole exposures
    "no stamps": (stamped(LEFT, lambda m: {"header": header(0, "cam0")}),
                  "/cam0/image_raw has no stamps: its times of arrival are used", 6),
    "a jump": (stamped(LEFT, lambda m: {"header": header(m.t_ns + (m.t_ns > d.T0 + 3 * d.STEP) * 10**10, "cam0")}),
               "/cam0/image_raw: stamps and times of arrival drift apart by 10.0 s", 4),
    "not together": (stamped(RIGHT, lambda m: {"header": header(m.t_ns + 30_000_000, "cam1")}),
                     "the cameras do not expose together: paired images are 30.0 ms apart", 6),
    "a late camera": (later(RIGHT, 1.0), "", 6),
    "one stamp twice": (stamped("/ins/fix", lambda m: {"header": header(min(m.t_ns, d.T0 + 5 * d.STEP), "")}),
                        "nav0 rows: 1 of 12 left out (first: line 12: the time is repeated)", 6),
    "no fix": (stamped("/ins/fix", lambda m: {"status": {"status": -(m.t_ns < d.T0 + d.STEP)}}), "", 6),
    "an IMU without a frame": (stamped("/imu", lambda m: {"header": header(m.t_ns, "")}),
                               "/imu names no frame: that of the body, base_link, is taken", 6),
    "an IMU in a frame unknown": (stamped("/imu", lambda m: {"header": header(m.t_ns, "imu_7")}),
                                  "tf does not connect 'imu_7' of /imu with 'base_link'; add that transform, or leave",
                                  0),
    "a gimbal": (turned_camera, "tf: 'cam0', between 'base_link' and 'cam0', moves; a camera must be fixed", 0),
    "an encoding that is not read": (stamped(LEFT, lambda m: {"encoding": "rgb16"}), "", 0),
}  # fmt: skip


@pytest.mark.parametrize("situation", CLOCKS)
def test_stamps_and_frames(bag: Write, situation: str) -> None:
    change, words, whole = CLOCKS[situation]
    messages = bag(change=change)
    if whole == 0 and words:
        with pytest.raises(InputError, match=re.escape(words)):
            opened(messages)
        return
    source = opened(messages)
    frames = of_kind(source, Frame)
    if whole:
        assert sum(all(i is not None for i in f.images) for f in frames) == whole
    else:
        assert source.notes["cameras"] == ["cam0"]
        assert source.notes["log"][0].startswith("topics: left=/cam1/image_raw")
    assert words in " ".join(source.warnings)
    if situation == "no fix":
        assert of_kind(source, NavSample)[0].position_world is None
    if not words:
        assert [w for w in source.warnings if "position" not in w] == []


def late_camera(flight: Path, seconds: float) -> Iterator[Drawn]:
    """The right camera arrives later; the bag goes on after its last picture."""
    drawn = [new for m in messages_of_flight(flight) for new in later(RIGHT, seconds)(m)]
    yield from sorted(drawn, key=lambda m: m.t_ns)


def test_an_image_does_not_wait_for_ever(flight: Path, tmp_path: Path) -> None:
    """Its memory would grow with a bag: beyond two seconds, the exposure goes without the other camera."""
    source = opened(write_bag(tmp_path / "late", "ros1", late_camera(flight, 1.9)))
    assert all(i is not None for f in of_kind(source, Frame) for i in f.images)
    source = opened(write_bag(tmp_path / "later", "ros1", late_camera(flight, 2.15)))
    assert [f.images[1] is None for f in of_kind(source, Frame)] == [False] + [True] * 5
    assert "cam1 images: 5 of 6 left out (first: " in source.warnings[0]
    assert "it arrives more than 2 s after others" in source.warnings[0]
    assert "its stamps are used as they are" in source.warnings[1]


def cut(path: Path, share: float = 0.6) -> Path:
    """Cut the data file of a bag; return it."""
    file = path if path.is_file() else next(p for p in path.iterdir() if p.suffix != ".yaml")
    d.cut_off(file, share)
    return file


def never_closed(path: Path) -> Path:
    """Set the place of the index to 0 and remove the index, as of a bag of ROS 1 that was never closed."""
    data = path.read_bytes()
    at = data.index(b"index_pos=") + len(b"index_pos=")
    end = int.from_bytes(data[at : at + 8], "little")
    path.write_bytes((data[:at] + bytes(8) + data[at + 8 :])[:end])
    return path


def with_others(m: Drawn) -> Iterator[Drawn]:
    """Large messages of no use, so that chunks are filled."""
    yield m
    if m.topic == LEFT:
        yield Drawn("/log", "std_msgs/msg/String", m.t_ns, {"data": "x" * 600_000})


@pytest.mark.parametrize(("form", "damage"), [*((form, cut) for form in FORMATS), ("ros1", never_closed)])
def test_a_bag_that_ends_early_is_read_as_far_as_it_goes(bag: Write, form: str, damage: Callable[[Path], Path]) -> None:
    file = damage(bag(form, with_others))
    source = opened(file)
    frames = of_kind(source, Frame)
    assert len(frames) == 6 if damage is never_closed else 0 < len(frames) < 6
    assert f"{file.name} ends early, as after a loss of power: what came before it is used" in source.warnings


def text(path: Path) -> Path:
    path.write_text("no bag")
    return path


def noise(path: Path) -> Path:
    data = path.read_bytes()
    path.write_bytes(data[:13] + np.random.default_rng(0).bytes(len(data)))
    return path


def huge(path: Path) -> Path:
    """The first record claims 4 GB."""
    data = path.read_bytes()
    path.write_bytes(data[:13] + b"\xff\xff\xff\xff" + data[17:])
    return path


def two(path: Path) -> Path:
    folder = path.parent / "two"
    folder.mkdir()
    shutil.copy(path, folder / "a.bag")
    shutil.copy(path, folder / "b.bag")
    return folder


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (text, "not a file that can"), (noise, "no message can be read ("), (huge, "no message can be read ("),
        (two, "holds 2 bags, not the parts _0, _1, ... of one; name one of them, such as "),
    ],
)  # fmt: skip
def test_what_is_no_bag_is_one_line(bag: Write, damage: Callable[[Path], Path], words: str, refused: Refused) -> None:
    path = damage(bag())
    refused(["check", path], words)


def too_long(data: bytes) -> bytes:
    """The text of the first picture is longer than the message."""
    at = data.index(b"mono8") - 4
    return data[:at] + b"\xff\xff\xff\x7f" + data[at + 4 :]


def other_order(data: bytes) -> bytes:
    """The first picture claims to be big-endian."""
    at = data.rindex(b"\0\1\0\0", 0, data.index(b"mono8"))
    return data[:at] + bytes(2) + data[at + 2 :]


@pytest.mark.parametrize(("form", "damage"), [("ros1", too_long), ("mcap", too_long), ("mcap", other_order)])
def test_a_message_that_is_damaged_is_left_out(bag: Write, form: str, damage: Callable[[bytes], bytes]) -> None:
    path = bag(form)
    file = path if path.is_file() else next(path.glob("*.mcap"))
    file.write_bytes(damage(file.read_bytes()))
    source = opened(file)
    assert len(of_kind(source, Frame)) == 6
    assert "/cam0/image_raw messages: 1 left out (first: of 1700000000000000000 ns: it is no sensor_msgs" in "".join(
        source.warnings
    )


def test_parts_of_a_bag_are_one(flight: Path, tmp_path: Path) -> None:
    drawn, folder = list(messages_of_flight(flight)), tmp_path / "split"
    folder.mkdir()
    for k, half in enumerate((drawn[: len(drawn) // 2], drawn[len(drawn) // 2 :])):
        write_bag(folder / f"flight_{k}", "ros1", half)
    assert_same(opened(folder).events(), opened(flight).events())


def test_the_command_line_prints_the_choice_and_takes_another(
    bag: Write, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = str(bag())

    def checked(*options: str) -> str:
        assert call(["check", path, *options]) in (0, 2, 3)
        told = capsys.readouterr()
        return told.out + told.err

    assert "LOG  topics: left=/cam0/image_raw (10 Hz" in checked()
    assert "topics: left=/cam1/image_raw (10 Hz, 0 ms old), position" in checked("--topic", f"left={RIGHT}")
    d.write_yaml(tmp_path / "topics.yaml", {"left": RIGHT, "right": LEFT, "velocity": ""})
    found = checked("--topics", str(tmp_path / "topics.yaml"))
    assert f"topics: left={RIGHT} (10 Hz, 0 ms old), right={LEFT}" in found
    assert "velocity=" not in found
    for role, topic, known in (("left", "/cam7", f"{LEFT}, {RIGHT}"), ("attitude", "/imu", "/ins/imu")):
        words = f"--topic {role}={topic}: no such topic in the bag; topics of the kind: {known}\n"
        assert words in checked("--topic", f"{role}={topic}")
    assert "--topic top=...: there is no such role; use left, right," in checked("--topic", f"top={LEFT}")
