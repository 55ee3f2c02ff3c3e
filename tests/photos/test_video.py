"""A video with telemetry as photos: frames by distance, with their places."""

from __future__ import annotations

import re
import shutil
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from drawn_photos import CAMERA, PLACE, UP, look, texture

from alight.geometry import enu_from_flu
from alight.photos.reading.film_frames import FilmFrames
from alight.photos.reading.photo_pose import BODY_FROM_CAM
from alight.photos.reading.subtitles import read_subtitles
from alight.photos.reading.video import focal_px
from alight.records import Frame, InputError, NavSample
from alight.runner.opening import open_source
from alight.sources import Source

RATE, SPEED, FRAMES = 10.0, 4.0, 60  # Hz, m/s
FILM = CAMERA.fu * 0.8 / CAMERA.width * 43.2666  # mm of 35 mm film

ROW = """1
00:00:00,000 --> 00:00:00,033
[focal_len: 24.00] [latitude: 45.123456] [longitude: -7.654321] [rel_alt: 30.100 abs_alt: 330.200]
"""


@pytest.mark.parametrize(
    ("written", "film"), [("24.00", 24), ("240", 24), ("162", 162), ("162.0", 162), ("480", 48), ("0", None)]
)
def test_a_focal_length_in_tenths_is_recognised_beside_a_tele_lens(written: str, film: float | None) -> None:
    (row,) = read_subtitles(ROW.replace("24.00", written), "a.srt").rows
    assert focal_px(row, 1920) == (None if film is None else pytest.approx(film * 1920 / 0.8 / np.hypot(36, 24)))


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a video of six seconds to the east over the drawn relief, 24 m."""
    path = tmp_path_factory.mktemp("film") / "DJI_0001.mp4"
    size = CAMERA.width, CAMERA.height
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), RATE, size)  # type: ignore[attr-defined]
    if not writer.isOpened():
        pytest.skip("this OpenCV writes no mp4")
    ground, rows = texture(3), []
    rotation = enu_from_flu(np.radians(90), np.radians(-90), 0.0) @ BODY_FROM_CAM.rotation
    for k in range(FRAMES):
        centre = np.array([-12.0 + SPEED * k / RATE, 0.0, UP])
        writer.write(np.ascontiguousarray(look(ground, centre, rotation)[..., ::-1]))
        latitude, longitude, height = (float(v) for v in PLACE.to_geodetic(centre))
        start, end = (f"00:00:{t:06.3f}".replace(".", ",") for t in (k / RATE, (k + 1) / RATE))
        rows.append(
            f"{k + 1}\n{start} --> {end}\n2026-01-26 13:50:{k / RATE:06.3f}\n[focal_len: {FILM:.3f}] "
            f"[latitude: {latitude:.8f}] [longitude: {longitude:.8f}] [rel_alt: {UP:.3f} abs_alt: {height:.3f}] "
            "[gb_yaw: 90.0 gb_pitch: -90.0 gb_roll: 0.0]\n"
        )
    writer.release()
    path.with_suffix(".SRT").write_text("\n".join(rows))
    return path


@pytest.fixture
def video(film: Path, tmp_path: Path) -> Path:
    """A copy of the video and its telemetry."""
    shutil.copy(film.with_suffix(".SRT"), tmp_path)
    return Path(shutil.copy(film, tmp_path))


def test_a_place_of_few_decimals_is_trusted_little(video: Path) -> None:
    rows = video.with_suffix(".SRT").read_text()
    coarse = re.sub(r"\[latitude: ([-\d.]+)\] \[longitude: ([-\d.]+)\] \[rel_alt: ([-\d.]+) abs_alt: [-\d.]+\]",
                    lambda m: f"GPS({float(m[1]):.4f},{float(m[2]):.4f},0.0M) BAROMETER:{m[3]}M", rows)  # fmt: skip
    video.with_suffix(".SRT").write_text(coarse)
    nav, _ = events(open_source(video))
    np.testing.assert_allclose(nav[0].sigma_position, [11.0, 11.0, 5.0])
    assert nav[0].position_world is not None
    assert nav[0].position_world[2] == pytest.approx(UP, abs=0.01)


def events(source: Source) -> tuple[list[NavSample], list[Frame]]:
    found = list(source.events())
    return [e for e in found if isinstance(e, NavSample)], [e for e in found if isinstance(e, Frame)]


def test_frames_are_taken_by_distance_and_know_their_place(video: Path) -> None:
    """With 80 % overlap of a field of 30 m, there is a frame every 6 m."""
    source = open_source(video)
    assert (source.kind, source.name) == ("photos", "DJI_0001")
    nav, frames = events(source)
    step = 0.2 * UP * CAMERA.height / CAMERA.fv
    assert len(frames) == 1 + int((FRAMES - 1) / RATE * SPEED // (np.ceil(step / SPEED * RATE) / RATE * SPEED))
    places = np.array([n.position_world for n in nav])
    apart = np.linalg.norm(np.diff(places, axis=0), axis=1)
    assert step <= apart.min() + 0.02
    assert apart.max() < step + 2 * SPEED / RATE
    assert source.rig.cameras[0].camera.fu == pytest.approx(CAMERA.fu, rel=1e-3)
    assert nav[0].world_from_body is not None
    axis = (nav[0].world_from_body @ BODY_FROM_CAM.rotation) @ [0, 0, 1]
    np.testing.assert_allclose(axis, [0, 0, -1], atol=1e-9)
    number = int(frames[1].name.partition("_")[2].partition(".")[0])
    rotation = enu_from_flu(np.radians(90), np.radians(-90), 0.0) @ BODY_FROM_CAM.rotation
    drawn = look(texture(3), np.array([-12.0 + SPEED * number / RATE, 0.0, UP]), rotation)
    assert np.corrcoef(np.asarray(frames[1].images[0]).ravel(), drawn.ravel())[0, 1] > 0.95
    assert source.digest() == open_source(video).digest()


def test_a_video_with_heights_above_take_off_alone_says_so(video: Path) -> None:
    telemetry = video.with_suffix(".SRT")
    telemetry.write_text(re.sub(r" abs_alt: [-\d.]+", "", telemetry.read_text()))
    source = open_source(video)
    assert source.warnings == [
        "no photo says its altitude: the height above take-off is used, heights above the sea are not known",
        "whether film and telemetry are in step is not clear from the pictures: they are too short",
    ]
    assert {p.altitude_kind for p in source.photos} == {"not given"}
    nav, frames = events(source)
    assert len(frames) == len(nav) == source.length
    for sample in nav:
        assert sample.position_world is not None
        assert sample.position_world[2] == pytest.approx(UP, abs=0.01)


def test_frames_are_stored_as_filmed_with_their_own_times(video: Path) -> None:
    """A film that is shown turned by 90 degrees; then twice as fast."""
    data = bytearray(video.read_bytes())
    turned = struct.pack(">9i", 0, 1 << 16, 0, -1 << 16, 0, 0, CAMERA.height << 16, 0, 1 << 30)
    matrix = data.index(b"tkhd") + 44
    data[matrix : matrix + 36] = turned
    times = data.index(b"stts") + 8
    count, entries, step = struct.unpack(">3I", data[times : times + 12])
    assert (count, entries) == (1, FRAMES)
    video.write_bytes(data)
    with FilmFrames(video) as frames:
        assert (frames.size, frames.orientation) == ((CAMERA.width, CAMERA.height), 6)
        assert list(frames) == pytest.approx(np.arange(FRAMES) / RATE, abs=1e-3)
        assert frames.seconds == pytest.approx(FRAMES / RATE)
    source = open_source(video)
    assert source.rig.cameras[0].camera.fu == pytest.approx(CAMERA.fu, rel=1e-3)
    assert source.notes["attitude_from"] == {"not used: EXIF orientation 6": source.length}
    data[times + 8 : times + 12] = struct.pack(">I", step // 2)
    video.write_bytes(data)
    with FilmFrames(video) as frames:
        assert list(frames)[-1] == pytest.approx((FRAMES - 1) / RATE / 2, abs=1e-3)


def test_a_video_that_cannot_be_used_is_refused_in_words(tmp_path: Path) -> None:
    path = tmp_path / "a.mp4"
    path.write_bytes(b"no film")
    with pytest.raises(InputError, match=r"has no telemetry; put a\.srt or a\.gpx beside it"):
        open_source(path)
    path.with_suffix(".srt").write_text("1\n00:00:00,000 --> 00:00:01,000\n[iso: 100]\n")
    with pytest.raises(InputError, match="no place in it"):
        open_source(path)
    path.with_suffix(".srt").write_text(ROW)
    with pytest.raises(InputError, match="not one frame could be decoded"):
        open_source(path)
