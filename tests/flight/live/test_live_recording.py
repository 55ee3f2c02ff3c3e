"""The recording of a live run: it replays bit for bit, survives any end of the run, and a full disk costs no flight."""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from refusal import Refused
from some_run import some_run
from stereo_flight import SMALL, flight
from waiting import wait_until

import alight_sim
from alight.cli import call
from alight.flight.live import run
from alight.flight.live.live import Listener, Live, LiveOptions
from alight.outputs import write_run
from alight.outputs.folder_lock import release_folder
from alight.outputs.recorder import Recorder, make_room
from alight.records import (
    Frame,
    ImuSample,
    InputError,
    Motion,
    NavSample,
    OutputError,
    Schedule,
)
from alight.records.codec import FlightHead
from alight.runner import replay
from alight.runner.opening import open_source
from alight.settings import load_settings

RASTERS = ("dem.tif", "flags.tif", "terrain.tif", "safe.tif", "reasons.tif", "ortho.tif")


def head() -> FlightHead:
    f = flight()[0]
    return FlightHead(f.name, f.rig, f.local, True, f.imu_noise, load_settings("", SMALL))


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory, warm: None) -> Path:
    """Write the flight as a log."""
    folder = tmp_path_factory.mktemp("log") / "flight"
    alight_sim.write(flight()[0], folder)
    return folder


def command(*words: str | Path) -> list[str]:
    code = "import sys; from alight.cli import main; sys.argv[0] = 'alight'; main()"
    return [sys.executable, "-c", code, *(str(w) for w in words)]


def assignments() -> list[str]:
    return [word for s in SMALL for word in ("--set", s)]


# -- content of a recording


def test_every_event_comes_back_bit_for_bit(tmp_path: Path) -> None:
    recorder, events = Recorder(tmp_path / "recording.mcap", head()), list(flight()[1][:40])
    camera = flight()[0].rig.cameras[1].camera
    picture = np.random.default_rng(0).integers(0, 255, (camera.height, camera.width), np.uint8)
    events.append(Frame(7, (None, picture), "a picture"))
    assert {type(event) for event in events} == {NavSample, ImuSample, Frame}
    for event in events:
        recorder.event(event)
    recorder.close()
    for event, again in zip(events, open_source(tmp_path / "recording.mcap").events(), strict=True):
        assert type(again) is type(event)
        assert again.t_ns == event.t_ns
        if isinstance(event, Frame) and isinstance(again, Frame):
            assert again.name == event.name
            for a, b in zip(event.images, again.images, strict=True):
                assert (a is None and b is None) or (a is not None and b is not None and (a == np.asarray(b)).all())
        elif isinstance(event, NavSample | ImuSample):
            for name, value in vars(event).items():
                other = getattr(again, name)
                assert value is None or np.asarray(value).tobytes() == np.asarray(other).tobytes(), name


def test_the_head_comes_back() -> None:
    again = FlightHead.from_json(head().to_json())
    assert again.settings == head().settings
    for a, b in zip(again.rig.cameras, head().rig.cameras, strict=True):
        assert a.camera == b.camera
        assert a.body_from_cam.matrix.tobytes() == b.body_from_cam.matrix.tobytes()
    with pytest.raises(InputError, match="damaged"):
        FlightHead.from_json('{"name": 3}')


def test_the_schedule_comes_back(tmp_path: Path) -> None:
    """The schedule includes the place of each judged map, to the last bit; older recordings have none."""
    recorder, place = Recorder(tmp_path / "recording.mcap", head()), (-3.7000000000000006, 1e-7)
    recorder.event(Frame(5, (np.zeros((2, 2), np.uint8),), "a picture"))
    recorder.entry("mapped", 5, 2)
    recorder.entry("judged", 5, about=place)
    recorder.entry("judged", 6)
    recorder.close()
    found = open_source(tmp_path / "recording.mcap").schedule
    assert found == Schedule(mapped=(5,), effort=(2,), judged=(5, 6), about=(place, None))


def test_a_file_that_is_no_recording_says_so(tmp_path: Path) -> None:
    wrong = tmp_path / "a.mcap"
    wrong.write_bytes(b"no MCAP at all")
    with pytest.raises(InputError, match="no recording"):
        open_source(wrong)


def test_a_recording_that_is_cut_anywhere_gives_what_it_has(tmp_path: Path) -> None:
    path = tmp_path / "whole.mcap"
    recorder = Recorder(path, head())
    for e in flight()[1][:200]:
        recorder.event(e)
    recorder.close()
    whole = open_source(path)
    assert [e.t_ns for e in whole.events()] == [e.t_ns for e in flight()[1][:200]]
    assert whole.warnings == []
    data = path.read_bytes()
    rng, seen = np.random.default_rng(3), set[int]()
    for cut in rng.integers(len(data) // 2, len(data) - 1, 8):
        (tmp_path / "cut.mcap").write_bytes(data[:cut])
        part = open_source(tmp_path / "cut.mcap")
        count = len(list(part.events()))
        seen.add(count)
        assert any("ends early" in w for w in part.warnings) or count == 200
    assert len(seen) > 1


# -- a disk that fails


def test_a_disk_that_is_full_at_the_start_says_so() -> None:
    """Writing to /dev/full fails at once."""
    if not Path("/dev/full").exists():
        pytest.skip("this system has no /dev/full")
    with pytest.raises(OutputError, match="the disk is full"):
        Recorder(Path("/dev/full"), head())


def test_a_disk_that_gets_full_costs_the_recording_and_not_the_flight(tmp_path: Path) -> None:
    """Files of this process may not grow beyond 1 MB, which is nine exposures."""
    recorder, motions = Recorder(tmp_path / "recording.mcap", head()), list[Motion]()
    options = LiveOptions(Listener(motions.append), recorder, drop=False)
    run = Live(flight()[0].rig, load_settings("", ["sites.every=0", *SMALL]), options)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, before[1]))
    try:
        for e in flight()[1]:
            run.feed(e)
        recorder.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    run.finish()
    assert len(motions) == 22
    assert recorder.lost["the disk is full"] > 500
    assert "the disk is full" in recorder.warnings[0]
    assert 5 <= sum(isinstance(e, Frame) for e in open_source(tmp_path / "recording.mcap").events()) < 10


def test_a_disk_that_is_too_slow_costs_messages(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "slow.mcap", head(), waiting_mb=0.05)
    for e in flight()[1]:
        if isinstance(e, Frame):
            recorder.event(e)  # 115 kB each: more than the queue may hold
    recorder.close()
    assert recorder.lost["the disk is too slow"] == 22
    assert "22 messages are missing" in recorder.warnings[0]


def test_a_folder_that_cannot_be_written_says_so(tmp_path: Path) -> None:
    with pytest.raises(OutputError):
        Recorder(tmp_path / "none" / "recording.mcap", head())


# -- recordings of earlier runs in the folder


def test_only_the_recording_of_a_finished_run_makes_room(tmp_path: Path) -> None:
    path = tmp_path / "recording.mcap"
    assert make_room(path) is None
    for k in (1, 2):
        path.write_bytes(b"flight %d" % k)
        assert make_room(path) == tmp_path / f"recording-{k}.mcap"
        assert (tmp_path / f"recording-{k}.mcap").read_bytes() == b"flight %d" % k
    write_run(some_run(), tmp_path, overwrite=True)
    source = tmp_path.with_name("elsewhere.mcap")
    source.write_bytes(b"precious")
    path.symlink_to(source)
    assert make_room(path) is None
    assert not path.exists()
    assert not (tmp_path / "run.json").exists()  # or it would stand beside the recording of a run that does not end
    assert source.read_bytes() == b"precious"


def test_a_live_run_keeps_the_recording_of_one_that_crashed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(run, "Live", lambda *_, **__: SimpleNamespace(close=lambda: None))
    out = tmp_path / "out"
    out.mkdir()
    for name in (".alight.lock", "recording.mcap"):
        (out / name).write_bytes(b"1")
    run.LiveRun(flight()[0], run.LiveRequest(out, load_settings())).close()
    release_folder(out)
    assert (out / "recording-1.mcap").read_bytes() == b"1"
    assert (out / "recording.mcap").stat().st_size > 100
    assert "is kept as recording-1.mcap" in caplog.text


@pytest.mark.parametrize("name", ["live", "run"])
def test_a_recording_is_not_flown_into_its_own_folder(
    name: str, tmp_path: Path, refused: Refused, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("alight.compiled.is_warm", lambda use="flight": True)
    for module, work in ((run, "Live"), (replay, "replay")):
        monkeypatch.setattr(module, work, lambda *_, **__: pytest.fail("the work was begun"))
    write_run(some_run(), tmp_path / "out")
    path = tmp_path / "out" / "recording.mcap"
    recorder = Recorder(path, head())
    recorder.event(next(e for e in flight()[1] if isinstance(e, Frame)))
    recorder.close()
    before = path.read_bytes()
    refused([name, path, "--force", "--out", tmp_path / "out"], f"{path}: lies in ")
    assert path.read_bytes() == before
    assert (tmp_path / "out" / "run.json").exists()


# -- the command


def test_a_live_run_flies_again_bit_for_bit(log: Path, tmp_path: Path) -> None:
    """`alight live`, then `alight run` on its recording, give the same rasters and sites, to the byte."""
    out, again = tmp_path / "live", tmp_path / "again"
    line = command("live", log, "--out", out, "--speed", "0.5", *assignments())
    subprocess.run(line, check=True, capture_output=True, timeout=600)
    assert call(["run", str(out / "recording.mcap"), "--out", str(again)]) == 0
    for name in RASTERS:
        assert (out / name).read_bytes() == (again / name).read_bytes(), name
    assert (out / "sites.geojson").read_bytes() == (again / "sites.geojson").read_bytes()
    info = json.loads((out / "run.json").read_text())
    assert {"frame to pose", "map step"} <= set(info["time"])
    assert len((out / "trajectory.csv").read_text().splitlines()) == 1 + info["counts"]["frames used"]
    assert info["time"]["frame to pose"]["p95_s"] >= info["time"]["frame to pose"]["median_s"] > 0
    assert info["counts"]["frames used"] + info["counts"].get("navigation: exposures left out, busy", 0) == 22


def test_what_kill_leaves_can_be_read_and_replayed(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """After `kill -9` in flight all but the last second is there, and no lane is left behind."""
    out = tmp_path / "killed"
    run = subprocess.Popen(command("live", log, "--out", out, "--speed", "0.5", *assignments()), stdout=-3, stderr=-3)
    path = out / "recording.mcap"
    wait_until(lambda: path.exists() and path.stat().st_size > 12 * 115_000, 300.0)
    before = path.stat().st_size
    time.sleep(1.0)
    children = lanes_of(run.pid)
    assert children
    run.send_signal(signal.SIGKILL)
    run.wait()
    source = open_source(path)
    frames = [e for e in source.events() if isinstance(e, Frame)]
    assert len(frames) * 115_200 >= before * 0.9
    assert source.schedule is not None
    assert len(source.schedule.tracked) >= len(frames) - 6
    assert call(["run", str(path), "--out", str(tmp_path / "again")]) == 0
    assert "ends early" in capsys.readouterr().err.replace("\n", " ")
    wait_until(lambda: not any(alive(pid) for pid in children))


def test_ctrl_c_ends_the_flight_and_keeps_its_results(log: Path, tmp_path: Path) -> None:
    out = tmp_path / "stopped"
    run = subprocess.Popen(
        command("live", log, "--out", out, "--speed", "0.25", *assignments()), stdout=-1, stderr=-1, text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # a shell's background job ignores it
    )  # fmt: skip
    path = out / "recording.mcap"
    wait_until(lambda: run.poll() is not None or (path.exists() and path.stat().st_size > 8 * 115_000), 300.0)
    assert run.poll() is None
    run.send_signal(signal.SIGINT)
    _, said = run.communicate(timeout=120)
    assert run.returncode == 0, said
    assert "ended by Ctrl-C" in said
    assert json.loads((out / "run.json").read_text())["counts"]["frames"] < 22
    assert list(open_source(path).events())


def lanes_of(pid: int) -> list[int]:
    """Return the lanes and the fork server of a live run: its children and grandchildren."""
    found, todo = list[int](), [pid]
    while todo:
        parent = todo.pop()
        for entry in Path("/proc").glob("[0-9]*/stat"):
            try:
                fields = entry.read_text().rpartition(")")[2].split()
            except OSError:
                continue
            if int(fields[1]) == parent:
                found.append(int(entry.parent.name))
                todo.append(found[-1])
    return found


def alive(pid: int) -> bool:
    """Return whether a process exists and is no zombie."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z" and os.path.exists(f"/proc/{pid}")
