"""Rasters that hold no heights or have an odd size, in `alight hazards`: one line that names the remedy."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from refusal import Refused
from written_raster import write

from alight.cli import call
from alight.geometry import LocalFrame
from alight.outputs.reading import read_bands
from alight.records import InputError


def ground(shape: tuple[int, int] = (81, 81)) -> np.ndarray:
    """Return level ground as from a survey, with noise of 5 mm."""
    return np.random.default_rng(0).normal(100.0, 0.005, shape).astype(np.float32)


def judging(path: Path, *options: str) -> list[str]:
    """Return the command that judges a raster."""
    return ["hazards", str(path), "--sigma", "0.01", "--out", str(path.parent / "out"), *options]


def judged(path: Path, capsys: pytest.CaptureFixture[str], *options: str) -> tuple[int, str, str]:
    """Run `alight hazards` on a raster; return exit code, stdout and stderr."""
    code = call(judging(path, *options))
    said = capsys.readouterr()
    return code, said.out, said.err


@pytest.mark.parametrize("value", [-9999.0, 1e30, -32768.0, -3.4028235e38, 0.0, 1e5])
@pytest.mark.parametrize("declared", [None, -1.0])
def test_no_data_that_is_not_declared(tmp_path: Path, refused: Refused, value: float, declared: float | None) -> None:
    if value == 0.0 and declared is not None:
        pytest.skip("another value is declared: 0 may be a height")
    z = ground()
    z[:30] = value
    refused(judging(write(tmp_path / "dem.tif", z, nodata=declared)), "2430 of 6561 cells", "-a_nodata")


def test_a_filling_among_the_heights_is_asked_about(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    z = ground() - 100
    z[:30] = 0.0
    code, _, err = judged(write(tmp_path / "dem.tif", z), capsys)
    assert code == 0
    assert "the height 0 m stands in 37 % of the cells exactly" in err
    code, _, err = judged(write(tmp_path / "dem.tif", z, nodata=0), capsys, "--force")
    assert code == 0
    assert err == ""


@pytest.mark.parametrize("dtype", ["uint8", "int16", "float32"])
def test_classes_are_no_heights(tmp_path: Path, refused: Refused, dtype: str) -> None:
    classes = np.random.default_rng(0).integers(1, 9, (81, 81)).astype(dtype)
    refused(judging(write(tmp_path / "dem.tif", classes)), "classes", "give heights in metres as float32")


def test_a_scale_is_applied(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    dem = write(tmp_path / "dem.tif", np.rint(1000 * ground()).astype(np.int32))
    with rasterio.open(dem, "r+") as d:
        d.scales = (0.001,)
    code, out, _ = judged(dem, capsys)
    assert code == 0
    assert out.startswith("SITE")


@pytest.mark.parametrize("shape", [(1, 1), (1, 200), (200, 1), (2, 2), (3, 100)])
@pytest.mark.parametrize("cell", [0.1, 10.0])
def test_rasters_too_small_for_a_footprint(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], shape: tuple[int, int], cell: float
) -> None:
    code, out, err = judged(write(tmp_path / "dem.tif", ground(shape), cell), capsys)
    assert code == 0, err
    assert out.startswith("NO SITE")


@pytest.mark.parametrize("cell", [1e-9, 1e300, 5000.0])
def test_cells_of_an_absurd_size(tmp_path: Path, refused: Refused, cell: float) -> None:
    refused(judging(write(tmp_path / "dem.tif", ground((20, 20)), cell)), "cells of")


def test_a_raster_far_from_everything(tmp_path: Path, refused: Refused) -> None:
    place = rasterio.Affine(0.1, 0, 1e200, 0, -0.1, 0)
    refused(judging(write(tmp_path / "dem.tif", ground(), transform=place)), "nowhere")


@pytest.mark.parametrize("sigma", ["1e300", "-1", "nan", "inf"])
def test_a_sigma_out_of_range(tmp_path: Path, refused: Refused, sigma: str) -> None:
    refused(judging(write(tmp_path / "dem.tif", ground()), "--sigma", sigma), "--sigma", "metres from 0 to 1000")


def test_a_raster_of_sigma_without_a_sigma(tmp_path: Path, refused: Refused) -> None:
    spread = write(tmp_path / "s.tif", np.full((81, 81), 1e30, np.float32))
    refused(judging(write(tmp_path / "dem.tif", ground()), "--sigma", str(spread)), "no height has a sigma")


@pytest.mark.parametrize("more", [{"count": 1}, {"tiled": True, "compress": "deflate"}])
def test_a_raster_that_is_cut_off(tmp_path: Path, refused: Refused, more: dict[str, Any]) -> None:
    dem = write(tmp_path / "dem.tif", ground((300, 300)), **more)
    dem.write_bytes(dem.read_bytes()[: dem.stat().st_size // 2])
    refused(judging(dem), "dem.tif")


def test_a_coordinate_system_whose_name_is_no_text(tmp_path: Path, refused: Refused) -> None:
    path = write(tmp_path / "dem.tif", ground(), crs=LocalFrame(47.6, 13.4, 500.0).crs)
    whole = path.read_bytes()
    path.write_bytes(whole.replace(b"Greenwich", b"\xebreenwich"))
    assert path.read_bytes() != whole
    refused(judging(path), "dem.tif", "not a raster that can be read")
    with pytest.raises(InputError, match="not a readable raster"):
        read_bands(path, 1, "f", "run it again")
