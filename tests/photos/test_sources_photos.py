"""Photo folders: tags of several makers, calibration, order, and folders damaged in named ways."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import damage as d
import numpy as np
import pytest
import yaml
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from alight.arrays import F64
from alight.geometry import LocalFrame, enu_from_flu, so3_log
from alight.photos.reading.photo_pixels import PhotoPixels, PictureMemory
from alight.photos.reading.photo_pose import BODY_FROM_CAM
from alight.photos.reading.photo_tags import finite
from alight.photos.reading.photo_xmp import parse_xmp
from alight.photos.reading.photos import SECOND, spread_times
from alight.records import Event, Frame, InputError, NavSample
from alight.runner.opening import open_source
from alight.settings import Settings, load_settings
from alight.sources import Source
from alight.sources.images import has_end, image_size, read_image

SENSOR: dict[int, Any] = {37386: 5.0, 41486: 10.0, 41487: 10.0, 41488: 4}  # mm; ten pixels a millimetre


def opened(path: Path, *assignments: str) -> Source:
    return open_source(path, load_settings("", assignments))


def one_photo(folder: Path, **photo: Any) -> Source:
    """Write a photo and open its folder."""
    d.write_photo(folder / "a.jpg", **photo)
    return opened(folder)


def of_kind(source: Source, kind: type[Event]) -> list[Any]:
    return [e for e in source.events() if isinstance(e, kind)]


def names(source: Source) -> list[str]:
    return [f.name for f in of_kind(source, Frame)]


def test_healthy_folder(photos: Path) -> None:
    source = opened(photos)
    events = list(source.events())
    assert [type(e) for e in events] == [NavSample, Frame] * 4
    assert [e.t_ns for e in events[::2]] == [e.t_ns for e in events[1::2]]
    assert (source.name, source.kind, source.length, source.georeferenced) == ("survey", "photos", 4, True)
    assert (source.warnings, source.truth_trajectory) == ([], None)
    assert source.local == LocalFrame(45.000045, 7.6, 305.0)
    assert source.notes["gps"] == {"RTK fixed": 4}
    assert source.notes["attitude_from"] == {"gimbal": 4}
    nav = events[2]
    assert nav.position_world[2] == pytest.approx(45, abs=1e-3)
    assert nav.position_world[1] == pytest.approx(-1.5e-5 * 111_140, abs=0.02)
    np.testing.assert_allclose(nav.sigma_position, [0.02, 0.015, 0.03])
    assert np.asarray(events[3].images[0]).shape == (48, 64, 3)


def test_looking_down_with_the_top_of_the_image_to_the_east(photos: Path) -> None:
    """The gimbal's pitch is -90 and its yaw 90."""
    nav = of_kind(opened(photos), NavSample)[0]
    world_from_cam = nav.world_from_body @ BODY_FROM_CAM.rotation
    np.testing.assert_allclose(world_from_cam @ [0, 0, 1], [0, 0, -1], atol=1e-12)  # the optical axis
    np.testing.assert_allclose(world_from_cam @ [0, -1, 0], [1, 0, 0], atol=1e-12)  # up in the image
    np.testing.assert_allclose(world_from_cam @ [1, 0, 0], [0, -1, 0], atol=1e-12)  # right in the image


def test_looking_at_the_horizon_is_the_body_itself(tmp_path: Path) -> None:
    tags = d.xmp_packet(d.dji_tags(GimbalPitchDegree="0.0", GimbalYawDegree="0.0"))
    source = one_photo(tmp_path, xmp=tags)
    nav = of_kind(source, NavSample)[0]
    world_from_cam = nav.world_from_body @ source.rig.cameras[0].body_from_cam.rotation
    np.testing.assert_allclose(world_from_cam @ [0, 0, 1], [0, 1, 0], atol=1e-12)  # north
    np.testing.assert_allclose(world_from_cam @ [0, -1, 0], [0, 0, 1], atol=1e-12)


def test_xmp_as_elements(tmp_path: Path) -> None:
    d.write_photo(tmp_path / "a.JPEG", xmp=d.xmp_packet(d.dji_tags(), elements=True))
    d.write_photo(tmp_path / "b.JPEG", second="14")
    first, second = of_kind(opened(tmp_path), NavSample)
    np.testing.assert_array_equal(first.world_from_body, second.world_from_body)
    np.testing.assert_array_equal(first.sigma_position, second.sigma_position)


@pytest.mark.parametrize(("make", "sign"), [("Parrot", 1), ("senseFly", -1)])
def test_pix4d_names(tmp_path: Path, make: str, sign: int) -> None:
    """Angles of zero (Camera:Yaw, Pitch, Roll) look down with the top to the north; a pitch of 90 looks ahead."""
    tags = {"Yaw": "30", "Pitch": "20", "Roll": "10"}
    photo = {41989: 28}
    source = one_photo(tmp_path, xmp=d.xmp_packet(tags, d.PIX4D), main={271: make}, photo=photo)
    (nav,) = of_kind(source, NavSample)
    craft = enu_from_flu(math.radians(30), math.radians(20), math.radians(sign * 10))
    np.testing.assert_allclose(
        (nav.world_from_body @ BODY_FROM_CAM.rotation) @ [0, 0, 1], craft @ [0, 0, -1], atol=1e-12
    )
    np.testing.assert_allclose(
        (nav.world_from_body @ BODY_FROM_CAM.rotation) @ [0, -1, 0], craft @ [1, 0, 0], atol=1e-12
    )
    assert source.notes["attitude_from"] == {"camera": 1}


def test_flight_attitude_where_there_is_no_gimbal(tmp_path: Path) -> None:
    xmp = d.xmp_packet(d.dji_tags(GimbalYawDegree=""))
    source = one_photo(tmp_path, xmp=xmp)
    (nav,) = of_kind(source, NavSample)
    craft = enu_from_flu(math.radians(91), math.radians(1), math.radians(-2))
    np.testing.assert_allclose(nav.world_from_body @ [1, 0, 0], craft @ [0, 0, -1], atol=1e-12)
    assert "no gimbal angles: a camera fixed to look down is assumed" in source.warnings[0]
    np.testing.assert_allclose(nav.sigma_attitude, [0.05, 0.05, 0.1])


def test_no_attitude_at_all(tmp_path: Path) -> None:
    source = one_photo(tmp_path, xmp=b"", photo={41989: 28})
    (nav,) = of_kind(source, NavSample)
    assert nav.world_from_body is None
    assert nav.sigma_attitude is None
    assert nav.position_world is not None
    assert "say nothing about where the camera looked" in source.warnings[0]


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"RtkFlag": "50", "RtkStdLon": "0.001"}, [0.01, 0.015, 0.03]),
        ({"RtkFlag": "34"}, [0.5, 0.5, 0.5]),
        ({"RtkFlag": "49", "RtkStdHgt": "0.8"}, [0.5, 0.5, 0.8]),
        ({"RtkFlag": "16"}, [3, 3, 5]),
        ({"RtkFlag": ""}, [3, 3, 5]),
        ({"RtkStdHgt": ""}, [3, 3, 5]),
        ({"RtkStdHgt": "n/a"}, [3, 3, 5]),
    ],
)
def test_position_sigma(tmp_path: Path, changes: dict[str, str], expected: list[float]) -> None:
    source = one_photo(tmp_path, xmp=d.xmp_packet(d.dji_tags(**changes)))
    np.testing.assert_allclose(of_kind(source, NavSample)[0].sigma_position, expected)
    assert ("height_note" in source.notes) == (changes.get("RtkFlag", "50") != "50")


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"GPSXYAccuracy": "0.5", "GPSZAccuracy": "120/100"}, [0.5, 0.5, 1.2]),
        ({"GPSXYAccuracy": "0.001", "GPSZAccuracy": "0.001"}, [0.02, 0.02, 0.03]),
        ({"GPSXYAccuracy": "0", "GPSZAccuracy": "8"}, [3, 3, 8]),
        ({"GPSXYAccuracy": "nan"}, [3, 3, 5]),
    ],
)
def test_position_sigma_of_other_makers(tmp_path: Path, changes: dict[str, str], expected: list[float]) -> None:
    """The names are Pix4D's, in metres; 0 stands for unknown."""
    d.write_photo(tmp_path / "a.jpg", xmp=d.xmp_packet(changes, d.PIX4D), photo={41989: 28})
    np.testing.assert_allclose(of_kind(opened(tmp_path), NavSample)[0].sigma_position, expected)


def test_a_place_in_decimal_degrees(tmp_path: Path) -> None:
    """Minutes and seconds are 0/0."""
    undefined = IFDRational(0, 0)
    degrees = {2: (45.25, undefined, undefined), 4: (7.5, 30.0, undefined)}
    assert one_photo(tmp_path, gps=degrees).photos[0].place == pytest.approx((45.25, 8.0))


def test_a_place_on_half_a_globe(photos: Path) -> None:
    d.write_photo(photos / "DJI_0009.JPG", second="59", gps={3: None})
    source = opened(photos)
    assert source.photos[-1].place == pytest.approx((45.0, 7.6))
    assert source.warnings == [
        "1 photo(s) do not say whether their place is north or south, east or west: north and east are taken"
    ]


@pytest.mark.parametrize(
    ("relative", "heights", "said"),
    [
        ((40, 42, 41), (40, 42, 41), "the height above take-off is used"),
        ((40, None, 41), (50, 50, 50), "the flight is taken as level"),
    ],
)
def test_a_set_without_altitudes(
    tmp_path: Path, relative: tuple[int | None, ...], heights: tuple[int, ...], said: str
) -> None:
    for k, up in enumerate(relative):
        tags = d.dji_tags(AbsoluteAltitude="", RelativeAltitude="" if up is None else f"+{up}.0")
        place = (45.0 + 3e-5 * k, 7.6, 0.0)
        d.write_photo(
            tmp_path / f"{k}.jpg", second=f"1{k}", xmp=d.xmp_packet(tags), place=place, gps={5: None, 6: None}
        )
    source = opened(tmp_path)
    ups = [n.position_world[2] for n in of_kind(source, NavSample)]
    np.testing.assert_allclose(np.array(ups) - ups[0], np.array(heights) - heights[0], atol=0.01)
    assert source.warnings == [f"no photo says its altitude: {said}, heights above the sea are not known"]
    assert [p.altitude_kind for p in source.photos] == ["not given"] * 3


@pytest.mark.parametrize("place", [(-33.5, -70.25, 800.0), (45.0, 7.6, 350.0)])
def test_hemispheres(tmp_path: Path, place: tuple[float, float, float]) -> None:
    local = one_photo(tmp_path, place=place, xmp=b"", photo={41989: 28}).local
    assert (local.latitude, local.longitude, local.height) == pytest.approx((place[0], place[1], place[2] - 50))


def test_place_from_xmp_alone(tmp_path: Path) -> None:
    tags = d.dji_tags(GpsLatitude="45.5", GpsLongtitude="7.5")
    local = one_photo(tmp_path, place=None, xmp=d.xmp_packet(tags)).local
    assert (local.latitude, local.longitude) == (45.5, 7.5)


def test_exif_altitude_left_at_zero_by_the_maker(tmp_path: Path) -> None:
    assert of_kind(one_photo(tmp_path, place=(45.0, 7.6, 0.0)), NavSample)[0].position_world[2] == pytest.approx(45)


def test_a_set_on_both_sides_of_longitude_180(tmp_path: Path) -> None:
    for k, longitude in enumerate((179.9999, -179.9999, -179.9998)):
        d.write_photo(tmp_path / f"{k}.jpg", second=f"1{k}", place=(-17.0, longitude, 350.0))
    source = opened(tmp_path)
    assert source.local.longitude == pytest.approx(-179.9999)
    for nav in of_kind(source, NavSample):
        assert np.abs(nav.position_world[:2]).max() < 25


@pytest.mark.parametrize(
    ("times", "spread"),
    [
        ([7], [7]),
        ([0, 0, 10], [0, 5, 10]),
        ([0, 4, 4], [0, 4, 4 + SECOND // 2]),
        ([0, 0, 5 * SECOND, 5 * SECOND], [0, SECOND // 2, 5 * SECOND, 5 * SECOND + SECOND // 2]),
    ],
)
def test_equal_times_are_spread(times: list[int], spread: list[int]) -> None:
    assert spread_times(times) == spread


# -- order and choice


def test_order_is_that_of_capture(tmp_path: Path) -> None:
    """Names do not count; photos of one second are spread over it, and subseconds count."""
    d.write_photo(tmp_path / "a.jpg", second="30")
    d.write_photo(tmp_path / "b.jpg", second="10", subsecond="90")
    d.write_photo(tmp_path / "c.jpg", second="10", subsecond="10")
    d.write_photo(tmp_path / "e.jpg", second="20")
    d.write_photo(tmp_path / "d.jpg", second="20")
    source = opened(tmp_path)
    assert names(source) == ["c.jpg", "b.jpg", "d.jpg", "e.jpg", "a.jpg"]
    times = np.array([f.t_ns for f in of_kind(source, Frame)])
    np.testing.assert_array_equal(times - times[0], [0, 8e8, 99e8, 104e8, 199e8])


def test_order_of_names_without_times(tmp_path: Path) -> None:
    for k, (name, second) in enumerate([("b.jpg", "10"), ("a.jpg", "20"), ("c.jpg", None)]):
        d.write_photo(tmp_path / name, second=second, place=(45.0 + 3e-5 * k, 7.6, 350.0))
    source = opened(tmp_path)
    assert names(source) == ["a.jpg", "b.jpg", "c.jpg"]
    assert source.warnings == ["1 photo(s) have no capture time: the order of the file names is used"]


def test_sub_folders_and_names(tmp_path: Path) -> None:
    d.write_photo(tmp_path / "DCIM/101/x.JPG", second="10")
    d.write_photo(tmp_path / "DCIM/102/x.JPG", second="12")
    d.write_photo(tmp_path / "DCIM/102/y.jpeg", second="14")
    d.write_photo(tmp_path / "DCIM/.x.JPG", second="16")
    source = opened(tmp_path / "DCIM")
    assert names(source) == ["101/x.JPG", "102/x.JPG", "y.jpeg"]
    assert source.name == tmp_path.name  # "DCIM" names nothing


def test_the_root_of_a_memory_card(tmp_path: Path) -> None:
    d.write_photo(tmp_path / "DCIM/100MEDIA/a.JPG")
    d.write_photo(tmp_path / "DCIM/survey/101MEDIA/b.JPG", second="12")
    d.write_photo(tmp_path / "c.JPG", second="14")
    for folder in (".Trash", "DCIM/odm_orthophoto", "DCIM/thumbs", "MISC/my_thumbnails", "out", "DCIM/a/b/c"):
        d.write_photo(tmp_path / folder / "no.JPG")
    (tmp_path / "out" / "run.json").write_text("{}")
    assert names(opened(tmp_path)) == ["a.JPG", "b.JPG", "c.JPG"]


def test_a_photo_that_links_reach_counts_once(tmp_path: Path) -> None:
    """A link to a folder, one to a photo, and one that leads back to the set."""
    d.write_photo(tmp_path / "b/x.JPG", second="10")
    d.write_photo(tmp_path / "b/y.JPG", second="12")
    (tmp_path / "a").symlink_to(tmp_path / "b")
    (tmp_path / "x.JPG").symlink_to(tmp_path / "b/x.JPG")
    (tmp_path / "b/c").symlink_to(tmp_path)
    (tmp_path / "z.JPG").symlink_to(tmp_path / "z.JPG")  # a link to itself is no photo
    source = opened(tmp_path)
    assert names(source) == ["x.JPG", "y.JPG"]
    assert source.counts["photos"] == 3


def test_a_folder_without_permission_is_left_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`lost+found` of a card is one."""
    (tmp_path / "card/lost+found").mkdir(parents=True)
    inside = Path.iterdir

    def iterdir(path: Path) -> Iterator[Path]:
        if path.name == "lost+found":
            raise PermissionError(13, "Permission denied", str(path))
        return inside(path)

    monkeypatch.setattr(Path, "iterdir", iterdir)
    with pytest.raises(InputError, match=r"nothing usable in it \(no permission to read lost\+found\); looked for"):
        opened(tmp_path / "card")
    d.write_photos(tmp_path / "card", 2)
    source = opened(tmp_path / "card")
    assert source.length == 2
    assert source.warnings == ["no permission to read lost+found: photos in there are left out"]


def test_unreadable_photos_of_equal_names_are_as_many(tmp_path: Path) -> None:
    d.write_photos(tmp_path, 2)
    for folder in ("101", "102"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "x.JPG").write_bytes(b"no picture")
    source = opened(tmp_path)
    assert source.warnings == ["photos: 2 of 4 left out (first: 101/x.JPG: it is no image)"]
    assert source.counts["photos left out"] == 2
    assert [p.name for p in source.photos if p.left_out] == ["101/x.JPG", "102/x.JPG"]


def test_skip_and_every(photos: Path) -> None:
    assert names(opened(photos, "sources.skip=1", "sources.every=2")) == ["DJI_0001.JPG", "DJI_0003.JPG"]
    with pytest.raises(InputError, match=r"sources\.skip"):
        opened(photos, "sources.skip=4")


def test_two_cameras_mixed(photos: Path) -> None:
    """The larger group is used, and the others are named."""
    d.write_photo(photos / "A_thermal.JPG", model="H20T", size=(32, 24))
    d.write_photo(photos / "B_zoomed.JPG", photo={37386: 12.0})
    source = opened(photos)
    assert source.length == 4
    assert "A_thermal.JPG" not in names(source)
    left_out = "1 photo(s) of another camera are left out: DJI H20T, 32x24 (first: A_thermal.JPG): fewer than 3 photos"
    assert any(w.startswith(left_out) for w in source.warnings)
    assert any("B_zoomed.JPG" in w and "12 mm" in w for w in source.warnings)
    assert source.counts["photos of another camera"] == 2


def test_thermal_pictures_do_not_become_the_camera(photos: Path) -> None:
    """Thermal pictures are recognised by name, tags or size, also if they are the majority."""
    source = d.xmp_packet(d.dji_tags(ImageSource="InfraredCamera"))
    lwir = d.xmp_packet({"BandName": "LWIR"}, d.PIX4D)
    for k in range(4):
        d.write_photo(photos / f"DJI_{k:04d}_T.JPG", model="H20T", size=(32, 24))
        d.write_photo(photos / f"infrared_{k}.JPG", model="H20T", size=(40, 30), xmp=source)
        d.write_photo(photos / f"lwir_{k}.JPG", model="Altum", size=(40, 30), xmp=lwir)
        d.write_photo(photos / f"small_{k}.JPG", model="XT", size=(160, 120))
    found = opened(photos)
    assert names(found) == [f"DJI_{k:04d}.JPG" for k in range(4)]
    assert found.warnings == ["16 thermal picture(s) are left out (first: DJI_0000_T.JPG)"]
    assert found.counts["thermal pictures"] == 16
    assert {p.left_out for p in found.photos} == {"", "a thermal picture"}


def test_nothing_but_thermal_pictures_is_used(tmp_path: Path) -> None:
    """Photos that were reduced to the size of a thermal camera are not taken for thermal pictures."""
    d.write_photo(tmp_path / "a" / "a_T.JPG")
    assert names(opened(tmp_path / "a")) == ["a_T.JPG"]
    for k in range(3):
        d.write_photo(tmp_path / "b" / f"{k}.JPG", size=(160, 120), second=f"{k + 10}")
    d.write_photo(tmp_path / "b" / "9.JPG", second="20")
    assert names(opened(tmp_path / "b")) == ["0.JPG", "1.JPG", "2.JPG"]


def write_bands(folder: Path, bands: dict[str, int], colour: int = 0) -> None:
    """Write captures of a multispectral camera, and colour pictures of the same model."""
    for place, (band, n) in enumerate(bands.items(), start=1):
        focal = f"{4.5 + 0.1 * place}"
        for k in range(n):
            tags = {"BandName": band, "RigCameraIndex": str(place), "PerspectiveFocalLength": focal}
            name = folder / f"IMG_{k:04d}_{place}.jpg"
            d.write_photo(name, second=f"{k + 10}", xmp=d.xmp_packet(tags, d.PIX4D), photo=SENSOR, model="Altum")
    for k in range(colour):
        d.write_photo(folder / f"IMG_{k:04d}_D.jpg", second=f"{k + 10}", model="Altum")


def test_one_band_of_a_multispectral_camera_is_used(tmp_path: Path) -> None:
    """Each band is a camera with a lens of its own; with equal numbers of photos, green is used."""
    write_bands(tmp_path, {"Blue": 4, "Green": 4, "Red": 4, "LWIR": 4})
    source = opened(tmp_path)
    assert names(source) == [f"IMG_000{k}_2.jpg" for k in range(4)]
    assert source.rig.cameras[0].camera.fu == pytest.approx(47.0)  # not that of blue
    assert "8 picture(s) of single bands are left out (first: IMG_0000_1.jpg)" in source.warnings[1]
    assert "band Green is used" in source.warnings[1]
    assert source.notes["camera"].endswith(", Green")
    assert source.counts["pictures of other bands"] == 8


def test_the_band_with_most_photos_or_the_colour_pictures(tmp_path: Path) -> None:
    write_bands(tmp_path / "a", {"NIR": 4, "Green": 3})
    assert names(opened(tmp_path / "a")) == [f"IMG_000{k}_1.jpg" for k in range(4)]
    write_bands(tmp_path / "b", {"Green": 3, "NIR": 3}, colour=3)
    source = opened(tmp_path / "b")
    assert names(source) == [f"IMG_000{k}_D.jpg" for k in range(3)]
    assert "the colour pictures are used" in source.warnings[0]


def test_colour_pictures_that_name_their_three_bands_are_no_bands(tmp_path: Path) -> None:
    for k in range(3):
        xmp = d.xmp_packet({"BandName": "Red,Green,Blue"}, d.PIX4D)
        d.write_photo(tmp_path / f"{k}.jpg", second=f"{k + 10}", xmp=xmp, photo={41989: 28})
    source = opened(tmp_path)
    assert source.length == 3
    assert not any("band" in w for w in source.warnings)


# -- damage


@pytest.mark.parametrize("share", [0.9, 0.6])
def test_photo_cut_off(photos: Path, share: float) -> None:
    """A truncated photo is not decoded in part: it is left out and named, and the others are read."""
    d.cut_off(photos / "DJI_0002.JPG", share)
    source = opened(photos)
    assert names(source) == ["DJI_0000.JPG", "DJI_0001.JPG", "DJI_0003.JPG"]
    assert len(of_kind(source, NavSample)) == 3
    (warning,) = source.warnings
    assert warning.startswith("photos: 1 of 4 left out (first: DJI_0002.JPG: ")
    assert "truncated" in warning


def test_photo_with_zeros_for_its_end(photos: Path) -> None:
    """Decoders read zeros as image data, without a warning."""
    d.zero_tail(photos / "DJI_0002.JPG", 0.7)
    source = opened(photos)
    assert "DJI_0002.JPG" not in names(source)
    assert "DJI_0002.JPG: it is truncated: its end is missing" in source.warnings[0]


@pytest.mark.parametrize("options", [{"progressive": True}, {"optimize": True}, {"restart_marker_blocks": 2}])
def test_every_kind_of_jpeg_has_its_end_found(tmp_path: Path, options: dict[str, Any]) -> None:
    path = tmp_path / "a.jpg"
    d.picture(size=(200, 100)).save(path, **options)
    data = path.read_bytes()
    assert has_end(data)
    assert has_end(data + bytes(1000))
    assert not has_end(data[:-2])
    assert not has_end(data[: len(data) // 2] + bytes(len(data) // 2))


@pytest.mark.parametrize("data", [b"", b"hello", b"\xff\xd8\xff\xe1\x00\x10Exif"])
def test_file_that_is_no_photo(photos: Path, data: bytes) -> None:
    (photos / "DJI_0002.JPG").write_bytes(data)
    source = opened(photos)
    assert source.length == 3
    assert source.warnings[0].startswith("photos: 1 of 4 left out (first: DJI_0002.JPG: ")


def test_nothing_but_rubbish(tmp_path: Path) -> None:
    (tmp_path / "a.jpg").write_bytes(b"hello")
    with pytest.raises(InputError, match=r"none of the pictures can be read \(1 found\)"):
        opened(tmp_path)


def test_every_photo_without_gps(tmp_path: Path) -> None:
    d.write_photo(tmp_path / "a.jpg", place=None)
    d.write_photo(tmp_path / "b.jpg", place=(0.0, 0.0, 40.0))  # written by a receiver without fix
    Image.new("L", (8, 8)).save(tmp_path / "c.png")  # no tags at all
    with pytest.raises(InputError, match="no photo has a GPS position; photos need EXIF GPS latitude"):
        opened(tmp_path)


def test_one_photo_without_gps(photos: Path) -> None:
    d.write_photo(photos / "DJI_0009.JPG", second="59", place=None)
    source = opened(photos)
    last = of_kind(source, NavSample)[-1]
    assert last.position_world is None
    assert last.sigma_position is None
    assert last.world_from_body is not None
    assert source.warnings == ["1 of 5 photos have no GPS position: their place comes from the pictures alone"]


def test_turned_photos_are_used_as_they_are_stored(photos: Path) -> None:
    """Turned photos belong to the same camera as the others; only their attitude is unknown."""
    d.write_photo(photos / "DJI_0009.JPG", 9, second="59", main={274: 6})
    source = opened(photos)
    assert (source.length, len(source.rig.cameras)) == (5, 1)
    navs, frames = of_kind(source, NavSample), of_kind(source, Frame)
    assert [n.world_from_body is None for n in navs] == [False] * 4 + [True]
    assert navs[-1].position_world is not None
    with Image.open(photos / "DJI_0009.JPG") as stored:
        np.testing.assert_array_equal(np.asarray(frames[-1].images[0]), np.asarray(stored))
    assert source.photos[-1].attitude_from == "not used: EXIF orientation 6"
    assert source.warnings == [
        "1 photo(s) have an EXIF orientation other than 1: their pixels are used as they are stored, their attitude "
        "tags are not used"
    ]
    for k, path in enumerate(sorted(photos.iterdir())):
        d.write_photo(path, k, main={274: 3})
    assert opened(photos).length == 5


@pytest.mark.parametrize("grey", [False, True])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_tiff_is_not_turned_either(tmp_path: Path, orientation: int, grey: bool) -> None:
    """Pillow would turn it, and damages grey ones."""
    picture, path = d.picture(3, grey=grey), tmp_path / "a.tif"
    exif = Image.Exif()
    exif[274] = orientation
    for compression in (None, "tiff_lzw"):
        picture.save(path, exif=exif, compression=compression)
        assert image_size(path) == d.SIZE
        np.testing.assert_array_equal(read_image(path, d.SIZE), np.asarray(picture))


@pytest.mark.parametrize("packet", [b"<x:xmpmeta", b'<!DOCTYPE x [<!ENTITY a "b">]><x>&a;</x>'])
def test_broken_xmp(photos: Path, packet: bytes) -> None:
    """One warning covers all photos with broken XMP."""
    for k in range(8, 10):
        d.write_photo(photos / f"DJI_000{k}.JPG", second=f"5{k}", xmp=packet)
    source = opened(photos)
    assert source.length == 6
    (warning,) = (w for w in source.warnings if "XMP" in w)
    assert warning.startswith("2 photo(s) have damaged XMP (first: DJI_0008.JPG: its XMP")
    assert parse_xmp(packet).fault.startswith("its XMP")


@pytest.mark.parametrize("elements", [False, True])
def test_values_are_picked_out_of_damaged_xmp(tmp_path: Path, elements: bool) -> None:
    """Values are found in spite of an undeclared prefix and an unclosed element."""
    whole = d.xmp_packet(d.dji_tags(), elements=elements)
    packet = whole.replace(b"<rdf:Description", b"<rdf:Description odd:tag='1'").replace(
        b"</rdf:RDF>", b"<a></rdf:RDF>"
    )
    d.write_photo(tmp_path / "a.jpg", xmp=packet)
    d.write_photo(tmp_path / "b.jpg", xmp=whole, second="12")
    source = opened(tmp_path)
    assert "1 photo(s) have damaged XMP (first: a.jpg: its XMP is malformed)" in source.warnings[0]
    first, second = of_kind(source, NavSample)
    np.testing.assert_array_equal(first.world_from_body, second.world_from_body)
    np.testing.assert_array_equal(first.sigma_position, second.sigma_position)
    assert parse_xmp(packet).values.items() >= d_named(d.dji_tags()).items()


@pytest.mark.parametrize("piece", ["<a:b>", "<a:b><rdf:Seq>", "a", "<a:b ", " a:b=", "<x:xmpmeta", "xmlns:a="])
def test_damaged_xmp_takes_no_time(piece: str) -> None:
    """Regular expressions could take hours for such packets, and names that grow with the depth as well."""
    found = parse_xmp(piece * (400_000 // len(piece)))
    assert (found.values, found.fault) == ({}, "its XMP is malformed")


def d_named(tags: dict[str, str]) -> dict[str, str]:
    return {f"dji:{k}": v for k, v in tags.items()}


def test_what_stands_about_the_packet_does_no_harm() -> None:
    whole = d.xmp_packet(d.dji_tags())
    assert parse_xmp(b"\0\x01 & <junk>" + whole + b"</junk>\0\0") == parse_xmp(whole) == (d_named(d.dji_tags()), "")


LISTS = """<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">
<rdf:Description rdf:about="" xmlns:Camera="http://pix4d.com/camera/1.0/"
 xmlns:drone-skydio="https://www.skydio.com/drone-skydio/1.0/">
<Camera:BandName><rdf:Seq><rdf:li>Green</rdf:li></rdf:Seq></Camera:BandName>
<Camera:PerspectiveDistortion>
 <rdf:Seq> <rdf:li>-0.1</rdf:li> <rdf:li>0.14</rdf:li> </rdf:Seq></Camera:PerspectiveDistortion>
<drone-skydio:CameraOrientationNED rdf:parseType="Resource"><drone-skydio:Yaw>30</drone-skydio:Yaw>
</drone-skydio:CameraOrientationNED><drone-skydio:Body drone-skydio:Yaw="7"/>
</rdf:Description></rdf:RDF></x:xmpmeta>"""


def test_lists_and_structures_of_xmp() -> None:
    assert parse_xmp(LISTS).values == {
        "camera:BandName": "Green", "camera:PerspectiveDistortion": "-0.1,0.14", "skydio:CameraOrientationNEDYaw": "30",
        "skydio:BodyYaw": "7",
    }  # fmt: skip
    lists = {"camera:BandName": "Green", "camera:PerspectiveDistortion": "-0.1,0.14"}
    assert parse_xmp(LISTS.replace("</x:xmpmeta>", "")).values.items() >= lists.items()


@pytest.mark.parametrize(
    ("text", "number"), [("527/100", 5.27), ("-3/2", -1.5), ("1/0", None), ("/2", None), ("a/b", None), ("2", 2.0)]
)
def test_a_number_may_be_a_fraction(text: str, number: float | None) -> None:
    assert finite(text) == number


# -- the lens


def lens_of(folder: Path, changes: dict[str, str], **photo: Any) -> tuple[Any, dict[str, Any]]:
    d.write_photo(folder / "a.jpg", xmp=d.xmp_packet(d.dji_tags(**changes)), **photo)
    source = opened(folder)
    return source.rig.cameras[0].camera, source.notes


def test_factory_calibration(tmp_path: Path) -> None:
    """The maker counts from the corner: the centre of a 64x48 image is at (31.5, 23.5) in our pixels."""
    lens, notes = lens_of(tmp_path, {})
    assert (lens.fu, lens.fv, lens.cu, lens.cv) == (60, 60, 33.5, 22.5)
    assert lens.distortion == (-0.1, 0.01, 0.001, 0.0005, 0.002)
    assert notes["focal_from"] == "factory calibration (DewarpData)"
    assert "focal_note" not in notes
    assert "lens_note" not in notes


@pytest.mark.parametrize(("nominal", "expected"), [("58.0", 60.0), ("70.0", 62.0), ("", 61.0)])
def test_two_focal_lengths(tmp_path: Path, nominal: str, expected: float) -> None:
    """Pixels are square: of two focal lengths the one nearer to the design is used, and the choice is noted."""
    dewarp = "2022-03-02;62.0,60.0,2.0,-1.0,-0.1,0.01,0.001,0.0005,0.002"
    lens, notes = lens_of(tmp_path, {"DewarpData": dewarp, "CalibratedFocalLength": nominal})
    assert (lens.fu, lens.fv) == (expected, expected)
    assert "fx 62.0 and fy 60.0 disagree by 3.3%" in notes["focal_note"]
    assert notes["focal_px"] == expected


def test_the_same_tangential_term_twice(tmp_path: Path) -> None:
    dewarp = "2022-03-02;60,60,2.0,-1.0,-0.1,0.01,0.0040638,0.0040638,0.002"
    lens, notes = lens_of(tmp_path, {"DewarpData": dewarp})
    assert lens.distortion == (-0.1, 0.01, 0.0, 0.0, 0.002)
    assert "0.0040638" in notes["lens_note"]


def test_already_dewarped(tmp_path: Path) -> None:
    lens, notes = lens_of(tmp_path, {"DewarpFlag": "1"})
    assert (lens.model, lens.distortion, lens.fu) == ("none", (), 60)
    assert "DewarpFlag" in notes["lens_note"]


@pytest.mark.parametrize("exif_size", [(128, 96), (64, 48)])
def test_resized_photo(tmp_path: Path, exif_size: tuple[int, int]) -> None:
    """The photo has half its size; its EXIF size is the camera's or that of the tool that reduced it."""
    centre = {"CalibratedOpticalCenterX": "64.0", "CalibratedOpticalCenterY": "48.0"}
    lens, notes = lens_of(tmp_path, centre, exif_size=exif_size)
    assert (lens.fu, lens.cu, lens.cv) == (30, 32 + 1 - 0.5, 24 - 0.5 - 0.5)
    assert notes["scale"] == 0.5


@pytest.mark.parametrize(
    ("photo", "expected", "source"),
    [
        ({37386: 5.0, 41486: 10.0, 41487: 10.0, 41488: 4}, 50.0, "FocalPlaneXResolution"),
        ({37386: 5.0, 41486: 100.0, 41487: 100.0, 41488: 3}, 50.0, "FocalPlaneXResolution"),
        ({37386: 5.0, 41486: 254.0, 41487: 254.0, 41488: 2}, 50.0, "FocalPlaneXResolution"),
        ({41989: 28}, 80 * 28 / math.hypot(36, 24), "FocalLengthIn35mmFilm"),
    ],
)
def test_focal_length_without_calibration(tmp_path: Path, photo: dict[int, Any], expected: float, source: str) -> None:
    opened_source = one_photo(tmp_path, xmp=b"", photo=photo)
    lens = opened_source.rig.cameras[0].camera
    assert lens.fu == pytest.approx(expected, rel=1e-6)
    assert (lens.cu, lens.cv, lens.model) == (31.5, 23.5, "none")
    assert source in opened_source.notes["focal_from"]


FACTORY = {
    "PerspectiveFocalLength": "4.8", "PrincipalPoint": "3.3,2.3", "ModelType": "perspective",
    "PerspectiveDistortion": "0.18,-0.47,0.40,-0.0009,-0.0007",
}  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "expected", "distortion", "source"),
    [
        ({"ModelType": "PERSPECTIVE"}, (48.0, 32.5, 22.5), (0.18, -0.47, -0.0009, -0.0007, 0.40), "Camera tags"),
        ({"PrincipalPoint": "3.3"}, (48.0, 31.5, 23.5), (0.18, -0.47, -0.0009, -0.0007, 0.40), "Camera tags"),
        ({"PerspectiveDistortion": "0.1,nan,0,0,0"}, (48.0, 32.5, 22.5), (), "Camera tags"),
        ({"ModelType": "fisheye"}, (50.0, 31.5, 23.5), (), "FocalPlaneXResolution"),
        ({"PerspectiveFocalLength": "0"}, (50.0, 31.5, 23.5), (), "FocalPlaneXResolution"),
        ({"PerspectiveFocalLength": "1e9"}, (50.0, 31.5, 23.5), (), "FocalPlaneXResolution"),
    ],
)
def test_factory_calibration_in_the_tags_of_pix4d(
    tmp_path: Path, changes: dict[str, str], expected: tuple[float, ...], distortion: tuple[float, ...], source: str
) -> None:
    """The sensor has ten pixels a millimetre; the principal point is from the corner of the 6.4 x 4.8 mm image."""
    source_opened = one_photo(tmp_path, xmp=d.xmp_packet(FACTORY | changes, d.PIX4D), photo=SENSOR)
    lens = source_opened.rig.cameras[0].camera
    assert (lens.fu, lens.cu, lens.cv) == pytest.approx(expected)
    assert lens.distortion == pytest.approx(distortion)
    assert source in source_opened.notes["focal_from"]


@pytest.mark.parametrize(
    ("changes", "sensor", "expected"),
    [
        ({"PerspectiveFocalLengthUnits": "mm"}, True, (48.0, 32.5, 22.5)),
        ({"PerspectiveFocalLength": "480/10", "PerspectiveFocalLengthUnits": "pixel"}, True, (48.0, 32.5, 22.5)),
        ({"PerspectiveFocalLength": "120"}, False, (120.0, 31.5, 23.5)),
        ({"PerspectiveFocalLength": "48"}, False, (54.4, 31.5, 23.5)),  # millimetres, of an unknown sensor: a guess
    ],
)
def test_the_unit_of_the_factory_focal_length(
    tmp_path: Path, changes: dict[str, str], sensor: bool, expected: tuple[float, ...]
) -> None:
    photo: dict[int, Any] = {41486: 10.0, 41487: 10.0, 41488: 4} if sensor else {}
    lens = one_photo(tmp_path, xmp=d.xmp_packet(FACTORY | changes, d.PIX4D), photo=photo).rig.cameras[0].camera
    assert (lens.fu, lens.cu, lens.cv) == pytest.approx(expected)


def fisheye(scale: float, polynomial: Sequence[float], angle: F64) -> F64:
    """Pix4D's fisheye model: distance in pixels from the centre, of a ray at an angle from the axis."""
    t = 2 * angle / np.pi
    return scale * sum(p * t**i for i, p in enumerate(polynomial))  # type: ignore[return-value]


@pytest.mark.parametrize("polynomial", [(0, 1, 0, 0), (0, 1, 0, -0.17), (0, 1, -0.02, -0.15)])
def test_a_fisheye_becomes_an_equidistant_camera(tmp_path: Path, polynomial: tuple[float, ...]) -> None:
    """The tags are those of a Sequoia's band, at a twentieth of its size; rays agree with the maker's model."""
    tags = {
        "ModelType": "fisheye", "FisheyeAffineMatrix": "83.4,0.0,0.0,83.4", "PrincipalPoint": "3.3,2.3",
        "FisheyePolynomial": ",".join(str(p) for p in polynomial),
    }  # fmt: skip
    source = one_photo(tmp_path, xmp=d.xmp_packet(tags, d.PIX4D), photo=SENSOR)
    lens = source.rig.cameras[0].camera
    assert (lens.model, lens.cu, lens.cv) == ("equidistant", pytest.approx(32.5), pytest.approx(22.5))
    assert lens.fu == pytest.approx(2 * 83.4 / np.pi, rel=0.02 if polynomial[2] else 1e-6)
    angle = np.linspace(0.02, 0.75, 30)  # the corner is at 0.8
    rays = np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=-1)
    np.testing.assert_allclose(lens.project(rays)[:, 0] - lens.cu, fisheye(83.4, polynomial, angle), atol=4e-3)
    assert source.notes["focal_from"].endswith("fisheye)")


def test_a_fisheye_that_is_none_is_not_taken(tmp_path: Path) -> None:
    tags = {"ModelType": "fisheye", "FisheyeAffineMatrix": "83,9,0,83", "FisheyePolynomial": "0,1,0,0"}
    for name, changes in (
        ("a", {}),
        ("b", {"FisheyeAffineMatrix": "-83,0,0,-83"}),
        ("c", {"FisheyePolynomial": "0,-1,0"}),
    ):
        d.write_photo(tmp_path / name / "a.jpg", xmp=d.xmp_packet(tags | changes, d.PIX4D), photo={41989: 28})
        assert opened(tmp_path / name).notes["focal_from"].startswith("FocalLengthIn35mmFilm")


def test_a_rational_calibration(tmp_path: Path) -> None:
    """DewarpDataK6 of the Matrice 4 divides the radial term by a second polynomial."""
    k = [0.30, 0.05, 0.002, 0.42, 0.08, 0.004]
    text = f"2024-11-02;60,60,2,-1,{k[0]},{k[1]},0.0005,-0.0002,{k[2]},{k[3]},{k[4]},{k[5]}"
    lens, notes = lens_of(tmp_path, {"DewarpData": "", "DewarpDataK6": text})
    assert (lens.fu, lens.cu, lens.cv, notes["focal_from"]) == (60, 33.5, 22.5, "factory calibration (DewarpDataK6)")
    r = np.linspace(0.02, 0.65, 30)  # the corner is at 0.67
    distorted = r * (1 + k[0] * r**2 + k[1] * r**4 + k[2] * r**6) / (1 + k[3] * r**2 + k[4] * r**4 + k[5] * r**6)
    k1, k2, p1, p2, k3 = lens.distortion
    np.testing.assert_allclose(r * (1 + k1 * r**2 + k2 * r**4 + k3 * r**6), distorted, atol=1e-5)
    assert (p1, p2) == (0.0005, -0.0002)


@pytest.mark.parametrize(
    ("make", "model", "size", "width"),
    [
        ("DJI", "FC1", (64, 36), 64 / 0.8),  # 16:9 of a 4:3 sensor keeps its width
        ("DJI", "FC330", (66, 44), 66 / 0.8),  # 3:2 of a sensor that is known to be 4:3
        ("DJI", "FC1", (66, 44), math.hypot(66, 44)),
        ("DJI", "FC6310", (64, 36), 64 * math.hypot(3, 2) / 3),  # of a 3:2 sensor
        ("Apple", "iPhone 15", (64, 36), math.hypot(64, 36)),
    ],
)
def test_a_picture_that_is_cut_out_of_its_sensor(
    tmp_path: Path, make: str, model: str, size: tuple[int, int], width: float
) -> None:
    """The 35 mm equivalent focal length compares the diagonals of the film and of the whole sensor."""
    d.write_photo(tmp_path / "a.jpg", xmp=b"", main={271: make}, model=model, size=size, photo={41989: 24})
    lens = opened(tmp_path).rig.cameras[0].camera
    assert lens.fu == pytest.approx(24 * width / math.hypot(36, 24))


@pytest.mark.parametrize(
    ("told", "expected"), [("47500", 48 * 47.5e-6), ("0", 0.0), ("-1", None), ("1e12", None), ("nan", None)]
)
def test_the_readout_that_a_maker_tells(tmp_path: Path, told: str, expected: float | None) -> None:
    """The tag has nanoseconds a row of the sensor."""
    xmp = d.xmp_packet({"LineReadoutTime": told}, d.PIX4D)
    d.write_photo(tmp_path / "a.jpg", xmp=xmp, photo={41989: 28})
    assert opened(tmp_path).rig.cameras[0].readout == (None if expected is None else pytest.approx(expected))


@pytest.mark.parametrize(("zoom", "expected"), [(2.0, 100.0), (1.0, 50.0), (0.0, 50.0), (1e9, 50.0)])
def test_a_digital_zoom_lengthens_the_focal_length(tmp_path: Path, zoom: float, expected: float) -> None:
    d.write_photo(tmp_path / "a.jpg", xmp=b"", photo=SENSOR | {41988: zoom})
    assert opened(tmp_path).rig.cameras[0].camera.fu == pytest.approx(expected)


@pytest.mark.parametrize("dewarp", ["", "2022;1,2", "2022;60,60,nan,0,0,0,0,0,0", "2022;-60,60,0,0,0,0,0,0,0"])
def test_malformed_factory_calibration_falls_back(tmp_path: Path, dewarp: str) -> None:
    lens, notes = lens_of(tmp_path, {"DewarpData": dewarp})
    assert (lens.fu, notes["focal_from"]) == (58, "CalibratedFocalLength")


def test_no_focal_length_at_all(tmp_path: Path) -> None:
    """A usual field of view is assumed, and a warning names it a guess."""
    source = one_photo(tmp_path, xmp=b"")
    lens = source.rig.cameras[0].camera
    assert (lens.fu, lens.fv, lens.cu, lens.model) == (pytest.approx(0.85 * 64), lens.fu, 31.5, "none")
    assert source.notes["focal_from"].startswith("a guess")
    assert source.photos[0].focal_from.startswith("a guess")
    (warning,) = (w for w in source.warnings if "guess" in w)
    assert "DJI FC1, 64x48" in warning
    assert "sources.calibration" in warning
    assert "heights above ground scale with it" in warning


@pytest.mark.parametrize(
    ("make", "model", "size", "focal", "expected"),
    [
        ("SONY", "DSC-WX220", (64, 48), 4.45, 64 / 6.17),
        ("SONY", "DSC-RX100M3", (96, 64), 8.8, 96 / 13.2),
        ("SONY", "ILCE-5100", (96, 54), 20.0, 96 / 23.5),  # 16:9 keeps the whole width of a 3:2 sensor
        ("Canon", "Canon PowerShot S110", (48, 64), 5.2, 64 / 7.44),
        ("DJI", "FC6310", (64, 48), 8.8, 48 * 1.5 / 13.2),  # 4:3 keeps the whole height of a 3:2 sensor
    ],
)
def test_focal_length_by_the_size_of_a_known_sensor(
    tmp_path: Path, make: str, model: str, size: tuple[int, int], focal: float, expected: float
) -> None:
    source = one_photo(tmp_path, xmp=b"", main={271: make}, model=model, photo={37386: focal}, size=size)
    assert source.rig.cameras[0].camera.fu == pytest.approx(focal * expected)
    assert model in source.notes["focal_from"]
    assert not any("guess" in w for w in source.warnings)


def test_calibration_of_the_user_wins(photos: Path, tmp_path: Path) -> None:
    entry = {"camera_model": "pinhole", "intrinsics": [70.0, 70.0, 31.0, 23.0], "resolution": list(d.SIZE)}
    path = tmp_path / "camchain.yaml"
    path.write_text(yaml.safe_dump({"cam0": entry}))
    source = opened(photos, f"sources.calibration={path}")
    assert source.rig.cameras[0].camera.fu == 70
    assert source.notes["focal_from"] == "Kalibr camchain.yaml"
    np.testing.assert_array_equal(source.rig.cameras[0].body_from_cam.matrix, BODY_FROM_CAM.matrix)


def test_two_factory_calibrations(photos: Path) -> None:
    other = d.xmp_packet(d.dji_tags(DewarpData=d.DEWARP.replace("60.0", "66.0")))
    d.write_photo(photos / "DJI_0000.JPG", second="10", xmp=other)
    source = opened(photos)
    assert source.rig.cameras[0].camera.fu == 60
    assert "2 different factory calibrations" in source.warnings[0]


# -- recognition of photos


def test_what_is_no_source(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such folder or file; give a flight log"):
        opened(tmp_path / "nowhere")
    with pytest.raises(InputError, match="the folder is empty"):
        opened(tmp_path)
    (tmp_path / "notes.txt").write_text("x")
    with pytest.raises(InputError, match="not a file that can be read; give a flight log"):
        opened(tmp_path / "notes.txt")
    with pytest.raises(InputError, match=r"nothing usable in it; looked for mav0/ and for \.jpg"):
        opened(tmp_path)
    (tmp_path / "first/mav0").mkdir(parents=True)
    with pytest.raises(InputError, match=r"holds 1 flight log.*first"):
        opened(tmp_path)


# -- real photos


def test_mirafiori_attitude_and_place_agree_with_the_reference(shared_data: Path) -> None:
    """Gimbal tags agree within 2.6 degrees, and RTK within 4 cm, with structure from motion."""
    source = open_source(shared_data / "mirafiori/images", Settings())
    z = np.load(shared_data / "mirafiori/sfm_reference.npz")
    index = {str(n): i for i, n in enumerate(z["names"])}
    reference = LocalFrame(*z["origin_llh"])
    nav = None
    for event in source.events():
        if isinstance(event, NavSample):
            nav = event
            continue
        assert isinstance(event, Frame)
        assert nav is not None
        assert nav.world_from_body is not None
        i = index[event.name]
        world_from_cam = nav.world_from_body @ source.rig.cameras[0].body_from_cam.rotation
        assert np.degrees(np.linalg.norm(so3_log(world_from_cam @ z["R_cam_from_enu"][i]))) < 2.6
        centre = source.local.to_enu(*reference.to_geodetic(z["centers_enu"][i]))
        assert np.abs(nav.position_world - centre).max() < 0.04
    assert source.warnings == []
    assert source.length == 32
    lens = source.rig.cameras[0].camera
    assert lens.fu == lens.fv == pytest.approx(1955.65, abs=0.01)


def test_pictures_that_are_let_go_take_no_memory_and_are_read_again(photos: Path) -> None:
    memory, path = PictureMemory(1e9), photos / "DJI_0000.JPG"
    pixels = PhotoPixels(path, d.SIZE, memory)
    before = np.asarray(pixels).copy()
    assert memory.held_bytes == before.nbytes
    pixels.let_go()
    assert memory.held_bytes == 0
    np.testing.assert_array_equal(np.asarray(pixels), before)
