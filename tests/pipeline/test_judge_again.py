"""Judging again: the answer for another lander, from what a run has kept, is that of a new run with that lander."""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from meadow_flight import flight, settings_of
from refusal import Refused

import alight
from alight import Lander, Result
from alight.cli import call
from alight.records import InputError, SettingsError
from alight_sim import SimulatedFlight

LANDER = Lander(radius=0.8, max_slope=0.12, rotor_radius=1.1)
ANSWER = (
    *("sites.geojson", "route.plan", "route.geojson", "wires.geojson", "dem.tif", "flags.tif", "ortho.tif"),
    *("terrain.tif", "safe.tif", "reasons.tif", "trajectory.tum", "trajectory.csv"),
)
METHODS = ("batch", "recursive")


@pytest.fixture(scope="module", autouse=True)
def _drawn_once() -> Iterator[None]:
    events = flight()[1]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(SimulatedFlight, "events", lambda _: iter(events))
        yield


@cache
def run(method: str, lander: Lander | None = None, **keys: object) -> Result:
    settings = settings_of(f"parallax.method={method}", "sites.every=8", *(f"{k}={v}" for k, v in keys.items()))
    return alight.run(flight()[0], poses="truth", settings=settings, lander=lander)


def answer(folder: Path) -> dict[str, object]:
    """The answer of run.json, and the bytes of every file that holds a part of it."""
    info = json.loads((folder / "run.json").read_text())
    kept = {k: info[k] for k in ("answer", "counts", "origin", "settings", "photos", "common_error")}
    return kept | {name: (folder / name).read_bytes() for name in ANSWER}


@pytest.mark.parametrize("method", METHODS)
def test_the_answer_is_that_of_a_new_run(method: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Also from the folder of the run, by the command, and from the folder that judging wrote."""
    run(method).save(tmp_path / "run")
    run(method, LANDER).save(tmp_path / "new")
    expected = answer(tmp_path / "new")
    assert expected["answer"] != answer(tmp_path / "run")["answer"]
    run(method).judge(LANDER).save(tmp_path / "again")
    assert answer(tmp_path / "again") == expected
    keys = ("radius=80cm", "max_slope=0.12rad", "rotor_radius=1.1")
    assert call(["judge", str(tmp_path / "run"), *(w for k in keys for w in ("--set", f"lander.{k}"))]) == 0
    assert answer(tmp_path / "run-judged") == expected
    assert "SITE " in capsys.readouterr().out
    again = alight.read_result(tmp_path / "run-judged")
    again.save(tmp_path / "third")
    assert answer(tmp_path / "third") == expected
    assert list(again.warnings) == list(run(method, LANDER).warnings)


def test_a_result_that_was_read_has_what_the_run_had(tmp_path: Path) -> None:
    run("recursive").save(tmp_path / "run")
    there, read = run("recursive").record, alight.read_result(tmp_path / "run").record
    assert read.settings == there.settings
    assert (read.counts, read.local, read.source_name) == (dict(there.counts), there.local, there.source_name)
    for a, b in zip(there.motions, read.motions, strict=True):
        assert (a.t_ns, a.state, a.tracks, a.frame_id) == (b.t_ns, b.state, b.tracks, b.frame_id)
        np.testing.assert_array_equal(a.world_from_body.matrix, b.world_from_body.matrix)
        np.testing.assert_array_equal(a.covariance, b.covariance)
    assert read.hazards is not None
    assert there.hazards is not None
    np.testing.assert_array_equal(read.hazards.p_safe, there.hazards.p_safe)


def test_limits_and_sites_are_judged_again() -> None:
    more = run("batch").judge(settings={"sites": {"count": 2}, "hazards.p_safe": 0.5, "route.approach_height": 12})
    assert len(more.sites) + len(more.candidates) <= 2
    assert all(s.p_safe >= 0.5 for s in more.sites)
    assert more.settings.lander == run("batch").settings.lander
    assert more.settings.route.approach_height == 12


@pytest.mark.parametrize(
    ("key", "value"),
    [("parallax.cell", 0.5), ("motion.method", "filter"), ("terrain.enabled", False), ("sites.every", 3)],
)
def test_a_key_that_the_judgement_does_not_use_is_refused(key: str, value: object) -> None:
    with pytest.raises(SettingsError, match=rf"^{key}: the judgement does not use it; run again with it$"):
        run("batch").judge(settings={key: value})
    same = dict(run("batch").settings)[key.split(".")[0]]
    run("batch").judge(settings={key: getattr(same, key.split(".")[1])})  # the run's own value


@pytest.mark.parametrize("keys", [{"lander.wings": 2}, {"lander.radius": -1}, {"lander": 3}])
def test_a_bad_value_is_named(keys: dict[str, object]) -> None:
    with pytest.raises(SettingsError, match=next(iter(keys)).split(".")[-1]):
        run("batch").judge(settings=keys)


def test_a_lander_that_is_judged_on_other_cells_is_warned_of() -> None:
    """A rough ground needs no small cells: a new run would judge on cells twice as large, from another picture."""
    rough = run("batch").judge(Lander(max_roughness=0.8))
    assert any("a new run may choose others" in w for w in rough.warnings)
    assert rough.hazards is not None
    assert rough.hazards.grid.cell == 0.5
    fine = rough.judge(Lander(max_roughness=0.15))  # and back, to cells finer than those that were judged
    assert fine.hazards is not None
    assert fine.hazards.grid.cell == 0.25
    assert not any("a new run" in w for w in run("batch").judge(Lander(radius=2.0)).warnings)


def test_finer_cells_than_those_of_the_run() -> None:
    """The run judged cells of 0.5 m with pixels of 0.125 m; the finer cells get the same picture."""
    coarse = run("batch", Lander(max_roughness=0.8))
    fine = coarse.judge(Lander(max_roughness=0.3))
    assert coarse.hazards is not None
    assert fine.hazards is not None
    assert (coarse.hazards.grid.cell, fine.hazards.grid.cell) == (0.5, 0.25)
    assert np.isfinite(fine.hazards.p_safe).any()


@pytest.mark.parametrize("cut", [0, 30, 4000, -200])
def test_damaged_evidence_is_one_line(cut: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run("batch").save(tmp_path / "run")
    file = tmp_path / "run" / "evidence.npz"
    file.write_bytes(file.read_bytes()[:cut])
    assert call(["judge", str(tmp_path / "run")]) == 2
    line = capsys.readouterr().err
    assert line.startswith(f"error: {file}: damaged, or of another version")
    assert line.count("\n") == 1


def test_a_folder_without_evidence_is_named(tmp_path: Path, refused: Refused) -> None:
    refused(["judge", tmp_path / "nothing"], "no finished run here")
    for path in run("batch").save(tmp_path / "run"):
        path.unlink() if path.name == "evidence.npz" else None
    refused(["judge", tmp_path / "run"], "evidence.npz: missing; name the folder of a run")


def test_a_run_is_not_replaced_by_its_own_judgement(tmp_path: Path, refused: Refused) -> None:
    run("batch").save(tmp_path / "run")
    refused(["judge", tmp_path / "run", "--out", tmp_path / "run"], "evidence.npz: lies in")
    assert (tmp_path / "run" / "run.json").exists()


def test_a_run_without_a_map_cannot_be_judged() -> None:
    with pytest.raises(InputError, match="the run has no map to judge"):
        run("batch", None, **{"parallax.height_range": "[500,600]"}).judge(LANDER)
