"""The table of photos: tags of several makers, zoom levels, flights, and the use of each photo."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import damage as d
import numpy as np
import pytest
from drawn_photos import CAMERA, draw_photos
from PIL import Image, PngImagePlugin

from alight.geometry import enu_from_flu
from alight.photos.bundle.adjust import adjust
from alight.photos.reading.photo_pose import BODY_FROM_CAM
from alight.photos.reading.photos import Photos
from alight.records import Frame, NavSample, PhotoFacts, PhotoOutcome, PhotoRow
from alight.runner.opening import open_source
from alight.settings import BundleSettings, load_settings

PARROT, AUTEL = "http://www.parrot.com/drone-parrot/1.0/", "http://www.autelrobotics.com/drone-autel/1.0/"
YUNEEC, SKYDIO = "http://www.yuneec.com/drone-yuneec/1.0/", "https://www.skydio.com/drone-skydio/1.0/"
LENS = {41989: 28}  # 35 mm equivalent


def opened(path: Path, *assignments: str) -> Photos:
    source = open_source(path, load_settings("", assignments))
    assert isinstance(source, Photos)
    return source


def attitude(source: Photos) -> np.ndarray:
    (nav,) = (e for e in source.events() if isinstance(e, NavSample))
    assert nav.world_from_body is not None
    return nav.world_from_body


def facts(path: Path, *assignments: str) -> list[PhotoFacts]:
    return opened(path, *assignments).photos


@pytest.mark.parametrize(
    ("make", "namespace", "pattern"),
    [
        ("Parrot", PARROT, "Camera{}Degree"),
        ("Autel Robotics", AUTEL, "Gimbal{}Degree"),
        ("Yuneec", YUNEEC, "Gimbal{}"),
        ("Yuneec", "http://ns.adobe.com/xap/1.0/", "Camera{}"),
    ],
)
def test_angles_from_the_horizon_of_several_makers(tmp_path: Path, make: str, namespace: str, pattern: str) -> None:
    tags = {pattern.format(axis): v for axis, v in (("Yaw", "30"), ("Pitch", "-80"), ("Roll", "1"))}
    d.write_photo(tmp_path / "a.jpg", xmp=d.xmp_packet(tags, namespace), main={271: make}, photo=LENS)
    expected = enu_from_flu(math.radians(30), math.radians(-80), math.radians(1))
    np.testing.assert_allclose(attitude(opened(tmp_path)), expected, atol=1e-12)


def test_angles_of_a_yuneec_that_declares_no_prefix(tmp_path: Path) -> None:
    """The camera is a CGO3+."""
    xmp = (
        b'<?xpacket begin="" id="W5M0MpCehiHzreSzNTczkc9d"?><rdf:RDF '
        b'xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"><xmp:GPSAltitude>6</xmp:GPSAltitude>\n'
        b"<xmp:CameraYaw>-85.5</xmp:CameraYaw><xmp:CameraPitch>-13.9</xmp:CameraPitch>\n"
        b'<xmp:CameraRoll>0.5</xmp:CameraRoll></rdf:RDF><?xpacket end="w"?>'
    )
    d.write_photo(tmp_path / "a.jpg", xmp=xmp, photo=LENS)
    expected = enu_from_flu(math.radians(-85.5), math.radians(-13.9), math.radians(0.5))
    np.testing.assert_allclose(attitude(opened(tmp_path)), expected, atol=1e-12)


def test_a_skydio(tmp_path: Path) -> None:
    """The tags have structures with equal names of parts, and the lens in pixels from the first pixel's centre."""
    parts = {
        "CameraOrientationFLU": {"Yaw": "1", "Pitch": "2", "Roll": "3"},
        "CameraOrientationNED": {"Yaw": "30", "Pitch": "-90", "Roll": "1"},
        "CalibratedFocalLength": {"X": "50", "Y": "50.1"}, "CalibratedOpticalCenter": {"X": "32.5", "Y": "23.5"},
    }  # fmt: skip
    inside = "".join(
        f'<m:{name} rdf:parseType="Resource">{"".join(f"<m:{k}>{v}</m:{k}>" for k, v in values.items())}</m:{name}>'
        for name, values in parts.items()
    )
    flat = {"DewarpData": "0.13, -0.24, 0.104", "GpsHorizontalAccuracy": "0.3", "GpsVerticalAccuracy": "0.4"}
    xmp = d.xmp_packet(flat, SKYDIO, elements=True).replace(b"<m:Dewarp", inside.encode() + b"<m:Dewarp")
    d.write_photo(tmp_path / "a.jpg", xmp=xmp, main={271: "Skydio"})
    source = opened(tmp_path)
    expected = enu_from_flu(math.radians(30), math.radians(-90), math.radians(1))
    np.testing.assert_allclose(attitude(source), expected, atol=1e-12)
    lens = source.rig.cameras[0].camera
    assert (lens.fu, lens.cu, lens.cv) == pytest.approx((50.05, 32.5, 23.5))
    assert lens.distortion == (0.13, -0.24, 0.0, 0.0, 0.104)
    (nav,) = (e for e in source.events() if isinstance(e, NavSample))
    np.testing.assert_allclose(nav.sigma_position, [0.3, 0.3, 0.4])


def test_an_autel_that_writes_its_pitch_from_the_horizon_into_the_names_of_pix4d(tmp_path: Path) -> None:
    """The EVO Lite Enterprise 640T writes -90 for straight down; in the meaning of these names it is 0."""
    tags = {"Yaw": "90", "Pitch": "-90", "Roll": "0"}
    d.write_photo(tmp_path / "a.jpg", xmp=d.xmp_packet(tags, d.PIX4D), main={271: "Camera"}, photo=LENS)
    source = opened(tmp_path)
    np.testing.assert_allclose(attitude(source) @ BODY_FROM_CAM.rotation @ [0, 0, 1], [0, 0, -1], atol=1e-12)
    assert source.photos[0].attitude_from == "camera, from the horizon"


@pytest.mark.parametrize(
    ("main", "xmp", "kind"),
    [
        ({271: "DJI"}, d.dji_tags(), "ellipsoid (RTK fixed)"),
        ({271: "DJI"}, d.dji_tags(RtkFlag="", AltitudeType="RtkAlt"), "ellipsoid"),
        ({271: "DJI"}, d.dji_tags(RtkFlag="", AltitudeType="GpsFusionAlt"), "sea level or ellipsoid: not declared"),
        ({271: "Parrot", 272: "Anafi"}, {}, "sea level (EGM96)"),
        ({271: "Parrot", 272: "AnafiAi"}, {}, "ellipsoid"),
        ({271: "Parrot", 272: "ANAFI Ai"}, {}, "ellipsoid"),
        ({271: "Apple", 272: "iPhone 15"}, {}, "sea level or ellipsoid: not declared"),
    ],
)
def test_what_an_altitude_is_counted_from(tmp_path: Path, main: dict[int, str], xmp: dict[str, str], kind: str) -> None:
    d.write_photo(tmp_path / "a.jpg", xmp=d.xmp_packet(xmp) if xmp else b"", main=main, photo=LENS)
    assert facts(tmp_path)[0].altitude_kind == kind


@pytest.mark.parametrize(
    ("code", "version", "xmp", "altitude", "kind"),
    [
        (b"\x00", b"0300", {}, 350.0, "ellipsoid"),
        (b"\x01", b"0300", {}, -350.0, "ellipsoid"),
        (b"\x02", b"0300", {}, 350.0, "sea level"),
        (b"\x03", b"0300", {}, -350.0, "sea level"),
        (b"\x02", b"0232", {}, 350.0, "sea level"),
        (b"\x00", b"0232", {}, 350.0, "sea level or ellipsoid: not declared"),
        (b"\x00", b"0300", {"AbsoluteAltitude": "+402.00"}, 402.0, "sea level or ellipsoid: not declared"),
    ],
)
def test_exif_3_says_what_an_altitude_is_counted_from(
    tmp_path: Path, code: bytes, version: bytes, xmp: dict[str, str], altitude: float, kind: str
) -> None:
    """It says nothing about an altitude that is not that of EXIF."""
    packet = d.xmp_packet(xmp) if xmp else b""
    d.write_photo(tmp_path / "a.jpg", xmp=packet, photo=LENS | {36864: version}, gps={5: code})
    (row,) = facts(tmp_path)
    assert (row.altitude, row.altitude_kind) == (altitude, kind)


def test_png_and_tiff_with_the_same_tags(tmp_path: Path) -> None:
    jpeg = d.write_photo(tmp_path / "a" / "a.jpg")
    with Image.open(jpeg) as picture:
        exif, xmp = picture.getexif(), picture.info["xmp"]
        text = PngImagePlugin.PngInfo()
        text.add_itxt("XML:com.adobe.xmp", xmp.decode())
        for name in ("b", "c"):
            (tmp_path / name).mkdir()
        picture.save(tmp_path / "b" / "a.png", exif=exif, pnginfo=text)
        details, gps = exif.get_ifd(0x8769), exif.get_ifd(0x8825)
        exif[700] = xmp
        exif.get_ifd(0x8769).update(details)
        exif.get_ifd(0x8825).update(gps)
        picture.save(tmp_path / "c" / "a.tif", exif=exif)
    (jpg,), (png,), (tif,) = (facts(tmp_path / n) for n in "abc")
    assert replace(png, name="") == replace(jpg, name="") == replace(tif, name="")
    frames = [e for e in opened(tmp_path / "c").events() if isinstance(e, Frame)]
    assert np.asarray(frames[0].images[0]).shape == (48, 64, 3)


def test_a_phone_says_where_but_not_whither(tmp_path: Path) -> None:
    main = {271: "Apple", 272: "iPhone 15"}
    d.write_photo(tmp_path / "a.jpg", xmp=b"", main=main, photo=LENS, place=(47.5, 8.25, 412.0))
    (row,) = facts(tmp_path)
    assert (row.camera, row.size, row.place, row.altitude) == ("Apple iPhone 15", (64, 48), (47.5, 8.25), 412.0)
    assert (row.attitude_from, row.position_from, row.group) == ("", "GPS", "flight 1, camera 1")
    assert row.focal_from.startswith("FocalLengthIn35mmFilm")
    assert row.focal_px == pytest.approx(math.hypot(64, 48) * 28 / math.hypot(36, 24), abs=0.1)
    assert row.taken == "2026-01-26 13:50:10"


def test_each_zoom_level_is_a_camera_and_each_pause_ends_a_flight(tmp_path: Path) -> None:
    """Four photos are at 28 mm, three at 56 mm six minutes later, and one at 84 mm is left out."""
    for k in range(8):
        zoom = 1 if k < 4 else 2 if k < 7 else 3
        time = f"2026:01:26 13:{50 if k < 4 else 57}:{10 + k:02d}"
        d.write_photo(
            tmp_path / f"{k}.jpg", k, xmp=b"", photo={41989: 28 * zoom, 37386: 4.5 * zoom, 36867: time},
            place=(45.0 + 3e-5 * k, 7.6, 350.0),
        )  # fmt: skip
    source = opened(tmp_path)
    rows = source.photos
    assert [r.group for r in rows] == ["flight 1, camera 1"] * 4 + ["flight 2, camera 2"] * 3 + [""]
    assert [bool(r.left_out) for r in rows] == [False] * 7 + [True]
    assert "fewer than 3 photos" in rows[7].left_out
    assert "fewer than 3 photos" in source.warnings[0]
    first, second = (c.camera.fu for c in source.rig.cameras)
    assert second == pytest.approx(2 * first)
    assert rows[5].focal_px == pytest.approx(2 * (rows[0].focal_px or 0), abs=0.2)
    frames = [e for e in source.events() if isinstance(e, Frame)]
    assert [[i is not None for i in f.images] for f in frames] == [[True, False]] * 4 + [[False, True]] * 3
    assert len(source.notes["cameras"]) == 2
    assert source.notes["flights"] == 2


def test_photos_that_are_not_used_say_why(tmp_path: Path) -> None:
    d.write_photos(tmp_path, 4)
    d.write_photo(tmp_path / "DJI_0030_T.jpg", second="30")
    d.cut_off(tmp_path / "DJI_0002.JPG")
    (tmp_path / "none.jpg").write_bytes(b"no picture")
    source = opened(tmp_path, "sources.skip=1")
    list(source.events())
    why = {r.name: r.left_out for r in source.photos}
    assert why["DJI_0000.JPG"] == "by sources.skip or sources.every"
    assert (why["DJI_0001.JPG"], why["DJI_0003.JPG"]) == ("", "")
    assert "truncated" in why["DJI_0002.JPG"]
    assert why["DJI_0030_T.jpg"] == "a thermal picture"
    assert why["none.jpg"] == "it is no image"


def test_photos_of_two_zoom_levels_are_adjusted_each_with_its_own_lens(tmp_path: Path) -> None:
    """The second line is flown at another focal length, and all photos get their true place."""
    pytest.importorskip("pycolmap")
    draw_photos(tmp_path, zooms=(1.0, 1.3))
    source = opened(tmp_path)
    events = list(source.events())
    frames, nav = ([e for e in events if isinstance(e, kind)] for kind in (Frame, NavSample))
    assert len(source.rig.cameras) == 2
    settings = BundleSettings(features=900, lens="held")
    found = adjust(frames, nav, source.rig, settings)
    for m, n in zip(found.motions, nav, strict=True):
        assert m is not None
        assert len(m.world_from_cams) == 2
        assert np.linalg.norm(m.world_from_body.translation - n.position_world) < 0.08
    assert found.notes["reprojection_median_px"] < 0.6
    assert [p.attitude for p in found.photos] == ["believed"] * 8
    free = adjust(frames, nav, source.rig, BundleSettings(features=900, focal="free", lens="held"))
    focals = [c.camera.fv for c in free.rig.cameras]
    np.testing.assert_allclose(focals, [CAMERA.fv, 1.3 * CAMERA.fv], rtol=0.01)
    assert free.notes["lens_free"] == ["camera 1: focal", "camera 2: focal"]


def test_a_row_says_what_became_of_the_tags() -> None:
    photo = PhotoFacts("a.jpg", (4000, 3000), "DJI FC1", attitude_from="gimbal", place=(1.0, 2.0), position_from="GPS")
    row = PhotoRow(photo, PhotoOutcome(1, "turned back", "contradicts the pictures, ignored"))
    assert "gimbal (turned back)" in row.line
    assert "GPS (contradicts the pictures, ignored)" in row.line
    assert row.line.endswith("used")
    assert not row.left_out
    lost = PhotoRow(photo, PhotoOutcome(1, left_out="no texture"))
    assert lost.line.endswith("left out: no texture")
    assert lost.as_json()["used"] is False
