"""Bags that are read while another program writes them."""

from __future__ import annotations

import shutil
import sqlite3
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from drawn_bags import FORMATS, Drawn, messages_of_flight, write_bag

from alight.cli import call
from alight.records import Event, Frame, ImuSample, NavSample
from alight.runner.opening import open_source
from alight.settings import Settings
from alight.sources.bags.growing_bag import open_growing_bag
from alight.sources.bags.growth import Growth

Step = Callable[[], None]


def by_bytes(source: Path, target: Path, share: float) -> Step:
    """Write the first part of a file; return what writes the rest, in pieces."""
    data = source.read_bytes()
    at = int(share * len(data))
    target.write_bytes(data[:at])

    def rest() -> None:
        with target.open("ab", buffering=0) as file:
            for k in range(at, len(data), 100_000):
                file.write(data[k : k + 100_000])
                time.sleep(0.002)

    return rest


def by_rows(source: Path, target: Path, share: float) -> Step:
    """Write the first messages of a database; return what writes the others."""
    with sqlite3.connect(source) as base:
        dump = [line for line in base.iterdump() if line not in ("BEGIN TRANSACTION;", "COMMIT;")]
        count = base.execute("SELECT max(id) FROM messages").fetchone()[0]
    base.close()

    def write(lines: list[str]) -> None:
        with sqlite3.connect(target) as grown:
            for line in lines:
                grown.execute(line)
        grown.close()

    is_later = [
        line.startswith('INSERT INTO "messages"') and int(line.split("(", 1)[1].split(",")[0]) > share * count
        for line in dump
    ]
    write([line for line, later in zip(dump, is_later, strict=True) if not later])
    return lambda: write([line for line, later in zip(dump, is_later, strict=True) if later])


def numbers(event: Event) -> list[np.ndarray]:
    """All numbers of an event."""
    values = vars(event) | {"name": 0} if isinstance(event, Frame) else vars(event)
    known = [v for value in values.values() for v in (value if isinstance(value, tuple) else (value,))]
    return [np.asarray(np.nan if v is None else v) for v in known]


@pytest.mark.parametrize("form", FORMATS)
def test_a_bag_that_is_being_written_has_the_events_of_the_closed_one(flight: Path, tmp_path: Path, form: str) -> None:
    filler = Drawn("/log", "std_msgs/msg/String", 0, {"data": "x" * 600_000})  # so that chunks are filled
    drawn = [
        one for m in messages_of_flight(flight) for one in (m, filler._replace(t_ns=m.t_ns))[: 1 + ("Image" in m.type)]
    ]
    whole = write_bag(tmp_path / "whole", form, drawn)
    file = whole if whole.is_file() else next(p for p in whole.iterdir() if p.suffix != ".yaml")
    target = tmp_path / "growing" / file.name
    target.parent.mkdir()
    rest = (by_rows if form == "sqlite3" else by_bytes)(file, target, 0.6)
    source = open_growing_bag(target.parent, Settings(), {}, Growth(idle=2.0), patience=10.0, begin=0.15)
    events = source.events()
    found = [next(events)]
    writing = threading.Thread(target=rest)
    writing.start()
    found += events
    writing.join()
    assert not source.warnings
    want = list(open_source(whole).events())
    for kind in (Frame, ImuSample, NavSample):
        one, other = ([e for e in group if isinstance(e, kind)] for group in (found, want))
        assert len(one) == len(other) > 0
        for a, b in zip(one, other, strict=True):
            for x, y in zip(numbers(a), numbers(b), strict=True):
                np.testing.assert_allclose(x, y, rtol=0, atol=1e-12)


def test_parts_that_appear_later_are_read_until_the_folder_is_closed(flight: Path, tmp_path: Path) -> None:
    drawn, folder = list(messages_of_flight(flight)), tmp_path / "split"
    folder.mkdir()
    halves = [
        write_bag(tmp_path / f"part{k}", "mcap", part)
        for k, part in enumerate((drawn[: len(drawn) // 2], drawn[len(drawn) // 2 :]))
    ]
    shutil.copy(next(halves[0].glob("*.mcap")), folder / "flight_0.mcap")
    source = open_growing_bag(folder, Settings(), {}, Growth(idle=60.0), patience=10.0, begin=0.1)
    events = source.events()
    found = [next(events)]
    shutil.copy(next(halves[1].glob("*.mcap")), folder / "flight_1.mcap")
    (folder / "metadata.yaml").touch()
    found += events
    assert len([e for e in found if isinstance(e, Frame)]) == 6


def test_a_bag_that_does_not_come_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("alight.sources.live.PATIENCE", 0.1)
    assert call(["live", str(tmp_path / "no.mcap"), "--follow", "--out", str(tmp_path / "out")]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "no message of ROS appears; name the bag that is being written" in err
