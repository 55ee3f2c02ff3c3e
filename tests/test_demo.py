"""The demo, as the first command of a newcomer: all the way, with what it must show against its truth."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from alight.evaluation import evaluate
from alight.outputs import FILES
from alight.records import OutputError
from alight.runner import demo, replay
from alight.settings import Settings

ALIGHT = [sys.executable, "-c", "from alight.cli import main; main()"]


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, subprocess.CompletedProcess[str]]:
    """`alight demo`, run once."""
    out = tmp_path_factory.mktemp("demo") / "out"
    return out, subprocess.run([*ALIGHT, "demo", "--out", str(out)], capture_output=True, text=True, timeout=600)


def rows(text: str) -> dict[str, str]:
    """The comparison with the truth, by name."""
    pairs = [line.strip().rsplit("  ", 1) for line in text.splitlines() if line.startswith("  ")]
    return {name.strip(): value for name, value in pairs}


def test_it_finds_a_site_and_says_where_everything_is(done: tuple[Path, subprocess.CompletedProcess[str]]) -> None:
    out, process = done
    assert process.returncode == 0, process.stderr
    lines = process.stdout.splitlines()
    assert lines[0].startswith("SITE  47.62")
    assert f"report: {out / 'report.html'}" in lines
    assert lines[-1].startswith(f"flight: {out}-flight ")
    assert all(line.startswith("warning: ") for line in process.stderr.splitlines())


def test_the_results_are_a_whole_run_and_nothing_else(done: tuple[Path, subprocess.CompletedProcess[str]]) -> None:
    out, _ = done
    assert {p.name for p in out.iterdir()} == {*FILES, "run.json"}
    assert {p.name for p in out.with_name("out-flight").iterdir()} == {"mav0", "truth"}
    info = json.loads((out / "run.json").read_text(encoding="utf-8"))
    assert info["not_written"] == {}
    assert info["notes"]["cameras"] == ["cam0", "cam1"]  # as it is, not as words
    assert info["counts"]["cam0 images"] == info["counts"]["exposures"]


def test_the_comparison_shows_a_sound_run(done: tuple[Path, subprocess.CompletedProcess[str]]) -> None:
    """The bounds are loose: they tell a broken stage from a sound one. docs/lab/flights.md has the figures."""
    found = rows(done[1].stdout)
    assert found["best site truly safe, registered"] == "yes"
    good, of = map(int, found["sites truly safe, registered"].split(" of "))
    assert good == of > 0
    assert float(found["sites centred on water, plants or structures, registered"]) == 0
    assert float(found["ground NMAD, % of height, registered"]) < 0.4
    assert abs(float(found["ground offset (median), m, registered"])) < 0.1
    assert float(found["ground accepted of seen, %, registered"]) > 75
    assert float(found["position RMSE less a constant, m"]) < 0.3


def test_the_page_for_newcomers_shows_lines_of_the_demo(done: tuple[Path, subprocess.CompletedProcess[str]]) -> None:
    page = (Path(__file__).parents[1] / "docs" / "start.md").read_text(encoding="utf-8")
    shown = page.split("```text\n")[1].split("```")[0]
    found = rows(done[1].stdout)
    assert len(rows(shown)) >= 4
    assert set(rows(shown)) <= set(found)
    assert rows(shown)["sites truly safe, registered"] == found["sites truly safe, registered"]


def test_the_flight_can_be_run_and_evaluated_by_hand(done: tuple[Path, subprocess.CompletedProcess[str]]) -> None:
    out, process = done
    flight = out.with_name("out-flight")
    assert evaluate(out, flight).lines()[1:] == [s for s in process.stdout.splitlines() if s.startswith("  ")]


def test_a_folder_of_somebody_else_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "out-flight").mkdir()
    (tmp_path / "out-flight" / "thesis.tex").write_text("precious")
    with pytest.raises(OutputError, match="out-flight: exists already"):
        demo.fly_demo(tmp_path / "out", 1, Settings(), True, lambda stage, share: None)
    assert (tmp_path / "out-flight" / "thesis.tex").read_text() == "precious"


def test_the_folder_here_has_its_flight_beside_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`--out .`: the flight must not land among the results."""
    here = tmp_path / "here"
    here.mkdir()
    monkeypatch.chdir(here)
    flown = []
    monkeypatch.setattr(demo, "_simulate", lambda folder, *_: flown.append(folder))
    monkeypatch.setattr(demo, "open_source", lambda *_: None)
    monkeypatch.setattr(replay, "replay", lambda *_: None)
    assert demo.fly_demo(Path(), 1, Settings(), False, lambda stage, share: None)[0] == tmp_path / "here-flight"
    assert flown == [tmp_path / "here-flight"]
