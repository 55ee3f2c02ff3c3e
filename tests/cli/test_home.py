"""The home of route.plan: read from a user, a geoid grid or an autopilot, and checked against the map."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from rasterio.transform import Affine
from some_run import LOCAL, route, some_run

from alight import cli
from alight.cli.terminal import save_result
from alight.records import Home, InputError, Place, Telemetry
from alight.records.telemetry import GpsQuality
from alight.runner import replay
from alight.runs import flown_home, known_home, wanted_home, with_home
from alight.sources.geoid import separation_at

NEAR = "48.1, 15.44, 250.12"


def geoid_at(latitude: Any, longitude: Any) -> Any:
    """A made-up linear geoid, which bilinear interpolation reproduces exactly."""
    return 40.0 + 0.5 * (latitude - 48.0) - 0.25 * (longitude - 15.0)


def write_geoid(
    path: Path, west: float = 10.0, crs: str | None = "EPSG:4326", shift: float = 0.0, scale: float = 1.0
) -> Path:
    """Write a geoid of ten degrees each way, cells of a quarter degree, rows from 53 degrees north."""
    cell = 0.25
    longitude, latitude = west + cell * (0.5 + np.arange(40)), 53.0 - cell * (0.5 + np.arange(40))
    heights = geoid_at(latitude[:, None], longitude[None, :] - (360.0 if west > 180 else 0.0)) + shift
    profile = {"driver": "GTiff", "width": 40, "height": 40, "count": 1, "dtype": "float64", "nodata": -9999.0}
    with rasterio.open(path, "w", crs=crs, transform=Affine(cell, 0, west, 0, -cell, 53.0), **profile) as out:
        out.write(heights / scale, 1)
        out.scales = (scale,)
    return path


# -- from a user


def test_a_home_has_three_numbers_or_four() -> None:
    assert Home.parse("48.1,15.44,250,43.9").height == pytest.approx(293.9)
    bare = Home.parse(" 48.1, 15.44, 250 ")
    assert math.isnan(bare.height)
    assert bare.with_separation(44.0).height == 294.0
    assert Home.parse("48.1,15.44,250,43.9").with_separation(44.0).separation == 43.9  # its own number stays


@pytest.mark.parametrize(
    "text",
    ["", "1,2", "a,b,c", "a,b,c,d", "95,13,500", "48,400,500", "47,13,nan", "47,13,500,inf", "47,13,500,460",
     "1,2,3,4,5", "48,15,250000"],
)  # fmt: skip
def test_a_home_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="LAT,LON,ALT_MSL"):
        Home.parse(text)


def test_a_recording_needs_the_separation() -> None:
    assert known_home(None) is None
    with pytest.raises(InputError, match="--geoid"):
        known_home(NEAR)
    found = known_home(f"{NEAR},33")
    assert found is not None
    assert found.height == pytest.approx(283.12)


# -- from a grid of the geoid


@pytest.mark.parametrize("west", [10.0, 370.0, -350.0])
@pytest.mark.parametrize("scale", [1.0, 0.5])
def test_the_grid_is_read_between_its_cells(tmp_path: Path, west: float, scale: float) -> None:
    """Longitudes may begin at -180 or go round once more, and values may be scaled."""
    cell = 0.25
    grid = tmp_path / "geoid.tif"
    write_geoid(grid, 10.0, scale=scale)
    with rasterio.open(grid, "r+") as out:
        out.transform = Affine(cell, 0, west, 0, -cell, 53.0)
    for latitude, longitude in ((48.1, 15.44), (52.875, 10.125), (43.2, 19.8), (50.0, 12.5)):
        assert separation_at(grid, latitude, longitude) == pytest.approx(geoid_at(latitude, longitude), abs=1e-9)


def test_home_and_grid_are_enough(tmp_path: Path) -> None:
    found = known_home(NEAR, write_geoid(tmp_path / "geoid.tif"))
    assert found is not None
    assert found.separation == pytest.approx(geoid_at(48.1, 15.44), abs=1e-9)
    own = wanted_home(f"{NEAR},33", tmp_path / "geoid.tif")
    assert own is not None
    assert own.separation == 33.0  # the user's number takes precedence over the grid


def test_a_grid_that_cannot_be_used_says_so(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        known_home(NEAR, tmp_path / "none.tif")
    with pytest.raises(InputError, match="not degrees"):
        known_home(NEAR, write_geoid(tmp_path / "utm.tif", crs="EPSG:32633"))
    with pytest.raises(InputError, match="does not reach"):
        known_home("15.44,48.1,250", write_geoid(tmp_path / "geoid.tif"))
    with pytest.raises(InputError, match="no geoid's height"):
        known_home(NEAR, write_geoid(tmp_path / "terrain.tif", shift=900.0))
    with pytest.raises(InputError, match="give the home"):
        known_home(None, tmp_path / "geoid.tif")


def test_a_hole_in_the_grid_is_no_height(tmp_path: Path) -> None:
    grid = write_geoid(tmp_path / "geoid.tif")
    with rasterio.open(grid, "r+") as out:
        heights = out.read(1)
        heights[18:22, 20:24] = -9999.0
        out.write(heights, 1)
    with pytest.raises(InputError, match="no geoid's height"):
        separation_at(grid, 48.1, 15.44)


# -- from an autopilot


def heard(separation: float = 44.0, home: bool = True) -> Telemetry:
    at = Place(48.1, 15.44, 250.0, 0.0)
    return Telemetry("ArduPilot", gps=GpsQuality(separation=separation), home=at if home else None)


def test_the_autopilots_own_home_is_taken() -> None:
    assert flown_home(None, heard(), None) == Home(48.1, 15.44, 250.0, 44.0)
    assert flown_home(None, heard(math.nan), 45.0) == Home(48.1, 15.44, 250.0, 45.0)
    assert flown_home(None, heard(home=False), None) is None
    assert flown_home(None, None, 45.0) is None


def test_the_users_home_goes_before_it() -> None:
    mine = Home.parse("48.2,15.5,300")
    assert flown_home(mine, heard(), None) == Home(48.2, 15.5, 300.0, 44.0)
    assert flown_home(mine.with_separation(43.0), heard(), None) == Home(48.2, 15.5, 300.0, 43.0)
    assert flown_home(mine, heard(), 45.0) == Home(48.2, 15.5, 300.0, 45.0)


# -- against the map


def test_a_home_near_by_is_taken_without_a_word() -> None:
    home = Home.parse(f"{NEAR},33")
    found = with_home(some_run(), home)
    assert found.home == home
    assert found.warnings == some_run().warnings


@pytest.mark.parametrize(
    ("text", "says"), [("15.44,48.1,250,33", "km from the site"), ("48.1,15.44,3000,33", "m above the site")]
)
def test_a_home_that_cannot_be_right_is_warned_of(text: str, says: str) -> None:
    found = with_home(some_run(), Home.parse(text))
    assert found.home is not None
    assert says in found.warnings[-1]


def test_without_a_place_on_earth_there_is_no_use_for_it() -> None:
    found = with_home(some_run(georeferenced=False), Home.parse(f"{NEAR},33"))
    assert found.home is None
    assert "not used" in found.warnings[-1]


def test_a_home_above_the_sea_alone_is_not_used_and_said() -> None:
    own = flown_home(None, heard(math.nan), None)
    assert own is not None
    found = with_home(some_run(), own)
    assert found.home is None
    assert "--separation" in found.warnings[-1]


# -- the whole way


def test_a_plan_without_a_home_warns_on_stderr(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for result, warned in ((some_run(), True), (with_home(some_run(), Home.parse(f"{NEAR},47")), False)):
        save_result(result, tmp_path / str(warned), False)
        assert ("--home" in capsys.readouterr().err) == warned


def test_the_command_writes_a_plan_above_the_home(
    flight: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The site's ground lies 2.12 m above the origin, and the origin is 301 m above the ellipsoid."""
    monkeypatch.setattr(replay, "replay", lambda *_, **__: some_run())
    grid = write_geoid(tmp_path / "geoid.tif")
    arguments = ["run", str(flight), "--out", str(tmp_path / "out"), "--home", NEAR, "--geoid", str(grid)]
    assert cli.call(arguments) == 0
    plan = json.loads((tmp_path / "out" / "route.plan").read_text())
    assert plan["mission"]["plannedHomePosition"] == [48.1, 15.44, 250.12]
    assert "RELATIVE TO THE SITE" not in plan["name"]
    assert "above the home" in (tmp_path / "out" / "report.html").read_text()
    altitudes = [i["Altitude"] for i in plan["mission"]["items"] if "Altitude" in i]
    home = 250.12 + geoid_at(48.1, 15.44)
    heights = [float(LOCAL.to_geodetic(w.position_world)[2]) - home for w in route().waypoints]
    assert altitudes == pytest.approx(heights, abs=2e-3)
