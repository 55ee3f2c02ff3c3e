"""The folder of a run: its contents, and that it is complete or absent."""

from __future__ import annotations

import json
import math
import resource
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields, replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pytest
import rasterio
from some_run import CELL, GRID, LOCAL, ROWS, candidate, elevation, hazards, site, some_run

from alight import outputs
from alight.geometry import world_up
from alight.outputs import FILES, prepare_folder, write_run
from alight.outputs import atomic_write as whole
from alight.outputs.plan import plan_items
from alight.outputs.reading import read_run
from alight.outputs.verdict import write_judgement
from alight.photos.work import WorkFolder
from alight.records import (
    Datum,
    Flag,
    Hazard,
    HazardMap,
    Home,
    InputError,
    OutputError,
    Route,
    Sites,
    Terrain,
    Waypoint,
    Wire,
)
from alight.settings import Settings


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run") / "deep" / "out"
    write_run(some_run(), folder)
    return folder


def loaded(path: Path) -> dict:
    return json.loads(path.read_text(encoding="utf-8"))


def test_everything_is_written_and_run_json_last(tmp_path: Path) -> None:
    written = [p.name for p in write_run(some_run(), tmp_path / "out")]
    assert set(written) == {*FILES, "run.json"}
    assert written[-1] == "run.json"
    assert {p.name for p in (tmp_path / "out").iterdir()} == set(written)


@pytest.mark.parametrize("name", ["dem", "flags", "terrain", "safe", "reasons", "ortho"])
def test_rasters_are_cloud_optimised_on_one_grid(out: Path, name: str) -> None:
    with rasterio.open(out / f"{name}.tif") as d:
        assert d.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        assert d.profile["tiled"]
        assert d.profile["compress"] == "deflate"
        assert all(d.descriptions)
        assert d.shape == GRID.shape
        assert d.crs == rasterio.crs.CRS.from_string(LOCAL.crs)
        assert "Transverse_Mercator" in d.crs.to_wkt()
        assert d.xy(0, 0) == pytest.approx((GRID.east, GRID.north))  # a cell's centre
        assert d.res == (CELL, CELL)


def test_large_rasters_have_overviews() -> None:
    grid = outputs.rasters.Grid(0.0, 0.0, 0.1, 700, 900)
    flat = outputs.rasters.RasterFile(grid, np.zeros((1, 700, 900), np.float32), ("flat",))
    data = outputs.rasters.encode(flat, rasterio.crs.CRS.from_string(LOCAL.crs))
    with rasterio.io.MemoryFile(data) as m, m.open() as d:
        assert d.overviews(1) == [2, 4]


def test_dem_is_above_the_ellipsoid_and_empty_where_refused(out: Path) -> None:
    with rasterio.open(out / "dem.tif") as d:
        assert d.descriptions == ("height", "sigma")
        assert d.units == ("m", "m")
        assert np.isnan(d.nodata)
        height, sigma = d.read()
    e = elevation()
    refused = (e.flags & np.uint16(Flag.MOVING | Flag.UNSEEN)) != 0
    np.testing.assert_array_equal(np.isnan(height), refused)
    np.testing.assert_array_equal(np.isnan(sigma), refused)
    r, c = 60, 60  # the exact geodesy beside the closed form
    east, north = GRID.xy()
    truth = LOCAL.to_geodetic([east[c], north[r], float(e.height[r, c])])[2]
    assert height[r, c] == pytest.approx(float(truth), abs=5e-5)
    assert np.isfinite(height[30, 45])  # a step is doubtful, not refused


def test_what_the_whole_map_shares_stands_in_tags_and_run_json(tmp_path: Path) -> None:
    """Offset and tilt come from the poses; without a covariance of the poses there are none."""
    datum = Datum(3.0, -4.0, np.array([[1.21, 0, 0], [0, 4e-6, 1e-6], [0, 1e-6, 9e-6]]))
    warp = np.full(GRID.shape, 0.04, np.float32)
    write_run(some_run(elevation=replace(elevation(), datum=datum, warp=warp)), tmp_path)
    with rasterio.open(tmp_path / "dem.tif") as d:
        tags, sigma = d.tags(), d.read(2)
    assert float(tags["COMMON_OFFSET_SIGMA_M"]) == pytest.approx(1.1)
    assert [float(v) for v in tags["COMMON_TILT_SIGMA_RAD"].split(",")] == pytest.approx([2e-3, 3e-3])
    assert [float(v) for v in tags["COMMON_CENTRE_M"].split(",")] == pytest.approx([3.0, -4.0])
    covariance = np.array([float(v) for v in tags["COMMON_COVARIANCE"].split(",")]).reshape(3, 3)
    np.testing.assert_allclose(covariance, datum.covariance, rtol=1e-5)
    assert np.nanmax(sigma) == pytest.approx(0.05)  # 0.03 of the match, 0.04 of the warp by the poses
    common = loaded(tmp_path / "run.json")["common_error"]
    assert common["offset_sigma_m"] == pytest.approx(1.1)
    assert common["tilt_sigma_rad"] == pytest.approx([2e-3, 3e-3])
    assert common["centre_m"] == [3.0, -4.0]
    np.testing.assert_allclose(common["covariance"], datum.covariance, rtol=1e-5)


def test_exact_poses_share_nothing(out: Path) -> None:
    with rasterio.open(out / "dem.tif") as d:
        assert not [t for t in d.tags() if t.startswith("COMMON")]
    assert loaded(out / "run.json")["common_error"] is None


def test_the_curvature_term_agrees_with_geodesy_far_from_the_origin() -> None:
    grid = outputs.rasters.Grid(1000.0, 2000.0, 1.0, 1, 1)
    one = np.ones((1, 1), np.float32)
    e = elevation()
    far = type(e)(grid, one, one, np.zeros((1, 1), np.uint16), e.views[:1, :1], e.rgb[:1, :1], one, one)
    height = outputs.ellipsoidal_height(far, LOCAL)
    assert height[0, 0] == pytest.approx(float(LOCAL.to_geodetic([1000.0, 2000.0, 1.0])[2]), abs=3e-3)
    assert world_up(height, grid, LOCAL)[0, 0] == pytest.approx(1.0, abs=1e-4)


@pytest.mark.parametrize(
    ("name", "bits", "values"),
    [("flags", Flag, lambda: elevation().flags), ("reasons", Hazard, lambda: hazards().reasons)],
)
def test_bits_are_named(out: Path, name: str, bits: type[Flag | Hazard], values: Callable[[], np.ndarray]) -> None:
    with rasterio.open(out / f"{name}.tif") as d:
        assert d.dtypes == ("uint16",)
        np.testing.assert_array_equal(d.read(1), values())
        tags = d.tags(1)
    for bit in bits:
        assert tags[f"bit_{bit.value.bit_length() - 1}"].startswith(f"{bit.name.lower()}: ")


def test_terrain_has_codes_and_colours(out: Path) -> None:
    with rasterio.open(out / "terrain.tif") as d:
        assert set(np.unique(d.read(1))) == {Terrain.UNKNOWN, Terrain.SHORT_GRASS, Terrain.WATER}
        colours, tags = d.colormap(1), d.tags(1)
    assert len({colours[t] for t in Terrain}) == len(Terrain)
    assert tags["class_5"] == "water"


def test_safe_is_a_probability(out: Path) -> None:
    with rasterio.open(out / "safe.tif") as d:
        p = d.read(1)
        assert d.descriptions == ("p_safe", "p_relief", "p_obstacle", "p_ground", "resolved")
        assert d.units == (None, None, None, None, "m")
        np.testing.assert_array_equal(d.read(5), hazards().resolved)
    assert d.dtypes == ("float32",) * 5
    assert np.isnan(p[0, 0])
    assert np.nanmin(p) >= 0
    assert np.nanmax(p) <= 1


def test_hazards_on_coarser_cells_are_written_on_the_grid_of_the_heights(tmp_path: Path) -> None:
    """Hazards are judged on cells of twice the size, whose last row reaches beyond the heights."""
    fine = hazards()
    cut = replace(GRID, rows=ROWS - 1)
    e = elevation()
    arrays = ("height", "sigma", "flags", "views", "rgb", "residual")
    e = replace(e, grid=cut, **{name: getattr(e, name)[:-1] for name in arrays})
    of_cells = [f.name for f in fields(HazardMap) if isinstance(getattr(fine, f.name), np.ndarray)]
    blocks = {name: getattr(fine, name)[::2, ::2] for name in of_cells}
    coarse = HazardMap(cut.coarser(2), **blocks)
    write_run(some_run(elevation=e, terrain=None, hazards=coarse), tmp_path)
    with rasterio.open(tmp_path / "dem.tif") as dem:
        for name in ("safe", "reasons"):
            with rasterio.open(tmp_path / f"{name}.tif") as d:
                assert (d.shape, d.transform, d.crs) == (dem.shape, dem.transform, dem.crs)
    reasons = read_run(tmp_path).reasons
    np.testing.assert_array_equal(reasons, np.repeat(np.repeat(blocks["reasons"], 2, 0), 2, 1)[:-1])


def test_hazards_are_unknown_beyond_their_own_cells() -> None:
    part = hazards().on(GRID.window(-1, -2, 5, 6))
    assert np.isnan(part.p_safe[0]).all()
    assert (part.reasons[:, :2] == Hazard.UNKNOWN).all()
    np.testing.assert_array_equal(part.slope[1:, 2:], hazards().slope[:4, :4])
    assert hazards().on(GRID).grid == GRID


def test_ortho_is_rgb_and_transparent_where_unseen(out: Path) -> None:
    with rasterio.open(out / "ortho.tif") as d:
        assert [c.name for c in d.colorinterp] == ["red", "green", "blue"]
        np.testing.assert_array_equal(np.moveaxis(d.read(), 0, 2), elevation().rgb)
        np.testing.assert_array_equal(d.dataset_mask() > 0, elevation().views > 0)


def test_sites_follow_rfc_7946(out: Path) -> None:
    tree = loaded(out / "sites.geojson")
    assert tree["type"] == "FeatureCollection"
    assert [f["properties"]["rank"] for f in tree["features"]] == [1, 2]
    best = tree["features"][0]
    lon, lat, height = best["geometry"]["coordinates"]
    np.testing.assert_allclose(LOCAL.to_enu(lat, lon, height), [5.0, -2.0, 2.12], atol=1e-3)
    assert set(best["properties"]) == PROPERTIES
    assert best["properties"]["kind"] == "site"
    assert "reason" not in tree
    assert best["properties"]["slope_deg"] == 2.1
    assert best["properties"]["heading_deg"] == 330.0
    assert best["properties"]["terrain"] == "short_grass"


def test_wires_are_written_with_the_heights_of_both_ends(tmp_path: Path) -> None:
    wire = Wire(np.array([2.0, 3.0, 6.0]), np.array([5.0, 7.0, 6.5]), 0.91)
    write_run(some_run(hazards=replace(hazards(), wires=(wire,))), tmp_path)
    (line,) = json.loads((tmp_path / "wires.geojson").read_text())["features"]
    (_, _, low), (_, _, high) = line["geometry"]["coordinates"]
    assert high - low == pytest.approx(0.5, abs=1e-3)
    assert line["properties"] == {"p_wire": 0.91, "length_m": 5.0}


PROPERTIES = {
    *("kind", "rank", "p_safe", "p_relief", "p_obstacle", "p_ground", "p_wires", "quality", "slope_deg", "roughness_m"),
    *("clearance_m", "radius_m", "resolved_m", "terrain", "heading_deg", "east_m", "north_m", "height_sigma_m"),
}


def test_candidates_come_after_the_sites_with_their_doubt_and_the_view_that_settles_it(tmp_path: Path) -> None:
    blind = replace(candidate(3, 12.0, 6.0), look=None)
    write_run(some_run(sites=Sites((site(),), candidates=(candidate(2), blind))), tmp_path)
    features = loaded(tmp_path / "sites.geojson")["features"]
    assert [f["properties"]["kind"] for f in features] == ["site", "candidate", "candidate"]
    assert [f["properties"]["rank"] for f in features] == [1, 2, 3]
    told = features[1]["properties"]
    assert set(told) == PROPERTIES | {"doubt", "look", "look_from_m"}
    assert (told["doubt"], told["look_from_m"], told["resolved_m"]) == ("obstacle", 12.0, 0.22)
    lon, lat, height = told["look"]
    np.testing.assert_allclose(LOCAL.to_enu(lat, lon, height), [6.0, -1.0, 14.12], atol=1e-3)
    assert (features[2]["properties"]["look"], features[2]["properties"]["look_from_m"]) == (None, None)
    answer = loaded(tmp_path / "run.json")["answer"]
    assert answer["counts"] == {"sites": 1, "candidates": 2}
    assert answer["candidates"][0]["look"] == [6.0, -1.0, 14.12]


def test_with_candidates_alone_the_reason_is_given_and_nothing_is_flown_to(tmp_path: Path) -> None:
    write_run(some_run(sites=Sites((), "no safe site: fog", candidates=(candidate(),)), route=None), tmp_path)
    tree = loaded(tmp_path / "sites.geojson")
    assert tree["reason"] == "no safe site: fog"
    assert [f["properties"]["kind"] for f in tree["features"]] == ["candidate"]
    assert loaded(tmp_path / "run.json")["not_written"]["route.plan"] == "there is no site to fly to"
    write_run(some_run(sites=Sites((), "fog", candidates=(candidate(),)), route=None, georeferenced=False), tmp_path)
    assert "sites.geojson" in loaded(tmp_path / "run.json")["not_written"]


def test_unknown_numbers_become_null(tmp_path: Path) -> None:
    unknown = site()
    unknown = type(unknown)(**{**vars(unknown), "clearance": float("nan"), "heading": float("inf")})
    write_run(some_run(sites=Sites((unknown,))), tmp_path)
    properties = loaded(tmp_path / "sites.geojson")["features"][0]["properties"]
    assert properties["clearance_m"] is None
    assert properties["heading_deg"] is None


def test_no_site_is_an_answer_with_a_reason(tmp_path: Path) -> None:
    write_run(some_run(sites=Sites((), "everything is water"), route=None), tmp_path)
    tree = loaded(tmp_path / "sites.geojson")
    assert tree == {"type": "FeatureCollection", "features": [], "reason": "everything is water"}
    assert not (tmp_path / "route.plan").exists()
    assert loaded(tmp_path / "run.json")["not_written"]["route.plan"] == "there is no site to fly to"


def test_plan_is_what_qgroundcontrol_reads(out: Path) -> None:
    plan = loaded(out / "route.plan")
    assert (plan["fileType"], plan["version"]) == ("Plan", 1)
    assert plan["geoFence"] == {"circles": [], "polygons": [], "version": 2}
    assert plan["rallyPoints"] == {"points": [], "version": 2}
    mission = plan["mission"]
    needed = {"version", "firmwareType", "vehicleType", "cruiseSpeed", "hoverSpeed", "items", "plannedHomePosition"}
    assert needed <= set(mission)
    items = mission["items"]
    commands = [i["command"] for i in items]
    assert commands == [16, 178, 115, 16, 178, 115, 21]  # speed and heading on the way to each place
    assert [i["doJumpId"] for i in items] == [1, 2, 3, 4, 5, 6, 7]
    assert all(i["type"] == "SimpleItem" and len(i["params"]) == 7 for i in items)
    places = [i for i in items if i["command"] in (16, 21)]
    assert all(i["frame"] == 3 for i in places)
    assert [i["params"][6] for i in places] == pytest.approx([29.88, 10.0, 0.0], abs=1e-3)  # above the site
    assert [i["params"][:3] for i in items if i["command"] == 178] == [[1.0, 5.0, -1.0], [3.0, 5.0, -1.0]]
    assert {i["params"][0] for i in items if i["command"] == 115} == {330.0}
    lat, lon, ground = mission["plannedHomePosition"]
    np.testing.assert_allclose(LOCAL.to_enu(lat, lon, ground), [5.0, -2.0, 2.12], atol=1e-3)
    assert "RELATIVE TO THE SITE" in plan["name"]


def test_items_of_a_plan_by_hand() -> None:
    """A way of 50 m, a look, and then straight down: speeds of the descent are marked as such."""
    names = [("start", 0, 40, 0, False), ("transit", 50, 40, 5, True), ("approach", 50, 12, 1, True),
             ("touchdown", 50, 2, 1, False)]  # fmt: skip
    items = plan_items(
        Route(tuple(Waypoint(n, np.array([3.0 + e, 0.0, u]), 1.5, s, 0.0, look) for n, e, u, s, look in names))
    )
    assert [i.command for i in items] == [16, 178, 115, 16, 178, 115, 16, 178, 115, 21]
    speeds = [i.parameters[:3] for i in items if i.command == 178]
    assert speeds == [(1.0, 5.0, -1.0), (3.0, 1.0, -1.0), (3.0, 1.0, -1.0)]  # over the ground; then straight down
    assert [i.parameters[0] for i in items if i.command == 115] == [pytest.approx(math.degrees(1.5))] * 3
    assert [i.position_world[2] for i in items if i.position_world is not None] == [40.0, 40.0, 12.0, 2.0]
    assert [i.parameters[0] for i in items if i.command == 16] == [0.0, 3.0, 3.0]


def test_a_plan_with_a_home_is_relative_to_it(tmp_path: Path) -> None:
    """The home lies 20 m below the site; GPS there gives 250.12 m above the sea, which is 33 m above the ellipsoid."""
    home = Home.parse("48.1, 15.44, 250.12, 33.0")
    write_run(some_run(home=home), tmp_path)
    plan = loaded(tmp_path / "route.plan")
    assert "RELATIVE TO THE SITE" not in plan["name"]
    assert plan["mission"]["plannedHomePosition"] == [48.1, 15.44, 250.12]
    altitudes = [i["Altitude"] for i in plan["mission"]["items"] if "Altitude" in i]
    assert altitudes == pytest.approx([49.88, 30.0, 20.0], abs=2e-3)


def read_by_others(plan: Path, text: Path) -> list[Any]:
    """Items of a plan, by pymavlink's own loader from QGroundControl's text format, which is written to `text`."""
    mavwp = pytest.importorskip("pymavlink.mavwp")
    items = loaded(plan)["mission"]["items"]
    rows = [[i["doJumpId"] - 1, 0, i["frame"], i["command"], *i["params"], 1] for i in items]
    text.write_text("QGC WPL 110\n" + "".join("\t".join(map(str, row)) + "\n" for row in rows))
    loader = mavwp.MAVWPLoader()
    assert loader.load(str(text)) == len(items)
    return [loader.wp(k) for k in range(loader.count())]


def test_an_independent_reader_understands_the_plan(out: Path, tmp_path: Path) -> None:
    places = [w for w in read_by_others(out / "route.plan", tmp_path / "plan.txt") if w.command in (16, 21)]
    ground = float(LOCAL.to_geodetic([5.0, -2.0, 2.12])[2])
    got = [LOCAL.to_enu(w.x, w.y, w.z + ground) for w in places]
    np.testing.assert_allclose(got, [w.position_world for w in some_run().route.waypoints], atol=2e-3)


def test_an_independent_reader_finds_speeds_headings_and_holds(tmp_path: Path) -> None:
    """The way-points face south-west; one is a look; the home lies 20 m below the site."""
    start, approach, touchdown = some_run().route.waypoints
    turned = [
        replace(w, heading=math.radians(225.0)) for w in (start, replace(approach, look=True, speed=3.0), touchdown)
    ]
    home = Home.parse("48.1, 15.44, 250.12, 33.0")
    write_run(some_run(home=home, route=Route(tuple(turned))), tmp_path)
    items = read_by_others(tmp_path / "route.plan", tmp_path / "plan.txt")
    speeds = [w.param2 for w in items if w.command == 178]
    assert speeds == pytest.approx([3.0, 5.0])
    assert [w.param1 for w in items if w.command == 115] == pytest.approx([225.0, 225.0])
    holds = [w.param1 for w in items if w.command == 16]
    assert holds[-1] == pytest.approx(3.0)  # at the look
    assert sum(h > 0 for h in holds) == 1
    assert items[-1].command == 21
    assert items[-1].z == pytest.approx(20.0, abs=0.1)  # the site, above the home
    assert {w.frame for w in items if w.command in (16, 21)} == {3}


def test_route_line_has_times_and_speeds(out: Path) -> None:
    line, *points = loaded(out / "route.geojson")["features"]
    assert line["geometry"]["type"] == "LineString"
    assert len(line["geometry"]["coordinates"]) == len(points) == 3
    assert line["properties"]["times_s"] == [0.0, 7.5, 17.5]
    assert line["properties"]["speeds_m_s"] == [5.0, 5.0, 5.0]
    assert points[1]["properties"]["name"] == "approach"


def test_tum_keeps_nanoseconds_and_puts_w_last(out: Path) -> None:
    rows = [r.split() for r in (out / "trajectory.tum").read_text().splitlines() if not r.startswith("#")]
    assert rows[0][0] == "1700000000.000000001"
    m = some_run().motions[0]
    np.testing.assert_allclose(np.array(rows[0][1:4], float), m.world_from_body.translation, atol=1e-6)
    np.testing.assert_allclose(np.roll(np.array(rows[0][4:], float), 1), m.world_from_body.quaternion, atol=1e-8)


def test_csv_has_velocity_and_sigma(out: Path) -> None:
    header, *rows = [r.split(",") for r in (out / "trajectory.csv").read_text().splitlines()]
    row = dict(zip(header, rows[0], strict=True))
    assert int(row["t_ns"]) == 1_700_000_000_000_000_001
    assert float(row["v_n"]) == -10.0
    assert float(row["sigma_u"]) == pytest.approx(0.3)
    assert float(row["sigma_yaw"]) == pytest.approx(3e-3, rel=0.01)  # yaw is about world up, nearly
    assert row["state"] == "good"


def test_attitude_sigma_turns_into_the_body() -> None:
    m = some_run().motions[0]  # heading 1.2 rad: roll and pitch mix the world's east and north parts
    roll, pitch, _ = outputs.vectors.attitude_sigma(m)
    s, c = np.sin(1.2), np.cos(1.2)
    assert roll == pytest.approx(np.hypot(1e-3 * c, 2e-3 * s), rel=0.02)
    assert pitch == pytest.approx(np.hypot(1e-3 * s, 2e-3 * c), rel=0.02)


def test_run_json_tells_the_run(out: Path) -> None:
    info = loaded(out / "run.json")
    assert Settings.model_validate(info["settings"]) == Settings()
    assert info["settings"]["tuning"] == Settings().tuning.model_dump(mode="json")
    assert info["counts"]["frames dropped, file missing"] == 1
    assert info["time"]["motion"] == {"steps": 3, "median_s": 0.02, "p95_s": pytest.approx(0.452), "total_s": 0.53}
    assert "sites" not in info["time"]
    assert info["warnings"] == ["nav0: 3 rows without attitude"]
    assert info["not_written"] == {}
    assert info["answer"]["sites"][0]["east_m"] == 5.0


def test_notes_may_hold_arrays_and_unknowns(tmp_path: Path) -> None:
    notes = {
        "mounting": np.array([0.5, np.nan]),
        "gps": {"RTK fixed": np.int64(32)},
        "file": Path("a"),
        "focal": "held",
    }
    write_run(some_run(notes=notes), tmp_path)
    assert loaded(tmp_path / "run.json")["notes"] == {
        "mounting": [0.5, None],
        "gps": {"RTK fixed": 32},
        "file": "a",
        "focal": "held",
    }


def test_what_cannot_be_filled_is_named(tmp_path: Path) -> None:
    empty = some_run(
        sites=Sites((), "nothing looked down"), elevation=None, terrain=None, hazards=None, route=None, motions=(),
        not_written={"dem.tif": "no downward view"},
    )  # fmt: skip
    names = {p.name for p in write_run(empty, tmp_path)}
    assert names == {"sites.geojson", "report.html", "run.json"}
    missing = loaded(tmp_path / "run.json")["not_written"]
    assert set(missing) == set(FILES) - names
    assert missing["dem.tif"] == "no downward view"
    run = read_run(tmp_path)
    assert run.grid is None
    assert run.height is None


def test_without_a_place_on_earth_nothing_claims_one(tmp_path: Path) -> None:
    write_run(some_run(georeferenced=False), tmp_path)
    missing = loaded(tmp_path / "run.json")["not_written"]
    assert set(missing) == {"sites.geojson", "route.plan", "route.geojson"}
    with rasterio.open(tmp_path / "dem.tif") as d:
        assert not d.crs.is_projected
        assert not d.crs.is_geographic
    assert read_run(tmp_path).local is None


def test_the_heights_name_their_zero(tmp_path: Path, out: Path) -> None:
    write_run(some_run(georeferenced=False), tmp_path)
    for folder, zero in ((out, "WGS84 ellipsoid"), (tmp_path, "the recording's origin")):
        with rasterio.open(folder / "dem.tif") as d:
            assert d.tags(1)["height_reference"] == zero


def test_work_that_cannot_be_begun_is_refused(tmp_path: Path) -> None:
    (tmp_path / "unfinished-work").write_text("a file")
    with pytest.raises(OutputError, match=r"unfinished-work: cannot be written .*choose another folder"):
        WorkFolder(tmp_path, {}, resume=False)


def test_a_run_is_read_back(out: Path) -> None:
    run = read_run(out)
    assert run.grid == GRID
    assert run.local == LOCAL
    e = elevation()
    up = world_up(run.height, run.grid, run.local)
    np.testing.assert_allclose(up[e.trusted], e.height[e.trusted], atol=5e-5)
    np.testing.assert_array_equal(run.flags, e.flags)
    np.testing.assert_array_equal(run.ortho, e.rgb)
    assert run.terrain[90, 120] == Terrain.WATER
    assert np.isnan(run.safe[0, 0])


def test_reading_what_is_no_run(tmp_path: Path, out: Path) -> None:
    with pytest.raises(InputError, match="no finished run"):
        read_run(tmp_path)
    (tmp_path / "run.json").write_bytes((out / "run.json").read_bytes())
    (tmp_path / "dem.tif").write_bytes((out / "dem.tif").read_bytes()[:200])
    with pytest.raises(InputError, match=r"dem\.tif: not a readable raster"):
        read_run(tmp_path)


def test_a_second_run_leaves_nothing_of_the_first(tmp_path: Path) -> None:
    write_run(some_run(), tmp_path)
    (tmp_path / "dem.tif.aux.xml").write_text("of QGIS")
    write_run(some_run(sites=Sites((), "fog"), route=None), tmp_path)
    assert not (tmp_path / "route.plan").exists()
    assert loaded(tmp_path / "run.json")["answer"]["reason"] == "fog"
    assert (tmp_path / "dem.tif.aux.xml").exists()


def test_an_old_raster_leaves_no_notes_of_gdal(tmp_path: Path) -> None:
    """GDAL and QGIS keep statistics beside a raster; those of an earlier one say nothing of the new one."""
    write_run(some_run(), tmp_path)
    for name in ("dem.tif", "terrain.tif"):
        (tmp_path / f"{name}.aux.xml").write_text("<PAMDataset>\n</PAMDataset>\n")
    write_run(some_run(terrain=None), tmp_path)
    assert not list(tmp_path.glob("*.aux.xml"))


def test_a_judgement_and_a_run_leave_nothing_of_each_other(tmp_path: Path) -> None:
    judged = some_run(source_kind="heights", georeferenced=False)
    own = {"safe.tif", "reasons.tif", "terrain.tif", "hazards.tif", "report.html", "run.json"}
    write_run(some_run(), tmp_path)
    write_judgement(judged, tmp_path, False, None, False)
    assert {p.name for p in tmp_path.iterdir()} == own
    write_judgement(judged, tmp_path, False, None, True)
    assert (tmp_path / "heights.tif").exists()
    write_run(some_run(), tmp_path)
    assert {p.name for p in tmp_path.iterdir()} == {*FILES, "run.json"}


def test_an_input_in_the_folder_of_the_results_is_refused(out: Path, tmp_path: Path) -> None:
    before = {p.name for p in out.iterdir()}
    with pytest.raises(OutputError, match=r"dem\.tif: lies in .*choose another folder"):
        prepare_folder(out, inputs=[out / ".." / out.name / "dem.tif"])
    assert {p.name for p in out.iterdir()} == before
    prepare_folder(tmp_path / "other", inputs=[out / "dem.tif"])


def test_somebody_elses_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("precious")
    with pytest.raises(OutputError, match="--force"):
        prepare_folder(tmp_path)
    prepare_folder(tmp_path, overwrite=True)
    write_run(some_run(), tmp_path, overwrite=True)
    assert (tmp_path / "thesis.tex").read_text() == "precious"


def test_a_run_json_of_somebody_else_is_no_licence(tmp_path: Path) -> None:
    (tmp_path / "run.json").write_text('{"score": 3}')
    (tmp_path / "model.pt").write_text("precious")
    with pytest.raises(OutputError, match="not a run's"):
        prepare_folder(tmp_path)


def test_an_interrupted_run_can_be_repeated(tmp_path: Path) -> None:
    (tmp_path / "dem.tif").write_text("old")
    (tmp_path / ".flags.tif.tmp").write_text("ha")
    prepare_folder(tmp_path)


def test_files_that_appear_during_the_run_cost_nothing(tmp_path: Path) -> None:
    prepare_folder(tmp_path)
    (tmp_path / "note.txt").write_text("precious")
    write_run(some_run(), tmp_path)
    assert {p.name for p in tmp_path.iterdir()} == {*FILES, "run.json", "note.txt"}


def test_files_of_systems_make_no_folder_somebody_elses(tmp_path: Path) -> None:
    for name in (".DS_Store", "Thumbs.db", "desktop.ini", ".nfs000000000001", "dem.tif.aux.xml"):
        (tmp_path / name).write_text("")
    prepare_folder(tmp_path)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / ".DS_Store").mkdir()
    with pytest.raises(OutputError, match="not a run's"):
        prepare_folder(tmp_path / "other")


def test_recordings_that_were_kept_make_no_folder_somebody_elses(tmp_path: Path) -> None:
    for name in (".alight.lock", "recording.mcap", "recording-1.mcap"):
        (tmp_path / name).write_text("")
    prepare_folder(tmp_path)


def test_a_folder_in_the_place_of_a_file_is_refused_at_the_start(tmp_path: Path) -> None:
    write_run(some_run(), tmp_path)
    (tmp_path / "heights.tif").mkdir()
    for overwrite in (False, True):
        with pytest.raises(OutputError, match=r"heights\.tif: is a folder, .* remove it"):
            prepare_folder(tmp_path, overwrite)


def test_files_that_are_obstructed_cost_no_other(tmp_path: Path) -> None:
    """Folders took the places of a file that is written, of one that is not, and of one of another command."""
    prepare_folder(tmp_path)
    names = {"dem.tif", "route.plan", "hazards.tif"}
    for name in names:
        (tmp_path / name).mkdir()
    with pytest.raises(OutputError) as e:
        write_run(some_run(route=None), tmp_path)
    assert all(name in str(e.value) for name in names)
    written = {p.name for p in tmp_path.iterdir() if p.is_file()}
    assert written == {*FILES, "run.json"} - {*names, "route.geojson"}
    missing = loaded(tmp_path / "run.json")["not_written"]
    assert set(missing) == {"dem.tif", "route.plan", "route.geojson"}
    assert "cannot be written" in missing["dem.tif"]


def test_a_file_is_no_folder(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("")
    with pytest.raises(OutputError, match="is a file"):
        prepare_folder(tmp_path / "out")
    with pytest.raises(OutputError, match="cannot be written"):
        prepare_folder(tmp_path / "out" / "deeper")


@contextmanager
def small_disk(size: int) -> Iterator[None]:
    """Limit the size of files in this process, in place of a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_disk_full_names_what_is_missing_and_keeps_the_rest_whole(tmp_path: Path, out: Path) -> None:
    write_run(some_run(), tmp_path)  # an older result, of which nothing may stay
    large = {p.name for p in out.iterdir() if p.stat().st_size > 20_000}
    assert {"dem.tif", "ortho.tif", "report.html"} <= large
    with small_disk(20_000), pytest.raises(OutputError, match="the disk is full; free some space") as e:
        write_run(some_run(), tmp_path)
    assert all(name in str(e.value) for name in large)
    assert "\n" not in str(e.value)
    assert {p.name for p in tmp_path.iterdir()} == {*FILES, "run.json"} - large
    for path in set(tmp_path.iterdir()) - {tmp_path / "run.json"}:
        assert path.read_bytes() == (out / path.name).read_bytes()
    missing = loaded(tmp_path / "run.json")["not_written"]
    assert set(missing) == large
    assert "the disk is full" in missing["dem.tif"]


def test_disk_full_to_the_last_byte_leaves_no_half(tmp_path: Path) -> None:
    with small_disk(0), pytest.raises(OutputError, match="0 other files are whole"):
        write_run(some_run(), tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_one_file_that_cannot_be_made_takes_no_other_with_it(tmp_path: Path) -> None:
    with mock.patch("alight.report.render", side_effect=RuntimeError("bug")), pytest.raises(RuntimeError, match="bug"):
        write_run(some_run(), tmp_path)
    assert {p.name for p in tmp_path.iterdir()} == {*FILES, "run.json"} - {"report.html"}
    assert "defect" in loaded(tmp_path / "run.json")["not_written"]["report.html"]


def test_ctrl_c_leaves_the_old_file_whole(tmp_path: Path) -> None:
    path = tmp_path / "dem.tif"
    whole.write_whole(path, b"old")
    with mock.patch("os.fsync", side_effect=KeyboardInterrupt), pytest.raises(KeyboardInterrupt):
        whole.write_whole(path, b"new")
    assert path.read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["dem.tif"]


def test_ctrl_c_between_files_leaves_no_run_json(tmp_path: Path) -> None:
    write_run(some_run(), tmp_path)
    with (
        mock.patch("alight.outputs.plan.route_plan", side_effect=KeyboardInterrupt),
        pytest.raises(KeyboardInterrupt),
    ):
        write_run(some_run(), tmp_path)
    assert not (tmp_path / "run.json").exists()
    with pytest.raises(InputError):
        read_run(tmp_path)
    prepare_folder(tmp_path)


def test_the_same_run_gives_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_run(some_run(), tmp_path / name)
    for path in (tmp_path / "a").iterdir():
        assert path.read_bytes() == (tmp_path / "b" / path.name).read_bytes(), path.name


def test_the_settings_of_an_earlier_version_are_read(out: Path, tmp_path: Path) -> None:
    """`alight evaluate` reads runs that were made before keys were removed."""
    folder = tmp_path / "earlier"
    shutil.copytree(out, folder)
    info = loaded(folder / "run.json")
    info["settings"]["tuning"]["tracks"] |= {"count": 99, "wings": 2}
    info["settings"]["lander"] |= {"radius": 2.0, "wings": 2}
    (folder / "run.json").write_text(json.dumps(info))
    found = read_run(folder).settings
    assert found.lander.radius == 2.0
    assert found.tuning.tracks.count == 99
