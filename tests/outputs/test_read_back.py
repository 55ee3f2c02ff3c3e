"""Damaged files of earlier runs, read back by the commands: one line and exit code 2, or the work is done again."""

from __future__ import annotations

import io
import json
import os
import struct
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
from damage import UNSMOOTHED, campaign_line, write_campaign
from length import first, first_rows
from refusal import Refused
from some_run import some_run

from alight.cli import call
from alight.outputs import folder, write_run
from alight.outputs.folder import WORK
from alight.outputs.recorder import Recorder
from alight.outputs.ros_messages import RosMessage
from alight.photos.work import saved
from alight.records.campaign import LandingRecord
from alight.records.codec import CAMERAS, IMU, NAV, NOTES, SCHEDULE, FlightHead
from alight.runner.opening import open_source
from alight.settings import ImuNoise, Settings
from alight.trials.campaign import run as campaign_run

DAMAGED = {
    "nested a thousand deep": b"[" * 1000 + b"]" * 1000,
    "mappings a thousand deep": b'{"alight":' * 1000 + b"1" + b"}" * 1000,
    "an integer of 5,000 digits": b'{"alight": ' + b"9" * 5000 + b"}",
    "a list": b"[1, 2]",
    "a word": b'"alight"',
    "wrong types": b'{"alight": 5, "seed": [], "scenes": 1, "landings": "many", "settings": 0, "answer": [], "key": 1}',
    "cut off": b'{"alight": "0.1.0", "seed"',
    "not UTF-8": b'{"alight": "\xff\xfe"}',
    "empty": b"",
    "zeros": bytes(100),
}
PIPE = b"a pipe"
Told = pytest.CaptureFixture[str]
each_damage = pytest.mark.parametrize("data", [*DAMAGED.values(), PIPE], ids=[*DAMAGED, "a pipe"])


def damage(path: Path, data: bytes) -> None:
    """Replace a file by other bytes or by a pipe."""
    path.unlink(missing_ok=True)
    if data is PIPE:
        os.mkfifo(path)
    else:
        path.write_bytes(data)


# -- campaigns


@pytest.fixture
def campaigns(tmp_path: Path) -> tuple[Path, Path]:
    """Write two campaigns whose landings are all flown."""
    return write_campaign(tmp_path / "one"), write_campaign(tmp_path / "two")


@pytest.fixture
def grounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fail the test if a landing is flown."""
    monkeypatch.setattr(campaign_run, "fly_conditions", lambda *_: pytest.fail("a landing was flown"))


def test_a_campaign_that_is_whole_goes_on_and_is_compared(campaigns: tuple[Path, Path], capsys: Told) -> None:
    one, two = map(str, campaigns)
    assert call(["campaign", "--out", one, "--compare", two]) == 0
    said = capsys.readouterr()
    assert "rightly refused  3" in said.out
    assert said.err == ""


@each_damage
@pytest.mark.usefixtures("grounded")
def test_the_head_of_a_campaign(campaigns: tuple[Path, Path], data: bytes, refused: Refused) -> None:
    one, two = campaigns
    damage(two / "campaign.json", data)
    for command in (["--out", str(two)], ["lake", "--out", str(two)], ["--out", str(one), "--compare", str(two)],
                    ["--out", str(two), "--only", "1"]):  # fmt: skip
        refused(["campaign", *command], "two/campaign.json: is not a campaign's (", "name another folder")


@each_damage
@pytest.mark.usefixtures("grounded")
def test_a_line_of_a_campaign(campaigns: tuple[Path, Path], data: bytes, refused: Refused) -> None:
    one, two = campaigns
    path = two / "landings.jsonl"
    whole = path.read_bytes().splitlines(keepends=True)
    damage(path, data if data is PIPE else whole[0] + (data or b" ") + b"\n" + whole[2])
    why = "landings.jsonl: cannot be read (is a pipe" if data is PIPE else "landings.jsonl: line 2 is damaged ("
    for command in (
        ["--out", str(two)],
        ["--out", str(one), "--compare", str(two)],
        ["--out", str(two), "--only", "1"],
    ):
        refused(["campaign", *command], why)


@pytest.mark.parametrize("data", first(3, filter(None, DAMAGED.values())), ids=[k for k, v in DAMAGED.items() if v])
def test_the_last_line_of_a_campaign_is_flown_again(
    campaigns: tuple[Path, Path], data: bytes, monkeypatch: pytest.MonkeyPatch, capsys: Told
) -> None:
    one, two = campaigns
    path = two / "landings.jsonl"
    whole = path.read_bytes()
    for end in (b"", b"\n"):
        path.write_bytes(b"".join(whole.splitlines(keepends=True)[:2]) + data + end)
        assert call(["campaign", "--out", str(one), "--compare", str(two)]) == 0
        assert "its last line is not whole (" in capsys.readouterr().err
        monkeypatch.setattr(campaign_run, "fly_all", lambda drawn, *_: [_again(c.landing) for c in drawn])
        assert call(["campaign", "--out", str(two)]) == 0
        assert [json.loads(line)["conditions"]["landing"] for line in path.read_text().splitlines()] == [0, 1, 2]


def _again(landing: int) -> tuple[object, None, None]:
    return LandingRecord.model_validate(campaign_line(landing)), None, None


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"seconds": float("nan")}, "seconds"), ({"p_found": float("inf")}, "p_found"), ({"outcome": "won"}, "outcome"),
        ({"picture": "../../secret.webp"}, "picture"), ({"picture": "/etc/passwd"}, "picture"),
        ({"more": 1}, "more"), ({"looks": [1]}, "looks.0"), ({"why": "x" * 2_000_000}, "longer than"),
    ],
)  # fmt: skip
def test_a_value_of_a_landing(
    campaigns: tuple[Path, Path], change: dict[str, object], word: str, refused: Refused
) -> None:
    path = campaigns[0] / "landings.jsonl"
    lines = path.read_text().splitlines()
    path.write_text("\n".join([lines[0], json.dumps(json.loads(lines[1]) | change), lines[2], ""]))
    refused(["campaign", "--out", str(campaigns[0])], "line 2 is damaged (", word)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"landings": 10**12}, "landings"), ({"landings": 0}, "landings"), ({"seed": -1}, "seed"),
        ({"scenes": []}, "scenes"), ({"scenes": ["nowhere"]}, "no scene is called 'nowhere'"),
        ({"settings": {"lander": {"radius": "wide"}}}, "lander.radius"), ({"alight": "0.0.9"}, "version 0.0.9"),
        ({"settings": {"lander": 5}}, "other settings"),
    ],
)  # fmt: skip
def test_a_value_of_the_head(
    campaigns: tuple[Path, Path], change: dict[str, object], word: str, refused: Refused
) -> None:
    path = campaigns[0] / "campaign.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    refused(["campaign", "--out", str(campaigns[0])], word)


@pytest.mark.parametrize("data", [PIPE, None, bytes(2_000_000)], ids=["a pipe", "none", "too large"])
def test_the_picture_of_a_touchdown(campaigns: tuple[Path, Path], data: bytes | None, capsys: Told) -> None:
    one = campaigns[0]
    touch = {"t": 9, "east": 0, "north": 0, "safe": False, "reasons": ["ground"], "tilt": 0, "roughness": 0,
             "sink": 0.5, "drift": 0}  # fmt: skip
    line = campaign_line(0) | {"outcome": "landed unsafely", "touchdown": touch, "picture": "landing-00000.webp"}
    lines = [json.dumps(x) + "\n" for x in (line, campaign_line(1), campaign_line(2))]
    (one / "landings.jsonl").write_text("".join(lines))
    if data is not None:
        damage(one / "landing-00000.webp", data)
    assert call(["campaign", "--out", str(one)]) == 0
    assert "the report shows no picture of that touchdown" in capsys.readouterr().err
    assert "one unsafe touchdown" in (one / "campaign.html").read_text()


# -- runs


@each_damage
def test_run_json_of_an_earlier_run(data: bytes, flight: Path, tmp_path: Path, refused: Refused) -> None:
    out = tmp_path / "out"
    write_run(some_run(), out)
    damage(out / "run.json", data)
    refused(["evaluate", out, "--truth", flight], "run.json")
    if data != DAMAGED["wrong types"]:  # these do not prove that it is no run
        refused(["run", flight, "--out", out], "holds files that are not a run's")


@each_damage
def test_whose_work_it_was(data: bytes, photos: Path, tmp_path: Path, refused: Refused) -> None:
    pytest.importorskip("pycolmap")
    work = tmp_path / "out" / WORK
    work.mkdir(parents=True)
    damage(work / "run.json", data)
    refused(["run", photos, "--out", tmp_path / "out", "--resume"])


@pytest.fixture
def unfinished(photos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the saved work of a run over photos, which is not removed."""
    pytest.importorskip("pycolmap")
    with monkeypatch.context() as patch:
        patch.setattr(folder, "remove_work", lambda out: None)
        assert call(["run", str(photos), "--out", str(tmp_path / "out")]) == 0
    assert list((tmp_path / "out" / WORK).glob("*.part"))
    return tmp_path / "out" / WORK


@each_damage
def test_a_piece_of_work_is_done_again(data: bytes, unfinished: Path, photos: Path, capsys: Told) -> None:
    for path in unfinished.glob("*.part"):
        damage(path, data)
    assert call(["run", str(photos), "--out", str(unfinished.parent), "--resume"]) == 0
    assert capsys.readouterr().out.startswith("NO SITE")


@pytest.mark.parametrize("tree", DAMAGED.values(), ids=DAMAGED)
def test_a_piece_of_work_that_pretends_to_be_whole(
    tree: bytes, unfinished: Path, photos: Path, monkeypatch: pytest.MonkeyPatch, capsys: Told, refused: Refused
) -> None:
    capsys.readouterr()
    monkeypatch.setattr(saved, "is_whole", lambda data, about: True)
    for path in unfinished.glob("*.part"):
        archive = io.BytesIO()
        np.savez(archive, tree=np.array(tree.decode("latin-1")))
        damage(path, bytes(16) + lz4.frame.compress(archive.getvalue()))
    refused(
        ["run", photos, "--out", unfinished.parent, "--resume"],
        "the saved work ",
        "is damaged; run without --resume to begin anew",
    )


@pytest.mark.parametrize("data", [None, PIPE], ids=["none", "a pipe"])
def test_poses_of_photos(data: bytes | None, photos: Path, tmp_path: Path, refused: Refused) -> None:
    path = tmp_path / "poses.tum"
    if data is not None:
        damage(path, data)
    refused(["run", photos, "--out", tmp_path / "out", "--poses", path], "poses.tum")


# -- recordings


Record = Callable[[str, bytes], Path]


@pytest.fixture
def record(flight: Path, tmp_path: Path) -> Record:
    """Return a function that writes a recording of the flight log over noise, with these bytes as its last message."""

    def write(topic: str, data: bytes) -> Path:
        source = open_source(flight, Settings())
        head = FlightHead(source.name, source.rig, source.local, True, ImuNoise(), Settings())
        recorder = Recorder(tmp_path / "recording.mcap", head)
        for event in source.events():
            recorder.event(event)
        text = b"\0\1\0\0" + struct.pack("<I", len(data) + 1) + data + b"\0"
        recorder.put(RosMessage(topic, "std_msgs/msg/String", 1, [text]))
        recorder.close()
        return tmp_path / "recording.mcap"

    return write


TOPICS = (SCHEDULE, NOTES, NAV, IMU, CAMERAS)
# each damage in one message in turn, then in the others
MESSAGES = [(TOPICS[(k + turn) % 5], data) for turn in range(5) for k, data in enumerate(DAMAGED.values())]


@pytest.mark.parametrize(("topic", "data"), first_rows(len(DAMAGED), MESSAGES), ids=[*DAMAGED] * 5)
def test_a_message_of_a_recording(topic: str, data: bytes, record: Record, tmp_path: Path, capsys: Told) -> None:
    assert call(["run", str(record(topic, data)), "--out", str(tmp_path / "out"), *UNSMOOTHED]) == 0
    said = capsys.readouterr()
    assert said.out.startswith("NO SITE")
    assert f"{topic[1:]} messages: 1 left out" in said.err


@pytest.mark.parametrize("head", [k for k in DAMAGED if k != "not UTF-8"])
def test_the_head_of_a_recording(
    head: str, record: Record, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: Refused
) -> None:
    monkeypatch.setattr(FlightHead, "to_json", lambda self: DAMAGED[head].decode())
    path = record(NOTES, b"{}")
    refused(["run", path, "--out", tmp_path / "out"], "the recording's head is damaged")
