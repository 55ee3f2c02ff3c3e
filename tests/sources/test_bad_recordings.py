"""Damaged recordings in `alight run`: the damaged part is left out, or one line names the remedy."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from alight.cli import call
from alight.outputs.recorder import Recorder
from alight.records import Event, Frame, ImuSample, InputError, NavSample
from alight.records.codec import FlightHead
from alight.runner.opening import open_source
from alight.settings import ImuNoise, Settings, load_settings

Change = Callable[[Event], Event]


@pytest.fixture
def record(flight: Path, tmp_path: Path) -> Callable[..., Path]:
    """Return a function that writes a recording of the flight log over noise, each event changed."""

    def write(change: Change = lambda event: event, entries: tuple[tuple[str, int], ...] = ()) -> Path:
        source = open_source(flight, Settings())
        head = FlightHead(source.name, source.rig, source.local, True, ImuNoise(), Settings())
        path = tmp_path / "recording.mcap"
        recorder = Recorder(path, head)
        for event in source.events():
            recorder.event(change(event))
        for entry in entries:
            recorder.entry(*entry)
        recorder.close()
        return path

    return write


def ran(path: Path, capsys: pytest.CaptureFixture[str]) -> tuple[int, str, str]:
    """Run a recording; return exit code, stdout and stderr."""
    code = call(["run", str(path), "--out", str(path.parent / "out")])
    told = capsys.readouterr()
    assert "could not be made" not in told.err
    return code, told.out, told.err


def of_kind(kind: type, **values: Any) -> Change:
    """Return a function that changes the events of a kind."""
    return lambda event: replace(event, **values) if isinstance(event, kind) else event


def test_a_whole_one_is_replayed(record: Callable[..., Path], capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = ran(record(), capsys)
    assert code == 0
    assert out.startswith("NO SITE")
    assert "left out" not in err


def test_a_height_without_position_is_kept(record: Callable[..., Path]) -> None:
    source = open_source(record(of_kind(NavSample, position_world=None, height_world=31.5)), Settings())
    rows = [e for e in source.events() if isinstance(e, NavSample)]
    assert {(r.position_world, r.height_world) for r in rows} == {(None, 31.5)}


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (of_kind(NavSample, position_world=np.full(3, 1e300)), "position_world is out of range"),
        (of_kind(NavSample, position_world=np.zeros(2)), "position_world is out of range"),
        (of_kind(NavSample, velocity_world=np.full(3, np.nan)), "velocity_world is out of range"),
        (of_kind(NavSample, world_from_body=np.ones((3, 3))), "no rotation"),
        (of_kind(NavSample, height_world=1e300), "height_world is out of range"),
        (of_kind(NavSample, sigma_position=np.full(3, 1e-300)), "sigma_position is out of range"),
        (of_kind(ImuSample, specific_force_body=np.full(3, 1e200)), "specific_force_body is out of range"),
        (of_kind(ImuSample, angular_velocity_body=np.full(3, np.nan)), "angular_velocity_body is out of range"),
        (of_kind(ImuSample, t_ns=-5), "its time is out of range"),
        (of_kind(Frame, images=(np.zeros((3, 3), np.uint8),)), "its images are not those of the cameras"),
    ],
)
def test_what_no_aircraft_measures_is_left_out(
    change: Change, why: str, record: Callable[..., Path], capsys: pytest.CaptureFixture[str]
) -> None:
    code, _, err = ran(record(change), capsys)
    assert code in (0, 2)
    assert why in err
    assert "Traceback" not in err


@pytest.mark.parametrize("share", [0.0, 0.13, 0.5, 0.97])
@pytest.mark.parametrize("how", ["cut", "zeros"])
def test_the_end_is_missing(
    how: str, share: float, record: Callable[..., Path], capsys: pytest.CaptureFixture[str]
) -> None:
    """Found by the fuzzer: a file that ends in zeros ended in `struct.error`."""
    path = record()
    data = path.read_bytes()
    kept = data[: int(share * len(data))]
    path.write_bytes(kept + bytes(len(data) - len(kept)) * (how == "zeros"))
    code, out, err = ran(path, capsys)
    if code == 2:  # the head or all exposures are gone
        assert share < 0.5
        assert err.count("\n") == 1
    else:
        assert (code, out[:7], share > 0) == (0, "NO SITE", True)
        assert "the recording ends early" in err


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b'"latitude": 48.1', b'"latitude": 4810'), (b'"latitude": 48.1', b'"latitude": "ab"'),
        (b'"fu": 50.0', b'"fu": 0.00'), (b'"fu": 50.0', b'"fu": 1e99'), (b'"width": 64', b'"width": -4'),
        (b'"cameras"', b'"camerae"'), (b'"p_safe": 0.95', b'"p_safe": 9.95'),
    ],
)  # fmt: skip
def test_a_damaged_head_is_refused(
    old: bytes, new: bytes, record: Callable[..., Path], capsys: pytest.CaptureFixture[str]
) -> None:
    path = record()
    data = path.read_bytes()
    assert old in data
    assert len(new) <= len(old)
    path.write_bytes(data.replace(old, new.ljust(len(old)), 1))
    code, _, err = ran(path, capsys)
    assert code == 2
    assert "head is damaged" in err
    assert err.count("\n") == 1


def test_a_damaged_schedule_is_said(record: Callable[..., Path], capsys: pytest.CaptureFixture[str]) -> None:
    path = record(entries=(("mapped", 5),))
    data = path.read_bytes()
    entry = b'"kind": "mapped", "t_ns"'
    assert entry in data
    path.write_bytes(data.replace(entry, entry.replace(b"t_ns", b"t_no")))
    code, _, err = ran(path, capsys)
    assert code == 0
    assert "schedule messages: 1 left out" in err


def test_each_message_that_is_left_out_counts(record: Callable[..., Path]) -> None:
    source = open_source(record(of_kind(NavSample, velocity_world=np.full(3, np.nan))))
    for _ in range(2):  # a second reading finds the same ones
        assert sum(isinstance(e, NavSample) for e in source.events()) == 0
    assert source.warnings == ["nav messages: 12 left out (first: number 1 of 12: velocity_world is out of range)"]
    assert source.counts == {
        "cameras messages": 6, "nav messages": 12, "imu messages": 60, "nav messages left out": 12, "exposures": 6,
    }  # fmt: skip


def test_skip_and_every_of_a_recording(record: Callable[..., Path]) -> None:
    path = record()
    whole = [e.t_ns for e in open_source(path).events() if isinstance(e, Frame)]
    source = open_source(path, load_settings("", ["sources.skip=1", "sources.every=2"]))
    assert [e.t_ns for e in source.events() if isinstance(e, Frame)] == whole[1::2]
    assert source.length == source.counts["exposures"] == 3
    with pytest.raises(InputError, match=r"no exposure is left; lower sources\.skip \(6\)"):
        open_source(path, load_settings("", ["sources.skip=6"]))


def test_the_settings_of_an_earlier_version_are_read(
    record: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Unknown keys are left out; of a head that cannot be read the file is named."""
    written = FlightHead.to_json

    def earlier(head: FlightHead) -> str:
        tree = json.loads(written(head))
        tree["settings"]["tuning"]["tracks"] |= {"count": 99, "wings": 2}
        tree["settings"]["lander"] |= {"radius": 2.0, "wings": 2}
        return json.dumps(tree)

    monkeypatch.setattr(FlightHead, "to_json", earlier)
    found = open_source(record()).flown_with
    assert found is not None
    assert (found.lander.radius, found.tuning.tracks.count) == (2.0, 99)
    monkeypatch.setattr(FlightHead, "to_json", lambda head: "{}")
    with pytest.raises(InputError, match=r"recording\.mcap: the recording's head is damaged"):
        open_source(record())
