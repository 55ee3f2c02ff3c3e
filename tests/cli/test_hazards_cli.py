"""`alight hazards` judges any height raster, and reports a fault of the raster in one line."""

from __future__ import annotations

import json
import re
import warnings
from pathlib import Path

import numpy as np
import pytest
import rasterio
from numpy.testing import assert_allclose
from rasterio.crs import CRS
from rasterio.warp import transform
from refusal import Refused
from written_raster import write

import alight
from alight.cli import call
from alight.records import Hazard, OutputError
from alight.sources.raster import read_ground


def rock(shape: tuple[int, int] = (81, 81)) -> np.ndarray:
    z = np.full(shape, 100.0, np.float32)
    z[20, 20] = 100.6
    return z


def test_a_raster_is_judged_on_its_own_grid(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lander = tmp_path / "lander.yaml"
    lander.write_text("lander:\n  radius: 1.0\n  max_roughness: 0.2\n")
    dem = write(tmp_path / "dem.tif", rock())
    assert call(["hazards", str(dem), "--lander", str(lander), "--sigma", "0.01", "--out", str(tmp_path / "out")]) == 0
    assert capsys.readouterr().out.startswith("SITE  east 5500")
    with rasterio.open(tmp_path / "out" / "safe.tif") as safe, rasterio.open(tmp_path / "out" / "reasons.tif") as why:
        assert safe.crs.to_epsg() == 32610
        assert safe.bounds == rasterio.open(dem).bounds
        p, reasons = safe.read(1), why.read(1)
    assert reasons[20, 20] == Hazard.ROUGHNESS
    assert p[20, 20] == 0.0
    assert p[60, 60] > 0.99
    assert np.isnan(p[0, 0])
    info = json.loads((tmp_path / "out" / "run.json").read_text())
    assert info["settings"]["lander"]["radius"] == 1.0
    assert_allclose(info["share_safe"], (reasons == 0).mean(), atol=1e-6)
    site = json.loads((tmp_path / "out" / "sites.geojson").read_text())["features"][0]
    assert_allclose(site["geometry"]["coordinates"][:2], [-122.4319, 37.7664], atol=1e-3)
    assert "refused" in (tmp_path / "out" / "report.html").read_text()
    assert not (tmp_path / "out" / "heights.tif").exists()
    again = ["hazards", str(dem), "--lander", str(lander), "--out", str(tmp_path / "out")]
    assert call(again) == 0  # results in its own folder are replaced
    assert "no sigma given" in capsys.readouterr().err


@pytest.mark.parametrize("picture", ["none", "grey", "colour"])
def test_ground_that_no_colour_shows_is_not_judged(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], picture: str
) -> None:
    dem, out = write(tmp_path / "dem.tif", rock((161, 161))), tmp_path / "out"
    dust = np.random.default_rng(0).normal(0, 6, (1, 161, 161)) + np.array([128, 112, 92])[:, None, None]
    pixels = np.clip(dust if picture == "colour" else dust[:1], 0, 255).astype(np.uint8)
    image = [] if picture == "none" else ["--image", str(write(tmp_path / "image.tif", pixels))]
    radius = ["--set", "lander.radius=0.6"]
    assert call(["hazards", str(dem), *image, "--sigma", "0.01", "--out", str(out), *radius]) == 0
    said, page = capsys.readouterr(), (out / "report.html").read_text()
    with rasterio.open(out / "safe.tif") as safe:
        p, ground = safe.read(1), safe.read(4)
    listed = json.loads((out / "sites.geojson").read_text())
    judged = picture == "colour"
    assert (out / "terrain.tif").exists() == listed.get("ground_judged", True) == judged
    assert np.isfinite(ground).any() == judged
    assert (
        ("not judged" in said.out.splitlines()[0]) == ("\nGROUND  not judged: no picture" in said.out) == (not judged)
    )
    assert np.isfinite(p[80, 80])
    if not judged:
        assert p[80, 80] > 0.99
        assert listed["features"][0]["properties"]["p_ground"] is None
        assert "Land here" not in page
        assert "ground was not judged" in page


@pytest.mark.parametrize("kind", ["mercator", "feet", "site grid"])
def test_places_and_files_lie_where_the_raster_lies(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str
) -> None:
    """Only a disc, whose centre is known, is level; the plane of the raster is not one of metres on Earth."""
    site_grid = 'LOCAL_CS["site grid",UNIT["metre",1],AXIS["Easting",EAST],AXIS["Northing",NORTH]]'
    crs = {"mercator": "EPSG:3857", "feet": "EPSG:2227", "site grid": site_grid}[kind]
    cell, x, y = {"mercator": (0.2, 1113194.9, 8399737.9), "feet": (0.1 / 0.3048, 6.1e6, 2.1e6)}.get(kind, (0.1, 9, 9))
    rows, cols = np.mgrid[:81, :81]
    z = np.where(np.hypot(rows - 30, cols - 50) < 14, 100.0, 100.0 + 0.3 * ((rows + cols) % 4)).astype(np.float32)
    place = rasterio.Affine(cell, 0, x, 0, -cell, y)
    dem, out = write(tmp_path / "dem.tif", z, crs=CRS.from_user_input(crs), transform=place), tmp_path / "out"
    with rasterio.open(dem, "r+") as d:
        d.units = ("m",)
    assert call(["hazards", str(dem), "--sigma", "0.01", "--set", "lander.radius=0.6", "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert re.search("^HEIGHTS  dem.tif: heights in m, vertical datum undeclared, ", printed, re.M)
    middle = (x + 50.5 * cell, y - 30.5 * cell)
    east, north = re.findall(r"(?:east|north) ([\d.]+)", printed.splitlines()[0])
    assert_allclose([float(east), float(north)], middle, atol=3 * cell)
    with rasterio.open(out / "safe.tif") as safe:
        assert_allclose(safe.transform[:6], place[:6], rtol=1e-9)
        assert safe.crs == rasterio.open(dem).crs
    info = json.loads((out / "run.json").read_text())
    assert info["notes"]["heights"] in printed
    if kind == "site grid":
        assert "place on Earth" in info["not_written"]["sites.geojson"]
        return
    first = json.loads((out / "sites.geojson").read_text())["features"][0]
    lon, lat = transform(crs, "EPSG:4326", *([v] for v in middle))
    assert_allclose(first["geometry"]["coordinates"][:2], [lon[0], lat[0]], atol=5e-6)
    assert first["properties"]["slope_deg"] < 0.5


def test_no_place_is_an_answer(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    z = np.add.outer(np.zeros(81), 0.05 * np.arange(81)).astype(np.float32)
    dem = write(tmp_path / "dem.tif", z, crs=None)
    assert call(["hazards", str(dem), "--sigma", "0", "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr()
    assert said.out.startswith("NO SITE  no safe site: of the seen ground")
    assert "too steep" in said.out
    assert "no coordinate system" in said.err
    assert json.loads((tmp_path / "out" / "sites.geojson").read_text())["features"] == []


def test_unknown_cells_and_an_own_sigma_band_are_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bands = np.stack([rock(), np.full((81, 81), 0.5, np.float32)])
    bands[0, 60, 60] = -9999.0
    dem = write(tmp_path / "dem.tif", bands, nodata=-9999.0)
    with rasterio.open(dem, "r+") as d:
        d.descriptions = ("height", "sigma")
    assert call(["hazards", str(dem), "--set", "lander.radius=1", "--out", str(tmp_path / "out")]) == 0
    with rasterio.open(tmp_path / "out" / "reasons.tif") as d:
        reasons = d.read(1)
    assert reasons[60, 60] == Hazard.UNKNOWN
    assert reasons[40, 60] == Hazard.DOUBT  # with a sigma of half a metre no flat ground is certain
    assert "LOOK CLOSER  east 5500" in capsys.readouterr().out
    first = json.loads((tmp_path / "out" / "sites.geojson").read_text())["features"][0]["properties"]
    assert (first["kind"], first["doubt"]) == ("candidate", "relief")
    assert (first["look"], first["look_from_m"]) == (None, None)  # no camera is known


def test_a_finer_image_makes_the_heights_finer(tmp_path: Path, shared_data: Path) -> None:
    folder = shared_data / "hazard-contest" / "terrain1"
    raw = np.fromfile(folder / "dem.raw", ">f4").reshape(500, 500)[:120, :120].astype(np.float32)
    with open(folder / "image.pgm", "rb") as f:
        picture = np.frombuffer(f.read()[-1000000:], np.uint8).reshape(1000, 1000)[:240, :240]
    dem, image = write(tmp_path / "dem.tif", raw, 0.2), write(tmp_path / "image.tif", np.ascontiguousarray(picture))
    arguments = ["hazards", str(dem), "--image", str(image), "--sigma", "0.002", "--out", str(tmp_path / "out")]
    assert call(arguments) == 0
    with rasterio.open(tmp_path / "out" / "heights.tif") as d, rasterio.open(tmp_path / "out" / "safe.tif") as s:
        assert d.shape == s.shape == (240, 240)
        assert_allclose(d.bounds, rasterio.open(dem).bounds, atol=1e-6)
        assert abs(d.read(1)[::2, ::2] - raw).max() < 0.5


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda p: write(p, rock(), crs="EPSG:4326"), "cells are degrees"),
        (lambda p: write(p, rock(), crs="EPSG:2227"), "unit is not the metre"),
        (lambda p: write(p, rock(), transform=rasterio.Affine(0.1, 0.01, 0, 0, -0.1, 0)), "not square with north up"),
        (lambda p: write(p, np.full((9, 9), np.nan, np.float32)), "no height is known"),
        (lambda p: p.write_text("heights"), "not a raster"),
        (lambda p: None, "no such file"),
    ],
)
def test_a_raster_that_cannot_be_judged_is_refused(make: object, says: str, tmp_path: Path, refused: Refused) -> None:
    make(tmp_path / "dem.tif")  # type: ignore[operator]
    refused(["hazards", tmp_path / "dem.tif", "--out", tmp_path / "out"], says)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("option", "value", "says"),
    [
        ("--sigma", "bare.tif", "do not fit 81 x 81 heights"),
        ("--sigma", "-1", "metres from 0 to 1000"),
        ("--image", "bare.tif", "do not fit 81 x 81 heights"),
        ("--image", "moved.tif", "lies elsewhere"),
        ("--image", "other.tif", "give 8 bit"),
        ("--lander", "bad.yaml", "lander.legs: unknown key"),
        ("--lander", "empty.yaml", "needs keys of the lander"),
    ],
)
def test_what_does_not_fit_the_heights_is_refused(
    option: str, value: str, says: str, tmp_path: Path, refused: Refused
) -> None:
    write(tmp_path / "other.tif", np.zeros((80, 81), np.float32))
    with warnings.catch_warnings(action="ignore"):
        write(tmp_path / "bare.tif", np.zeros((80, 81), np.uint8), crs=None, transform=rasterio.Affine.identity())
    write(
        tmp_path / "moved.tif",
        np.zeros((81, 81), np.uint8),
        transform=rasterio.Affine(0.1, 0, 550010, 0, -0.1, 4180000),
    )
    (tmp_path / "bad.yaml").write_text("radius: 1\nlegs: 4\n")
    (tmp_path / "empty.yaml").write_text("")
    dem = write(tmp_path / "dem.tif", rock())
    given = value if value.startswith("-") else str(tmp_path / value)
    refused(["hazards", dem, f"{option}={given}", "--out", tmp_path / "out"], says)


def test_an_input_among_the_results_is_refused(tmp_path: Path, refused: Refused) -> None:
    dem, out = write(tmp_path / "dem.tif", rock()), tmp_path / "out"
    assert call(["hazards", str(dem), "--sigma", "0.01", "--out", str(out)]) == 0
    dem = write(out / "heights.tif", rock())
    before = {p.name: p.read_bytes() for p in out.iterdir()}
    refused(["hazards", dem, "--sigma", "0.01", "--out", out], "heights.tif: lies in")
    with pytest.raises(OutputError, match="lies in"):
        alight.judge(dem, sigma=0.01).save(out)
    assert {p.name: p.read_bytes() for p in out.iterdir()} == before


def test_the_files_that_were_read_are_known(tmp_path: Path) -> None:
    """A folder of results must not hold them."""
    dem, image = write(tmp_path / "dem.tif", rock()), write(tmp_path / "image.tif", np.zeros((81, 81), np.uint8))
    sigma = write(tmp_path / "sigma.tif", np.full((81, 81), 0.02, np.float32))
    assert read_ground(dem, "0.03", None, 0.05).files == (dem,)
    assert read_ground(dem, str(sigma), image, 0.05).files == (dem, sigma, image)


def test_gear_on_cells_too_coarse_for_it_is_judged(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    steep = np.add.outer(np.zeros(41), 0.577 * np.arange(41)).astype(np.float32)
    dem, out = write(tmp_path / "dem.tif", steep, 1.0), str(tmp_path / "out")
    for gear in ("lander.feet=[[0.4,0.4],[0.4,-0.4],[-0.4,0.4],[-0.4,-0.4]]", "lander.skids=[0.8,0.6]"):
        assert call(["hazards", str(dem), "--sigma", "0.03", "--set", gear, "--out", out]) == 0
        assert "too steep" in capsys.readouterr().out
    assert call(["hazards", str(dem), "--set", "lander.radius=0.9", "--out", out]) == 0
    assert "unknown ground within the footprint" in capsys.readouterr().out  # a single cell has no slope


def test_a_settings_file_may_change_how_surveyed_heights_are_judged(tmp_path: Path) -> None:
    dem, out, file = write(tmp_path / "dem.tif", rock()), tmp_path / "out", tmp_path / "settings.yaml"
    file.write_text("tuning: {hazards: {smoothed: true, tilt_sigma: 0.01}}\n")
    assert call(["hazards", str(dem), "--sigma", "0.01", "--settings", str(file), "--out", str(out)]) == 0
    stored = json.loads((out / "run.json").read_text())["settings"]["tuning"]["hazards"]
    assert (stored["smoothed"], stored["tilt_sigma"], stored["noise_length"]) == (True, 0.01, 0.4)


def zones_file(path: Path, *zones: tuple[dict[str, object], list[tuple[float, float]]]) -> Path:
    """Write zones, each with its properties and its corners in metres of the plane of `written_raster`."""
    features = []
    for properties, corners in zones:
        ring = [
            list(at)
            for at in zip(*transform(CRS.from_epsg(32610), "EPSG:4326", *zip(*corners, strict=True)), strict=True)
        ]
        place = {"type": "Polygon", "coordinates": [ring]}
        features.append({"type": "Feature", "properties": properties, "geometry": place})
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    return path


WEST = [(549990.0, 4179980.0), (550004.0, 4179980.0), (550004.0, 4180010.0), (549990.0, 4180010.0)]


def test_zones_refuse_ground_in_all_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    dem, out = write(tmp_path / "dem.tif", rock((81, 161))), tmp_path / "out"
    zones = zones_file(tmp_path / "zones.geojson", ({"alight": "keep-out", "name": "farm", "reason": "crops"}, WEST))
    options = ["--sigma", "0.01", "--zones", str(zones), "--set", "lander.radius=1", "--out", str(out)]
    assert call(["hazards", str(dem), *options]) == 0
    assert "ZONES  zones.geojson: 1 keep-out" in capsys.readouterr().out
    with rasterio.open(out / "reasons.tif") as why:
        zone = (why.read(1) & Hazard.ZONE) != 0
        assert why.tags(1)["bit_10"] == "zone: refused by a zone"
    assert zone[:, :48].all()  # 4 m, and the lander's radius beyond
    assert not zone[:, 52:].any()
    sites = json.loads((out / "sites.geojson").read_text())["features"]
    for p in (s["properties"] for s in sites):
        assert p["zone"] == "keep-out zone farm (crops)"
        assert p["zone_m"] == pytest.approx(p["east_m"] - 550004.0, abs=0.02)
        assert p["zone_deg"] == pytest.approx(270.0, abs=0.5)
    assert sites
    assert "keep-out zone farm (crops)" in (out / "report.html").read_text()
    named = alight.judge(dem, sigma=0.01, zones=zones, settings={"lander.radius": 1.0}).sites
    assert [s.zone for s in named] == [
        s.zone for s in alight.judge(dem, sigma=0.01, zones=str(zones), lander=alight.Lander(radius=1.0)).sites
    ]


def test_where_zones_leave_nothing_the_reason_names_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    dem = write(tmp_path / "dem.tif", rock((81, 81)))
    zones = zones_file(tmp_path / "z.geojson", ({"alight": "landing", "name": "pad"}, [(x - 50, y) for x, y in WEST]))
    assert call(["hazards", str(dem), "--sigma", "0.01", "--zones", str(zones), "--out", str(tmp_path / "out")]) == 0
    assert "100 % is refused by a zone (outside landing zone pad)" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("properties", "plane", "words"),
    [
        ({"alight": "no-fly", "name": "farm"}, "EPSG:32610", 'polygon "farm" (feature 1): alight: "no-fly"'),
        ({"alight": "keep-out", "name": "farm"}, None, "is for heights with a place on Earth"),
    ],
)
def test_zones_that_cannot_be_used_end_before_any_work(
    tmp_path: Path, refused: Refused, properties: dict[str, object], plane: str | None, words: str
) -> None:
    dem = write(tmp_path / "dem.tif", rock(), crs=plane)
    zones = zones_file(tmp_path / "zones.geojson", (properties, WEST))
    refused(["hazards", dem, "--sigma", "0.01", "--zones", zones, "--out", tmp_path / "out"], words)
