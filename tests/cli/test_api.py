"""Public interface of `import alight`."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from operator import attrgetter
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from some_run import some_run

import alight
from alight.api import settings_of
from alight.records import OutputError, SettingsError
from alight.runner import replay
from alight.settings import Settings, load_settings
from alight.trials import demo


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


@pytest.mark.parametrize(
    ("given", "key", "value"),
    [
        ({"lander": alight.Lander(radius=0.8)}, "lander.radius", 0.8),
        ({"lander.max_slope": 0.1, "lander": alight.Lander(radius=0.8)}, "lander.max_slope", 0.1),
        ({"terrain.model": Path("mine/ground.npz")}, "terrain.model", "mine/ground.npz"),
        ({"terrain": {"model": Path("\u00fc\U0001f600.npz")}}, "terrain.model", "\u00fc\U0001f600.npz"),
        ({"lander.radius": np.float32(0.5)}, "lander.radius", 0.5),
        ({"parallax.store_mb": np.int64(99)}, "parallax.store_mb", 99),
        ({"parallax.height_range": np.array([-1.0, 4.0])}, "parallax.height_range", (-1.0, 4.0)),
        ({"terrain.enabled": np.bool_(False)}, "terrain.enabled", False),
    ],
)
def test_settings_take_models_paths_and_numbers_of_numpy(given: dict[str, object], key: str, value: object) -> None:
    assert attrgetter(key)(settings_of(given)) == value


def test_a_value_that_is_none_of_a_setting_is_refused_with_its_key() -> None:
    ring: list[object] = []
    ring.append(ring)
    for value in (object(), {1, 2}, b"9", ring, {(1, 2): 3}, 10**400):
        with pytest.raises(SettingsError, match=r"^parallax\.cell: "):
            settings_of({"parallax.cell": value})


def test_a_recording_is_run_with_the_settings_of_its_flight_where_none_are_given(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    used, flown_with = list[Settings](), load_settings("", ["parallax.cell=0.3"])
    monkeypatch.setattr(replay, "replay", lambda source, settings, *_: used.append(settings) or some_run())
    recording = SimpleNamespace(flown_with=flown_with)
    alight.run(recording)  # type: ignore[arg-type]
    assert used.pop() == flown_with
    for given in ({"parallax.quality": "normal"}, {"lander.radius": 1.5}):  # the defaults, and asked for
        alight.run(recording, settings=given)  # type: ignore[arg-type]
        assert used.pop() == Settings()
    alight.run(recording, lander=alight.Lander(radius=0.8))  # type: ignore[arg-type]
    assert used.pop().parallax.cell is None


def test_the_demo_keeps_off_the_files_of_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demo, "SteeredFlight", lambda *_, **__: pytest.fail("it flies"))
    (tmp_path / "thesis.tex").write_text("precious")
    with pytest.raises(OutputError, match="holds files that are not a run's"):
        alight.demo(tmp_path)


def test_a_recording_without_a_place_on_earth_gives_none() -> None:
    result = alight.Result(replace(some_run(), georeferenced=False))
    assert result.best is not None
    assert result.latitude_longitude(result.best) is None
    assert result.ellipsoid_height(result.best) is None
