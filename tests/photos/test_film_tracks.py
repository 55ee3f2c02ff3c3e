"""Telemetry beside a film and in its tracks: GPX, GPMF, subtitles, an autopilot's log."""

from __future__ import annotations

import struct
import sys
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from alight.photos.reading.film_tracks import read_gpx, telemetry_beside, telemetry_inside
from alight.photos.reading.gpmf import read_gpmf
from alight.records import InputError

SRT = "1\n00:00:0{0},000 --> 00:00:01,000\n[latitude: 45.03] [longitude: 7.62] [abs_alt: 350.5]\n"
GPX = """<?xml version="1.0"?><gpx version="1.1" xmlns="http://www.topografix.com/GPX/1/1"><trk><trkseg>
<trkpt lat="45.03" lon="7.62"><ele>350.5</ele><time>2026-05-04T10:00:00Z</time></trkpt>
<trkpt lat="45.04" lon="7.63"><time>2026-05-04T12:00:01.5+02:00</time></trkpt>
<trkpt lat="45.05" lon="7.64"></trkpt></trkseg></trk></gpx>"""


def element(key: str, kind: str, size: int, data: bytes) -> bytes:
    """One GPMF element, filled to four bytes."""
    count = len(data) // size
    return struct.pack(">4scBH", key.encode(), kind.encode(), size, count) + data + bytes(-len(data) % 4)


def payload(north: float, *, nine: bool = False, fix: int = 3, dop: float = 1.5) -> bytes:
    """A second of GoPro's GPS with two places, and another stream before it."""
    places = [[round((45.03 + north + 1e-4 * k) * 1e7), round(7.62e7), 348_123, 6000, 600] for k in range(2)]
    scale = [10**7, 10**7, 1000, 1000, 100, *([1, 1000, 100, 1] if nine else [])]
    gps = element("STNM", "c", 1, b"GPS") + element("SCAL", "l", 4, struct.pack(f">{len(scale)}i", *scale))
    if nine:
        rows = [struct.pack(">7i2H", *place, 9000, 36000, round(100 * dop), fix) for place in places]
        gps += element("TYPE", "c", 1, b"lllllllSS") + element("GPS9", "?", 32, b"".join(rows))
    else:
        gps += element("GPSF", "L", 4, struct.pack(">I", fix))
        gps += element("GPSP", "S", 2, struct.pack(">H", round(100 * dop)))
        gps += element("GPS5", "l", 20, b"".join(struct.pack(">5i", *place) for place in places))
    accelerometer = element("STRM", "\0", 1, element("ACCL", "s", 6, bytes(12)))
    return element("DEVC", "\0", 1, element("DVNM", "c", 1, b"Hero") + accelerometer + element("STRM", "\0", 1, gps))


@pytest.mark.parametrize("nine", [False, True], ids=["GPS5", "GPS9"])
def test_gopro(nine: bool) -> None:
    found = read_gpmf(
        [(0.0, payload(0, nine=nine)), (1.0, payload(0.001, nine=nine, fix=2)),
         (2.0, payload(0.002, nine=nine, dop=50)), (3.0, payload(0.003, nine=nine))], "a.mp4",
    )  # fmt: skip
    assert [r.seconds for r in found.rows] == [0.0, 0.5, 3.0, 3.5]
    np.testing.assert_allclose([r.values["latitude"] for r in found.rows], [45.03, 45.0301, 45.033, 45.0331])
    assert found.rows[0].values == pytest.approx({"latitude": 45.03, "longitude": 7.62, "abs_alt": 348.123})
    assert found.found == "4 of 8 places left out: a poor fix"


def test_gopro_with_damage_gives_what_can_be_read() -> None:
    whole = payload(0)
    for end in range(len(whole)):
        read_gpmf([(0.0, whole[:end])], "a.mp4")
        read_gpmf([(0.0, whole[:end] + b"\xff" + whole[end + 1 :])], "a.mp4")
    assert read_gpmf([], "a.mp4").rows == ()


def test_gpx() -> None:
    track = read_gpx(GPX, "a.gpx")
    assert [(r.seconds, r.place) for r in track.rows] == [(0.0, (45.03, 7.62)), (1.5, (45.04, 7.63))]
    assert track.rows[0].values["abs_alt"] == 350.5
    assert not track.of_film


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("no xml", "no GPX track"),
        ("<!DOCTYPE a>" + GPX, "document type"),
        (GPX.replace("time>", "when>"), "has a time; export the track with times"),
        (GPX.replace('lat="45.03"', 'lat="north"'), "no GPX track"),
        (GPX.replace("lon=", "long="), "no GPX track"),
    ],
)
def test_a_gpx_file_that_cannot_be_used_is_refused(text: str, why: str) -> None:
    with pytest.raises(InputError, match=rf"a\.gpx: .*{why}"):
        read_gpx(text, "a.gpx")


def test_a_file_beside_the_film_that_has_places_is_used(tmp_path: Path) -> None:
    film = tmp_path / "DJI_0[1].MP4"
    assert telemetry_beside(film) is None
    (tmp_path / "DJI_0[1].old.srt").write_text(SRT.format(0))
    assert telemetry_beside(film) is None
    film.with_suffix(".SRT").write_text("1\n00:00:00,000 --> 00:00:01,000\nGood morning\n")
    with pytest.raises(InputError, match="no place in it"):
        telemetry_beside(film)
    film.with_suffix(".gpx").write_text(GPX)
    found = telemetry_beside(film)
    assert found is not None
    assert found.source.endswith(".gpx")


def test_tracks_of_a_film_are_read_by_ffmpeg(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A stand-in for the tool that gives the subtitles, or the packets of all data tracks one after the other."""
    monkeypatch.setitem(sys.modules, "av", None)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(InputError, match=r"put a\.srt or a\.gpx beside it, .*alight\[films\].*ffmpeg"):
        telemetry_inside(tmp_path / "a.mp4", 2.0)
    tool = tmp_path / "ffmpeg"
    tool.write_text(f'#!/bin/sh\ncase "$*" in *srt*) f=text;; *) f=data;; esac\nexec /bin/cat "{tmp_path}/$f"\n')
    tool.chmod(0o755)
    (tmp_path / "text").write_text("")
    (tmp_path / "data").write_bytes(b"\0\1\2\3")
    assert telemetry_inside(tmp_path / "a.mp4", 2.0) is None
    (tmp_path / "text").write_text(SRT.format(0))
    found = telemetry_inside(tmp_path / "a.mp4", 2.0)
    assert found is not None
    assert found.rows[0].values["abs_alt"] == 350.5
    (tmp_path / "data").write_bytes(b"\0\1\2\3" + payload(0) + b"\0\1\2\3" + payload(0.001))
    found = telemetry_inside(tmp_path / "a.mp4", 2.0)
    assert found is not None
    assert [r.seconds for r in found.rows] == [0.0, 0.5, 1.0, 1.5]


def test_tracks_of_a_film_are_read_by_av(tmp_path: Path) -> None:
    av = pytest.importorskip("av", reason="av, of the extra films, is not installed")
    with av.open(str(tmp_path / "a.mp4"), "w") as file:
        picture, track = file.add_stream("mpeg4", rate=5), file.add_data_stream("bin_data")
        picture.width, picture.height, picture.pix_fmt = 64, 48, "yuv420p"
        for k in range(10):
            frame = av.VideoFrame.from_ndarray(np.full((48, 64, 3), 20 * k, np.uint8), format="rgb24")
            file.mux(picture.encode(frame))
        file.mux(picture.encode())
        for k in range(2):
            packet = av.Packet(payload(0.001 * k))
            packet.stream, packet.time_base = track, Fraction(1, 1000)
            packet.pts, packet.dts, packet.duration = 1001 * k, 1001 * k, 1001
            file.mux(packet)
    found = telemetry_inside(tmp_path / "a.mp4", 2.0)
    assert found is not None
    assert [r.seconds for r in found.rows] == pytest.approx([0.0, 0.5005, 1.001, 1.501], abs=1e-3)
