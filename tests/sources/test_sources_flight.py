"""Flight logs: healthy, real, and damaged in named ways."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any

import damage as d
import numpy as np
import pytest
import yaml
from PIL import Image

from alight.geometry import LocalFrame
from alight.records import Event, Frame, ImuSample, InputError, NavSample
from alight.runner.opening import open_source
from alight.settings import Settings, load_settings
from alight.sources import Source
from alight.sources.flight_log import group_exposures
from alight.sources.streams import Table, nav_samples, rising


def opened(path: Path, *assignments: str) -> Source:
    return open_source(path, load_settings("", assignments))


def of_kind(source: Source, kind: type[Event]) -> list[Any]:
    return [e for e in source.events() if isinstance(e, kind)]


def test_healthy_flight(flight: Path) -> None:
    source = opened(flight)
    events = list(source.events())
    assert [e.t_ns for e in events] == sorted(e.t_ns for e in events)
    kinds = [sum(isinstance(e, k) for e in events) for k in (Frame, NavSample, ImuSample)]
    assert kinds == [6, 12, 60]
    assert (source.name, source.kind, source.length, source.georeferenced) == ("flight", "flight", 6, True)
    assert source.warnings == []
    assert source.counts["cam0 images"] == source.counts["exposures"] == 6
    at_start = [type(e) for e in events if e.t_ns == d.T0]
    assert at_start == [NavSample, ImuSample, Frame]  # samples at a frame's time come before the frame


def test_a_height_alone_is_that_of_a_barometer() -> None:
    rows = np.full((2, 22), np.nan)
    rows[0, :3], rows[1, 2] = (47.0, 13.0, 530.0), 540.0
    placed, alone = nav_samples(Table(np.array([1, 2]), rows, [2, 3]), LocalFrame(47.0, 13.0, 512.0))
    assert placed.height_world is None
    assert placed.position_world is not None
    assert (alone.position_world, alone.height_world) == (None, 28.0)


def test_numbers_of_a_healthy_flight(flight: Path) -> None:
    source = opened(flight / "mav0")  # the inner folder is accepted as well
    assert source.name == "flight"
    cam = source.rig.cameras[1]
    assert (cam.name, cam.camera.fu, cam.camera.model) == ("cam1", 50.0, "radial-tangential")
    np.testing.assert_allclose(cam.body_from_cam.matrix.ravel(), d.LOOK_DOWN)
    nav = of_kind(source, NavSample)[3]
    np.testing.assert_allclose(nav.position_world, [0, 3e-6 * 111_200, 30], atol=1e-3)
    np.testing.assert_allclose(nav.world_from_body, np.eye(3))
    np.testing.assert_allclose(nav.sigma_attitude, [0.01, 0.01, 0.03])
    np.testing.assert_allclose(nav.velocity_world, [0.5, 1.0, 0.0])
    assert source.truth_trajectory is not None
    times, poses = source.truth_trajectory
    assert times[2] == d.T0 + 2 * d.STEP
    np.testing.assert_allclose(poses[2].translation, [2, 0, 30])


def test_images_are_grey_or_rgb_and_exact(flight: Path) -> None:
    first = of_kind(opened(flight), Frame)[0]
    left, right = first.images
    np.testing.assert_array_equal(left, np.asarray(d.picture(0, grey=True)))
    np.testing.assert_array_equal(right, np.asarray(d.picture(0)))


def test_events_can_be_had_again(flight: Path) -> None:
    source = opened(flight)
    d.cut_off(flight / "mav0/cam0/data/2.png")
    runs = [[(type(e).__name__, e.t_ns) for e in source.events()] for _ in range(2)]
    assert runs[0] == runs[1]
    assert len(source.warnings) == 1


def test_images_are_decoded_one_at_a_time(flight: Path) -> None:
    events = opened(flight).events()
    next(e for e in events if isinstance(e, Frame))
    shutil.rmtree(flight / "mav0/cam0/data")
    left = [e.images[0] for e in events if isinstance(e, Frame)]
    assert left[1:] == [None] * 4  # one exposure may have been fetched ahead, no more


def test_skip_and_every(flight: Path) -> None:
    source = opened(flight, "sources.skip=1", "sources.every=2")
    assert [f.name for f in of_kind(source, Frame)] == ["1.png", "3.png", "5.png"]
    with pytest.raises(InputError, match=r"sources\.skip"):
        opened(flight, "sources.skip=6")


@pytest.mark.parametrize("where", ["cam0", "cam1"])
def test_missing_and_broken_images_are_dropped(flight: Path, where: str) -> None:
    """A row whose file is missing or cut off leaves None; the other camera's image is kept."""
    data = flight / "mav0" / where / "data"
    (data / "1.png").unlink()
    d.cut_off(data / "3.png")
    (data / "4.png").write_text("not an image")
    source = opened(flight)
    index = int(where[-1])
    frames = of_kind(source, Frame)
    assert [f.images[index] is None for f in frames] == [False, True, False, True, True, False]
    assert all(f.images[1 - index] is not None for f in frames)
    (warning,) = source.warnings
    assert warning.startswith(f"{where} images: 3 of 6 left out (first: 1.png: the file is missing)")


def test_exposure_without_any_image_yields_no_frame(flight: Path) -> None:
    for cam in ("cam0", "cam1"):
        d.cut_off(flight / f"mav0/{cam}/data/2.png")
    assert [f.name for f in of_kind(opened(flight), Frame)] == ["0.png", "1.png", "3.png", "4.png", "5.png"]


def test_image_of_another_size_is_dropped(flight: Path) -> None:
    d.picture(0, (32, 24)).save(flight / "mav0/cam0/data/4.png")
    source = opened(flight)
    assert of_kind(source, Frame)[4].images[0] is None
    assert "4.png: it is 32x24, the camera 64x48" in source.warnings[0]


def test_rows_beyond_the_images_are_an_excerpt(flight: Path) -> None:
    """Logs that are cut short often keep data.csv: this gives a note, not a warning."""
    for k in (0, 5):
        (flight / f"mav0/cam0/data/{k}.png").unlink()
        (flight / f"mav0/cam1/data/{k}.png").unlink()
    source = opened(flight)
    assert (source.length, source.warnings) == (4, [])
    assert source.notes["cam0 excerpt"] == "rows 2 to 5 of 6 have images"


def test_right_camera_without_images(flight: Path) -> None:
    shutil.rmtree(flight / "mav0/cam1/data")
    source = opened(flight)
    assert "cam1 images: 6 of 6 left out" in source.warnings[0]
    assert all(f.images[1] is None for f in of_kind(source, Frame))


def test_missing_nav0(flight: Path) -> None:
    """A plain EuRoC folder is read, with a warning that its place is unknown."""
    shutil.rmtree(flight / "mav0/nav0")
    source = opened(flight)
    assert not source.georeferenced
    assert source.warnings[0].startswith("nav0 is missing")
    assert len(of_kind(source, NavSample)) == 0
    assert len(of_kind(source, Frame)) == 6


def test_nav0_without_rows(flight: Path) -> None:
    d.write_rows(flight / "mav0/nav0/data.csv", [])
    source = opened(flight)
    assert source.georeferenced
    assert source.warnings == ["nav0 has no usable row: there is no GPS/INS, so the flight's place is not known"]


@pytest.mark.parametrize(
    ("column", "text", "why"),
    [
        (2, "fifteen", "'fifteen' is no number"),
        (0, "12.5", "'12.5' is no time in integer nanoseconds"),
        (0, "99999999999999999999", "is no time"),
        (1, "91", "no place on Earth"),
        (4, "2", "not of unit length"),
        (14, "-1", "a sigma is negative"),
        (8, "inf", "a number is infinite"),
        (5, "0,0", "24 columns instead of 23"),
    ],
)
def test_bad_nav_row(flight: Path, column: int, text: str, why: str) -> None:
    """The row is left out, and the warning gives its line; the other rows stay."""
    d.change_field(flight / "mav0/nav0/data.csv", 5, column, text)
    source = opened(flight)
    (warning,) = source.warnings
    assert warning.startswith("nav0 rows: 1 of 12 left out (first: line 5: ")
    assert why in warning
    assert [e.t_ns for e in of_kind(source, NavSample)] == [d.nav_row(k)[0] for k in range(12) if k != 3]


def test_empty_fields_are_not_measured(flight: Path) -> None:
    path = flight / "mav0/nav0/data.csv"
    for column in (4, 5, 6, 7, 8, 11, 14, 17, 20):
        d.change_field(path, 3, column, "")
    d.change_field(path, 4, 3, "")
    source = opened(flight)
    second, third = of_kind(source, NavSample)[1:3]
    assert [w.split(":")[0] for w in source.warnings] == ["nav0"]
    assert "no height" in source.warnings[0]
    assert second.position_world is not None
    for name in ("world_from_body", "velocity_world", "angular_velocity_body", "sigma_position", "sigma_attitude"):
        assert getattr(second, name) is None, name
    assert third.position_world is None
    assert third.world_from_body is not None


@pytest.mark.parametrize("stream", ["nav0", "imu0", "state_groundtruth_estimate0", "cam0"])
def test_time_going_backwards_and_repeated(flight: Path, stream: str) -> None:
    path = flight / "mav0" / stream / "data.csv"
    d.change_field(path, 4, 0, str(d.T0 - 5))
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:5], lines[4], *lines[5:]]) + "\n")
    source = opened(flight)
    times = [e.t_ns for e in source.events()]
    assert times == sorted(times)
    (warning,) = source.warnings
    assert "2 of" in warning
    assert "first: line 4: time goes backwards" in warning


@pytest.mark.parametrize("stream", ["nav0", "imu0", "cam0"])
def test_rows_that_came_late_are_put_in_their_place(flight: Path, stream: str) -> None:
    """Rows with right stamps in the order of arrival, as from a radio link, are sorted, and none is lost."""
    path = flight / "mav0" / stream / "data.csv"
    whole = [e.t_ns for e in opened(flight).events()]
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:2], lines[3], lines[4], lines[2], *lines[5:]]) + "\n")
    source = opened(flight)
    assert [e.t_ns for e in source.events()] == whole
    assert not source.warnings


def test_of_images_with_one_stamp_the_first_is_used(flight: Path) -> None:
    """The first image is used in both cameras: the others were exposed at another, unknown time."""
    for cam in ("cam0", "cam1"):
        folder = flight / "mav0" / cam
        first = (folder / "data.csv").read_text().splitlines()[3]
        other = folder / "data" / "other.png"
        d.picture(99, grey=cam == "cam0").save(other)
        lines = (folder / "data.csv").read_text().splitlines()
        (folder / "data.csv").write_text("\n".join([*lines[:4], f"{first.split(',')[0]},other.png", *lines[4:]]) + "\n")
    source = opened(flight)
    names = [e.name for e in of_kind(source, Frame)]
    assert "other.png" not in names
    assert len(names) == 6
    assert "the time is repeated" in source.warnings[0]


def test_one_wild_time_costs_one_row(flight: Path) -> None:
    d.change_field(flight / "mav0/nav0/data.csv", 3, 0, str(d.T0 * 2))
    source = opened(flight)
    assert len(of_kind(source, NavSample)) == 11
    assert "first: line 3" in source.warnings[0]


def test_rising_is_the_longest_rising_part() -> None:
    rng = np.random.default_rng(1)
    for _ in range(200):
        times = rng.integers(0, 8, rng.integers(0, 9)).tolist()
        kept = [t for t, k in zip(times, rising(times), strict=True) if k]
        assert kept == sorted(set(kept))
        best = max(
            n for n in range(len(times) + 1) for c in combinations(times, n) if all(a < b for a, b in pairwise(c))
        )
        assert len(kept) == best


BAD_CAMERAS: list[tuple[dict[str, Any], str]] = [
    ({"T_BS": {"data": [1, 2, 3]}}, "T_BS has 3 numbers instead of 16"),
    ({"T_BS": {"data": [2.0, *d.LOOK_DOWN[1:]]}}, "T_BS is not a rigid motion"),
    ({"T_BS": {"data": [float("nan"), *d.LOOK_DOWN[1:]]}}, "T_BS is not a rigid motion"),
    ({"T_BS": {"data": ["x"] * 16}}, "T_BS is no matrix of numbers"),
    ({"T_BS": None}, "T_BS is missing"),
    ({"intrinsics": [50.0, 50.0, 31.0]}, "intrinsics has 3 numbers"),
    ({"intrinsics": [-50.0, 50.0, 31.0, 24.0]}, "focal lengths and image size must be positive"),
    ({"intrinsics": [50.0, 50.0, float("nan"), 24.0]}, "intrinsics has a number that is not finite"),
    ({"intrinsics": None}, "intrinsics is missing"),
    ({"resolution": "64x48"}, "resolution"),
    ({"resolution": [640, 480]}, "resolution is 640x480 but 0.png is 64x48"),
    ({"distortion_coefficients": [0.1]}, "distortion_coefficients has 1 numbers"),
    ({"distortion_model": "fisheye624"}, "distortion_model 'fisheye624' is unknown"),
    ({"camera_model": "omni"}, "camera_model 'omni' is not supported"),
]


@pytest.mark.parametrize(("changes", "why"), BAD_CAMERAS)
def test_bad_calibration(flight: Path, changes: dict[str, Any], why: str) -> None:
    """The error is one line with the file, the key, and a remedy."""
    path = flight / "mav0/cam0/sensor.yaml"
    d.write_yaml(path, d.camera_yaml(**changes))
    with pytest.raises(InputError) as caught:
        opened(flight)
    message = str(caught.value)
    assert why in message
    assert str(path) in message
    assert "\n" not in message
    assert any(hint in message for hint in ("write", "use", "calibrate", "must"))


@pytest.mark.parametrize("text", ["a: [", "just words", ""])
def test_calibration_that_is_no_yaml(flight: Path, text: str) -> None:
    path = flight / "mav0/cam0/sensor.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=r"cam0/sensor\.yaml"):
        opened(flight)


@pytest.mark.parametrize(
    "origin", [None, {"latitude": 1, "longitude": 2}, {"latitude": 99, "longitude": 2, "height": 3}, "x"]
)
def test_bad_origin(flight: Path, origin: Any) -> None:
    d.write_yaml(flight / "mav0/nav0/sensor.yaml", {"origin": origin, "rate_hz": 20})
    with pytest.raises(InputError, match=r"nav0/sensor\.yaml: origin .*write origin: \{latitude"):
        opened(flight)


def test_missing_parts(flight: Path) -> None:
    (flight / "mav0/cam1/sensor.yaml").unlink()
    with pytest.raises(InputError, match=r"cam1/sensor\.yaml: cannot be read"):
        opened(flight)
    shutil.rmtree(flight / "mav0/cam1")
    (flight / "mav0/cam0/data.csv").rename(flight / "mav0/cam0/other.csv")
    with pytest.raises(InputError, match=r"cam0/data\.csv: missing"):
        opened(flight)
    (flight / "mav0/cam0/other.csv").rename(flight / "mav0/cam0/data.csv")
    shutil.rmtree(flight / "mav0/cam0/data")
    with pytest.raises(InputError, match=r"no image of data\.csv is there"):
        opened(flight)
    shutil.rmtree(flight / "mav0/cam0")
    with pytest.raises(InputError, match="there is no cam0"):
        opened(flight)


def test_file_names_stay_in_their_folder(flight: Path) -> None:
    d.change_field(flight / "mav0/cam0/data.csv", 3, 1, "../../secret.png")
    assert "names no file of the folder" in opened(flight).warnings[0]


@pytest.mark.parametrize(("name", "why"), [("\u00e9" * 128, "names no file"), ("\u00e9" * 127, "the file is missing")])
def test_the_length_of_a_file_name_is_that_of_its_bytes(flight: Path, name: str, why: str) -> None:
    d.change_field(flight / "mav0/cam0/data.csv", 3, 1, name)
    assert why in opened(flight).warnings[0]


def test_a_negative_time_is_left_out(flight: Path) -> None:
    d.change_field(flight / "mav0/nav0/data.csv", 2, 0, "-5")
    assert "line 2: '-5' is no time in integer nanoseconds, 0 or more" in opened(flight).warnings[0]


def test_folders_beside_the_cameras_are_none(flight: Path) -> None:
    for name in ("cam0_old", "cam1.bak", "camera"):
        shutil.copytree(flight / "mav0/cam0", flight / "mav0" / name)
    assert [c.name for c in opened(flight).rig.cameras] == ["cam0", "cam1"]


def test_imu_is_turned_into_the_body(flight: Path) -> None:
    turned = [0.0, -1, 0, 0.5, 1, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
    d.write_yaml(flight / "mav0/imu0/sensor.yaml", {"T_BS": {"data": turned}})
    source = opened(flight)
    sample = of_kind(source, ImuSample)[0]
    np.testing.assert_allclose(sample.angular_velocity_body, [-0.2, 0.1, 0.3])
    np.testing.assert_allclose(sample.specific_force_body, [-2, 1, 9.8])
    assert "0.50 m from the body's origin" in source.warnings[0]


def test_stereo_grouping() -> None:
    left = [(0, "a"), (100, "b"), (200, "c"), (300, "d")]
    right = [(3, "A"), (100, "B"), (260, "D"), (550, "F")]
    exposures, apart = group_exposures([left, right])
    assert [(e.t_ns, e.names) for e in exposures] == [
        (0, ("a", "A")),
        (100, ("b", "B")),
        (200, ("c", None)),
        (300, ("d", "D")),
        (550, (None, "F")),
    ]
    assert apart == 40


def test_exact_partner_wins_over_a_near_one() -> None:
    exposures, apart = group_exposures([[(0, "a"), (100, "b")], [(90, "near"), (100, "exact")]])
    assert [e.names for e in exposures] == [("a", None), (None, "near"), ("b", "exact")]
    assert apart == 0


def test_cameras_that_do_not_expose_together_are_named(tmp_path: Path) -> None:
    folder = d.write_flight(tmp_path / "f", cameras=1)
    d.write_camera(folder / "mav0/cam1", 6, grey=True, shift=20_000_000)
    source = opened(folder)
    assert source.length == 6
    assert "paired images are 20.0 ms apart" in source.warnings[0]


# -- Kalibr


def camchain(**second: Any) -> dict[str, Any]:
    entry = {
        "camera_model": "pinhole",
        "intrinsics": [60.0, 61.0, 30.0, 25.0],
        "distortion_model": "equidistant",
        "distortion_coeffs": [0.1, 0.0, 0.0, 0.0],
        "resolution": list(d.SIZE),
    }
    step = np.eye(4)
    step[0, 3] = -0.2
    return {"cam0": entry, "cam1": entry | {"T_cn_cnm1": step.tolist()} | second}


def with_camchain(flight: Path, tree: Any) -> Source:
    d.write_yaml(flight / "camchain.yaml", tree)
    return opened(flight, f"sources.calibration={flight / 'camchain.yaml'}")


def test_camchain_replaces_the_rig(flight: Path) -> None:
    left, right = with_camchain(flight, camchain()).rig.cameras
    assert (left.camera.fu, left.camera.model) == (60.0, "equidistant")
    np.testing.assert_allclose(left.body_from_cam.matrix.ravel(), d.LOOK_DOWN)  # the log's own: Kalibr had no IMU
    right_in_left = left.body_from_cam.inverse @ right.body_from_cam
    np.testing.assert_allclose(right_in_left.translation, [0.2, 0, 0], atol=1e-12)


def test_camchain_with_imu_gives_the_mounting(flight: Path) -> None:
    tree = camchain()
    cam_from_imu = np.diag([1.0, -1, -1, 1])
    cam_from_imu[:3, 3] = [0.1, 0.2, 0.3]
    tree["cam0"] = tree["cam0"] | {"T_cam_imu": cam_from_imu.tolist()}
    left = with_camchain(flight, tree).rig.cameras[0]
    np.testing.assert_allclose(left.body_from_cam.matrix, np.linalg.inv(cam_from_imu), atol=1e-12)


def shifted(flight: Path, shifts: tuple[Any, Any], *assignments: str) -> Source:
    tree = camchain()
    for cam, shift in zip(("cam0", "cam1"), shifts, strict=True):
        tree[cam] = tree[cam] | ({} if shift is None else {"timeshift_cam_imu": shift})
    d.write_yaml(flight / "camchain.yaml", tree)
    return opened(flight, f"sources.calibration={flight / 'camchain.yaml'}", *assignments)


@pytest.mark.parametrize(
    ("shifts", "given", "late", "warned"),
    [
        ((-0.08, -0.08), 0.0, (0.08, 0.08), 0),  # Kalibr: t_imu = t_cam + timeshift
        ((0.0123456, 0.0123456), 0.0, (-0.0123456, -0.0123456), 0),
        ((-0.08, -0.2), 0.0, (0.08, 0.2), 0),  # exposed together, stamped apart
        ((-0.08, None), 0.0, (0.08, 0.0), 1),  # each stamped by another clock
        ((-0.08, None), 0.0, (0.08, 0.08), 1),  # one trigger
        ((None, -0.08), 0.0, (0.08, 0.08), 1),
        ((-0.08, None), 0.07, (0.0, 0.0), 2),
        ((None, None), 0.07, (0.0, 0.0), 0),
        ((-0.08, -0.08), 0.07, (0.0, 0.0), 1),  # the filter subtracts the user's offset: not twice
        ((-0.08, -0.2), 0.07, (0.0, 0.12), 1),
    ],
)
def test_the_time_shift_of_a_camchain_is_used_once(
    flight: Path, shifts: tuple[Any, Any], given: float, late: tuple[float, float], warned: int
) -> None:
    for cam, seconds in zip(("cam0", "cam1"), late, strict=True):
        table = flight / "mav0" / cam / "data.csv"
        head, *rows = table.read_text().splitlines()
        stamped = [f"{int(r.split(',')[0]) + round(1e9 * seconds)},{r.split(',')[1]}" for r in rows]
        table.write_text("\n".join([head, *stamped]) + "\n")
    source = shifted(flight, shifts, f"motion.filter.time_offset={given}")
    found = of_kind(source, Frame)
    assert [f.t_ns for f in found] == [d.T0 + k * d.STEP for k in range(6)]
    assert all(image is not None for f in found for image in f.images)
    assert sum("timeshift_cam_imu" in w for w in source.warnings) == warned


def test_frames_of_12_bits_in_16_keep_their_contrast(flight: Path) -> None:
    """All pictures of a camera by one range; the other camera has eight bits."""
    folder = flight / "mav0" / "cam0" / "data"
    for k, path in enumerate(sorted(folder.iterdir())):
        grey = np.asarray(Image.open(path).convert("L")).astype(np.uint16)
        Image.fromarray((grey // 2 + 20 * k) * 16).save(path)
    source = opened(flight)
    dark, *_, bright = (e.images for e in of_kind(source, Frame))
    assert np.ptp(dark[0]) > 60
    assert np.mean(bright[0]) > np.mean(dark[0]) + 40
    np.testing.assert_array_equal(dark[1], next(e.images[1] for e in of_kind(opened(flight), Frame)))
    assert list(source.notes["levels"]) == ["cam0"]


@pytest.mark.parametrize("shift", ["late", [0.1, 0.2], float("nan")])
def test_a_time_shift_that_is_no_number_is_refused(flight: Path, shift: Any) -> None:
    with pytest.raises(InputError, match=r"cam1\.timeshift_cam_imu"):
        shifted(flight, (0.0, shift))


def test_camchain_of_larger_images_is_scaled(flight: Path) -> None:
    tree = camchain()
    for cam in ("cam0", "cam1"):
        tree[cam] = tree[cam] | {"resolution": [128, 96]}
    lens = with_camchain(flight, tree).rig.cameras[0].camera
    assert (lens.width, lens.fu, lens.cu) == (64, 30.0, 14.75)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda t: t.pop("cam1"), "cam1 is missing"),
        (lambda t: t["cam1"].pop("T_cn_cnm1"), "cam1 has neither T_cn_cnm1 nor T_cam_imu"),
        (lambda t: t["cam1"].update(T_cn_cnm1=[[1, 2], [3, 4]]), "cam1.T_cn_cnm1 has 4 numbers"),
        (lambda t: t["cam1"].update(T_cn_cnm1=[[1, 2, 3, 4], [1]]), "cam1.T_cn_cnm1 is no matrix"),
        (lambda t: t["cam1"].update(T_cn_cnm1=(2 * np.eye(4)).tolist()), "cam1.T_cn_cnm1 is not a rigid motion"),
        (lambda t: t["cam1"].update(intrinsics=[1, 2]), "cam1.intrinsics has 2 numbers"),
        (lambda t: t["cam1"].update(resolution=[100, 48]), "cam1.resolution is 100x48, the images are 64x48"),
        (lambda t: t["cam1"].update(camera_model="omni"), "cam1.camera_model 'omni'"),
    ],
)
def test_bad_camchain(flight: Path, change: Callable[[dict[str, Any]], Any], why: str) -> None:
    tree = yaml.safe_load(yaml.safe_dump(camchain()))
    change(tree)
    with pytest.raises(InputError, match=r"camchain\.yaml: ") as caught:
        with_camchain(flight, tree)
    assert why in str(caught.value)


def test_missing_camchain(flight: Path) -> None:
    with pytest.raises(InputError, match=r"nowhere\.yaml: cannot be read"):
        opened(flight, "sources.calibration=nowhere.yaml")


# -- real recordings


def test_euroc_excerpt(shared_data: Path) -> None:
    """A plain EuRoC log gives one warning, for its missing place."""
    source = opened(shared_data / "euroc-excerpt")
    frames = of_kind(source, Frame)
    assert [i.shape for i in frames[0].images] == [(480, 752)] * 2
    assert len(frames) == source.length == 16
    assert len(source.warnings) == 1
    assert source.warnings[0].startswith("nav0 is missing")


def test_sample_flight(shared_data: Path) -> None:
    source = open_source(shared_data / "sample", Settings())
    assert (source.length, source.warnings) == (120, [])
    assert source.truth_trajectory is not None
    times, poses = source.truth_trajectory
    nav = of_kind(source, NavSample)
    truth = np.array([poses[int(np.searchsorted(times, n.t_ns))].translation for n in nav if n.t_ns <= times[-1]])
    error = np.array([n.position_world for n in nav[: len(truth)]]) - truth
    assert np.abs(error).max() < 4  # sigma 1, 1, 1.5 m
