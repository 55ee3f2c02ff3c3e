"""Places where a command runs: odd names, closed streams, signals, and a folder in use by another process."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any

import pytest
from damage import write_flight, write_photos
from length import first
from refusal import Refused

from alight.cli import call

ROOT = Path(__file__).parents[1]
COMMAND = [sys.executable, "-c", "from alight.cli import main; main()"]
ASCII = {"LC_ALL": "C", "LANG": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "PYTHONIOENCODING": "ascii"}
LEFT = {"run.json", "report.html", "sites.geojson", "trajectory.tum", "trajectory.csv"}  # of a flight over noise


BOTH = """
import sys
from alight.cli import call
flight, out = sys.argv[1:]
print("ran:", call(["run", flight, "--out", out]))
sys.exit(call(["evaluate", out, "--truth", flight]))
"""


def environment(**more: str) -> dict[str, str]:
    """Return the environment of this process, with the package."""
    return os.environ | {"PYTHONPATH": str(ROOT / "src")} | more


def alight(*arguments: str | bytes | Path, **how: Any) -> tuple[int, str, str]:
    """Run a command; return exit code, stdout and stderr."""
    env = environment(**how.pop("env", {}))
    done = subprocess.run([*COMMAND, *arguments], env=env, capture_output=True, timeout=300, **how)
    return done.returncode, done.stdout.decode(errors="replace"), done.stderr.decode(errors="replace")


def names(out: Path) -> set[str]:
    """Return the names in a folder."""
    return {p.name for p in out.iterdir()}


def whole(out: Path) -> None:
    """Assert that the folder holds a finished run and nothing else."""
    assert names(out) == LEFT
    assert "alight" in json.loads((out / "run.json").read_text(encoding="utf-8"))


def test_somebody_elses_raster_is_not_overwritten(flight: Path, tmp_path: Path, refused: Refused) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "dem.tif").write_bytes(b"a survey of a year")
    refused(["run", flight, "--out", tmp_path / "out"], "holds files that are not a run's")
    assert (tmp_path / "out" / "dem.tif").read_bytes() == b"a survey of a year"


def test_a_full_standard_output_loses_nothing(flight: Path, tmp_path: Path) -> None:
    with Path("/dev/full").open("wb") as full:
        done = subprocess.run(
            [*COMMAND, "run", flight, "--out", tmp_path / "out"],
            env=environment(), stdout=full, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
    assert done.returncode == 2
    assert "error: standard output: cannot be written (No space left on device)" in done.stderr
    whole(tmp_path / "out")


@pytest.mark.parametrize("closed", first(1, ["<&- >&- 2>&-", "<&-", ">&-", "2>&-"]))
def test_closed_streams_lose_nothing(flight: Path, tmp_path: Path, closed: str) -> None:
    script = f'exec "$@" {closed}'
    done = subprocess.run(
        ["sh", "-c", script, "sh", *COMMAND, "run", flight, "--out", tmp_path / "out"], env=environment()
    )
    assert done.returncode == 0
    whole(tmp_path / "out")


@pytest.mark.parametrize("env", first(1, [ASCII, {}]), ids=["ascii", "utf-8"])
def test_folder_names_that_are_no_utf_8(tmp_path: Path, env: dict[str, str]) -> None:
    flight, out = (Path(os.fsdecode(os.fsencode(tmp_path) + name)) for name in (b"/fl\xff\xc3g", b"/o\xfft"))
    write_flight(flight)
    words = os.fsencode(flight), os.fsencode(out)
    done = subprocess.run([sys.executable, "-c", BOTH, *words], env=environment(**env), capture_output=True)
    answer, err = done.stdout.decode(errors="replace"), done.stderr.decode(errors="replace")
    assert answer.startswith("NO SITE"), err
    whole(out)
    assert "Traceback" not in err
    assert done.returncode in (0, 2)
    assert "ran: 0\n" in answer


def test_photo_names_that_are_no_utf_8(tmp_path: Path) -> None:
    photos = write_photos(tmp_path / "survey")
    for k, path in enumerate(sorted(photos.iterdir())):
        path.rename(os.fsdecode(os.fsencode(photos) + b"/\xff\xfe" + str(k).encode() + b".JPG"))
    (Path(os.fsdecode(os.fsencode(photos) + b"/\xffbad.JPG"))).write_bytes(b"no picture")
    code, _, err = alight("run", photos, "--out", tmp_path / "out", env=ASCII)
    assert code == 0, err
    assert json.loads((tmp_path / "out" / "run.json").read_text(encoding="utf-8"))["warnings"]


def test_two_runs_into_one_folder(flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    command = ["run", str(flight), "--out", str(out)]
    script = (
        "import sys, pathlib; from alight.outputs import prepare_folder; "
        "prepare_folder(pathlib.Path(sys.argv[1])); print('held', flush=True); sys.stdin.read()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", script, out], env=environment(), stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as first:
        assert first.stdout is not None
        assert first.stdout.readline() == b"held\n"
        assert call(command) == 2
        err = capsys.readouterr().err.replace("\n", " ")
        assert f"another run writes there (process {first.pid}); wait for its end" in err
        assert first.stdin is not None
        first.stdin.close()
    assert call(command) == 0
    whole(out)


@pytest.fixture
def running(flight: Path, tmp_path: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Start a run and wait until it has locked its folder."""
    out = tmp_path / "out"
    with subprocess.Popen(
        [*COMMAND, "run", flight, "--out", out], env=environment(), stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        end = time.monotonic() + 300
        while not (out / ".alight.lock").exists() and time.monotonic() < end:
            time.sleep(0.01)
        yield process


ENDINGS = list(product((signal.SIGTERM, signal.SIGKILL, signal.SIGINT), (0.0, 0.2, 0.5)))  # and s after the start
ENDINGS = ENDINGS[::4] + [e for k, e in enumerate(ENDINGS) if k % 4]  # each signal and each moment once, then the rest


@pytest.mark.parametrize("ending", first(2, ENDINGS))
def test_a_run_that_is_ended_leaves_nothing_that_harms_the_next(
    running: subprocess.Popen[bytes], flight: Path, tmp_path: Path, ending: tuple[signal.Signals, float]
) -> None:
    how, moment = ending
    time.sleep(moment)
    running.send_signal(how)
    _, err = running.communicate(timeout=300)
    codes = {signal.SIGTERM: (143, 0), signal.SIGKILL: (-9, 0), signal.SIGINT: (130, 0)}
    assert running.returncode in codes[how]
    assert b"Traceback" not in err
    if how != signal.SIGKILL:
        left = names(tmp_path / "out")
        assert not left or left <= LEFT | {".alight.lock"}
    assert call(["run", str(flight), "--out", str(tmp_path / "out")]) == 0
    whole(tmp_path / "out")
