"""Bad input through the whole of `alight run`: an error in one line, or a warning and the rest of the work done."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from damage import change_field, change_line, cut_off, write_flight, write_photo, write_photos, write_yaml
from refusal import Refused

from alight import cli
from alight.geometry import Pose, so3_exp

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Run:
    """Return a function that runs `alight run` on a folder and returns exit code, stdout and stderr."""

    def call(source: Path, *options: str) -> tuple[int, str, str]:
        code = cli.call(["run", str(source), "--out", str(tmp_path / "out"), *options])
        told = capsys.readouterr()
        return code, told.out, told.err

    return call


def told(out: Path) -> dict[str, Any]:
    """Read the run.json of a run."""
    tree: dict[str, Any] = json.loads((out / "run.json").read_text(encoding="utf-8"))
    return tree


# -- refused


def test_an_empty_folder(refused: Refused, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    refused(["run", tmp_path / "empty", "--out", tmp_path / "out"], "the folder is empty; give a flight log")
    assert not (tmp_path / "out").exists()


def test_a_file(refused: Refused, tmp_path: Path) -> None:
    (tmp_path / "flight.zip").write_text("")
    refused(
        ["run", tmp_path / "flight.zip", "--out", tmp_path / "out"], "flight.zip: not a file that can be read; give"
    )


def test_photos_without_gps(refused: Refused, tmp_path: Path) -> None:
    for k in range(3):
        write_photo(tmp_path / "survey" / f"{k}.jpg", k, place=None)
    refused(["run", tmp_path / "survey", "--out", tmp_path / "out"], "no photo has a GPS position")


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"intrinsics": [50.0, 0.0, 31.0]}, "intrinsics"),
        ({"intrinsics": [-50.0, 50.0, 31.0, 24.0]}, "focal"),
        ({"T_BS": {"cols": 4, "rows": 4, "data": [9.0] * 16}}, "T_BS"),
        ({"T_BS": {"cols": 4, "rows": 3, "data": [0.0] * 12}}, "T_BS"),
        ({"resolution": [640, 480]}, "resolution"),
        ({"distortion_coefficients": ["a lot"]}, "distortion_coefficients"),
    ],
)
def test_a_calibration_with_a_wrong_matrix(
    refused: Refused, tmp_path: Path, flight: Path, change: dict[str, Any], word: str
) -> None:
    path = flight / "mav0" / "cam1" / "sensor.yaml"
    tree = yaml.safe_load(path.read_text().removeprefix("%YAML:1.0\n"))
    write_yaml(path, tree | change)
    refused(["run", flight, "--out", tmp_path / "out"], "cam1/sensor.yaml", word)


def test_photos_without_the_extra_are_refused_before_they_are_read(
    refused: Refused, tmp_path: Path, photos: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    sample = iter(np.zeros((2, 48, 64), np.uint8))  # judged for false colours
    monkeypatch.setattr("alight.photos.reading.photo_pixels.read_image", lambda *_: next(sample))
    refused(
        ["run", photos, "--out", tmp_path / "out"],
        "pycolmap is not installed; mend it with: pip install 'alight[photos]'",
    )


def test_a_folder_for_the_results_that_may_not_be_written(refused: Refused, flight: Path, tmp_path: Path) -> None:
    (tmp_path / "out").write_text("a file")
    refused(
        ["run", flight, "--out", tmp_path / "out"], "out: is a file, not a folder; choose another folder with --out"
    )


def test_no_image_can_be_read(refused: Refused, tmp_path: Path, flight: Path) -> None:
    for path in flight.rglob("*.png"):
        path.write_bytes(b"")
    refused(["run", flight, "--out", tmp_path / "out"], "not one image could be read")


# -- done, with a warning


@pytest.fixture
def loss(run: Run, flight: Path, tmp_path: Path) -> Callable[..., str]:
    """Return a function that runs the damaged flight, asserts exit code 0 and all possible files; it returns stderr."""

    def check(*options: str) -> str:
        code, out, err = run(flight, *options)
        assert code == 0
        assert out.startswith(("SITE  ", "NO SITE  "))
        info = told(tmp_path / "out")
        assert [f"warning: {w}" for w in info["warnings"]] == err.splitlines()
        there = {p.name for p in (tmp_path / "out").iterdir()}
        assert {"run.json", "report.html", "sites.geojson"} <= there
        assert not there & set(info["not_written"])
        return err

    return check


def test_a_healthy_flight_is_run_without_a_complaint_but_its_answer(run: Run, flight: Path, tmp_path: Path) -> None:
    """Noise has no parallax: this is the answer, and the reader gives no warning."""
    code, out, err = run(flight)
    assert code == 0
    assert out.startswith("NO SITE  ")
    assert "left out" not in err
    assert "trajectory.tum" in {p.name for p in (tmp_path / "out").iterdir()}


def test_a_row_with_text_in_it(loss: Callable[..., str], flight: Path) -> None:
    change_field(flight / "mav0" / "nav0" / "data.csv", 3, 2, "east")
    assert "nav0 rows: 1 of 12 left out (first: line 3: 'east' is no number)" in loss()


def test_time_going_backwards(loss: Callable[..., str], flight: Path) -> None:
    path = flight / "mav0" / "cam0" / "data.csv"
    lines = path.read_text().splitlines()
    change_line(path, 3, lines[3])
    change_line(path, 4, lines[2])
    err = loss()
    assert "cam0 images: 1 of 6 left out" in err
    assert "time goes backwards" in err


def test_an_image_cut_off_in_the_middle(loss: Callable[..., str], flight: Path) -> None:
    cut_off(flight / "mav0" / "cam0" / "data" / "2.png")
    assert "cam0 images: 1 of 6 left out (first: 2.png: " in loss()


def test_no_nav0(loss: Callable[..., str], flight: Path, tmp_path: Path) -> None:
    shutil.rmtree(flight / "mav0" / "nav0")
    assert "nav0 is missing" in loss()
    info = told(tmp_path / "out")
    assert info["origin"] is None
    assert "no motion" in info["answer"]["reason"]


def test_no_imu_and_no_second_camera(loss: Callable[..., str], tmp_path: Path, flight: Path) -> None:
    shutil.rmtree(flight)
    write_flight(flight, cameras=1)
    shutil.rmtree(flight / "mav0" / "imu0")
    assert "left out" not in loss()


def test_a_photo_cut_off_and_another_camera_among_good_ones(run: Run, photos: Path, tmp_path: Path) -> None:
    cut_off(photos / "DJI_0001.JPG", 0.8)
    write_photo(photos / "phone.jpg", 9, model="Pocket", place=(45.0, 7.6, 300.0))
    code, out, err = run(photos)
    assert code == 0
    assert out.startswith("NO SITE  ")  # noise cannot be matched
    assert "1 photo(s) of another camera are left out: DJI Pocket" in err
    assert "DJI_0001.JPG" in err
    assert told(tmp_path / "out")["answer"]["reason"]


def test_two_folders_of_photos(run: Run, tmp_path: Path) -> None:
    write_photos(tmp_path / "survey" / "100MEDIA", 2)
    write_photos(tmp_path / "survey" / "101MEDIA", 2, seed=2)
    assert run(tmp_path / "survey")[0] == 0
    assert told(tmp_path / "out")["counts"]["exposures"] == 4


# -- the folder for the results


def test_an_earlier_run_is_replaced(run: Run, flight: Path, tmp_path: Path) -> None:
    assert run(flight)[0] == 0
    (tmp_path / "out" / "route.plan").write_text("of yesterday")
    assert run(flight)[0] == 0
    assert not (tmp_path / "out" / "route.plan").exists()


def test_what_is_somebody_elses_stays(run: Run, refused: Refused, flight: Path, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "thesis.tex").write_text("precious")
    refused(["run", flight, "--out", tmp_path / "out"], "--force")
    assert run(flight, "--force")[0] == 0
    assert (tmp_path / "out" / "thesis.tex").read_text() == "precious"


# -- real recordings


def test_euroc_is_read_without_a_complaint(run: Run, shared_data: Path) -> None:
    code, out, err = run(shared_data / "euroc-excerpt")
    assert code == 0
    assert out.startswith("NO SITE  no motion: there is no GPS/INS position with height to start from (nav0)")
    assert err.splitlines() == [
        "warning: nav0 is missing: there is no GPS/INS, "
        "so heights and places are relative and nothing can be put on a map"
    ]


def write_tum(path: Path, times: list[int], step: float) -> None:
    """Write level body poses, `step` metres apart, the nose northwards."""
    lines = []
    for k, t in enumerate(times):
        x, y, z, w = np.roll(Pose(so3_exp([0.0, 0.0, np.pi / 2]), np.zeros(3)).quaternion, -1)
        lines.append(f"{t // 10**9}.{t % 10**9:09d} 0 {step * k} 20 {x} {y} {z} {w}")
    path.write_text("\n".join(lines) + "\n")


@pytest.mark.parametrize("down", [False, True])
def test_euroc_with_poses_is_refused_with_the_reason(run: Run, shared_data: Path, tmp_path: Path, down: bool) -> None:
    """A vehicle that stands still has no site; its cameras look forward, or are declared to look down."""
    flight = tmp_path / "euroc"
    shutil.copytree(shared_data / "euroc-excerpt", flight)
    for cam in ("cam0", "cam1"):
        path = flight / "mav0" / cam / "sensor.yaml"
        path.chmod(0o644)
        tree = yaml.safe_load(path.read_text().removeprefix("%YAML:1.0\n"))
        look = [0, -1, 0, 0, -1, 0, 0, 0, 0, 0, -1, 0] if down else [0, 0, 1, 0, -1, 0, 0, 0, 0, -1, 0, 0]
        tree["T_BS"]["data"] = [*map(float, look), 0.0, 0.0, 0.0, 1.0]
        write_yaml(path, tree)
    names = sorted(int(p.stem) for p in (flight / "mav0" / "cam0" / "data").glob("*.png"))
    write_tum(tmp_path / "still.tum", names, 0.0)
    code, out, _ = run(flight, "--poses", str(tmp_path / "still.tum"))
    assert code == 0
    assert out.startswith(
        "NO SITE  no parallax: the aircraft did not move" if down else "NO SITE  no camera looks down"
    )
