"""Public interface of `import alight`."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from some_run import some_run

import alight
from alight.api import settings_of
from alight.records import SettingsError


def test_every_public_name_is_there() -> None:
    for name in alight.__all__:
        assert getattr(alight, name) is not None
    with pytest.raises(AttributeError, match="nothing"):
        _ = alight.nothing


def test_importing_it_imports_no_numpy() -> None:
    done = subprocess.run(
        [sys.executable, "-c", "import sys, alight; print('numpy' in sys.modules, 'alight.records' in sys.modules)"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split() == ["False", "False"]


def test_settings_come_as_a_mapping_nested_or_dotted_as_a_file_or_as_a_model(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("parallax: {cell: 0.2}\n")
    for given in ({"parallax.cell": 0.2}, {"parallax": {"cell": 0.2}}, str(file), settings_of({"parallax.cell": 0.2})):
        assert settings_of(given).parallax.cell == 0.2
    assert settings_of({"lander.radius": 3.0}, alight.Lander(radius=0.8)).lander.radius == 0.8


def test_a_bad_setting_is_refused_by_name() -> None:
    with pytest.raises(SettingsError, match=r"parallax\.cel"):
        settings_of({"parallax.cel": 0.2})
    with pytest.raises(SettingsError, match="no_such"):
        settings_of("no_such.yaml")


def test_a_result_gives_arrays_with_their_grid_and_saves_itself(tmp_path: Path) -> None:
    result = alight.Result(some_run())
    assert result.best is not None
    assert result.elevation is not None
    assert result.elevation.height.shape == result.elevation.grid.shape
    place = result.latitude_longitude(result.best)
    assert place is not None
    assert np.isfinite(place).all()
    height = result.ellipsoid_height(result.best)
    assert height == pytest.approx(result.record.local.height + result.best.up, abs=1e-3)
    written = result.save(tmp_path / "out")
    assert {p.name for p in written} >= {"dem.tif", "report.html", "run.json"}


def test_a_recording_without_a_place_on_earth_gives_none() -> None:
    result = alight.Result(replace(some_run(), georeferenced=False))
    assert result.best is not None
    assert result.latitude_longitude(result.best) is None
    assert result.ellipsoid_height(result.best) is None
