"""The focal length: all sources of the tags against each other, and heights above ground against the photos."""

from __future__ import annotations

import math
from itertools import permutations
from pathlib import Path
from typing import Any

import pytest

from alight.photos.reading.photo_camera import Claim, focal_given, photo_camera
from alight.photos.reading.photo_tags import PhotoTags
from alight.records import InputError

TRUE = 600.0  # px, of a picture of 800 x 600
SIZE = (800, 600)
SENSOR = 6.17  # mm, width of the sensor of this model
FOCAL, FILM = TRUE / 800 * SENSOR, round(TRUE / 1000 * math.hypot(36, 24))  # mm
EXIF = {
    "Make": 271, "Model": 272, "FocalLength": 37386, "Plane": 41486, "PlaneY": 41487, "Unit": 41488, "Film": 41989,
    "Zoom": 41988, "Width": 40962, "Height": 40963,
}  # fmt: skip


def tags(size: tuple[int, int] = SIZE, xmp: dict[str, Any] | None = None, **exif: Any) -> PhotoTags:
    return PhotoTags(
        Path("a.jpg"), size, {EXIF[k]: v for k, v in exif.items()}, {},
        {f"dji:{k}": str(v) for k, v in (xmp or {}).items()},
    )  # fmt: skip


def with_sources(**factors: float) -> PhotoTags:
    """Tags with some sources, each wrong by a factor."""
    exif: dict[str, Any] = {"Make": "DJI", "Model": "other", "FocalLength": FOCAL}
    xmp = {}
    for name, factor in factors.items():
        match name:
            case "dewarp":
                xmp["DewarpData"] = f"2022;{TRUE * factor},{TRUE * factor},0,0,-0.1,0,0,0,0"
            case "calibrated":
                xmp["CalibratedFocalLength"] = f"{TRUE * factor}"
            case "plane":
                exif |= {"Plane": 800 / SENSOR * 10 * factor, "Unit": 3}
            case "film":
                exif["Film"] = FILM * factor
            case "model":
                exif |= {"Model": "FC330", "FocalLength": FOCAL * factor}
    return tags(xmp=xmp, **exif)


SOURCES = "dewarp", "calibrated", "plane", "film", "model"


@pytest.mark.parametrize("pair", [p for p in permutations(SOURCES, 2) if p != ("model", "plane")])
@pytest.mark.parametrize("factor", [0.5, 0.8, 1.25, 2.0])
def test_no_source_is_wrong_without_a_word(pair: tuple[str, str], factor: float) -> None:
    wrong, right = pair
    camera, notes = photo_camera(with_sources(**{wrong: factor, right: 1.0}))
    warning = notes["focal_warning"]
    assert warning.count(" px") == 2
    assert f"{camera.fu:.0f} px is used" in warning
    for px in (TRUE, TRUE * factor):
        assert any(abs(int(word) / px - 1) < 0.03 for word in warning.split() if word.isdigit())


@pytest.mark.parametrize("pair", list(permutations(SOURCES, 2)))
def test_sources_that_agree_give_no_warning(pair: tuple[str, str]) -> None:
    camera, notes = photo_camera(with_sources(**dict.fromkeys(pair, 1.0)))
    assert camera.fu == pytest.approx(TRUE, rel=0.01)
    assert "focal_warning" not in notes


LARGE = {"Width": 1600, "Height": 1200}
SITUATIONS = {
    "resized": (tags(xmp={"CalibratedFocalLength": 1200}, Film=FILM, **LARGE), TRUE, False),
    "resized, size rewritten": (
        tags(xmp={"CalibratedFocalLength": 1200, "CalibratedOpticalCenterX": 800}, Film=FILM), TRUE, False,
    ),
    "turned": (tags((600, 800), {"CalibratedFocalLength": 1200}, Film=FILM, **LARGE), TRUE, False),
    "focal plane of the large picture": (tags(FocalLength=5.0, Plane=2400.0, Unit=3, Film=FILM), TRUE, True),
    "inches for centimetres": (tags(FocalLength=5.0, Plane=1200.0, Unit=2, Film=FILM), TRUE, True),
    "plane by its height alone": (tags(FocalLength=5.0, PlaneY=1200.0, Unit=3), TRUE, False),
    "zoom in the film's tag alone": (
        tags(xmp={"CalibratedFocalLength": 600}, Film=2 * FILM, Make="DJI", Model="FC330", FocalLength=FOCAL),
        2 * TRUE, True,
    ),
    "zoom": (tags(xmp={"CalibratedFocalLength": 600}, Film=2 * FILM, Zoom=2.0), 2 * TRUE, False),
    "zoom that the film's tag lacks": (tags(xmp={"CalibratedFocalLength": 600}, Film=FILM, Zoom=2.0), 2 * TRUE, True),
    "zoom, unconfirmed": (tags(xmp={"CalibratedFocalLength": 600}, Zoom=2.0), 2 * TRUE, True),
    "one of three is wrong": (with_sources(dewarp=2.0, calibrated=1.0, film=1.0), TRUE, True),
    "16:9 out of 4:3": (tags((800, 450), {"CalibratedFocalLength": 600}, Film=FILM, Make="DJI"), TRUE, False),
}  # fmt: skip


@pytest.mark.parametrize("situation", SITUATIONS)
def test_the_likeliest_focal_length_is_used(situation: str) -> None:
    photo, focal, warned = SITUATIONS[situation]
    camera, notes = photo_camera(photo)
    assert camera.fu == pytest.approx(focal, rel=0.02)
    assert ("focal_warning" in notes) == warned


def test_a_lens_keeps_its_shape_with_another_focal_length() -> None:
    """The maker's distortion and, by the same factor, its principal point go with the focal length of another tag."""
    dewarp = f"2022;{2 * TRUE},{2 * TRUE},10,-4,-0.1,0,0,0,0"
    camera, _ = photo_camera(tags(xmp={"DewarpData": dewarp}, Film=FILM))
    assert camera.fu == pytest.approx(TRUE, rel=0.02)
    assert camera.cu - 399.5 == pytest.approx(5, rel=0.02)
    assert camera.distortion[0] == -0.1


def test_what_the_user_gives_is_used_and_compared() -> None:
    photo = with_sources(dewarp=1.0)
    given = focal_given(photo, 800.0)
    camera, notes = photo_camera(photo, given)
    assert (camera.fu, camera.distortion[0], notes["focal_from"]) == (800, -0.1, "sources.calibration")
    assert "sources.calibration 800 px is used, but factory calibration (DewarpData) 600 px" in notes["focal_warning"]
    assert photo_camera(tags(), focal_given(tags(), 800.0))[0].fu == 800
    assert "focal_warning" not in photo_camera(photo, Claim("Kalibr", camera, 0.5, "user", {}))[1]


CENTRE = {"CalibratedOpticalCenterX": 400, "CalibratedOpticalCenterY": 300}  # of the whole picture, 800 x 600
CALIBRATED = {"CalibratedFocalLength": TRUE}
CUT = {"Width": 800, "Height": 600}  # size in the tags
DEWARP = {"DewarpData": f"2022;{TRUE},{TRUE},10,-4,-0.1,0,0.01,0.02,0"}
CHANGED = {  # photo, focal length, part of the doubt; no case is a contradiction
    "crop of the middle, or resized": (tags((400, 300), CALIBRATED, Film=FILM, **CUT), TRUE / 2, "calibration=600"),
    "square crop, size kept": (tags((600, 600), CALIBRATED, Film=FILM, **CUT), TRUE, ""),
    "square crop, size rewritten": (
        tags((600, 600), CALIBRATED | CENTRE, Film=FILM, Width=600, Height=600), TRUE, "",
    ),
    "turned, size kept": (tags((600, 800), CALIBRATED | CENTRE, Film=FILM, **CUT), TRUE, ""),
    "turned, size rewritten": (
        tags((600, 800), CALIBRATED | CENTRE, Film=FILM, Width=600, Height=800), TRUE, "",
    ),
    "turned, without 35 mm": (tags((600, 800), CALIBRATED | {"CalibratedOpticalCenterX": 400}), TRUE, ""),
    "whole": (tags(SIZE, CALIBRATED | CENTRE, **CUT), TRUE, ""),
    "centre off the middle": (
        tags((800, 450), CALIBRATED | {"CalibratedOpticalCenterX": 380, "CalibratedOpticalCenterY": 310}, Film=FILM,
             Width=800, Height=450), TRUE, "",
    ),
    "size gone": (tags((400, 300), CALIBRATED), TRUE, "unconfirmed"),
    "size gone, 35 mm": (tags((400, 300), CALIBRATED | CENTRE, Film=FILM), TRUE / 2, "calibration=600"),
    "size rewritten": (tags((400, 300), DEWARP, Width=400, Height=300), TRUE, "unconfirmed"),
}  # fmt: skip


@pytest.mark.parametrize("situation", CHANGED)
def test_cropped_turned_and_resized_photos(situation: str) -> None:
    photo, focal, doubt = CHANGED[situation]
    camera, notes = photo_camera(photo)
    assert camera.fu == pytest.approx(focal, rel=1e-6)
    assert "focal_warning" not in notes
    assert doubt in notes.get("focal_doubt", "")
    assert bool(doubt) == ("focal_doubt" in notes)


def test_a_lens_of_a_turned_photo_keeps_what_has_no_side() -> None:
    camera, notes = photo_camera(tags((600, 800), DEWARP | CENTRE, Film=FILM))
    assert (camera.fu, camera.cu, camera.cv) == (TRUE, 299.5, 399.5)
    assert camera.distortion == (-0.1, 0, 0, 0, 0)
    assert "turned" in notes["lens_note"]


def test_the_sensor_of_the_model_wins_over_a_calibration_of_unknown_size() -> None:
    photo = tags((200, 150), DEWARP, Make="DJI", Model="FC330", FocalLength=FOCAL)
    camera, notes = photo_camera(photo)
    assert camera.fu == pytest.approx(TRUE / 4, rel=0.01)
    assert "600 px" in notes["focal_warning"]


def test_a_35_mm_equivalent_that_no_lens_has_is_not_used() -> None:
    with pytest.raises(InputError, match="no focal length"):
        photo_camera(tags(Film=5.0))
    assert photo_camera(tags(xmp=CALIBRATED | CENTRE, Film=5.0))[0].fu == TRUE
