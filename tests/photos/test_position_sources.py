"""Sources of the positions of photos (file, EXIF, XMP, height above take-off) that contradict each other."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import damage as d
import numpy as np
import pytest

from alight.photos.reading.photo_pose import position_sigma
from alight.photos.reading.photo_tags import PhotoTags
from alight.photos.reading.positions import Positions, positions_by_tags, settle_positions
from alight.records import InputError
from alight.runner.opening import open_source

UP = np.array([40.0, 41.5, 41.3, 42.0, 40.1, 40.7])
PLACES = np.array([45.0, 7.6]) + 3e-5 * np.arange(6)[:, None]


def photos(
    folder: Path, places: Any = PLACES, exif: Any = 380 + UP - 40, above: Any = UP, **gps: Any
) -> list[PhotoTags]:
    """Photos 3 s apart, with EXIF places and altitudes and, in XMP, heights above take-off; None: no such tag."""
    out = []
    for k, (latitude, longitude) in enumerate(np.asarray(places).tolist()):
        tags: dict[int, Any] = {1: "NS"[latitude < 0], 2: (abs(latitude), 0.0, 0.0)}
        tags |= {3: "EW"[longitude < 0], 4: (abs(longitude), 0.0, 0.0)}
        tags |= {} if exif is None else {6: float(exif[k])}
        tags |= {{"north": 1, "latitude": 2, "east": 3, "below": 5}[n]: v for n, v in gps.items()}
        xmp = {} if above is None else {"dji:RelativeAltitude": f"{above[k]:+.2f}"}
        out.append(PhotoTags(folder / f"{k}.jpg", (64, 48), {36867: f"2026:01:26 13:00:{3 * k:02d}"}, tags, xmp))
    return out


def by_file(folder: Path, places: Any, heights: Any, system: str = "EPSG:4326", **tags: Any) -> Positions:
    """The same photos with a geo.txt of these places and heights."""
    lines = [f"{k}.jpg {x:.9f} {y:.9f} {z}" for k, ((y, x), z) in enumerate(zip(places, heights, strict=True))]
    (folder / "geo.txt").write_text("\n".join([system, *lines]))
    return settle_positions(photos(folder, **tags), folder)


@pytest.mark.parametrize(
    ("places", "system", "what"),
    [
        (PLACES * [1, -1], "EPSG:4326", "with the sign of the longitude changed they agree"),
        (PLACES * [-1, 1], "EPSG:4326", "with the sign of the latitude changed they agree"),
        (-PLACES, "EPSG:4326", "with the signs changed they agree"),
        (PLACES[:, ::-1], "EPSG:4326", "with latitude and longitude exchanged they agree"),
        ([[4983900.0 + k, 389650.0] for k in range(6)], "EPSG:32631", "km from those of the tags: mend the coordinate"),
    ],
)
def test_a_file_on_another_continent_is_refused(tmp_path: Path, places: Any, system: str, what: str) -> None:
    with pytest.raises(InputError, match=what):
        by_file(tmp_path, places, UP, system)


def test_tags_without_a_hemisphere_contradict_no_sign(tmp_path: Path) -> None:
    found = by_file(tmp_path, -PLACES, 380 + UP - 40, north="", east=None)
    assert (found.warnings, found.contradictions) == ([], [])


@pytest.mark.parametrize(
    ("heights", "tags", "warning", "contradicted"),
    [
        (340 + UP, {}, "", []),
        (388 + UP, {}, "48.0 m above those of the tags (429 and 381 m): they count from another surface; they", []),
        ((340 + UP) / 0.3048, {}, "", ["ten times as well as feet", "(1250 and 381 m): as feet they agree"]),
        ((1 + UP) / 0.3048, {"exif": 1 + UP, "above": None}, "", ["ten times as well as feet", ": as feet they agree"]),
        (UP, {}, "", [": they count from take-off"]),
        (0 * UP, {}, "", ["381.0 m below those of the tags (0 and 381 m): one is wrong"]),
        (358 + 9 * np.arange(6), {}, "", ["of the tags only to 40 m in a flight"]),
        (340 + UP, {"exif": 0 * UP}, "", []),  # not written by the maker
        (-340 - UP, {"above": None}, "", ["with the opposite sign", "with the opposite sign they agree"]),
    ],
)
def test_heights_of_a_file_are_compared_with_the_tags(
    tmp_path: Path, heights: Any, tags: Any, warning: str, contradicted: list[str]
) -> None:
    found = by_file(tmp_path, PLACES, heights, **tags)
    said = found.contradictions + (found.warnings if not warning else [])
    assert len(said) == len(contradicted)
    assert all(what in text for what, text in zip(contradicted, said, strict=True)), said
    assert [warning in w for w in found.warnings] == ([True] if warning else [])


def test_places_of_a_file_100_m_away(tmp_path: Path) -> None:
    (text,) = by_file(tmp_path, PLACES + np.array([1e-3, 0.0]), 340 + UP).contradictions
    assert text == "geo.txt: its places lie 0.1 km from those of the tags; those of the file are used"


@pytest.mark.parametrize(
    ("exif", "gps", "used", "what"),
    [
        (np.round((340 + UP) / 0.3048, 1), {}, 340 + UP, "only as feet: they are read so; 1250.0 becomes 381.0 m"),
        (300 + UP, {"below": b"\1"}, 300 + UP, "only with the opposite sign: they are read so; -341.0 becomes 341.0 m"),
        (300 + 0 * UP, {"below": b"\1"}, -300 + 0 * UP, "altitudes lie 300 m below the sea: if the ground does not"),
        (300 - UP, {"below": b"\1"}, UP - 300, "altitudes lie 259 m below the sea"),  # by the Dead Sea
        (20 - UP, {"below": b"\1"}, UP - 20, ""),
    ],
)
def test_units_and_signs_of_altitudes(tmp_path: Path, exif: Any, gps: Any, used: Any, what: str) -> None:
    """A flight that climbs by 2 m shows them; a level one does not."""
    found = positions_by_tags(photos(tmp_path, exif=exif, above=UP if np.ptp(exif) else 40 + 0 * UP, **gps), [0] * 6)
    np.testing.assert_allclose([p.position[2] for p in found.photos if p.position], used, atol=0.1)
    assert [what in w for w in found.warnings + found.contradictions] == ([True] if what else [])


def test_noise_is_no_unit(tmp_path: Path) -> None:
    """Altitudes that drift by some metres against heights above take-off are left alone, in 60 flights."""
    rng = np.random.default_rng(0)
    for _ in range(60):
        above = 40 + rng.uniform(0, 3) * np.sin(np.arange(6) * rng.uniform(0.1, 3)) + rng.normal(0, 0.1, 6)
        exif = 340 + above + np.clip(np.cumsum(rng.normal(0, 0.8, 6)), -4.0, 4.0)
        assert positions_by_tags(photos(tmp_path, exif=exif, above=above), [0] * 6).contradictions == []


@pytest.mark.parametrize(
    ("tags", "xmp", "place", "is_missing"),
    [
        ({}, None, (33.6, 117.1), False),
        ({"north": "South", "east": b"w\0"}, None, (-33.6, -117.1), False),
        ({"north": "S", "latitude": (-33.0, 36.0, 0.0)}, None, (-33.6, 117.1), False),
        ({"north": "", "east": None}, None, (33.6, 117.1), True),
        ({"north": "", "east": None}, (-33.6001, -117.1), (-33.6, -117.1), False),
        ({"north": None}, (-33.6, -117.1), (-33.6, 117.1), False),
        ({"north": None, "east": None}, (-30.0, -110.0), (33.6, 117.1), True),
        ({"north": "X"}, None, (33.6, 117.1), True),
    ],
)
def test_hemispheres(tmp_path: Path, tags: Any, xmp: Any, place: Any, is_missing: bool) -> None:
    (photo,) = photos(tmp_path, np.array([[33.6, 117.1]]), **tags)
    assert isinstance(photo.xmp, dict)
    photo.xmp.update({} if xmp is None else {"dji:GpsLatitude": str(xmp[0]), "dji:GpsLongitude": str(xmp[1])})
    assert photo.exif_place == pytest.approx(place, abs=1e-9)
    assert photo.hemisphere_missing == is_missing


def test_letters_of_the_other_axis(tmp_path: Path) -> None:
    found = positions_by_tags(photos(tmp_path, PLACES[:, ::-1], north="E", east="N"), [0] * 6)
    np.testing.assert_allclose([p.place for p in found.photos if p.place], PLACES)
    assert found.warnings == ["6 photo(s) have a latitude east or west: it is read as the longitude"]


def test_exif_and_xmp_of_other_signs(tmp_path: Path) -> None:
    taken = photos(tmp_path)
    for photo, (latitude, longitude) in zip(taken, PLACES, strict=True):
        assert isinstance(photo.xmp, dict)
        photo.xmp.update({"dji:GpsLatitude": f"{latitude:.7f}", "dji:GpsLongitude": f"{-longitude:.7f}"})
    (text,) = positions_by_tags(taken, [0] * 6).contradictions
    assert "(with the sign of the longitude changed they agree)" in text


@pytest.mark.parametrize(("still", "what"), [(6, "nothing gives the scale"), (4, "the pictures alone"), (3, "")])
def test_a_receiver_that_stands_still(tmp_path: Path, still: int, what: str) -> None:
    places = PLACES.copy()
    places[:still] = PLACES[0]
    found = settle_positions(photos(tmp_path, places), tmp_path)
    assert [what in text for text in found.contradictions] == ([True] if what else [])
    assert sum(p.place is not None for p in found.photos) == (2 if still == 4 else 6)


def test_sigmas_that_a_file_gives_in_part(tmp_path: Path) -> None:
    (tmp_path / "geo.txt").write_text("EPSG:4326\n0.jpg 7.6 45.0 380 0 0 0 0.02\n")
    found = settle_positions(photos(tmp_path), tmp_path).photos
    np.testing.assert_allclose(position_sigma(found[0]), (0.02, 0.02, 5.0))


def test_a_set_whose_file_contradicts_it_opens_with_a_contradiction(tmp_path: Path) -> None:
    folder = d.write_photos(tmp_path, 4)
    lines = [f"DJI_{k:04d}.JPG,{45 + 3e-5 * k:.6f},N,7.6,E,{350 / 0.3048:.2f}" for k in range(4)]
    (folder / "a.csv").write_text("\n".join(["name,lat,lat_ref,lon,lon_ref,alt_m", *lines]))
    source = open_source(folder)
    assert [c for c in source.findings.contradictions if "(1148 and 350 m): as feet they agree" in c]
