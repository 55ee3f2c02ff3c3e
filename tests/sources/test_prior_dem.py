"""A prior DEM: put on the world's grid, it narrows the search where points are few, and the map is compared."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from drawn_photos import PLACE, SMALL, draw_photos, relief
from rasterio.transform import Affine
from refusal import Refused

from alight.cli import call
from alight.geometry import Grid
from alight.pipeline.mapping.batch_map import BatchMap
from alight.records import InputError, PriorHeights
from alight.settings import load_settings
from alight.sources.prior_dem import read_prior

GEOID = 47.0  # m above the ellipsoid, height of the geoid of the DEM


def write_dem(path: Path, crs: str | None = "EPSG:32632", offset: float = -GEOID, side: float = 160.0) -> Path:
    """Write the relief of the drawn photos, on cells of 1 m in UTM or of about 1 m in degrees, above a geoid."""
    import pyproj

    size = int(side)
    if crs is None or crs.startswith("+"):
        east, north = np.meshgrid(np.arange(size) - 0.5 * side + 0.5, 0.5 * side - 0.5 - np.arange(size))
        transform = Affine(1.0, 0.0, -0.5 * side, 0.0, -1.0, 0.5 * side)
    else:
        to_dem = pyproj.Transformer.from_crs(PLACE.crs, crs, always_xy=True)
        x0, y0 = to_dem.transform(0.0, 0.0)
        step = 1.0 if crs == "EPSG:32632" else 1e-5
        transform = Affine(step, 0.0, x0 - 0.5 * size * step, 0.0, -step, y0 + 0.5 * size * step)
        cols, rows = np.meshgrid(np.arange(size) + 0.5, np.arange(size) + 0.5)
        east, north = to_dem.transform(transform.c + step * cols, transform.f - step * rows, direction="INVERSE")
    height = (relief(np.asarray(east), np.asarray(north)) + PLACE.height + offset).astype(np.float32)
    profile = {"driver": "GTiff", "width": size, "height": size, "count": 1, "dtype": "float32", "nodata": -9999}
    with rasterio.open(path, "w", transform=transform, crs=crs, **profile) as out:
        out.write(height, 1)
    return path


@pytest.mark.parametrize("crs", ["EPSG:32632", "EPSG:4326"])
def test_a_dem_is_put_on_the_grid_of_the_world(tmp_path: Path, crs: str) -> None:
    """The DEM is in metres of UTM, whose north is not the world's, or in degrees."""
    prior = read_prior(write_dem(tmp_path / "dem.tif", crs, offset=0.0), PLACE)
    east, north = np.meshgrid(np.linspace(-50, 50, 21), np.linspace(-50, 50, 21))
    off = prior.at(east, north) - relief(east, north)
    assert np.isfinite(off).all()
    assert np.abs(off).max() < 0.2  # half a cell on slopes of 0.18
    assert abs(np.median(off)) < 0.01
    assert np.isnan(prior.at(np.array([500.0]), np.array([0.0]))).all()


def test_a_dem_that_cannot_be_used_is_refused_in_words(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no such file"):
        read_prior(tmp_path / "none.tif", PLACE)
    with pytest.raises(InputError, match="has no coordinate system"):
        read_prior(write_dem(tmp_path / "nowhere.tif", None), PLACE)
    there = "+proj=tmerc +lat_0=-33 +lon_0=-70 +k=1 +x_0=0 +y_0=0 +datum=WGS84 +units=m +no_defs"
    with pytest.raises(InputError, match="lies elsewhere"):
        read_prior(write_dem(tmp_path / "elsewhere.tif", there), PLACE)


def test_the_search_begins_with_the_prior_where_points_are_few() -> None:
    """The prior has a step of 20 m in the middle, and the points lie on its lower half only."""
    rng = np.random.default_rng(1)
    grid = Grid(-100.0, 100.0, 1.0, 200, 200)
    east = np.broadcast_to(grid.xy()[0], grid.shape)
    prior = PriorHeights("dem", grid, np.where(east < 0, 0.0, 20.0).astype(np.float32) - 50.0)
    xy = rng.uniform([-100, -100], [-20, 100], (2000, 2))
    points = np.column_stack([xy, rng.normal(0, 0.05, len(xy))])
    lane = BatchMap(load_settings("", []).stages(), prior=prior)
    without = BatchMap(load_settings("", []).stages())
    for m in (lane, without):
        m.points = points
    high = Grid(60.0, 10.0, 0.25, 64, 64)
    assert without.searched_heights(high, 100.0)[1] < 20.0  # the points hold no height there
    low, top = lane.searched_heights(high, 100.0)
    assert low < 20.0 < top
    assert low > 10.0
    flat = Grid(-60.0, 10.0, 0.25, 64, 64)
    assert lane.searched_heights(flat, 100.0)[0] == pytest.approx(without.searched_heights(flat, 100.0)[0], abs=0.5)
    fixed = BatchMap(load_settings("", ["parallax.height_range=[-1,1]"]).stages(), prior=prior)
    fixed.points = points
    assert fixed.searched_heights(high, 100.0) == (-1.0, 1.0)


def test_a_run_says_how_far_it_is_from_the_dem(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], refused: Refused
) -> None:
    pytest.importorskip("pycolmap")
    photos, out = draw_photos(tmp_path / "survey", lines=1, per_line=4), tmp_path / "out"
    dem = write_dem(tmp_path / "dem.tif")
    assert call(["run", str(photos), "--out", str(out), *SMALL, "--prior-dem", str(dem)]) == 0
    said = [line for line in capsys.readouterr().out.splitlines() if line.startswith("PRIOR DEM")]
    assert len(said) == 1
    bias = float(said[0].partition("lies ")[2].partition(" m above")[0])
    nmad = float(said[0].partition("NMAD ")[2].partition(" m over")[0])
    assert bias == pytest.approx(GEOID, abs=0.3)
    assert nmad < 0.15
    assert said[0].partition("  ")[2] in (out / "report.html").read_text()
    refused(["run", photos, "--out", out, *SMALL, "--prior-dem", tmp_path / "none.tif"], "there is no such file")
