"""Zones from GeoJSON: what is read, and the one line that names what cannot be."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely

from alight.geometry import LocalFrame
from alight.records import InputError, Zones
from alight.sources.zones import read_zones

HERE = LocalFrame(47.0, 13.0, 300.0)
SQUARE = [[13.0, 47.0], [13.001, 47.0], [13.001, 47.001], [13.0, 47.001], [13.0, 47.0]]
BOW = [[13, 47], [13.1, 47.1], [13.1, 47], [13, 47.1], [13, 47]]  # crosses itself
HOLE = [[13.0002, 47.0002], [13.0004, 47.0002], [13.0004, 47.0004], [13.0002, 47.0002]]
IN_UTM = [[500000, 5205000], [500100, 5205000], [500100, 5205100], [500000, 5205000]]
METRES = 111_194.0  # of a degree of latitude


def shape(kind: str, *coordinates: Any) -> dict[str, Any]:
    return {"type": kind, "coordinates": list(coordinates)}


def feature(geometry: Any = None, **properties: Any) -> dict[str, Any]:
    return {"type": "Feature", "properties": properties, "geometry": geometry or shape("Polygon", SQUARE)}


def named(geometry: Any = None, **properties: Any) -> dict[str, Any]:
    return feature(geometry, **{"alight": "keep-out", "name": "farm", **properties})


def written(folder: Path, *features: Any, **more: Any) -> Path:
    path = folder / "zones.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features, **more}))
    return path


def read(folder: Path, *features: Any, **more: Any) -> Zones:
    return read_zones(written(folder, *features, **more))


def crs(name: str) -> dict[str, Any]:
    return {"type": "name", "properties": {"name": name}}


def test_a_zone_has_its_name_reason_margin_and_floor(tmp_path: Path) -> None:
    (zone,) = read(tmp_path, named(shape("Polygon", SQUARE, HOLE), reason="crops", margin_m="2.5", floor_m=20)).zones
    assert (zone.label, zone.margin, zone.floor) == ("keep-out zone farm (crops)", 2.5, 20.0)
    (there,) = Zones("", (zone,)).in_world(HERE).zones
    assert there.shape.contains(shapely.Point(5.0, 5.0))
    assert not there.shape.contains(shapely.Point(76.0 * 0.35, 111.2 * 0.25))  # in the hole
    np.testing.assert_allclose(there.shape.bounds, [0.0, 0.0, 76.06, 111.18], atol=0.05)


@pytest.mark.parametrize(
    ("geometry", "more"),
    [
        (shape("Polygon", [[*p, 200.0] for p in SQUARE]), {}),  # with heights
        (shape("Polygon", SQUARE[:-1]), {}),  # not closed
        (shape("Polygon", SQUARE[::-1]), {}),  # clockwise
        (shape("MultiPolygon", [SQUARE]), {"crs": crs("urn:ogc:def:crs:OGC:1.3:CRS84")}),
    ],
)
def test_a_polygon_is_read_as_it_may_be_written(tmp_path: Path, geometry: Any, more: Any) -> None:
    (zone,) = read(tmp_path, named(geometry), **more).zones
    assert shapely.hausdorff_distance(zone.shape, shapely.Polygon(SQUARE)) < 1e-9


def test_another_coordinate_system_is_obeyed(tmp_path: Path) -> None:
    (zone,) = read(tmp_path, named(shape("Polygon", IN_UTM)), crs=crs("urn:ogc:def:crs:EPSG::32633")).zones
    west, south, east, north = zone.shape.bounds
    np.testing.assert_allclose([west, east], [15.0, 15.001315], atol=1e-6)  # on the central meridian, and 100 m east
    np.testing.assert_allclose([south, north], [46.99852, 46.99942], atol=1e-5)


@pytest.mark.parametrize(
    "geometry",
    [
        shape("Polygon", [[179.999, -17], [-179.999, -17], [-179.999, -16.999], [179.999, -16.999], [179.999, -17]]),
        shape("Polygon", [[179.999, -17], [180.001, -17], [180.001, -16.999], [179.999, -16.999], [179.999, -17]]),
        shape(
            "MultiPolygon",
            [[[179.999, -17], [180, -17], [180, -16.999], [179.999, -16.999], [179.999, -17]]],
            [[[-180, -17], [-179.999, -17], [-179.999, -16.999], [-180, -16.999], [-180, -17]]],
        ),
    ],
)
@pytest.mark.parametrize("longitude", [179.9995, -179.9995])
def test_a_polygon_crosses_the_date_line(tmp_path: Path, geometry: Any, longitude: float) -> None:
    (zone,) = read(tmp_path, named(geometry)).in_world(LocalFrame(-17.0, longitude, 0.0)).zones
    side = 0.001 * METRES * np.cos(np.radians(17.0))
    west = -0.5 * side if longitude > 0.0 else -1.5 * side
    assert zone.shape.area == pytest.approx(2.0 * side * 0.001 * METRES, rel=0.01)
    assert zone.shape.bounds[0] == pytest.approx(west, rel=0.01)


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        (named(shape("Polygon", BOW)), "Self-intersection at 13.05"),
        (named(shape("Polygon", SQUARE, [[14, 48], [14.1, 48], [14, 48.1], [14, 48]])), "Hole lies outside shell"),
        (named(shape("Polygon", [[13, 47], [13.1, 47], [13, 47]])), "no polygon"),
        (named(shape("Polygon")), "empty"),
        (named(shape("Polygon", [])), "no area"),
        (named(shape("Polygon", [[13, 47], ["x", 47], [13, 48]])), "coordinates"),
        (named(shape("Polygon", [[13, 47], [None, 47], [13, 48]])), "coordinates"),
        (named(shape("Polygon", [[13], [13, 47], [13, 48]])), "coordinates"),
        (named(shape("Polygon", [[47, 113], [47.1, 113], [47, 113.1], [47, 113]])), "but the reverse"),
        (named(shape("Polygon", IN_UTM)), "500000 5205000 is no longitude and latitude"),
        (named(shape("Polygon", [[-180, -90], [180, -90], [180, 90], [-180, 90], [-180, -90]])), "no polygon"),
        (named(shape("LineString", *SQUARE)), "the geometry LineString; draw a Polygon"),
        (named(shape("Point", 13, 47)), "the geometry Point"),
        (named({"type": "GeometryCollection", "geometries": []}), "the geometry GeometryCollection"),
        ({**named(), "geometry": None}, "no geometry"),
        (named(alight="no-fly"), "needs one of keep-out, avoid, landing, search, prefer"),
        (named(alight=["avoid"]), "needs one of"),
        (named(margin_m="wide"), 'margin_m: "wide": needs metres'),
        (named(margin_m=-1), "margin_m: -1"),
        (named(floor_m=True), "floor_m: true"),
        (named(alight="avoid", floor_m=10), "floor_m is for keep-out, and it is avoid"),
    ],
)  # fmt: skip
def test_a_zone_that_cannot_be_used_is_named_in_one_line(tmp_path: Path, bad: Any, words: str) -> None:
    with pytest.raises(InputError) as caught:
        read(tmp_path, named(name="good"), bad)
    message = str(caught.value)
    assert 'zones.geojson: polygon "farm" (feature 2): ' in message
    assert words in message
    assert "\n" not in message


@pytest.mark.parametrize(
    ("name", "called"),
    [('Müll & "co"', 'Müll & "co"'), (12, "12"), (None, "2"), (["a"], "2"), (True, "2"), ("", "2")],
)
def test_a_name_of_any_type_is_accepted(tmp_path: Path, name: Any, called: str) -> None:
    assert read(tmp_path, named(), named(name=name)).zones[1].name == called


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (b"{nope", "not valid JSON"),
        (json.dumps(feature(alight="avoid", name="Müll"), ensure_ascii=False).encode("latin-1"), "not text in UTF-8"),
        (b"[1, 2]", "no GeoJSON"),
        (json.dumps(shape("Polygon", SQUARE)).encode(), "is a Polygon; it needs a FeatureCollection"),
        (b'{"type": "FeatureCollection", "features": []}', "holds no zone; give each polygon the property alight"),
        (b'{"type": "FeatureCollection", "features": [3]}', "feature 1 is no Feature"),
        (json.dumps(feature(name="a")).encode(), "holds no zone"),
        (json.dumps({**named(), "crs": crs("EPSG:999999")}).encode(), '"EPSG:999999" is not known'),
        (json.dumps({**named(), "crs": 3}).encode(), "coordinate system 3 is not known"),
    ],
)
def test_a_file_that_is_none_is_refused_in_one_line(tmp_path: Path, text: bytes, words: str) -> None:
    path = tmp_path / "zones.geojson"
    path.write_bytes(text)
    with pytest.raises(InputError, match=r"zones\.geojson: ") as caught:
        read_zones(path)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_zones_far_away_are_named_and_exchanged_ones_refused(tmp_path: Path) -> None:
    zones = read(tmp_path, named())
    away = zones.in_world(LocalFrame(48.0, 13.0, 0.0))
    assert not away.zones
    assert "no zone lies within 50 km" in away.warnings[0]
    only = read(tmp_path, named(alight="landing")).in_world(LocalFrame(48.0, 13.0, 0.0))
    assert only.zones[0].shape.is_empty  # it still refuses all ground here
    with pytest.raises(InputError, match="keep-out zone farm: latitude stands before longitude"):
        zones.in_world(LocalFrame(13.0, 47.0, 0.0))


def test_features_of_a_map_become_zones_by_their_tags(tmp_path: Path) -> None:
    line = shape("LineString", *SQUARE[:3])
    found = read(
        tmp_path,
        feature(line, highway="residential", name="Main Street"),
        feature(line, highway="track", width="3.5 m"),
        feature(line, highway="secondary", lanes="4"),
        feature(line, other_tags='"railway"=>"tram","electrified"=>"yes"'),
        feature(line, tags={"power": "line", "voltage": "110000;20000"}),
        feature(line, power="minor_line"),
        feature(shape("LineString", *SQUARE), building="house"),  # closed
        feature(shape("Polygon", BOW), building="yes"),
        feature(landuse="cemetery"),
        *(feature(line, **{k: v}, tunnel="yes") for k, v in {"highway": "primary", "railway": "rail"}.items()),
        feature(line, highway="proposed"), feature(line, railway="abandoned"), feature(line, power="cable"),
        feature(shape("Point", 13, 47), highway="crossing"), feature(landuse="meadow"), feature(natural="wood"),
        {**feature(building="yes"), "geometry": None},
    )  # fmt: skip
    assert [(z.name, z.use, 2.0 * z.reach, z.floor) for z in found.zones] == [
        ("highway residential Main Street", "avoid", 7.0, 0.0),
        ("highway track", "avoid", 3.5, 0.0),
        ("highway secondary", "avoid", 14.0, 0.0),
        ("railway tram", "keep-out", 5.0, 0.0),
        ("power line", "keep-out", 40.0, 40.0),
        ("power minor_line", "keep-out", 20.0, 20.0),
        ("building house", "keep-out", 0.0, 0.0),
        ("building", "keep-out", 0.0, 0.0),
        ("cemetery", "avoid", 0.0, 0.0),
    ]
    assert shapely.get_dimensions(found.zones[6].shape) == 2
    assert found.zones[7].shape.area == pytest.approx(0.005, rel=0.01)  # both halves of the crossed square
    assert found.note == "zones.geojson: 5 keep-out, 4 avoid; 9 other features are left out"


@pytest.mark.parametrize("corners", [100_000, 5])
def test_a_hundred_thousand_corners_are_read(tmp_path: Path, corners: int) -> None:
    """One polygon of all, or 20,000 buildings."""
    angle = np.linspace(0.0, 2.0 * np.pi, corners)[:, None]
    ring = 1e-3 * (1.0 + 0.1 * np.sin(37.0 * angle)) * np.concatenate([np.cos(angle), np.sin(angle)], axis=1)
    at = np.random.default_rng(0).uniform(-0.1, 0.1, (100_000 // corners, 2)) + np.array([13.0, 47.0])
    zones = read(tmp_path, *(feature(shape("Polygon", (p + ring).tolist()), building="yes") for p in at))
    assert len(zones.in_world(HERE).zones) == len(at)
