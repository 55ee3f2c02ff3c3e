"""Frames in a folder: where their times are from, in which unit, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image

from alight.records import InputError
from alight.settings import load_settings
from alight.sources.frame_folder import FrameFolder
from alight.sources.frame_times import frame_times

T = 1_700_000_000
NS, US, MS = ([T * 10**n + k * 10**n // 20 for k in range(4)] for n in (9, 6, 3))
EVEN = [0, 50_000_000, 100_000_000, 150_000_000]
COUNTED = [f"frame_{k:06d}.png" for k in range(8, 12)]


@pytest.mark.parametrize(
    ("names", "unit"),
    [
        ([f"{t}.png" for t in NS], "ns"),
        ([f"left-{t}.jpg" for t in US], "us"),
        ([f"cam0_{t}.png" for t in MS], "ms"),
        ([f"frame{T + k / 20:.6f}.png" for k in range(4)], "s"),
        ([f"3_{t}.png" for t in NS], "ns"),  # another number in the name
    ],
)
def test_times_in_names_have_the_unit_of_a_cameras_interval(tmp_path: Path, names: list[str], unit: str) -> None:
    found = frame_times(tmp_path, names[::-1], None)
    assert [name for _, name in found.rows] == names
    assert [t - T * 10**9 for t, _ in found.rows] == EVEN
    assert found.source.endswith(f"in {unit}")


@pytest.mark.parametrize(
    ("names", "seconds"),
    [
        (["IMG_20240102100058", "IMG_20240102100059", "IMG_20240102100100"], [0, 1, 2]),
        (["cam_20240102105959900", "cam_20240102110000000"], [0, 0.1]),
        (["20240102_235959_900", "20240103_000000_100"], [0, 0.2]),
        (["2024-02-28_23-59-59.500", "2024-02-29_00-00-00.250"], [0, 0.75]),
        (["f240102100059_0001", "f240102100100_0002"], [0, 1]),
        (["20240102T100000", "20240102T100005"], "5 apart"),
        (["DJI_20240102100000_0001", "DJI_20240102100000_0002", "DJI_20240102100001_0003"], "have one date"),
        (["2024130210005900000", "2024130210010000000"], [0, 0.0041]),  # no month: nanoseconds since a start
    ],
)
def test_dates_in_names_are_no_numbers(tmp_path: Path, names: list[str], seconds: list[float] | str) -> None:
    names = [f"{name}.png" for name in names]
    if isinstance(seconds, str):
        with pytest.raises(InputError, match=seconds):
            frame_times(tmp_path, names, None)
        return
    found = frame_times(tmp_path, names, None).rows
    assert [(t - found[0][0], name) for t, name in found] == [
        (round(1e9 * s), name) for s, name in zip(seconds, names, strict=True)
    ]


TABLES = {  # as they are written by EuRoC, KITTI (two), exporters of bags (three), and by hand
    "data.csv": "#timestamp [ns],filename\n" + "".join(f"{t},{n}\n" for t, n in zip(NS, COUNTED, strict=True)),
    "times.txt": "".join(f"{k / 20:e}\n" for k in range(4)),
    "timestamps.txt": "".join(f"2011-09-26 13:02:25.{50 * k:03d}000000\n" for k in range(4)),
    "timestamps.csv": "".join(f"{k + 1},{n},{T}.{50 * k:03d}\n" for k, n in enumerate(COUNTED)),
    "../timestamps.csv": "frame,time_ms\n" + "".join(f"{n[:-4]};{50 * k}\n" for k, n in enumerate(COUNTED)),
    "timestamp.txt": "".join(f"images/{n} {t}\n" for t, n in zip(US, COUNTED, strict=True)),
    "times.csv": "seconds\n" + "".join(f"{k / 20}\n" for k in range(4)),
}


@pytest.mark.parametrize("name", TABLES)
def test_times_in_tables(tmp_path: Path, name: str) -> None:
    (folder := tmp_path / "images").mkdir()
    (folder / name).write_text(TABLES[name])
    found = frame_times(folder, COUNTED, None)
    assert [n for _, n in found.rows] == COUNTED
    assert [t - found.rows[0][0] for t, _ in found.rows] == EVEN
    assert Path(name).name in found.source


def test_numbers_that_name_their_frame_are_no_times(tmp_path: Path) -> None:
    names = [f"{k:010d}.png" for k in range(4)]
    (tmp_path / "times.txt").write_text("".join(f"{n[:-4]} {k / 20}\n" for k, n in enumerate(names)))
    assert [t for t, _ in frame_times(tmp_path, names, None).rows] == EVEN


@pytest.mark.parametrize(
    ("table", "why"),
    [
        ("", r"no times.*sources\.rate"),
        ("1\n2\n3\n", "no times"),  # three times of four frames
        ("#time [s]\n0\n50\n100\n150\n", "50 apart"),  # the unit of its head is wrong
        ("5\n5\n5\n5\n", "0 apart"),
    ],
)
def test_times_that_are_none_are_refused(tmp_path: Path, table: str, why: str) -> None:
    if table:
        (tmp_path / "times.txt").write_text(table)
    with pytest.raises(InputError, match=why):
        frame_times(tmp_path, COUNTED, None)


def test_a_constant_rate_counts_the_frames_in_their_natural_order(tmp_path: Path) -> None:
    found = frame_times(tmp_path, ["f10.png", "f9.png", "f11.png"], 20.0)
    assert found.rows == [(0, "f9.png"), (50_000_000, "f10.png"), (100_000_000, "f11.png")]
    assert found.source == "20 Hz as given"


def frames(folder: Path) -> Path:
    folder.mkdir(exist_ok=True)
    for t in NS:
        Image.fromarray(np.zeros((48, 64), np.uint8)).save(folder / f"{t}.png")
    return folder


def camchain(mounting: bool) -> str:
    cam = {"camera_model": "pinhole", "intrinsics": [60.0, 60, 32, 24], "distortion_model": "none",
           "resolution": [64, 48]}  # fmt: skip
    return yaml.safe_dump({"cam0": cam | ({"T_cam_imu": np.diag([1, -1, -1, 1]).tolist()} if mounting else {})})


def test_a_folder_of_frames_with_its_camchain(tmp_path: Path) -> None:
    (tmp_path / "camchain.yaml").write_text(camchain(True))
    frames(tmp_path / "images")
    (tmp_path / "images" / f"{NS[1]}.png").write_text("no picture")
    source = FrameFolder(tmp_path, load_settings(""))
    assert source.rig.cameras[0].camera.fu == 60.0
    assert [e.t_ns for e in source.events()] == [NS[0], *NS[2:]]
    assert "1 of 4 left out" in source.findings.warnings[0]


@pytest.mark.parametrize(("text", "why"), [("", "have no calibration"), (camchain(False), "T_cam_imu is missing")])
def test_frames_without_calibration_or_mounting_are_refused(tmp_path: Path, text: str, why: str) -> None:
    frames(tmp_path)
    if text:
        (tmp_path / "camchain.yaml").write_text(text)
    with pytest.raises(InputError, match=why):
        FrameFolder(tmp_path, load_settings(""))
