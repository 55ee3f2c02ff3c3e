"""Photos whose run is interrupted and continued: the same rasters, and only the interrupted piece is done twice."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from threading import Thread

import numpy as np
import pytest
from drawn_photos import SMALL, draw_photos
from refusal import Refused

from alight.cli import call
from alight.jobs import InTurn, Task
from alight.outputs.folder import WORK
from alight.photos.work import SavedJobs, WorkFolder
from alight.photos.work.packing import is_whole, pack_result, unpack_result
from alight.records import InputError

RASTERS = ("dem.tif", "flags.tif", "ortho.tif", "safe.tif", "reasons.tif", "terrain.tif", "trajectory.csv")


def square(x: int) -> np.ndarray:
    return np.arange(x, dtype=np.float64) ** 2


def tasks(count: int) -> list[Task]:
    return [Task(f"square-{k}", square, (k,), about=str(k)) for k in range(count)]


class Interrupting(dict[str, bytes]):
    """Raise Ctrl-C while the n-th piece is being saved."""

    def __init__(self, after: int, have: dict[str, bytes]) -> None:
        super().__init__(have)
        self._left = after

    def __setitem__(self, name: str, data: bytes) -> None:
        self._left -= 1
        if self._left < 0:
            raise KeyboardInterrupt
        super().__setitem__(name, data)


@pytest.mark.parametrize("at_once", [False, True])
@pytest.mark.parametrize("after", [0, 3, 7])
def test_nothing_is_done_twice_but_what_was_not_saved(after: int, at_once: bool) -> None:
    saved = Interrupting(after, {})
    with pytest.raises(KeyboardInterrupt):
        list(SavedJobs(InTurn(), saved).run(tasks(8), at_once))
    again = SavedJobs(InTurn(), dict(saved))
    found = list(again.run(tasks(8), at_once))
    assert again.done == [f"square-{k}" for k in range(after, 8)]
    for k, value in enumerate(found):
        np.testing.assert_array_equal(value, square(k))


def test_pieces_that_are_there_stand_in_their_place_between_those_that_are_not() -> None:
    saved = {f"square-{k}": pack_result(square(k), str(k)) for k in (1, 2, 5)}
    jobs = SavedJobs(InTurn(), saved)
    assert [len(v) for v in jobs.run(tasks(7))] == list(range(7))
    assert jobs.done == [f"square-{k}" for k in (0, 3, 4, 6)]


def test_a_piece_that_is_damaged_or_rests_on_something_else_is_done_again() -> None:
    saved = {
        "square-0": pack_result(square(0), "something else"),
        "square-1": pack_result(square(1), "1")[:-1],
        "square-2": b"",
    }
    jobs = SavedJobs(InTurn(), saved)
    list(jobs.run(tasks(3)))
    assert jobs.done == ["square-0", "square-1", "square-2"]


def test_packing_gives_the_same_bits_and_knows_no_other_kind() -> None:
    value = {
        "a": (1, 2.5, None, "text", True, [float("nan"), -0.0]),
        "b": np.array([np.nan, np.inf, -0.0, 5e-324]),
        "c": np.arange(6, dtype=np.uint16).reshape(2, 3)[:, ::-1],
    }
    data = pack_result(value, "x")
    back = unpack_result(data)
    assert is_whole(data, "x")
    assert not is_whole(data, "y")
    assert repr(back["a"]) == repr(value["a"])
    assert back["b"].tobytes() == value["b"].tobytes()
    np.testing.assert_array_equal(back["c"], value["c"])
    with pytest.raises(TypeError, match="not saved"):
        pack_result(Path("x"), "")


def test_work_of_something_else_is_refused_by_name(tmp_path: Path) -> None:
    key = {"alight": "1", "photos": "abc", "settings": {"parallax": {"cell": 0.1}}}
    WorkFolder(tmp_path, key, resume=False)["a"] = b"1"
    assert WorkFolder(tmp_path, key, resume=True)["a"] == b"1"
    with pytest.raises(InputError, match=r"cannot be resumed.* another settings.parallax.cell \(0.1, now 0.2\)"):
        WorkFolder(tmp_path, key | {"settings": {"parallax": {"cell": 0.2}}}, resume=True)
    with pytest.raises(InputError, match="another photos"):
        WorkFolder(tmp_path, key | {"photos": "b" * 64}, resume=True)
    assert len(WorkFolder(tmp_path, key, resume=False)) == 0  # started anew
    (tmp_path / WORK / "run.json").write_text("{")
    with pytest.raises(InputError, match="is damaged; run without --resume"):
        WorkFolder(tmp_path, key, resume=True)


def test_only_photos_are_resumed(tmp_path: Path, flight: Path, refused: Refused) -> None:
    refused(["run", flight, "--out", tmp_path / "out", "--resume"], "--resume: is for folders of photos")


def start(photos: Path, out: Path, *more: str) -> subprocess.Popen[bytes]:
    code = "import sys; from alight.cli import main; sys.argv = ['alight', *sys.argv[1:]]; main()"
    command = [sys.executable, "-c", code, "run", str(photos), "--out", str(out), *SMALL, *more]
    return subprocess.Popen(command, stderr=subprocess.PIPE, env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)})


def pieces(out: Path) -> set[str]:
    return {p.name for p in (out / WORK).glob("*.part")} if (out / WORK).is_dir() else set()


@pytest.fixture(scope="module")
def survey(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Draw eight small photos."""
    pytest.importorskip("pycolmap")
    return draw_photos(tmp_path_factory.mktemp("photos") / "survey")


@pytest.fixture(scope="module")
def whole(survey: Path) -> Path:
    """Return the results of a run without interruption."""
    out = survey.parent / "whole"
    assert call(["run", str(survey), "--out", str(out), *SMALL]) == 0
    assert not (out / WORK).exists()
    return out


def test_the_results_have_a_row_for_each_photo(whole: Path) -> None:
    page, rows = (whole / "report.html").read_text(), json.loads((whole / "run.json").read_text())["photos"]
    assert "What was understood of 8 photos" in page
    assert [r["name"] for r in rows] == [f"DJI_{k:04d}.JPG" for k in range(8)]
    assert all(r["used"] and r["attitude"] == r["position"] == "believed" for r in rows)
    for r in rows:
        assert r["name"] in page
    assert page.count("gimbal (believed)") == 8


def assert_same(out: Path, whole: Path) -> None:
    for name in RASTERS:
        assert (out / name).read_bytes() == (whole / name).read_bytes(), name
    one, two = (json.loads((folder / "run.json").read_text()) for folder in (out, whole))
    assert (one["notes"], one["warnings"], one["answer"]) == (two["notes"], two["warnings"], two["answer"])


def wait_for(out: Path, what: str, count: int, still: Callable[[], bool]) -> None:
    """Wait until `count` pieces of a kind are saved, or the work has ended."""
    until = time.monotonic() + 300
    while sum(name.startswith(what) for name in pieces(out)) < count and still() and time.monotonic() < until:
        time.sleep(0.02)


@pytest.mark.skipif(sys.platform == "win32", reason="needs kill -9")
def test_a_run_that_was_killed_gives_the_same_rasters(
    survey: Path, whole: Path, tmp_path: Path, refused: Refused
) -> None:
    """A run is killed among the tiles by kill -9 and then continued."""
    cut = tmp_path / "cut"
    run = start(survey, cut)
    wait_for(cut, "tile", 2, lambda: run.poll() is None)
    run.send_signal(signal.SIGKILL)
    run.communicate()
    there = {name: (cut / WORK / name).stat().st_mtime_ns for name in pieces(cut)}
    assert any(name.startswith("tile") for name in there), "it ended before it was killed"
    again = ["run", str(survey), "--out", str(cut), *SMALL]
    refused([*again, "--set", "parallax.cell=0.5", "--resume"], "another settings.parallax.cell (0.3, now 0.5)")
    assert {name: (cut / WORK / name).stat().st_mtime_ns for name in pieces(cut)} == there
    assert call([*again, "--resume"]) == 0
    assert_same(cut, whole)
    assert not (cut / WORK).exists()
    refused([*again, "--resume"], "holds a finished run")


@pytest.mark.filterwarnings("ignore")  # the cluster's own
@pytest.mark.skipif(sys.platform == "win32", reason="needs kill -9")
def test_a_cluster_gives_the_same_rasters_and_a_killed_worker_loses_nothing(
    survey: Path, whole: Path, tmp_path: Path
) -> None:
    distributed = pytest.importorskip("distributed", reason="needs the extra 'cluster'")
    out = tmp_path / "out"
    with distributed.LocalCluster(3, threads_per_worker=1, dashboard_address=None) as cluster:
        killed: list[int] = []

        def kill() -> None:
            wait_for(out, "tile", 1, lambda: True)
            killed.append(cluster.workers[0].pid)
            os.kill(killed[0], signal.SIGKILL)

        killer = Thread(target=kill, daemon=True)
        killer.start()
        assert call(["run", str(survey), "--out", str(out), *SMALL, "--scheduler", cluster.scheduler_address]) == 0
        killer.join(1)
    assert killed
    assert_same(out, whole)


def test_a_scheduler_is_for_photos_and_has_to_answer(
    survey: Path, flight: Path, tmp_path: Path, refused: Refused
) -> None:
    refused(
        ["run", flight, "--out", tmp_path / "a", "--scheduler", "tcp://127.0.0.1:9"],
        "--scheduler: is for folders of photos",
    )
    without = "distributed" not in sys.modules and find_spec("distributed") is None
    if without:
        refused(
            ["run", survey, "--out", tmp_path / "b", "--scheduler", "tcp://127.0.0.1:9"],
            "distributed (Dask) is not installed",
        )
