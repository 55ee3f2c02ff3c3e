"""Evaluation: made-up runs with known errors over a known truth."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from damage import HEIGHT, LATITUDE, LONGITUDE, STEP, T0, write_flight, write_rows
from numpy.typing import NDArray
from some_run import some_run

from alight.evaluation import evaluate, flight, photos
from alight.evaluation.report import Evaluation, rms
from alight.geometry import Grid, LocalFrame, Pose, so3_exp
from alight.outputs import write_run
from alight.records import Datum, ElevationMap, Flag, Hazard, HazardMap, InputError, Motion, RunResult, Sites, Terrain
from alight.spread import nmad

CELL = 0.1
GRID = Grid(-20.0, 20.0, CELL, 401, 401)
LOCAL = LocalFrame(LATITUDE, LONGITUDE, HEIGHT)
OFFSET = np.array([0.8, -0.6, 0.5])  # of the run against the truth; whole cells, so that nothing is interpolated
NOISE = 0.03
BOX = (-2.0, 4.0, 3.0, 8.0)  # west, east, south, north of a box that stands on the slope
POND = (-20.0, -12.0, -20.0, -12.0)


def inside(box: tuple[float, float, float, float], e: NDArray[np.float64], n: NDArray[np.float64]) -> NDArray[np.bool_]:
    return (e >= box[0]) & (e <= box[1]) & (n >= box[2]) & (n <= box[3])


def world(e: NDArray[np.float64], n: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Height and class of a slope with a box on it and a pond."""
    height = 0.05 * e + 2.0 * inside(BOX, e, n)
    label = np.where(inside(BOX, e, n), Terrain.STRUCTURE, Terrain.SHORT_GRASS)
    return height, np.where(inside(POND, e, n), Terrain.WATER, label).astype(np.uint8)


def write_raster(path: Path, values: NDArray[np.generic], grid: Grid = GRID) -> None:
    path.parent.mkdir(exist_ok=True)
    path.unlink(missing_ok=True)
    profile = {"driver": "GTiff", "height": grid.rows, "width": grid.cols, "count": 1, "dtype": values.dtype.name}
    with rasterio.open(path, "w", crs=LOCAL.crs, transform=rasterio.Affine(*grid.transform), **profile) as d:
        d.write(values, 1)


@pytest.fixture(scope="module")
def truth(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A flight log with the world as its truth, and a path over it."""
    folder = write_flight(tmp_path_factory.mktemp("truth") / "flight")
    rows = [[T0 + k * STEP, k, 0, 30, 1, 0, 0, 0, *[0] * 9] for k in range(6)]
    write_rows(folder / "mav0" / "state_groundtruth_estimate0" / "data.csv", rows)
    height, label = world(*np.meshgrid(*GRID.xy()))
    write_raster(folder / "truth" / "dem.tif", (HEIGHT + height).astype(np.float32))
    write_raster(folder / "truth" / "class.tif", label)
    return folder


def a_run() -> RunResult:
    """A run that is off by OFFSET, with noise, a refused corner and a patch that is wrong by 2 m."""
    grid = GRID.window(50, 50, 300, 300)
    e, n = np.meshgrid(*grid.xy())
    height, label = world(e - OFFSET[0], n - OFFSET[1])
    rng = np.random.default_rng(1)
    height = (height + OFFSET[2] + rng.normal(0, NOISE, height.shape)).astype(np.float32)
    height[:60, :50] += 2.0
    flags = np.zeros(grid.shape, np.uint16)
    flags[:150, 150:] = np.uint16(Flag.TEXTURE)
    full = np.full(grid.shape, NOISE, np.float32)
    views, rgb = np.full(grid.shape, 9, np.uint8), np.zeros((*grid.shape, 3), np.uint8)
    elevation = ElevationMap(grid, height, full, flags, views, rgb, full, full)
    p_safe = np.where(label == Terrain.STRUCTURE, 0.0, 1.0).astype(np.float32)
    reasons = np.where(label == Terrain.WATER, np.uint16(Hazard.TERRAIN), np.uint16(0))
    reasons[:, :150] |= np.uint16(Hazard.DOUBT)
    hazards = HazardMap(grid, *[full] * 4, p_safe, *[full] * 6, reasons)
    turn = so3_exp([0.002, 0.0, 0.0])
    poses = [Pose(turn, np.array([k, 0.0, 30.0]) + OFFSET) for k in range(6)]
    motions = [Motion(T0 + k * STEP, p, (p,), np.eye(6) * 1e-4) for k, p in enumerate(poses)]
    first = some_run().sites.sites[0]
    # truly 1.85 m west of the box: safe; at its place in the run, the footprint touches the box
    beside = replace(first, east=BOX[0] - 1.85 + OFFSET[0], north=5.0 + OFFSET[1])
    pond = replace(first, rank=2, east=POND[1] + OFFSET[0] - 0.5, north=POND[3] + OFFSET[1] - 0.5)
    listed = Sites((beside, pond), candidates=(replace(pond, rank=3, doubt="ground"),))
    return some_run(
        local=LOCAL, sites=listed, elevation=elevation, terrain=None, hazards=hazards, route=None,
        motions=motions, height_above_ground=30.0,
    )  # fmt: skip


@pytest.fixture(scope="module")
def found(truth: Path, tmp_path_factory: pytest.TempPathFactory) -> Evaluation:
    out = tmp_path_factory.mktemp("run") / "out"
    write_run(a_run(), out)
    return evaluate(out, truth)


def number(found: Evaluation, name: str) -> float:
    value = found.values[name]
    assert isinstance(value, float)
    return value


def test_nmad_and_rms() -> None:
    e = np.random.default_rng(0).normal(3.0, 0.5, 20_000)
    assert nmad(e) == pytest.approx(0.5, rel=0.03)
    e[:1000] = 1e6  # tails change it little
    assert nmad(e) == pytest.approx(0.5, rel=0.1)
    assert nmad([1.0, 2.0, 3.0]) == pytest.approx(1.4826)
    assert np.isnan(nmad([]))
    assert rms([3.0, -4.0]) == pytest.approx(np.sqrt(12.5))


def test_heights_as_they_are(found: Evaluation) -> None:
    """A shift of 0.8 m on a slope of 0.05 makes 4 cm of the offset."""
    assert number(found, "ground offset (median), m") == pytest.approx(OFFSET[2] - 0.05 * OFFSET[0], abs=0.003)
    assert number(found, "ground NMAD, m") == pytest.approx(NOISE, rel=0.1)
    assert number(found, "ground P95 of |error|, m") > 0.5


def test_heights_registered(found: Evaluation) -> None:
    assert number(found, "ground offset (median), m, registered") == pytest.approx(0.0, abs=0.002)
    assert number(found, "ground NMAD, m, registered") == pytest.approx(NOISE, rel=0.07)
    share = number(found, "ground NMAD, % of height, registered")
    assert share == pytest.approx(number(found, "ground NMAD, m, registered") / 0.3)


def test_acceptance_wrong_cells_and_coverage(found: Evaluation) -> None:
    grid = GRID.window(50, 50, 300, 300)
    e, n = np.meshgrid(*grid.xy())
    label = world(e - OFFSET[0], n - OFFSET[1])[1]
    ground, given = label == Terrain.SHORT_GRASS, np.ones(grid.shape, bool)
    given[:150, 150:] = False
    accepted = 100 * (given & ground).sum() / ground.sum()
    assert number(found, "ground accepted of seen, %, registered") == pytest.approx(
        accepted, abs=0.2
    )  # a rim of one cell
    wrong = 100 * 60 * 50 / given.sum()
    name = "given out and off by more than 0.5 m, % of given out"
    assert number(found, f"{name}, registered") == pytest.approx(wrong, abs=0.05)
    right = 1 - 60 * 50 / (given & ground).sum()
    assert number(found, "ground within 1 sigma, %, registered") == pytest.approx(68.3 * right, abs=1.0)
    assert number(found, "ground within 1.96 sigma, %, registered") == pytest.approx(95 * right, abs=1.0)
    assert number(found, name) > number(found, f"{name}, registered")  # the box's edges are elsewhere


def test_coverage_with_the_common_tilt(truth: Path, tmp_path: Path) -> None:
    """A map leans by 4 mrad and claims 4 mrad: its sigma alone covers too few errors, with the tilt enough."""
    result = a_run()
    assert result.elevation is not None
    e, _ = np.meshgrid(*result.elevation.grid.xy())
    lean = (4e-3 * e).astype(np.float32)
    datum = Datum(0.0, 0.0, np.diag([1.0, 4e-3, 4e-3]) ** 2)
    sigma = np.full(lean.shape, 0.5 * NOISE, np.float32)
    leaning = replace(result.elevation, height=result.elevation.height + lean, sigma=sigma, datum=datum)
    write_run(replace(result, elevation=leaning), tmp_path)
    found = evaluate(tmp_path, truth)
    alone = number(found, "ground within 1.96 sigma, %, registered")
    both = number(found, "ground within 1.96 sigma and common tilt, %, registered")
    assert alone < 65 < 75 < both


def test_a_map_is_registered_by_its_own_heights(truth: Path, tmp_path: Path) -> None:
    """The path has another offset than the map; over one slope, heights show only the sum of its three components."""
    result = a_run()
    path = tuple(replace(m, world_from_body=Pose(np.eye(3), [k, 0.0, 31.0])) for k, m in enumerate(result.motions))
    write_run(replace(result, motions=path), tmp_path)
    found = evaluate(tmp_path, truth)
    assert number(found, "ground offset (median), m, registered") == pytest.approx(-0.54, abs=0.01)
    assert number(found, "ground offset (median), m, registered by its heights") == pytest.approx(0.0, abs=0.005)
    assert number(found, "ground NMAD, m, registered by its heights") == pytest.approx(NOISE, rel=0.1)


def test_the_decision_as_it_is_and_registered(found: Evaluation) -> None:
    assert found.values["best site truly safe"] == "NO"
    assert found.values["best site truly safe, registered"] == "yes"
    assert found.values["sites truly safe"] == "0 of 2"
    assert found.values["sites truly safe, registered"] == "1 of 2"
    assert found.values["sites centred on water, plants or structures, registered"] == 1.0
    assert number(found, "declared safe and not within 0.3 m of truly safe, %, registered") > 0  # the box's skirt
    assert number(found, "truly safe cells found, %, registered") == 100.0


def test_candidates_and_what_is_not_refused(found: Evaluation, truth: Path, tmp_path: Path) -> None:
    """The doubt about the western half counts as not refused; a refusal of it counts as refused."""
    assert found.values["candidates truly safe, registered"] == "0 of 1"
    assert "first candidate truly safe, registered" not in found.values  # there is a site
    name = "seen and truly safe with 1 m of clearance, and not refused, %, registered"
    assert number(found, name) == 100.0
    result = a_run()
    assert result.hazards is not None
    refused = np.where(result.hazards.reasons & Hazard.DOUBT, np.uint16(Hazard.SLOPE), result.hazards.reasons)
    doubtful = replace(result.hazards, reasons=refused.astype(np.uint16))
    alone = Sites((), "none", candidates=result.sites.candidates)
    write_run(replace(result, hazards=doubtful, sites=alone), tmp_path)
    other = evaluate(tmp_path, truth)
    assert other.values["first candidate truly safe, registered"] == "NO"
    assert 20.0 < number(other, name) < 80.0


def test_the_path(found: Evaluation) -> None:
    assert number(found, "position RMSE, m") == pytest.approx(np.linalg.norm(OFFSET), abs=1e-5)
    assert found.values["position mean error (east, north, up), m"] == "0.800 -0.600 0.500"
    assert number(found, "position RMSE less a constant, m") == pytest.approx(0.0, abs=1e-5)
    assert number(found, "attitude RMSE, deg") == pytest.approx(np.degrees(0.002), rel=1e-3)
    assert found.values["mean tilt (about east, north), mrad"] == "2.00 0.00"


def test_without_a_path_nothing_is_registered(truth: Path, tmp_path: Path) -> None:
    write_run(replace(a_run(), motions=()), tmp_path)
    assert not [k for k in evaluate(tmp_path, truth).values if "registered" in k or "position" in k]


def test_a_run_without_a_map_is_evaluated_all_the_same(truth: Path, tmp_path: Path) -> None:
    nothing = replace(a_run(), elevation=None, hazards=None, sites=Sites((), "nothing looked down"))
    write_run(nothing, tmp_path)
    found = evaluate(tmp_path, truth)
    assert found.values["heights"] == "the run has no dem.tif"
    assert found.values["sites truly safe"] == "0 of 0"


def test_another_flight_is_refused(truth: Path, tmp_path: Path) -> None:
    write_run(replace(a_run(), local=LocalFrame(48.2, 15.4, 300.0)), tmp_path)
    with pytest.raises(InputError, match="another origin"):
        evaluate(tmp_path, truth)


def test_damaged_truth_is_refused(truth: Path, tmp_path: Path) -> None:
    write_run(a_run(), tmp_path / "out")
    flight_ = write_flight(tmp_path / "flight")
    (flight_ / "truth").mkdir()
    with pytest.raises(InputError, match=r"dem\.tif: missing"):
        evaluate(tmp_path / "out", flight_)
    for name in ("dem", "class"):
        (flight_ / "truth" / f"{name}.tif").write_bytes((truth / "truth" / f"{name}.tif").read_bytes()[:90])
    with pytest.raises(InputError, match="not a raster that can be read"):
        evaluate(tmp_path / "out", flight_)
    write_raster(flight_ / "truth" / "dem.tif", np.zeros(GRID.shape, np.float32))
    write_raster(flight_ / "truth" / "class.tif", np.ones((9, 9), np.uint8), Grid(0.0, 0.0, 1.0, 9, 9))
    with pytest.raises(InputError, match="not on one grid"):
        evaluate(tmp_path / "out", flight_)


@pytest.mark.parametrize("case", ["feet", "elsewhere"])
def test_a_truth_is_read_in_metres_of_the_world(truth: Path, tmp_path: Path, case: str) -> None:
    other = Path(shutil.copytree(truth, tmp_path / "truth"))
    with rasterio.open(other / "truth" / "dem.tif", "r+") as d:
        metres = d.read(1)
        if case == "feet":
            d.write(metres / np.float32(0.3048), 1)
            d.units = ("ft",)
        else:
            d.crs = "EPSG:32633"
    if case == "feet":
        np.testing.assert_allclose(flight.read_flight_truth(other, LOCAL).dem, metres, atol=1e-3)
        return
    with pytest.raises(InputError, match=r"not in the flight's own coordinates.*gdalwarp"):
        flight.read_flight_truth(other, LOCAL)


def test_dilation() -> None:
    mask = np.zeros((9, 9), bool)
    mask[4, 4] = True
    assert flight.dilated(mask, 2.0).sum() == 13
    assert flight.dilated(np.zeros((3, 3), bool), 2.0).sum() == 0


# -- photos


def test_interpolation_is_exact_on_a_plane_and_nearest_beside_holes() -> None:
    grid = Grid(0.0, 0.0, 0.5, 20, 20)
    e, n = np.meshgrid(*grid.xy())
    height = (1.0 + 0.2 * e - 0.1 * n).astype(np.float32)
    at_e, at_n = np.array([1.1, 3.33]), np.array([-2.2, -4.07])
    got = photos.interpolated(height, grid, at_e, at_n)
    np.testing.assert_allclose(got, 1.0 + 0.2 * at_e - 0.1 * at_n, atol=0.002)  # OpenCV's grain
    height[4, 3] = np.nan
    got = photos.interpolated(height, grid, np.array([1.2, 1.6, 99.0]), np.array([-2.0, -2.05, 0.0]))
    assert got[0] == height[4, 2]
    assert np.isnan(got[1:]).all()


def test_the_plane_is_found_under_outliers() -> None:
    rng = np.random.default_rng(2)
    points = rng.uniform(-30, 30, (4000, 3))
    errors = 0.002 * points[:, 0] - 0.001 * points[:, 1] + 0.3 + rng.normal(0, 0.03, 4000)
    errors[:200] += 2.0
    plane, left = photos.plane_of(points, errors)
    np.testing.assert_allclose(plane[:2], [0.002, -0.001], atol=1e-4)
    assert plane[2] == pytest.approx(0.3, abs=2e-3)
    assert nmad(left) == pytest.approx(0.03, rel=0.15)
    np.testing.assert_allclose(photos.plane_of(points, np.zeros(4000))[1], 0.0, atol=1e-9)


def test_the_slab_is_filled_and_keeps_off_its_rim() -> None:
    grid = Grid(0.0, 20.0, 0.1, 200, 200)
    e, n = np.meshgrid(np.arange(5.0, 15.0, 0.4), np.arange(5.0, 15.0, 0.4))
    points = np.c_[e.ravel(), n.ravel(), np.zeros(e.size)]
    mask = photos.slab_of(points, np.ones(len(points), bool), grid)
    assert mask[grid.rows // 2, grid.cols // 2]
    assert 70 < mask.sum() * grid.cell**2 < 97  # 9.6 m squared less the rim
    assert not mask[:45].any()


def test_the_high_pass_takes_out_what_is_wider_than_a_metre() -> None:
    e, n = np.meshgrid(np.arange(200) * 0.05, np.arange(200) * 0.05)
    height = 0.1 * e - 0.05 * n
    height[50:60, 50:60] = np.nan
    ripple = 0.01 * np.sin(2 * np.pi * e / 0.3)
    flat, rippled = photos.high_pass(height, 0.05), photos.high_pass(height + ripple, 0.05)
    inner = np.zeros(e.shape, bool)
    inner[85:-15, 85:-15] = True
    assert np.abs(flat[inner]).max() < 1e-9
    assert rms((rippled - ripple)[inner]) < 0.1 * rms(ripple[inner])


def test_photos_against_their_reference(tmp_path: Path) -> None:
    """Heights are off by a plane and noise, cameras by 5 cm; the reference has another origin."""
    rng = np.random.default_rng(4)
    run = a_run()
    assert run.elevation is not None
    grid = run.elevation.grid
    e = np.meshgrid(*grid.xy())[0]
    height = (0.05 * e + 0.002 * e + 0.2 + rng.normal(0, 0.02, e.shape)).astype(np.float32)
    height[:30] += 0.6  # 10 %: wrong and given out
    elevation = replace(run.elevation, height=height, flags=np.zeros(grid.shape, np.uint16))
    centres = np.array([[k, 0.0, 30.0] for k in range(6)])
    poses = [Pose(np.eye(3), c + np.array([0.0, 0.05, 0.0])) for c in centres]
    motions = [Motion(T0 + k, p, (p,), np.eye(6)) for k, p in enumerate(poses)]
    write_run(replace(run, elevation=elevation, motions=motions), tmp_path / "out")
    xy = rng.uniform([grid.east + 1, grid.north - 28.9], [grid.east + 28.9, grid.north - 1], (5000, 2))
    points = np.c_[xy, 0.05 * xy[:, 0]]
    other = LocalFrame(LATITUDE + 1e-4, LONGITUDE - 1e-4, HEIGHT + 5)

    def moved(p: NDArray[np.float64]) -> NDArray[np.float64]:
        return other.to_enu(*LOCAL.to_geodetic(p))

    reference = tmp_path / "reference"
    reference.mkdir()
    np.savez(
        reference / "sfm_reference.npz", origin_llh=[other.latitude, other.longitude, other.height],
        points_enu=moved(points), points_track=np.full(5000, 4), points_err=np.full(5000, 0.5),
        centers_enu=moved(centres),
    )  # fmt: skip
    np.savez(reference / "slab_plane.npz", points=moved(points), inlier=np.ones(5000, bool))
    found = evaluate(tmp_path / "out", reference)
    assert number(found, "bias (median), m") == pytest.approx(0.2, abs=0.01)
    assert number(found, "tilt, mrad") == pytest.approx(2.0, abs=0.2)
    assert number(found, "NMAD less a plane, m") == pytest.approx(0.015, rel=0.35)  # interpolation averages the noise
    assert number(found, "off by more than 1 % of height and given out, % of all points") == pytest.approx(
        100 * np.mean(xy[:, 1] > grid.north - 2.95), abs=0.3
    )
    assert number(found, "accepted on the slab, %") == 100.0
    assert number(found, "slab flatness (NMAD after 1 m high-pass), m") == pytest.approx(0.02, rel=0.1)
    assert number(found, "camera centres RMS, m") == pytest.approx(0.05, abs=1e-3)
    assert found.values["camera centres compared"] == "6 of 6"


def test_photos_of_an_unknown_height_are_compared_all_the_same(tmp_path: Path) -> None:
    run = a_run()
    assert run.elevation is not None
    grid, rng = run.elevation.grid, np.random.default_rng(4)
    write_run(replace(run, height_above_ground=None), tmp_path / "out")
    xy = rng.uniform([grid.east + 1, grid.north - 28.9], [grid.east + 28.9, grid.north - 1], (500, 2))
    np.savez(
        tmp_path / "sfm_reference.npz", origin_llh=[LATITUDE, LONGITUDE, HEIGHT], points_enu=np.c_[xy, 0.05 * xy[:, 0]],
        points_track=np.full(500, 4), points_err=np.full(500, 0.5), centers_enu=rng.uniform(0, 30, (50, 3)),
    )  # fmt: skip
    found = evaluate(tmp_path / "out", tmp_path)
    assert np.isnan(number(found, "height above ground, m"))
    assert np.isnan(number(found, "off by more than 1 % of height and given out, % of all points"))
    assert number(found, "NMAD less a plane, m") >= 0.0


def test_a_reference_that_is_none_or_of_another_place(tmp_path: Path) -> None:
    write_run(a_run(), tmp_path / "out")
    path = tmp_path / "sfm_reference.npz"
    path.write_bytes(b"PK")
    with pytest.raises(InputError, match=r"sfm_reference\.npz: not a reference"):
        evaluate(tmp_path / "out", tmp_path)
    np.savez(path, origin_llh=[0.0, 0.0, 0.0])
    with pytest.raises(InputError, match="not a reference"):
        evaluate(tmp_path / "out", tmp_path)
    none = np.zeros((0, 3))
    np.savez(path, origin_llh=[0.0, 0.0, 0.0], points_enu=none, points_track=[], points_err=[], centers_enu=none)
    with pytest.raises(InputError, match="another place"):
        evaluate(tmp_path / "out", tmp_path)


def test_lines_are_named_numbers() -> None:
    found = Evaluation("title")
    found.put("short", 0.123456)
    found.put("a longer name", "yes")
    assert found.lines() == ["title", "  short          0.1235", "  a longer name  yes"]


def test_numbers_that_are_compared_in_several_ways_share_a_line_below_the_main_ones() -> None:
    found = Evaluation("title", {"ground NMAD, m": 0.5, "sites": 3.0, "ground NMAD, m, registered": 0.25})
    found.put("ground NMAD, m, registered by its heights", 0.125)
    assert found.lines() == [
        "title",
        "  ground NMAD, m  0.25",
        "",
        "                  as it is  registered  registered by its heights",
        "  ground NMAD, m  0.5       0.25        0.125",
        "  sites           3",
    ]


# -- damaged runs and truths


def damaged(run: Path, key: str, value: object) -> None:
    """Replace a value in run.json."""
    tree = json.loads((run / "run.json").read_text(encoding="utf-8"))
    *way, last = key.split(".")
    inner = tree
    for part in way:
        inner = inner[part]
    inner[last] = value
    (run / "run.json").write_text(json.dumps(tree), encoding="utf-8")


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("answer", None), ("answer.sites", [{"east_m": "x", "north_m": 0}]), ("answer.sites", [{}]),
        ("height_above_ground_m", "high"), ("common_error", {"centre_m": [0, 0], "covariance": [[1]]}),
        ("settings", 3), ("origin", {"latitude": "north"}),
    ],
)  # fmt: skip
def test_a_damaged_run_json_is_told_with_its_key(truth: Path, tmp_path: Path, key: str, value: object) -> None:
    write_run(a_run(), tmp_path / "run")
    damaged(tmp_path / "run", key, value)
    with pytest.raises(InputError, match=rf"{key.split('.')[0]}.* is damaged"):
        evaluate(tmp_path / "run", truth)


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("dem", lambda b: b[:1]), ("dem", lambda b: b[:, :1]), ("flags", lambda b: b.astype(np.float32)),
        ("safe", lambda b: b[:, ::2]), ("ortho", lambda b: b[:1]), ("reasons", lambda b: b.astype(np.float32)),
    ],
)  # fmt: skip
def test_a_raster_of_a_run_that_does_not_fit_is_told(
    truth: Path, tmp_path: Path, name: str, change: Callable[[NDArray[Any]], NDArray[Any]]
) -> None:
    """Found by the fuzzer: a `dem.tif` of one row ended in `boolean index did not match`."""
    write_run(a_run(), tmp_path / "run")
    path = tmp_path / "run" / f"{name}.tif"
    with rasterio.open(path) as d:
        bands, place = change(d.read()), d.transform
    path.unlink()
    size = {"count": len(bands), "height": bands.shape[1], "width": bands.shape[2], "dtype": bands.dtype.name}
    with rasterio.open(path, "w", driver="GTiff", transform=place, **size) as d:
        d.write(bands)
    with pytest.raises(InputError, match=rf"({name}|flags)\.tif: .*run again"):
        evaluate(tmp_path / "run", truth)


@pytest.mark.parametrize("case", ["another grid", "not square", "classes that are no numbers of classes"])
def test_a_truth_that_does_not_fit_is_told(truth: Path, tmp_path: Path, case: str) -> None:
    write_run(a_run(), tmp_path / "run")
    other = shutil.copytree(truth, tmp_path / "truth")
    height, label = world(*np.meshgrid(*GRID.xy()))
    if case == "another grid":
        write_raster(other / "truth" / "class.tif", label[:200], GRID.window(0, 0, 200, GRID.cols))
    elif case == "not square":
        with rasterio.open(other / "truth" / "dem.tif", "r+") as d:
            d.transform = rasterio.Affine(0.1, 0, -20, 0, -0.3, 20)
    else:
        write_raster(other / "truth" / "class.tif", height.astype(np.float32))
    with pytest.raises(InputError, match="truth"):
        evaluate(tmp_path / "run", other)


@pytest.mark.parametrize("name", sorted(photos.REFERENCE))
def test_a_reference_of_another_shape_is_told(tmp_path: Path, name: str) -> None:
    arrays = {"origin_llh": np.zeros(3), "points_enu": np.zeros((5, 3)), "points_track": np.zeros(5),
              "points_err": np.zeros(5), "centers_enu": np.zeros((2, 3))}  # fmt: skip
    path = tmp_path / "sfm_reference.npz"
    np.savez(path, **arrays)
    assert photos.read_arrays(path, photos.REFERENCE).keys() == arrays.keys()
    np.savez(path, **(arrays | {name: arrays[name].reshape(-1)[:-1][:, None]}))
    with pytest.raises(InputError, match="not a reference"):
        photos.read_arrays(path, photos.REFERENCE)
