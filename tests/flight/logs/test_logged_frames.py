"""Frames and an autopilot's log beside them: opened, brought on one clock, and refused where that is not clear."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from autopilot_logs import Autopilot, write_dataflash
from meadow_flight import flight
from PIL import Image

from alight.checks.clock_offset import contradicted_shift
from alight.geometry import Camera
from alight.records import Frame, InputError, NavSample
from alight.runner.opening import open_source
from alight.settings import load_settings
from alight.sources import Source

AHEAD_NS = 1_699_999_940_123_456_789  # the stamps of the frames against the log, which begins at its boot


def write_frames(folder: Path) -> None:
    """Frames of the flight named by their stamps, the calibration, and the log on its own clock."""
    f, events = flight()
    for e in events:
        if isinstance(e, Frame):
            Image.fromarray(np.asarray(e.images[0])).save(folder / f"{e.t_ns}.png")
    write_calibration(folder, f.rig.cameras[0].camera)
    write_dataflash(folder / "flight.BIN", Autopilot(events, f.local, AHEAD_NS))


def write_calibration(folder: Path, lens: Camera) -> None:
    mounting = flight()[0].rig.cameras[0].body_from_cam.inverse.matrix
    cam = {
        "camera_model": "pinhole", "intrinsics": [lens.fu, lens.fv, lens.cu, lens.cv], "distortion_model": "none",
        "resolution": [lens.width, lens.height], "T_cam_imu": mounting.tolist(),
    }  # fmt: skip
    (folder / "camchain.yaml").write_text(yaml.safe_dump({"cam0": cam}))


def opened(folder: Path, *assignments: str) -> Source:
    return open_source(folder, load_settings("", assignments))


def test_frames_and_log_become_the_flight(tmp_path: Path) -> None:
    """The same events as of the flight itself, by stamps that are right to 10 ms; a table of what was found."""
    write_frames(tmp_path)
    source, events = opened(tmp_path), flight()[1]
    frames = [e for e in source.events() if isinstance(e, Frame)]
    was = [e for e in events if isinstance(e, Frame)]
    assert len(frames) == len(was) == source.length
    off = np.array([e.t_ns + AHEAD_NS - w.t_ns for e, w in zip(frames, was, strict=True)]) * 1e-9
    assert np.abs(off).max() < 0.01
    nav = {e.t_ns + AHEAD_NS: e for e in source.events() if isinstance(e, NavSample)}
    for w in (e for e in events if isinstance(e, NavSample) and e.t_ns in nav):
        enu = flight()[0].local.to_enu(*source.local.to_geodetic(nav[w.t_ns].position_world))
        np.testing.assert_allclose(enu, w.position_world, atol=0.02)
    assert source.georeferenced
    assert any("ATT" in line and "20 Hz" in line for line in source.notes["log"])
    assert "names of the frames, in ns" in source.notes["log"][-1]
    given = opened(tmp_path, f"sources.time_offset={AHEAD_NS * 1e-9}")
    assert next(e for e in given.events() if isinstance(e, Frame)).t_ns == pytest.approx(
        was[0].t_ns - AHEAD_NS, abs=1e4
    )


@pytest.mark.parametrize(("late", "warned"), [(0.0, False), (0.08, True)])
def test_a_time_shift_that_the_pictures_contradict_is_warned_of(late: float, warned: bool) -> None:
    """The stamps come late by 80 ms after a shift of -0.02 s was used: it is -0.1 s."""
    f, events = flight()
    some = [replace(e, t_ns=e.t_ns + round(1e9 * late)) if isinstance(e, Frame) else e for e in events]
    found = contradicted_shift(f.rig, some, -0.02)
    assert bool(found) == warned
    if warned:
        assert float(found.split("give ")[1].split(" ")[0]) == pytest.approx(-0.1, abs=0.015)
        assert float(found.split("time_offset=")[1]) == pytest.approx(0.1, abs=0.015)


def test_what_cannot_be_settled_is_refused(tmp_path: Path) -> None:
    """One frame again and again, as in a hover; two time offsets; several logs."""
    f, events = flight()
    still = next(e for e in events if isinstance(e, Frame))
    for k in range(20):
        Image.fromarray(np.asarray(still.images[0])).save(tmp_path / f"{still.t_ns + k * 200_000_000}.png")
    write_calibration(tmp_path, f.rig.cameras[0].camera)
    hovering = [replace(e, velocity_world=np.zeros(3)) for e in events if isinstance(e, NavSample)]
    write_dataflash(tmp_path / "a.bin", Autopilot(hovering, f.local, AHEAD_NS))
    with pytest.raises(InputError, match=r"is not clear: .*sources\.time_offset=SECONDS"):
        opened(tmp_path)
    with pytest.raises(InputError, match=r"motion\.filter\.time_offset"):
        opened(tmp_path, "motion.filter.time_offset=0.1")
    (tmp_path / "b.ulg").write_bytes(b"ULog")
    with pytest.raises(InputError, match=r"holds 2 logs"):
        opened(tmp_path)


def test_a_log_beside_photos_with_places_is_left_alone(photos: Path) -> None:
    (photos / "flight.bin").write_bytes(b"\xa3\x95")
    first = min(photos.glob("*.[jJ]*"))
    Image.open(first).save(first)  # without a fix
    assert opened(photos).kind == "photos"


def test_files_of_a_camera_are_no_logs(photos: Path) -> None:
    """As on the card of a camera with a receiver for surveys."""
    for name in ("EVENTLOG.bin", "PPKRAW.bin", "empty.ulg"):
        (photos / name).write_bytes(b"\xd3\x00" if name.startswith("PPK") else b"")
    assert opened(photos).kind == "photos"
    for path in photos.glob("*.[jJ]*"):
        Image.open(path).save(path)
    with pytest.raises(InputError, match=r"no photo has a GPS.* no autopilot's log.*EVENTLOG.bin, PPKRAW.bin"):
        opened(photos)
