"""`alight simulate`: flights of built-in and written scenes, the list, and one line for every mistake."""

from __future__ import annotations

import io
import re
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import yaml
from refusal import Refused
from rich.console import Console

import alight_sim
from alight import cli
from alight.cli.display import half_blocks
from alight.cli.simulated import read_scene_with
from alight.evaluation.flight import read_flight_truth
from alight.records import Frame
from alight.runner.opening import open_source
from alight.settings import Settings
from alight_sim.scene import FOLDER, built_in, parse_scene, read_scene, things

SMALL = "ground: {size: [60, 60]}\nflight: {height: 20, duration: 0.5}\nimaging: {rate_hz: 4}\n"
HILL = """
ground:
  size: [80, 80]
  relief: [{height: 6, longest: 20, shortest: 5}]
"""


@pytest.fixture
def small(tmp_path: Path) -> Path:
    """Write a scene file that is made and flown in a second or two."""
    file = tmp_path / "mine.yaml"
    file.write_text(SMALL)
    return file


def test_a_written_scene_becomes_a_flight_log_that_is_read_back(
    small: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "flight"
    assert cli.call(["simulate", str(small), "--seed", "3", "--out", str(out)]) == 0
    told = capsys.readouterr()
    assert (
        told.out.splitlines()[0] == f"flight: {out}  (mine, seed 3: 0.5 s, 3 exposures of 2 cameras, truth beside them)"
    )
    assert told.out.splitlines()[1].startswith(f"go on:  alight run {out} --out {out}-run && alight evaluate ")
    assert told.err == ""
    source = open_source(out, Settings())
    frames = [e for e in source.events() if isinstance(e, Frame)]
    assert len(frames) == 3
    assert all(i is not None and i.shape == (480, 640, 3) for f in frames for i in f.images)
    truth = read_flight_truth(out)
    assert truth.grid.cell == pytest.approx(0.1)
    assert source.truth_trajectory is not None
    at = dict(zip(source.truth_trajectory[0].tolist(), source.truth_trajectory[1], strict=True))
    up = [at[f.t_ns].translation[2] for f in frames]
    assert np.mean(up) - (np.nanmedian(truth.dem) - source.local.height) == pytest.approx(20.0, abs=2.0)


def test_overrides_win_over_the_file(small: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    chosen = read_scene_with(str(small), ["flight.height=33", "imaging.rate_hz=2"])
    assert (chosen.flight.height, chosen.imaging.rate_hz, chosen.flight.duration) == (33.0, 2.0, 0.5)
    out = tmp_path / "flight"
    command = ["simulate", str(small), "--out", str(out), "--duration", "1", "--set", "imaging.rate_hz=1"]
    assert cli.call(command) == 0
    assert "1.0 s, 2 exposures" in capsys.readouterr().out


def test_a_list_is_counted_from_one() -> None:
    chosen = read_scene_with("demo", ["ground.relief.1.height=0.25"])
    assert chosen.ground.relief[0].height == 0.25


def test_force_replaces_a_simulated_flight_and_nothing_else(
    small: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], refused: Refused
) -> None:
    out = tmp_path / "flight"
    command = ["simulate", str(small), "--out", str(out), "--duration", "0.25"]
    assert cli.call(command) == 0
    capsys.readouterr()
    assert f"{out}: exists already" in refused(command)
    assert cli.call([*command, "--force"]) == 0
    capsys.readouterr()
    other = tmp_path / "thesis"
    other.mkdir()
    (other / "thesis.tex").write_text("precious")
    command[3] = str(other)
    assert "exists already" in refused([*command, "--force"])
    assert [p.name for p in other.iterdir()] == ["thesis.tex"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("grond: {size: [60, 60]}", "mine.yaml: grond: there is no such key; use one of: "),
        ("ground: {sise: [60, 60]}", "ground.sise: there is no such key; use one of: size"),
        ("ground: {layers: [{thing: castle}]}", "no thing is called 'castle'; use one of: "),
        ("flight: {height: low}", "flight.height: "),
        ("ground: [1, 2", "mine.yaml: not valid YAML at line "),
        ("- a\n- b\n", "mine.yaml: holds a list"),
        ("\x00", "mine.yaml: not valid YAML"),
        ("flight: {height: 40, speed: 10, duration: 60}", "leaves the world"),
        ("flight: {height: 0.2}", "ground"),
        ("flight: {height: -5, above: origin}", "flight.height: "),
        (
            f"{HILL}flight: {{above: origin, waypoints: [[-20, 0, 30], [0, 0, -9], [20, 0, 30]]}}",
            "way-point 2 (east 0.0, north 0.0) is inside",
        ),
    ],
)
def test_a_scene_that_cannot_be_flown_is_told_in_one_line(
    text: str, words: str, tmp_path: Path, refused: Refused
) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(text)
    told = refused(["simulate", str(file), "--out", str(tmp_path / "flight")])
    assert words in told
    assert [p.name for p in tmp_path.iterdir()] == ["mine.yaml"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "needs SCENE and --out FLIGHT; --list shows the built-in scenes; see 'alight simulate --help'"),
        (["demo"], "needs SCENE and --out FLIGHT"),
        (["atlantis", "--out", "x"], "atlantis: no such file and no built-in scene; 'alight simulate --list' shows"),
        (["demo", "--out", "x", "--set", "flight"], "--set takes key=value, got 'flight'"),
        (["demo", "--out", "x", "--set", "flight.wings=2"], "flight.wings: there is no such key"),
        (["demo", "--out", "x", "--set", "ground.relief.99.height=2"], "does not fit the scene"),
        (["demo", "--out", "x", "--set", "flight.height=[1"], "--set flight.height=[1: not valid YAML"),
        (["demo", "--out", "x", "--height", "-3"], "flight.height: "),
        (["demo", "--out", "x", "--seed", "-3"], "--seed"),
    ],
)
def test_a_mistake_on_the_line_is_told_in_one_line(
    arguments: list[str],
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    refused: Refused,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert words in refused(["simulate", *arguments])
    assert list(tmp_path.iterdir()) == []


def test_the_printed_command_can_be_pasted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    flown = SimpleNamespace(rig=SimpleNamespace(cameras=[0]), seconds=1.0, length=2)
    monkeypatch.setattr(alight_sim, "fly", lambda *_: flown)
    monkeypatch.setattr(alight_sim, "write", lambda *_, **__: None)
    out = tmp_path / "my flight"
    assert cli.call(["simulate", "demo", "--out", str(out)]) == 0
    go_on = capsys.readouterr().out.splitlines()[1].partition("go on:  ")[2]
    assert go_on == f"alight run '{out}' --out '{out}-run' && alight evaluate '{out}-run' --truth '{out}'"


def test_the_seed_draws_what_a_family_of_scenes_leaves_open() -> None:
    chosen = read_scene_with("gravel", ["flight.height=33"], 3)
    drawn = read_scene(built_in()["gravel"], 3)
    assert chosen.ground == drawn.ground
    assert chosen.light == drawn.light != read_scene(built_in()["gravel"], 4).light
    assert chosen.flight.height == 33.0


def test_the_list_names_every_scene_and_its_picture(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.call(["simulate", "--list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2 * len(built_in())
    for (name, path), first, second in zip(built_in().items(), lines[::2], lines[1::2], strict=True):
        assert first.split(maxsplit=1) == [name, read_scene(path).description]
        assert Path(second.strip()) == FOLDER / "pictures" / f"{name}.jpg"
        assert 1_000 < Path(second.strip()).stat().st_size < 10_000


def test_every_key_is_written_down(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.call(["simulate", "--keys"]) == 0
    told = capsys.readouterr().out
    assert told.startswith("# Keys of a scene file\n")
    assert "### `ground.relief`" in told
    assert "| `height` | `40` | metres above what `above` names, at the start |" in told
    for name, kind in things().items():
        assert f"### `thing: {name}`" in told
        assert all(f"| `{key}` |" in told for key in kind.model_fields if key != "thing")


def test_the_scenes_of_the_documentation_are_scenes() -> None:
    page = (Path(__file__).parents[2] / "docs" / "simulator.md").read_text(encoding="utf-8")
    blocks_of_yaml = re.findall(r"```yaml\n(.*?)```", page, re.DOTALL)
    scenes = [parse_scene(yaml.safe_load(b), "docs/simulator.md") for b in blocks_of_yaml]
    assert len(scenes) >= 3
    assert scenes[0].flight.kind == "lawn_mower"
    assert [layer.thing for layer in scenes[0].ground.layers] == ["fields", "pads", "houses", "rocks"]


def test_a_picture_in_a_terminal_has_two_pixels_a_character(tmp_path: Path) -> None:
    columns, rows = 32, 12
    image = np.zeros((2 * rows, columns, 3), np.uint8)
    image[::2] = (0, 0, 255)  # red above blue, in OpenCV's order
    image[1::2] = (255, 0, 0)
    cv2.imwrite(str(tmp_path / "stripes.png"), image)
    picture = half_blocks(tmp_path / "stripes.png")
    assert picture.plain == ("\u2580" * columns + "\n") * rows
    assert {s.style for s in picture.spans} == {"rgb(255,0,0) on rgb(0,0,255)"}
    told = io.StringIO()
    Console(file=told, force_terminal=True, color_system="truecolor", width=100).print(picture)
    assert "\x1b[38;2;255;0;0;48;2;0;0;255m" in told.getvalue()
