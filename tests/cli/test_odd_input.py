"""Odd input found by trying every command: once each was ignored silently, or gave a traceback or an endless wait."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import rasterio
from damage import HEIGHT, LATITUDE, LONGITUDE, UNSMOOTHED, picture, write_rows
from numpy.typing import NDArray
from refusal import Refused
from some_run import some_run

from alight.cli import call
from alight.geometry import LocalFrame
from alight.outputs import write_run
from alight.photos.bundle.summary import fixed_attitudes
from alight_sim.autopilot import UdpServer

Told = pytest.CaptureFixture[str]
LOCAL = LocalFrame(LATITUDE, LONGITUDE, HEIGHT)


def running(source: Path, *more: str) -> list[str]:
    """Return the command that runs a source."""
    return ["run", str(source), "--out", str(source.parent / "out"), *UNSMOOTHED, *more]


# -- settings


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("lander.radius=true", "not true or false"), ("sites.count=false", "not true or false"),
        ("lander.radius=1:30", "must be a number"), ("lander.radius=0x10", "must be a number"), ("...=5", "key=value"),
        ("lander..radius=5", "key=value"),
    ],
)  # fmt: skip
def test_what_is_no_number_of_ours(setting: str, words: str, refused: Refused) -> None:
    """YAML 1.1 reads 1:30 as 90 and 0x10 as 16; Python takes true for 1."""
    refused(["settings", "--set", setting], words)


def test_a_number_with_a_leading_zero_is_decimal(capsys: Told) -> None:
    """YAML 1.1 reads 010 as 8."""
    assert call(["settings", "--set", "lander.radius=010"]) == 0
    assert "  radius: 10.0  # m\n" in capsys.readouterr().out


@pytest.mark.parametrize("command", [["settings", "--settings"], ["simulate", "--out", "x"]])
def test_a_key_that_stands_twice(command: list[str], tmp_path: Path, refused: Refused) -> None:
    path = tmp_path / "twice.yaml"
    path.write_text("light:\n  haze: 1\n  haze: 2\n")
    refused([*command, path], "twice.yaml: ", "the key 'haze' stands twice; write it once")


def test_merged_keys_are_no_repetition(tmp_path: Path, capsys: Told) -> None:
    path = tmp_path / "merged.yaml"
    path.write_text("lander: &a {radius: 2}\nsites: {<<: {count: 7}, count: 3}\n")
    assert call(["settings", "--settings", str(path)]) == 0
    assert "  count: 3\n" in capsys.readouterr().out


@pytest.mark.parametrize("columns", ["0", ""])
def test_a_terminal_without_columns(columns: str) -> None:
    """Without columns the whole help was missing."""
    code = "import sys; from alight.cli import main; sys.argv = ['alight', 'settings', '--help']; main()"
    env = os.environ | {"COLUMNS": columns, "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True)
    assert "--settings" in done.stdout


# -- flight logs


@pytest.mark.parametrize("stream", ["imu0", "nav0"])
@pytest.mark.parametrize("kind", ["device", "folder", "pipe"])
def test_a_stream_that_is_no_plain_file(stream: str, kind: str, flight: Path, capsys: Told) -> None:
    path = flight / "mav0" / stream / "data.csv"
    path.unlink()
    {"device": lambda: path.symlink_to("/dev/zero"), "folder": path.mkdir, "pipe": lambda: os.mkfifo(path)}[kind]()
    assert call(running(flight)) == 0
    assert f"warning: {stream}/data.csv is no plain file and is not read" in capsys.readouterr().err


def restamp(flight: Path, change: Callable[[int], str]) -> None:
    """Replace the times of all streams."""
    for table in flight.glob("mav0/*/data.csv"):
        head, *rows = table.read_text().splitlines()
        fields = [row.partition(",") for row in rows]
        table.write_text("\n".join([head, *(f"{change(int(t))},{rest}" for t, _, rest in fields)]) + "\n")


@pytest.mark.parametrize("unit", [10**3, 10**6])
def test_times_of_another_unit(unit: int, flight: Path, refused: Refused) -> None:
    restamp(flight, lambda t: str(t // unit))
    refused(
        running(flight),
        "cam0/data.csv: its images are ",
        " ms apart, as of no camera; write the times of all streams in nano",
    )


def test_times_in_seconds(flight: Path, refused: Refused) -> None:
    restamp(flight, lambda t: f"{t / 1e9:.4f}")
    refused(
        running(flight),
        "cam0: no image of data.csv is there (cam0 images: 6 of 6 left out",
        "no time in integer nanoseconds",
    )


@pytest.mark.parametrize(
    ("force", "said"), [(1.0, "below 1 m/s^2"), (0.0, "below 0 m/s^2"), (981.0, "below 981 m/s^2")]
)
def test_accelerations_of_another_unit(force: float, said: str, flight: Path, capsys: Told) -> None:
    path = flight / "mav0" / "imu0" / "data.csv"
    rows = [row.split(",")[:4] for row in path.read_text().splitlines()[1:]]
    write_rows(path, [[*row, 0, 0, force] for row in rows])
    assert call(running(flight)) == 0
    assert f"warning: imu0: half of its accelerations are {said}" in capsys.readouterr().err


def test_poses_at_a_time_beyond_all_numbers(flight: Path, tmp_path: Path, refused: Refused) -> None:
    (tmp_path / "p.tum").write_text("1e999999999 0 0 0 0 0 0 1\n")
    refused(running(flight, "--poses", str(tmp_path / "p.tum")), "p.tum, line 1: no pose")


# -- photos, videos


def test_photos_that_are_no_plain_files(photos: Path, capsys: Told) -> None:
    pytest.importorskip("pycolmap")
    os.mkfifo(photos / "pipe.jpg")
    (photos / "link.jpg").symlink_to("/nowhere")
    (photos / "zeros.jpg").symlink_to("/dev/zero")
    assert call(running(photos)) == 0
    assert (
        "photos: 3 of 7 left out (first: link.jpg: it is no plain file, or a link to nothing)"
        in capsys.readouterr().err
    )


def test_an_image_that_is_a_pipe(flight: Path, capsys: Told) -> None:
    image = flight / "mav0" / "cam0" / "data" / "2.png"
    image.unlink()
    os.mkfifo(image)
    assert call(running(flight)) == 0
    assert "cam0 images: 1 of 6 left out (first: 2.png: it is no plain file)" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["index.csv", "water/x.png"])
def test_a_library_with_a_pipe_in_it(name: str, tmp_path: Path, refused: Refused) -> None:
    for kind in ("water", "bare"):
        (tmp_path / kind).mkdir()
        picture(0, (96, 96)).save(tmp_path / kind / "a.png")
    os.mkfifo(tmp_path / name)
    refused(["terrain", "test", tmp_path], f"{name}: not a ")


def test_a_video_that_is_none_is_told_by_us_alone(tmp_path: Path) -> None:
    """The test runs a process of its own, because the decoder reads the level of its messages once a process."""
    (tmp_path / "v.mp4").write_text("no video")
    place = "[latitude: 45.0] [longitude: 7.6] [abs_alt: 350]"
    (tmp_path / "v.srt").write_text(f"1\n00:00:00,000 --> 00:00:01,000\n{place}\n")
    command = [
        sys.executable,
        "-c",
        "from alight.cli import main; main()",
        "run",
        str(tmp_path / "v.mp4"),
        "--out",
        str(tmp_path / "out"),
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 2
    assert done.stderr.startswith("error: ")
    assert done.stderr.count("\n") == 1
    assert "v.mp4: not one frame could be decoded" in done.stderr


# -- rasters, runs


def write_dem(path: Path, values: NDArray[np.generic], east: float = -12.0) -> Path:
    """Write a raster on the grid of the made-up run, or elsewhere."""
    path.parent.mkdir(parents=True, exist_ok=True)
    rows, cols = values.shape
    form = {"driver": "GTiff", "width": cols, "height": rows, "count": 1, "dtype": values.dtype.name}
    place = rasterio.Affine(0.25, 0, east, 0, -0.25, 21)
    with rasterio.open(path, "w", crs=LOCAL.crs, transform=place, **form) as d:
        d.write(values, 1)
    return path


def test_complex_heights(tmp_path: Path, refused: Refused) -> None:
    path = write_dem(tmp_path / "z.tif", np.ones((60, 60), np.complex64))
    refused(
        ["hazards", path, "--out", tmp_path / "out"], "z.tif: holds complex numbers; give heights in metres as float32"
    )


@pytest.fixture
def done(tmp_path: Path) -> Path:
    """Write a run over the place of the flight."""
    write_run(some_run(local=LOCAL), tmp_path / "run")
    return tmp_path / "run"


def test_a_raster_of_a_run_that_is_a_pipe(done: Path, flight: Path, refused: Refused) -> None:
    (done / "dem.tif").unlink()
    os.mkfifo(done / "dem.tif")
    (flight / "truth").mkdir()
    refused(["evaluate", done, "--truth", flight], "dem.tif: missing, or not a plain file; run again to write it anew")


def test_a_site_beyond_the_frame(done: Path, flight: Path, refused: Refused) -> None:
    info = json.loads((done / "run.json").read_text())
    info["answer"]["sites"][0]["east_m"] = 1e300
    (done / "run.json").write_text(json.dumps(info))
    refused(["evaluate", done, "--truth", flight], "run.json: answer.sites.0.east_m is damaged")


@pytest.mark.parametrize("case", ["elsewhere", "nothing known"])
def test_truth_that_says_nothing_of_the_map(case: str, done: Path, flight: Path, refused: Refused) -> None:
    """Sites of such a run were counted as unsafe."""
    height = np.full((120, 160), np.nan if case == "nothing known" else HEIGHT, np.float32)
    for name, values in (("dem", height), ("class", np.ones((120, 160), np.uint8))):
        write_dem(flight / "truth" / f"{name}.tif", values, -12.0 if case == "nothing known" else -12000.0)
    refused(
        ["evaluate", done, "--truth", flight],
        "truth/dem.tif: has no height on the run's map; name the flight that was run",
    )


# -- scenes


@pytest.mark.parametrize("item", ["0", "-1", "3"])
def test_an_item_that_a_list_has_not(item: str, tmp_path: Path, refused: Refused) -> None:
    """Item 0 was once the last one."""
    (tmp_path / "s.yaml").write_text("ground: {layers: [{thing: rocks}, {thing: trees}]}\n")
    words = ["--set", f"ground.layers.{item}.per_hectare=5", "--out", str(tmp_path / "flight")]
    refused(["simulate", tmp_path / "s.yaml", *words], "does not fit the scene")


# -- rehearsals, flights


@pytest.mark.parametrize(
    "words",
    [
        ["rehearse", "concrete", "--folder", "x", "--rate", "inf"],
        ["rehearse", "concrete", "--folder", "x", "--width", "100000000"],
        ["rehearse", "concrete", "--folder", "x", "--height", "1e300"],
        ["rehearse", "concrete", "--folder", "x", "--wind", "inf"],
        ["fly", "--link", "tcp:127.0.0.1:9", "--camera", "x", "--out", "x", "--imu", "inf"],
        ["fly", "--link", "tcp:127.0.0.1:9", "--camera", "x", "--out", "x", "--separation", "nan"],
        ["live", "x", "--out", "x", "--separation", "inf"],
        ["campaign", "lake", "--out", "x", "--landings", str(10**15)],
        ["campaign", "lake", "--out", "x", "--jobs", "100000"],
    ],
)
def test_options_out_of_range(words: list[str], refused: Refused) -> None:
    refused(words, f"Invalid value for '{words[-2]}'")


def test_a_rehearsal_that_cannot_keep_up_ends_and_knows_it() -> None:
    """The steps once never ended behind a clock that ran away, and Ctrl-C had no effect."""
    nobody = SimpleNamespace(step=lambda seconds: None, pending=lambda: [], receive=lambda data: None)
    with UdpServer(nobody, step=0.001, after_step=lambda events: time.sleep(0.02)) as server:  # type: ignore[arg-type]
        time.sleep(0.3)
    assert server.behind > 0.1


# -- photos of noise


def test_a_photo_whose_attitude_nothing_fixes_is_not_registered() -> None:
    """Two photos of noise were matched: their variances were -3e6, and Python warned of a square root on stderr."""
    joint = np.eye(6 * 4 + 2) * 1e-4
    joint[9, 9], joint[16, 16], joint[21:24, 21:24] = 1e9, -1e-9, np.nan
    assert fixed_attitudes(joint, 4).tolist() == [True, False, False, False]
