"""A raster that is judged in windows has the hazards, the places and the reasons of the raster judged as a whole."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import rasterio
from numpy.testing import assert_allclose, assert_array_equal
from written_raster import write

from alight.cli import call
from alight.cluster import open_jobs
from alight.jobs import InTurn, Jobs
from alight.outputs.folder import new_work, prepare_folder
from alight.raster import clearance_of
from alight.records import Hazard, InputError, RunResult
from alight.runner.judge import for_surveyed_heights, judge_ground
from alight.runner.large import LargeJudgement, is_large, read_large
from alight.settings import load_settings
from alight.sources.raster import read_ground

SIDE = 128  # cells of a window


def rough_ground(rows: int = 600, cols: int = 600, seed: int = 0) -> np.ndarray:
    """Return rolling ground with rocks, and holes without heights: -9999."""
    rng = np.random.default_rng(seed)
    y, x = 0.1 * np.arange(rows)[:, None], 0.1 * np.arange(cols)
    z = 250 + 2 * np.sin(x / 11) * np.cos(y / 9) + rng.normal(0, 0.005, (rows, cols))
    for r, c, side in rng.integers(0, (rows, cols, 6), (rows * cols // 4000, 3)):
        z[r : r + side, c : c + side] += rng.uniform(0.05, 1.0)
    for r, c in rng.integers(0, (rows, cols), (4, 2)):
        z[r : r + 25, c : c + 15] = -9999
    return z.astype(np.float32)


def both(
    dem: Path, folder: Path, *assignments: str, zones: Path | None = None, jobs: Jobs | None = None
) -> tuple[RunResult, RunResult]:
    """Judge a raster as a whole and in windows, and write the results to `whole` and `parts`."""
    settings = for_surveyed_heights(load_settings("", assignments))
    whole = judge_ground(read_ground(dem, "0.01", None, 0.05), settings, dem.name, zones)
    whole.save(folder / "whole")
    out = folder / "parts"
    prepare_folder(out)
    ground = read_large(dem, "0.01", settings)
    large = LargeJudgement(ground, settings, new_work(out), zones, SIDE)
    parts = large.judge(dem.name, jobs or InTurn(), lambda *_: None)
    parts.save(out)
    return whole.record, parts.record


def assert_alike(folder: Path, farthest: float = np.inf) -> None:
    """Assert that the rasters agree up to the rounding of float32 heights, which are taken above the median of a part.

    DOUBT may differ where P(safe) is at its limit; clearance is the distance to the cells that are refused.
    """
    info, other = (json.loads((folder / name / "run.json").read_text()) for name in ("whole", "parts"))
    least = info["settings"]["hazards"]["p_safe"]
    for key in ("crs", "plane", "warnings", "settings"):
        assert info[key] == other[key]
    assert_allclose(info["share_safe"], other["share_safe"], atol=1e-5)
    assert sorted(p.name for p in (folder / "whole").iterdir()) == sorted(p.name for p in (folder / "parts").iterdir())
    read: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    for name in ("reasons", "safe", "hazards"):
        with rasterio.open(folder / "whole" / f"{name}.tif") as a, rasterio.open(folder / "parts" / f"{name}.tif") as b:
            assert (a.transform, a.crs, a.descriptions, a.units) == (b.transform, b.crs, b.descriptions, b.units)
            assert a.tags(1) == b.tags(1)
            assert a.overviews(1) == b.overviews(1)
            read |= {title: (a.read(n), b.read(n)) for n, title in enumerate(a.descriptions, 1)}
    whole, parts = read.pop("reasons")
    certain = np.abs(read["p_safe"][0] - least) > 2e-5
    assert_array_equal(whole[certain], parts[certain])
    assert_array_equal(whole | Hazard.DOUBT, parts | Hazard.DOUBT)
    clearance = read.pop("clearance")[1]
    assert_array_equal(clearance, np.minimum(clearance_of(parts == 0, 0.1), np.float32(farthest)))
    for title, (a, b) in read.items():
        assert_allclose(b, a, atol=2e-4, rtol=1e-6, err_msg=title)


def places(result: RunResult) -> list[tuple[object, ...]]:
    """Return what must be equal in all listed places, up to rounding."""
    return [
        (s.kind, s.rank, round(s.east, 6), round(s.north, 6), round(s.p_safe, 4), round(s.clearance, 3), s.avoid,
         s.zone and s.zone.label, s.preferred, s.doubt)
        for s in result.sites.listed
    ]  # fmt: skip


@pytest.mark.parametrize(
    "assignments",
    [
        (),
        ("lander.radius=0.6", "sites.count=30"),
        ("lander.feet=[[0.6,0.5],[0.6,-0.5],[-0.6,0.5],[-0.6,-0.5]]", "lander.rotor_radius=2.0"),
        ("hazards.p_safe=0.9999999", "tuning.hazards.tilt_sigma=0.05"),  # candidates only
        ("lander.max_slope=0.05deg",),  # no place at all
    ],
    ids=["disc", "many sites", "feet and rotors", "candidates", "refused"],
)
def test_a_raster_in_windows_has_the_answer_of_the_whole(tmp_path: Path, assignments: tuple[str, ...]) -> None:
    dem = write(tmp_path / "dem.tif", rough_ground(), nodata=-9999.0)
    whole, parts = both(dem, tmp_path, *assignments)
    assert_alike(tmp_path)
    assert places(parts) == places(whole)
    assert parts.sites.reason == whole.sites.reason


def test_zones_count_in_windows_as_in_the_whole(tmp_path: Path) -> None:
    dem = write(tmp_path / "dem.tif", rough_ground(seed=1), nodata=-9999.0)
    rings = {"keep-out": (0.0, 0.2), "avoid": (0.2, 0.6), "prefer": (0.5, 0.9)}  # shares of the extent
    with rasterio.open(dem) as raster:
        left, bottom, right, top = rasterio.warp.transform_bounds(raster.crs, "EPSG:4326", *raster.bounds)
    features = []
    for use, (a, b) in rings.items():
        w, e, s, n = left + a * (right - left), left + b * (right - left), bottom, top
        ring = [[w, s], [e, s], [e, n], [w, n], [w, s]]
        geometry = {"type": "Polygon", "coordinates": [ring]}
        features.append({"type": "Feature", "properties": {"alight": use, "name": f"the {use}"}, "geometry": geometry})
    zones = tmp_path / "zones.geojson"
    zones.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    whole, parts = both(dem, tmp_path, "lander.radius=0.6", zones=zones)
    assert_alike(tmp_path)
    assert places(parts) == places(whole)
    assert any(s.preferred for s in parts.sites.listed)


@pytest.mark.filterwarnings("ignore")  # the cluster's own
def test_a_cluster_judges_the_same(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed", reason="needs the extra 'cluster'")
    dem = write(tmp_path / "dem.tif", rough_ground(300, 300), nodata=-9999.0)
    with (
        distributed.LocalCluster(1, threads_per_worker=1, dashboard_address=None) as cluster,
        open_jobs(cluster.scheduler_address) as jobs,
    ):
        whole, parts = both(dem, tmp_path, jobs=jobs)
    assert_alike(tmp_path)
    assert places(parts) == places(whole)


def test_open_ground_has_its_clearance_up_to_a_bound(tmp_path: Path) -> None:
    dem = write(tmp_path / "dem.tif", rough_ground(400, 400) * 0 + 250 + np.linspace(0, 1, 400, dtype=np.float32))
    both(dem, tmp_path)
    assert_alike(tmp_path, farthest=12.75)  # of 128 cells of 0.1 m


def test_a_strange_value_is_found_in_any_window(tmp_path: Path) -> None:
    z = rough_ground(300, 300)
    z[z < 0] = 250.0
    z[77, 131] = -9999.0
    dem = write(tmp_path / "dem.tif", z)
    with pytest.raises(InputError, match="-9999 stands in 1 of"):
        read_large(dem, "0.01", load_settings("", ()))


def test_only_large_rasters_are_judged_in_windows(tmp_path: Path) -> None:
    for rows, large in ((2048, False), (2049, True)):
        dem = write(tmp_path / f"{rows}.tif", np.zeros((rows, 2048), np.uint8))
        assert is_large(dem) == large


def test_the_command_judges_a_large_raster(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, flat = tmp_path / "out", np.linspace(100, 103, 70_000, dtype=np.float32)[None].repeat(60, axis=0)
    flat[::2, 200:] += 2.0  # only the western end is even
    dem = write(tmp_path / "dem.tif", flat)
    assert call(["hazards", str(dem), "--sigma", "0.01", "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert said.startswith("SITE  east 55000")
    assert "RASTER  70000 x 60 cells, judged in windows" in said
    assert "judged in windows" in (out / "report.html").read_text()
    with rasterio.open(out / "safe.tif") as safe:
        assert safe.shape == flat.shape
        assert safe.read(1)[30, 100] > 0.99
