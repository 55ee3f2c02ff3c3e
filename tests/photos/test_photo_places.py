"""Positions of photos: files of places, the finer of two places, altitudes, and what they count from."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import damage as d
import numpy as np
import pytest
import rasterio
from refusal import Refused

from alight.cli import call
from alight.photos.reading.photo_pose import position_sigma, rtk_fix
from alight.photos.reading.photo_tags import PhotoTags
from alight.photos.reading.places import places_beside, read_places
from alight.photos.reading.positions import above_ellipsoid, positions_by_tags, settle_positions
from alight.records import InputError
from alight.runner.opening import open_source

PIX4D = "Image Name,Latitude [deg],Longitude [deg],Altitude [ft],Accuracy Horz [m],Accuracy Vert [m]"
GEO = "EPSG:4326\nDJI_0000.JPG 7.6 45.0 300.0 0 0 0 0.02 0.03\nDJI_0001.JPG 7.6 45.00003 300.5 0 0 0 0.02 0.03\n"
METASHAPE = (
    '# CoordinateSystem: GEOGCS["WGS 84",DATUM["World Geodetic System 1984",SPHEROID["WGS 84",6378137,298.257223563]],'
    'PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433],AUTHORITY["EPSG","4326"]]\n'
    "#Label,Accuracy_X/Y_(m),X/Longitude,Y/Latitude,Z/Altitude,Error_(m)\n"
)
TABLE = "name,latitude,longitude,height\nDJI_0000.JPG,45.0,7.6,300.0\nDJI_0001.JPG,45.00003,7.6,300.5\n"


def rows(tmp_path: Path, text: str, name: str = "geo.txt") -> Any:
    (tmp_path / name).write_text(text, encoding="utf-8")
    return read_places(tmp_path / name)


@pytest.mark.parametrize(
    ("text", "sigma"),
    [
        (GEO, (0.02, 0.02, 0.03)),
        (GEO.replace("4326", "4979"), (0.02, 0.02, 0.03)),
        ("+proj=longlat +datum=WGS84\nDJI_0000.JPG 7.6 45.0 300\n", None),
        ("EPSG:4326\n# a note\n\nDJI_0000.JPG\t7.6\t45.0\t300 0 0 0\n", None),
        ("WGS84 UTM 32N\nDJI_0000.JPG 389658.5676 4983903.7286 300\n", None),
        ("EPSG:32632\nDJI_0000.JPG 389658.5676 4983903.7286 300 1 2 3 0.02 0.03\n", (0.02, 0.02, 0.03)),
        (TABLE, None),
        (TABLE.replace(",", ";"), None),
        (TABLE.replace(",", "\t"), None),
        ("Label,X/Longitude,Y/Latitude,Z/Altitude\nDJI_0000.JPG,7.6,45.0,300\n", None),
        (f"{PIX4D}\nDJI_0000.JPG,45.0,7.6,984.251969,0.02,0.03\n", (0.02, 0.02, 0.03)),
        ("EPSG:4326\nDJI_0000.JPG,7.6,45.0,300,0,0,0,0.02,0.03\n", (0.02, 0.02, 0.03)),
        ("EPSG:4326\nDJI_0000.JPG, 7.6, 45.0, 300.0\n", None),
        ("EPSG:4326\nDJI_0000.JPG 7.6 45.0 300 1 2 3 0.02\n", (0.02, 0.02, np.nan)),
        ("EPSG:4326+5831\nDJI_0000.JPG 7.6 45.0 -300\n", None),  # depths
        ("file,lat_deg,lon_deg,altitude_ft,sigma_h_m\nDJI_0000.JPG,45,7.6,984.251969,0.02\n", (0.02, 0.02, np.nan)),
        ("name,lat,lon,height_m,accuracy (cm)\nDJI_0000.JPG,45,7.6,300,2\n", (0.02, 0.02, np.nan)),
        ("name,lat,lon,altitude,ellipsoidal height\nDJI_0000.JPG,45,7.6,252,300\n", None),
        (f"{METASHAPE}DJI_0000.JPG,0.02,7.6,45.0,300,\n", (0.02, 0.02, np.nan)),
        ("SourceFile,EXIF:GPSLatitude,EXIF:GPSLongitude,EXIF:GPSAltitude\nDJI_0000.JPG,45,7.6,300\n", None),
        ("\ufefffile,lat,lon,alt,sigma_e,sigma_n,sigma_u\nDJI_0000,45,7.6,300,0.01,0.02,0.03\n", (0.01, 0.02, 0.03)),
    ],
)  # fmt: skip
def test_the_forms_of_a_file(tmp_path: Path, text: str, sigma: Any) -> None:
    place = rows(tmp_path, text).of(["DJI_0000.JPG"])["DJI_0000.JPG"]
    np.testing.assert_allclose(place[:2], (45.0, 7.6), atol=1e-7)
    assert place.height == pytest.approx(300.0, abs=1e-5)
    assert place.sigma == (None if sigma is None else pytest.approx(sigma, nan_ok=True))


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("", "first line"),
        ("DJI_0000.JPG 7.6 45.0\n", "neither a coordinate system"),
        ("EPSG:4326\n", "no rows"),
        ("EPSG:4326\na.jpg 7.6\n", "line 2: needs name x y"),
        ("EPSG:4326\na.jpg 7,6 45,0 300,0\n", "with points for decimal commas and blanks between"),
        ("EPSG:4326\na.jpg 7.6 45.0 0.02 0.03\n", "line 2: needs name x y [z]"),
        ("EPSG:4326\na.jpg 7.6 45.0 300 0.02 0.03\n", "it has 5 number(s)"),
        (TABLE.replace("height", "height_agl"), "the column 'height_agl' is not known"),
        (TABLE.replace("height", "altitudeft"), "the column 'altitudeft' is not known"),
        ("name,lat,lat_ref,lon\na.jpg,45.1,E,7.6\n", "line 2: 'E' does not fit 45.1"),
        ("name,lat,lat_ref,lon\na.jpg,-45.1,N,7.6\n", "line 2: 'N' does not fit -45.1"),
        (METASHAPE.replace("WGS 84", "NAD27") + "a.jpg,7.6,45.0,300\n", "is not WGS 84"),
        ("EPSG:4326\na.jpg 45.0 107.6\n", "no place on Earth; x is the longitude"),
        ("EPSG:4326\na.jpg 7.6 45.0\na.jpg 7.6 45.0\n", "line 3: a.jpg stands twice"),
        ("EPSG:2263\na.jpg 980000 190000 100\n", "unit of heights is not declared"),
        ("lat,lon\n45,7\n", "no column of names"),
        (TABLE.splitlines()[0], "no rows"),
        (TABLE.replace("45.0,", "45,0,"), "line 2 has 5 fields, the header 4; write decimal points"),
        (TABLE.replace(",", ";").replace("45.0;", "45,0;"), "'45,0' is a decimal comma"),
        (TABLE.replace("300.0", "high"), "'high' is no number"),
        (TABLE.replace("45.0,", ","), "'' is no number"),
        (TABLE.replace("height", "height [furlong]"), "unit of the column"),
    ],
)
def test_what_is_no_file_of_places(tmp_path: Path, text: str, what: str) -> None:
    with pytest.raises(InputError, match=r"geo\.txt") as e:
        rows(tmp_path, text)
    assert what in str(e.value)


@pytest.mark.parametrize(
    ("head", "column", "datum"),
    [
        ("EPSG:4326", "", "sea level or ellipsoid: not declared"),
        ("EPSG:4979", "", "ellipsoid"),
        ("EPSG:4326+5773", "", "sea level (EGM96 height)"),
        ("", "height", "sea level or ellipsoid: not declared"),
        ("", "altitude_msl", "sea level (altitude_msl)"),
        ("", "Ellipsoidal height", "ellipsoid (Ellipsoidal height)"),
        ("", "HAE_m", "ellipsoid (HAE_m)"),
        ("EPSG:4326+5831", "", "sea level (Instantaneous Water Level depth)"),
    ],
)
def test_what_heights_of_a_file_count_from(tmp_path: Path, head: str, column: str, datum: str) -> None:
    text = GEO.replace("EPSG:4326", head) if head else TABLE.replace("height", column)
    assert rows(tmp_path, text).datum == datum


@pytest.mark.parametrize(
    "written", ["DJI_0000.JPG", "dji_0000.jpg", "DJI_0000", "images/DJI_0000.JPG", "C:\\x\\dji_0000.tif"]
)
@pytest.mark.parametrize("name", ["DJI_0000.JPG", "100MEDIA/DJI_0000.jpg"])
def test_names_with_and_without_folder_suffix_and_capitals(tmp_path: Path, written: str, name: str) -> None:
    assert list(rows(tmp_path, f"EPSG:4326\n{written} 7.6 45.0\n").of([name, "other.jpg"])) == [name]


def test_names_of_two_folders(tmp_path: Path) -> None:
    names = ["a/1.jpg", "b/1.jpg"]
    found = rows(tmp_path, "EPSG:4326\na/1.jpg 7.6 45.0\nb/1.jpg 7.7 45.0\n").of(names)
    assert [found[n].longitude for n in names] == [7.6, 7.7]
    with pytest.raises(InputError, match="write the folder as well"):
        rows(tmp_path, "EPSG:4326\n1.jpg 7.6 45.0\n").of(names)


def test_a_file_beside_the_photos_replaces_their_tags(tmp_path: Path) -> None:
    folder = d.write_photos(tmp_path / "card" / "images", 3)
    (tmp_path / "card" / "geo.txt").write_text(GEO + "gone.jpg 7.6 45.0 300\n")
    source = open_source(folder)
    facts = {p.name: p for p in source.photos}
    assert (facts["DJI_0001.JPG"].altitude, facts["DJI_0001.JPG"].position_from) == (300.5, "geo.txt")
    assert facts["DJI_0002.JPG"].place is None
    assert source.notes["positions_from"].startswith("geo.txt (WGS 84, x y z, sigmas, angles not used")
    assert source.notes["heights_count_from"] == "sea level or ellipsoid: not declared"
    assert source.notes["position_sigma"] == [0.02, 0.02, 0.03]
    assert "geo.txt: 1 photo(s) have no row (first: DJI_0002.JPG): the pictures alone place them" in source.warnings
    assert "geo.txt: 1 row(s) name no photo of the set" in source.warnings
    before = source.digest()
    assert open_source(folder, places=Path("tags")).digest() != before


def test_one_file_is_chosen(tmp_path: Path) -> None:
    folder = d.write_photos(tmp_path / "card", 2)
    assert places_beside(folder) is None
    for name in ("flight.csv", "notes.txt"):
        (folder / name).write_text("time,latitude,longitude\n1,45,7\n")
    assert places_beside(folder) is None
    (folder / "places.csv").write_text(TABLE)
    assert places_beside(folder) == folder / "places.csv"
    (folder / "more.CSV").write_text(TABLE)
    with pytest.raises(InputError, match=r"more.CSV and places.csv both give places: name one with --places"):
        places_beside(folder)
    (folder / "GEO.TXT").write_text(GEO)
    assert places_beside(folder) == folder / "GEO.TXT"


def test_signs_by_columns_and_columns_that_are_not_used(tmp_path: Path) -> None:
    """As `exiftool -n -csv` writes them."""
    head = "SourceFile,GPSLatitude,GPSLatitudeRef,GPSLongitude,GPSLongitudeRef,GPSAltitude,GPSAltitudeRef,Yaw\n"
    found = rows(tmp_path, f"{head}./a.jpg,33.6,South,117.9,W,30,1,5\n./b.jpg,33.6,N,117.9,East,30,0,5\n")
    assert [found.rows[f"./{n}.jpg"][:3] for n in "ab"] == [(-33.6, -117.9, -30.0), (33.6, 117.9, 30.0)]
    assert found.settled.endswith("; not used: Yaw")


@pytest.mark.parametrize("name", ["pix4d.csv", "geo.csv", "LOG.TXT"])
def test_a_table_that_is_not_read_is_named(tmp_path: Path, name: str) -> None:
    folder = d.write_photos(tmp_path / "card", 4)
    (folder / name).write_text("".join(f"DJI_000{k}.JPG,45.1,7.6,380\n" for k in range(3)))
    (folder / "notes.txt").write_text("DJI_0000.JPG is blurred, 1 2 3\n")
    (warning,) = open_source(folder).warnings
    assert warning.startswith(f"{name} names 3 photos and is not read: if it gives their places, write the header")
    assert open_source(folder, places=Path("tags")).warnings == []


def test_the_option(tmp_path: Path, capsys: pytest.CaptureFixture[str], refused: Refused) -> None:
    folder, file = d.write_photos(tmp_path / "card", 2), tmp_path / "elsewhere.csv"
    file.write_text(TABLE)
    call(["check", str(folder), "--places", str(file), "--json"])
    found = {r["name"]: r["evidence"] for r in json.loads(capsys.readouterr().out)}
    assert "elsewhere.csv (columns name, latitude, longitude, height): 2 of 2 photos" in found["positions"]
    assert "altitudes count from: sea level or ellipsoid: not declared" in found["heights"]
    refused(["check", d.write_flight(tmp_path / "flight"), "--places", file], "is for a folder of photos")
    refused(["check", folder, "--places", tmp_path / "none.csv"], "none.csv: cannot be read")


@pytest.mark.parametrize(
    ("text", "what"),
    [
        (GEO.replace("DJI", "IMG"), "none of its 2 names is that of a photo"),
        (GEO.replace("7.6 45.0", "45.0 7.6"), "exchanged they agree: mend the coordinate system"),
    ],
)
def test_a_file_that_does_not_fit_the_photos(tmp_path: Path, text: str, what: str) -> None:
    d.write_photos(tmp_path, 2)
    (tmp_path / "geo.txt").write_text(text)
    with pytest.raises(InputError, match=what):
        open_source(tmp_path)


# -- tags


def tagged(
    exif: float | None, absolute: float | None = None, relative: float | None = None, seconds: int = 0, **xmp: str
) -> PhotoTags:
    """A photo with altitudes, at 45 N 7.6 E."""
    values = {"AbsoluteAltitude": absolute, "RelativeAltitude": relative}
    texts = {f"dji:{k}": f"{v:+.2f}" for k, v in values.items() if v is not None} | {
        f"dji:{k}": v for k, v in xmp.items()
    }
    gps = {1: "N", 2: (45.0, 0.0, 0.0), 3: "E", 4: (7.0, 36.0, 0.0)} | ({} if exif is None else {6: exif})
    times = {36867: f"2026:01:26 13:{seconds // 60:02d}:{seconds % 60:02d}"}
    return PhotoTags(Path(f"{seconds:04d}.jpg"), (64, 48), times, gps, texts)


UP = [40.0, 45.5, 51.3, 47.2, 60.1, 43.7]


@pytest.mark.parametrize(
    ("exif", "absolute", "relative", "used", "warning"),
    [
        ([340 + u for u in UP], [340 + u for u in UP], UP, [340 + u for u in UP], ""),
        ([round(340 + u) for u in UP], [340 + u for u in UP], UP, [340 + u for u in UP], ""),  # XMP is finer
        ([0.0] * 6, [340 + u for u in UP], UP, [340 + u for u in UP], ""),
        ([300 + u for u in UP], [340 + u for u in UP], UP, [340 + u for u in UP], "EXIF lie 40.0 m below"),
        (UP, [340 + u for u in UP], UP, [340 + u for u in UP], "another surface"),
        ([400.0] * 6, [340 + u for u in UP], UP, [340 + u for u in UP], "XMP agree with the heights above take-off"),
        ([340 + u for u in UP], [400.0] * 6, UP, [340 + u for u in UP], "EXIF agree with the heights above take-off"),
        ([350 + 3 * k for k in range(6)], [340.25 + u for u in UP], None, [340.25 + u for u in UP], "XMP are finer"),
        ([400.0] * 6, None, UP, [400.0 + u - np.median(UP) for u in UP], "the altitudes stand still"),
        ([400.0 + 9 * k for k in range(6)], None, UP, [400.0 + 9 * k for k in range(6)], "one is wrong"),
        (None, None, UP, UP, "the height above take-off is used"),
        (None, None, None, [0.0] * 6, "the flight is taken as level"),
    ],
)  # fmt: skip
def test_the_altitude_that_the_others_confirm(exif: Any, absolute: Any, relative: Any, used: Any, warning: str) -> None:
    none = [None] * 6
    photos = [
        tagged(*v, seconds=5 * k)
        for k, v in enumerate(zip(exif or none, absolute or none, relative or none, strict=True))
    ]
    found = positions_by_tags(photos, [0] * 6)
    np.testing.assert_allclose([p.position[2] for p in found.photos if p.position], used, atol=1e-6)
    assert [warning in w for w in found.warnings + found.contradictions] == ([True] if warning else [])


def test_each_flight_has_a_take_off_of_its_own() -> None:
    photos = [tagged(340 + u + (30 if k > 2 else 0), None, u, 400 * (k > 2) + k) for k, u in enumerate(UP)]
    assert positions_by_tags(photos, [0, 0, 0, 1, 1, 1]).contradictions == []
    assert "drift" in positions_by_tags(photos, [0] * 6).contradictions[0]


@pytest.mark.parametrize(
    ("digits", "shift", "xmp_used", "sigma", "warning"),
    [
        (0, 0.0, True, 3.0, "XMP are used, which are finer"),
        (1, 0.0, True, 3.0, "XMP are used, which are finer"),
        (4, 0.0, False, 3.0, ""),
        (4, 2e-6, False, 3.0, ""),
        (4, 1e-4, False, 3.0, "places in EXIF and XMP lie up to 11.1 m apart"),
        (4, None, False, 3.0, ""),
        (1, None, False, 3.09 / 12**0.5, "places have steps of 3 m"),
        (0, None, False, 30.9 / 12**0.5, "places have steps of 31 m"),
    ],
)
def test_the_finer_place(digits: int, shift: float | None, xmp_used: bool, sigma: float, warning: str) -> None:
    """EXIF with so many digits of a second of arc, XMP with so many degrees beside it, or none."""
    photos, true = [], [45.0 + 0.00123456 * k for k in range(1, 5)]
    for k, latitude in enumerate(true):
        xmp = {} if shift is None else {"GpsLatitude": f"{latitude + shift:.9f}", "GpsLongitude": "7.600000000"}
        photos.append(tagged(350.0, seconds=k, **xmp))
        assert isinstance(photos[-1].gps, dict)
        photos[-1].gps[2] = (45.0, 0.0, round(3600 * (latitude - 45.0), digits))
    found = positions_by_tags(photos, [0] * 4)
    for photo, at in zip(found.photos, true, strict=True):
        assert photo.place is not None
        assert (abs(photo.place[0] - at) < 1e-9) == xmp_used
    assert position_sigma(found.photos[0])[0] == pytest.approx(max(sigma, 3.0), rel=0.01)
    assert [warning in w for w in found.warnings + found.contradictions] == ([True] if warning else [])


# -- datum


def geoid(path: Path) -> Path:
    with rasterio.open(path, "w", "GTiff", 4, 4, 1, dtype="float32", crs="EPSG:4326",
                       transform=rasterio.Affine(1, 0, 6, 0, -1, 47)) as raster:  # fmt: skip
        raster.write(np.full((4, 4), 48.0, np.float32), 1)
    return path


@pytest.mark.parametrize(
    ("column", "height", "counted", "warns"),
    [
        ("altitude_msl", 348.0, "ellipsoid, by egm.tif: +48.00 m from sea level", False),
        ("hae", 300.0, "ellipsoid (hae)", False),
        ("height", 300.0, "sea level or ellipsoid: not declared", True),
    ],
)
def test_a_geoid_moves_what_is_known_to_count_from_the_sea(
    tmp_path: Path, column: str, height: float, counted: str, warns: bool
) -> None:
    (tmp_path / "places.csv").write_text(TABLE.replace("height", column))
    photos = [PhotoTags(tmp_path / "DJI_0000.JPG", (64, 48), {}, {}, {})]
    found = settle_positions(photos, tmp_path, tmp_path / "places.csv", geoid(tmp_path / "egm.tif"))
    assert found.photos[0].position == pytest.approx((45.0, 7.6, height))
    assert found.counted_from == counted
    assert any("not known to count from the sea level" in w for w in found.warnings) == warns


def test_sigmas_and_fix_of_a_file(tmp_path: Path) -> None:
    (tmp_path / "geo.txt").write_text(GEO)
    photo = PhotoTags(tmp_path / "DJI_0000.JPG", (64, 48), {}, {}, {"dji:RtkFlag": "50"})
    (found,) = settle_positions([photo], tmp_path).photos
    np.testing.assert_allclose(position_sigma(found), (0.02, 0.02, 0.03))
    assert rtk_fix(found) == "geo.txt"
    assert above_ellipsoid([found], None)[1] == "sea level or ellipsoid: not declared"
