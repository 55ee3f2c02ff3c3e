"""Sources of a live run: recordings at their own speed, folders that fill, cameras."""

from __future__ import annotations

import math
import shutil
import threading
import time
from collections.abc import Iterator
from functools import cache
from itertools import islice, pairwise
from pathlib import Path
from typing import Any
from unittest import mock

import cv2
import numpy as np
import pytest
from damage import STEP, T0, change_field, write_camera, write_flight
from over_a_link import free_port
from stereo_flight import STEREO

import alight_sim
from alight.arrays import U8
from alight.flight.live.telemetry import with_telemetry
from alight.records import Event, Frame, ImuSample, InputError, NavSample
from alight.runner.opening import open_live, open_source
from alight.runs import flown_home
from alight.settings import Settings
from alight.sources.capture import SensorClock
from alight.sources.growing import GrowingLog, GrowingTable, WaitingExposures
from alight.sources.live import LiveSource, as_they_arrive, open_sensors, paced
from alight_sim import fly
from alight_sim.autopilot import SimulatedAutopilot, UdpServer


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a flight of 2 s as a log."""
    folder = tmp_path_factory.mktemp("log") / "flight"
    alight_sim.write(fly("demo", 1, 2.0, rig=STEREO, rate_hz=6.0, height=15.0), folder)
    return folder


def rows(*stamps_ms: int) -> list[Event]:
    return [NavSample(t * 1_000_000, None, None) for t in stamps_ms]


# -- at their own speed


class Clock:
    """Replacement of the module `time`: a sleep moves the clock on at once."""

    def __init__(self) -> None:
        self.now = 50.0

    def perf_counter(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds + 1e-6  # as a real one, it takes a little longer


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    """The clock of recordings that are read at their own speed."""
    found = Clock()
    monkeypatch.setattr("alight.sources.live.time", found)
    return found


def test_events_come_when_they_came_in_flight(clock: Clock) -> None:
    arrived = [clock.now - 50.0 for _ in paced(iter(rows(5000, 5100, 5100, 5400)), 2.0)]
    np.testing.assert_allclose(arrived, [0.0, 0.05, 0.05, 0.2], atol=1e-4)


def test_what_comes_late_is_not_waited_for(clock: Clock) -> None:
    """After a stall of 0.3 s a reader catches up."""
    begun = threading.Event()

    def stalls() -> Iterator[Event]:
        for k, e in enumerate(rows(0, 100, 200, 300, 400)):
            if k == 1:
                assert begun.wait(60.0)
                clock.sleep(0.31)
            yield e

    arrived = []
    for _ in paced(stalls(), 1.0):
        arrived.append(clock.now - 50.0)
        begun.set()
    np.testing.assert_allclose(arrived, [0.0, 0.31, 0.31, 0.31, 0.4], atol=1e-4)


def test_reading_ahead_keeps_order_ends_and_errors() -> None:
    def fails() -> Iterator[Event]:
        yield from rows(1, 2)
        raise InputError("a bad file")

    assert [e.t_ns for e in as_they_arrive(iter(rows(*range(300))), most=4)] == [k * 1_000_000 for k in range(300)]
    found = as_they_arrive(fails(), most=1)
    assert [next(found).t_ns, next(found).t_ns] == [1_000_000, 2_000_000]
    with pytest.raises(InputError, match="a bad file"):
        next(found)


def test_events_of_two_sources_come_until_the_first_one_ends() -> None:
    def slowly() -> Iterator[Event]:
        for e in rows(1, 2, 3):
            time.sleep(0.05)
            yield e

    def endless() -> Iterator[Event]:
        while True:
            yield from rows(7)
            time.sleep(0.01)

    assert sorted(e.t_ns for e in as_they_arrive(slowly(), iter(rows(5, 6)))) == [
        k * 1_000_000 for k in (1, 2, 3, 5, 6)
    ]
    arrived = [e.t_ns for e in as_they_arrive(slowly(), endless())]
    assert [t for t in arrived if t != 7_000_000] == [1_000_000, 2_000_000, 3_000_000]


def test_a_flight_that_is_stopped_ends() -> None:
    assert list(paced(iter(rows(0, 60_000)), 1.0, lambda: True)) == []


def test_photos_have_no_speed(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such folder"):
        open_live(str(tmp_path / "none"), Settings())


# -- a folder that fills


def test_lines_count_once_they_are_whole(tmp_path: Path) -> None:
    path = tmp_path / "data.csv"
    table = GrowingTable(path)
    assert table.new_lines() == []
    with path.open("ab", buffering=0) as f:
        f.write(b"#timestamp\n1,2\n3")
        assert table.new_lines() == [(1, "#timestamp"), (2, "1,2")]
        f.write(b",4\r\n")
        assert table.new_lines() == [(3, "3,4\r")]
        assert table.new_lines() == []


def test_a_folder_that_fills_gives_what_the_whole_log_gives(log: Path, tmp_path: Path) -> None:
    """Rows and pictures appear one by one, pictures half-written at first, one after its row, one never."""
    root, settings = tmp_path / "filling", Settings()
    whole = list(open_source(log, settings).events())
    for folder in ("cam0", "cam1", "nav0", "imu0"):
        (root / "mav0" / folder / "data").mkdir(parents=True)
        shutil.copy(log / "mav0" / folder / "sensor.yaml", root / "mav0" / folder)
    pictures = sorted((log / "mav0" / "cam0" / "data").iterdir())
    never = pictures[3].name

    def fill() -> None:
        tables = {n: (log / "mav0" / n / "data.csv").read_text().splitlines() for n in ("cam0", "cam1", "nav0", "imu0")}
        header = {n: lines[0] for n, lines in tables.items()}
        lines = sorted((line for n, t in tables.items() for line in ((int(x.split(",")[0]), n, x) for x in t[1:])))
        for n, text in header.items():
            with (root / "mav0" / n / "data.csv").open("a") as f:
                f.write(text + "\n")
        for k, (_, n, text) in enumerate(lines):
            with (root / "mav0" / n / "data.csv").open("a") as f:
                f.write(text + "\n")
            if n.startswith("cam") and not (n == "cam0" and text.endswith(never)):
                name = text.split(",")[1].strip()
                data = (log / "mav0" / n / "data" / name).read_bytes()
                target = root / "mav0" / n / "data" / name
                target.write_bytes(data[: len(data) // 2])
                time.sleep(0.02)
                target.write_bytes(data)
            if k % 25 == 0:
                time.sleep(0.01)

    source = GrowingLog(root, settings, idle=1.5)
    threading.Thread(target=fill, daemon=True).start()
    found = list(source.events())
    for kind in (NavSample, ImuSample):
        assert [e.t_ns for e in found if isinstance(e, kind)] == [e.t_ns for e in whole if isinstance(e, kind)]
    frames = [e for e in found if isinstance(e, Frame)]
    wanted = [e for e in whole if isinstance(e, Frame)]
    assert [f.t_ns for f in frames] == [f.t_ns for f in wanted]
    for a, b in zip(frames, wanted, strict=True):
        for one, other in zip(a.images, b.images, strict=True):
            if one is None:
                assert str(a.t_ns) == Path(never).stem
            else:
                assert other is not None
                assert (one == other).all()
    assert any(never in w for w in source.warnings)


def test_images_of_a_folder_that_fills_are_paired_within_half_a_period(tmp_path: Path) -> None:
    """The right camera exposes 20 ms later, and its last image is 60 ms late, at 10 Hz."""
    root = write_flight(tmp_path / "flight", cameras=1)
    write_camera(root / "mav0/cam1", 6, grey=True, shift=20_000_000)
    change_field(root / "mav0/cam1/data.csv", 7, 0, str(T0 + 5 * STEP + 60_000_000))
    frames = [e for e in GrowingLog(root, Settings(), idle=0.01).events() if isinstance(e, Frame)]
    assert [f.t_ns for f in frames] == [*(T0 + k * STEP for k in range(6)), T0 + 5 * STEP + 60_000_000]
    assert [[i is not None for i in f.images] for f in frames] == [[True, True]] * 5 + [[True, False], [False, True]]


def test_an_exposure_has_the_time_of_its_first_camera_though_that_comes_later() -> None:
    """At 100 Hz, the row of the left camera comes after that of the right one, which is 2 ms ahead."""
    waiting = WaitingExposures(2)
    for k in range(4):
        waiting.add(1, T0 + k * 10_000_000 - 2_000_000, f"right {k}", 0.0)
        waiting.add(0, T0 + k * 10_000_000, f"left {k}", 0.0)
    assert waiting.items == {T0 + k * 10_000_000: [f"left {k}", f"right {k}"] for k in range(4)}


def test_gps_that_comes_after_the_start_of_a_folder_is_not_used(tmp_path: Path) -> None:
    """Its rows would be read about a place that is none."""
    root = write_flight(tmp_path / "flight")
    (root / "mav0/nav0").rename(tmp_path / "nav0")
    log = GrowingLog(root, Settings(), idle=0.01)
    (tmp_path / "nav0").rename(root / "mav0/nav0")
    kinds = [type(e) for e in log.events()]
    assert (kinds.count(NavSample), kinds.count(Frame)) == (0, 6)
    assert sum("nav0 came after the start" in w for w in log.warnings) == 1
    log = GrowingLog(root, Settings(), idle=0.01)
    assert sum(isinstance(e, NavSample) for e in log.events()) == 12
    assert log.warnings == []


def test_a_flight_waits_for_pictures_that_come_late(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The estimator of a real Copter had a position 25 s after its receiver; pictures that follow it begin then."""
    root = write_flight(tmp_path / "flight")
    table, clock = root / "mav0/cam0/data.csv", Clock()
    whole = table.read_bytes()
    table.write_bytes(whole.split(b"\n")[0] + b"\n")

    def sleep(seconds: float) -> None:
        clock.sleep(60.0)
        table.write_bytes(whole)

    monkeypatch.setattr("alight.sources.growing.time", mock.Mock(monotonic=clock.perf_counter, sleep=sleep))
    log = open_sensors(str(root), Settings(), None, lambda: clock.now > 600.0, math.inf)
    assert sum(isinstance(e, Frame) for e in log.events) == 6


def test_a_folder_without_calibration_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("alight.sources.live.PATIENCE", 0.05)
    with pytest.raises(InputError, match=r"cam0/sensor\.yaml does not appear"):
        open_live(str(tmp_path), Settings(), follow=True)


# -- cameras


def matched(waiting: WaitingExposures[int], now: float) -> list[tuple[int, list[int | None]]]:
    return [(t_ns, items) for t_ns, items, _ in waiting.ready(now)]


def test_pairs_are_matched_by_their_stamps() -> None:
    """At 30 images a second, the right ones come 4 ms later; one is missing, and one has no left image."""
    waiting, out = WaitingExposures[int](2), list[tuple[int, list[int | None]]]()
    for k in range(12):
        for camera, late in ((0, 0.0), (1, 4.0)):
            if (camera, k) not in ((0, 7), (1, 4)):
                waiting.add(camera, round((1000 + 33.3 * k + late) * 1e6), k, k / 30.0)
            out += matched(waiting, k / 30.0)
    assert len(out) == 7  # an exposure waits for a partner that may come
    out += matched(waiting, 1.0)
    assert [t for t, _ in out] == [round((1000 + 33.3 * k + 4 * (k == 7)) * 1e6) for k in range(12)]
    assert [items for _, items in out] == [[None if k == 7 else k, None if k == 4 else k] for k in range(12)]


def test_images_that_come_too_late_for_their_exposure_delay_no_other() -> None:
    """The right camera is half a second behind."""
    waiting, out = WaitingExposures[int](2), list[tuple[float, int, list[int | None]]]()
    for k in range(60):
        waiting.add(0, k * 33_000_000, k, k / 30.0)
        if k >= 15:
            waiting.add(1, (k - 15) * 33_000_000, k - 15, k / 30.0)
        out += [(k / 30.0, *found) for found in matched(waiting, k / 30.0)]
    left = [(now, items[0]) for now, _, items in out if items[0] is not None]
    assert [k for _, k in left] == list(range(len(left)))
    assert max(now - k / 30.0 for now, k in left) < 0.2


def test_a_sensor_clock_takes_the_smallest_delay() -> None:
    """The driver's stamps are even and have their own zero; arrivals are 5 to 40 ms late."""
    rng, clock = np.random.default_rng(2), SensorClock()
    own = 7.0 + np.arange(300) / 30.0
    arrival = 1_000.0 + own + rng.uniform(0.005, 0.040, 300)
    stamps = np.array([clock.stamp(o, a) for o, a in zip(own, arrival, strict=True)]) * 1e-9
    np.testing.assert_allclose(stamps[100:] - own[100:], 1_000.005, atol=0.002)
    assert np.std(np.diff(stamps[100:])) < 0.0005
    assert clock.stamp(0.0, 5.0) == 5_000_000_000  # a driver without stamps: the arrival


@cache
def film_of(folder: str) -> Path:
    path = Path(folder) / "film.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 20.0, (160, 120))  # type: ignore[attr-defined]
    for k in range(12):
        writer.write(np.full((120, 160, 3), 20 * k, np.uint8))
    writer.release()
    return path


def test_opencv_gives_the_frames_of_a_film(log: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    film = film_of(str(tmp_path_factory.mktemp("film")))
    opened = open_live(f"video:{film},video:{film}", Settings(), rig=log)
    frames = [e for e in opened.events if isinstance(e, Frame)]
    assert opened.real_time
    assert len(frames) == 12
    means = [float(f.images[0].mean()) for f in frames if f.images[0] is not None]
    assert all(a < b for a, b in pairwise(means))


@pytest.mark.parametrize(
    ("name", "cameras"),
    [
        ("camera:0,camera:/dev/video2", ["camera:0", "camera:/dev/video2"]),
        ("camera:0, video:a,b.avi", ["camera:0", "video:a,b.avi"]),
        ("rtsp://h/s?a=1,2,rtsp://h/t", ["rtsp://h/s?a=1,2", "rtsp://h/t"]),
        (
            "gst:v4l2src ! video/x-raw,width=640,height=480 ! appsink,gst:v4l2src ! appsink",
            ["gst:v4l2src ! video/x-raw,width=640,height=480 ! appsink", "gst:v4l2src ! appsink"],
        ),
    ],
)
def test_names_of_cameras_may_hold_commas(
    name: str, cameras: list[str], log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = list[str]()
    monkeypatch.setattr(
        "alight.sources.capture.Cameras", lambda names, rig, settings: given.extend(names) or mock.Mock()
    )
    open_live(name, Settings(), rig=log)
    assert given == cameras


@pytest.mark.parametrize(
    ("name", "rig", "says"),
    [
        ("camera:77", True, "cannot be opened"),
        ("camera:0", False, "--rig"),
        ("video:none.avi", True, "name as many"),
    ],
)
def test_cameras_that_cannot_be_used_say_so(log: Path, name: str, rig: bool, says: str) -> None:
    names = f"{name},{name}" if says == "cannot be opened" else name
    with pytest.raises(InputError, match=says):
        list(open_live(names, Settings(), rig=log if rig else None).events)


# -- with an autopilot's telemetry


def test_cameras_with_the_telemetry_of_an_autopilot(log: Path, tmp_path: Path) -> None:
    """Pictures and GPS/INS come in the order of arrival, on one clock; the world's origin is at the autopilot."""
    film = film_of(str(tmp_path))
    feed_port = free_port()
    with UdpServer(SimulatedAutopilot(), ("127.0.0.1", feed_port), speed=1.0, step=0.02):
        opened = with_telemetry(slow(open_live(f"video:{film},video:{film}", Settings(), rig=log)),
                                f"udp:127.0.0.1:{feed_port}")  # fmt: skip
        found = list(opened.events)
    rows = [e for e in found if isinstance(e, NavSample)]
    assert opened.source.georeferenced
    assert len(rows) > 5
    assert sum(isinstance(e, Frame) for e in found) == 12
    assert rows[-1].sigma_position is not None
    assert (rows[-1].sigma_position > 0).all()
    first = rows[-1].position_world
    assert first is not None
    assert np.linalg.norm(first) < 5.0
    now = time.monotonic_ns()
    assert all(0 <= now - r.t_ns < 60_000_000_000 for r in rows)
    home = flown_home(None, opened.telemetry(), None)  # of route.plan: the autopilot's own
    assert home is not None
    assert np.isfinite(home.height)


def slow(opened: LiveSource) -> LiveSource:
    """Return a source whose events come as from a film of two seconds."""

    def events() -> Iterator[Event]:
        for e in opened.events:
            time.sleep(0.2)
            yield e

    return LiveSource(opened.source, events(), True)


def test_an_autopilot_that_is_not_there_says_so(log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("alight.flight.live.telemetry.PATIENCE", 0.1)
    film = film_of(str(tmp_path))
    with pytest.raises(InputError, match="no heartbeat"):
        with_telemetry(open_live(f"video:{film},video:{film}", Settings(), rig=log), f"udp:127.0.0.1:{free_port()}")
    with pytest.raises(InputError, match="a clock of its own"):
        with_telemetry(open_live(str(log), Settings()), "udp:127.0.0.1:0")


class Broken:
    """A stream of three images, which then breaks off."""

    left = 3

    def grab(self) -> bool:
        """Nothing queued up."""
        return False

    def read(self) -> tuple[bool, U8]:
        """The next image, and whether there is one."""
        self.left -= 1
        return self.left >= 0, np.zeros((120, 160), np.uint8)

    def get(self, _: int) -> float:
        """No time of the driver."""
        return 0.0

    def release(self) -> None:
        """Nothing is held."""


@pytest.fixture
def one_camera(log: Path, tmp_path: Path) -> Path:
    """The calibration of the left camera."""
    (tmp_path / "cam0").mkdir()
    shutil.copy(log / "mav0" / "cam0" / "sensor.yaml", tmp_path / "cam0")
    return tmp_path


def test_a_stream_that_breaks_off_is_opened_again(one_camera: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its server restarts twice, and then stays away."""
    answers: list[Any] = [Broken(), Broken(), InputError("no route"), Broken()]

    def opened(name: str, size: tuple[int, int]) -> Any:
        if not answers or isinstance(answers[0], InputError):
            raise answers.pop(0) if answers else InputError("refused")
        return answers.pop(0)

    monkeypatch.setattr("alight.sources.capture.open_capture", opened)
    monkeypatch.setattr("alight.sources.capture.SILENT", 0.4)
    source = open_live("rtsp://h/s", Settings(), rig=one_camera)
    assert sum(isinstance(e, Frame) for e in source.events) == 9
    assert "rtsp://h/s: broke off and was opened again; motion and map have a gap there" in source.source.warnings


class Unplugged(Broken):
    """A stream of three images, which then falls silent, as when its camera loses power."""

    def __init__(self, name: str, backend: int, limits: list[int]) -> None:
        self.limits = dict(zip(limits[::2], limits[1::2], strict=True))

    def isOpened(self) -> bool:
        """The camera has its power back."""
        return True

    def read(self) -> tuple[bool, U8]:
        """The next image; after the last, wait as long as OpenCV was told to."""
        good, image = super().read()
        if not good:
            time.sleep(1e-3 * self.limits[cv2.CAP_PROP_READ_TIMEOUT_MSEC])
        return good, image

    def get(self, which: int) -> float:
        """Size of the images; no time of the driver."""
        return {cv2.CAP_PROP_FRAME_WIDTH: 160.0, cv2.CAP_PROP_FRAME_HEIGHT: 120.0}.get(which, 0.0)


def test_a_stream_that_falls_silent_is_opened_again(one_camera: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("alight.sources.capture.cv2.VideoCapture", Unplugged)
    monkeypatch.setattr("alight.sources.capture.SILENT", 2.0)
    source = open_live("rtsp://h/s", Settings(), rig=one_camera)
    assert sum(isinstance(e, Frame) for e in islice(source.events, 7)) == 7
    assert any("broke off and was opened again" in w for w in source.source.warnings)


class Examined:
    """A stream at 20 Hz of which eight images queued up while it was opened; an image's brightness is its number."""

    number = -1

    def grab(self) -> bool:
        """Whether there is one more image; those that have not been taken yet are waited for."""
        self.number += 1
        if self.number > 7:
            time.sleep(0.05)
        return self.number < 14

    def read(self) -> tuple[bool, U8]:
        """The next image, and whether there is one."""
        return self.grab(), np.full((120, 160), self.number, np.uint8)

    def get(self, _: int) -> float:
        """Time in ms; the first two have the same, as with FFmpeg."""
        return 50.0 * max(self.number - 1, 0)

    def release(self) -> None:
        """Nothing is held."""


def test_images_that_queued_up_while_a_stream_was_opened_are_skipped(
    one_camera: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They would be stamped as they arrive, all at once."""
    opened = mock.Mock(side_effect=[Examined(), *[InputError("refused")] * 99])
    monkeypatch.setattr("alight.sources.capture.open_capture", opened)
    monkeypatch.setattr("alight.sources.capture.SILENT", 0.4)
    frames = [e for e in open_live("rtsp://h/s", Settings(), rig=one_camera).events if isinstance(e, Frame)]
    assert [int(i[0, 0]) for f in frames if (i := f.images[0]) is not None] == [9, 10, 11, 12, 13]
