"""A video with telemetry (`.srt`, in the dialects of DJI) as photos: frames by distance, with tags for `Photos`."""

from __future__ import annotations

import itertools
import math
import os
import re
import shutil
import tempfile
import weakref
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from PIL import ExifTags, Image

from alight.photos.reading.photo_camera import film_focal_px
from alight.photos.reading.photo_tags import PhotoTags
from alight.photos.reading.photos import Photos
from alight.records import InputError
from alight.settings import Settings

Base = ExifTags.Base

OVERLAP = 0.8  # of one frame with the next, along the flight
_TIME = re.compile(r"(\d+):(\d\d):(\d\d)[,.](\d{1,3})\s*-->")
_STAMP = re.compile(r"(\d{4})[-.](\d\d)[-.](\d\d)[ T](\d\d):(\d\d):(\d\d)(?:[.,:](\d{1,3}))?")
_NUMBER = r"([-+]?\d+(?:\.\d+)?)"
_PAIR = re.compile(rf"\b([a-z_]+)\s*:\s*{_NUMBER}", re.IGNORECASE)
_GPS = re.compile(rf"\bGPS\s*\(\s*{_NUMBER}\s*,\s*{_NUMBER}\s*(?:,\s*{_NUMBER}\s*(M?)\s*)?\)", re.IGNORECASE)
_UP = re.compile(rf"\bBAROMETER\s*[:(]\s*{_NUMBER}|,\s*H\s+{_NUMBER}\s*m\b", re.IGNORECASE)


@dataclass(frozen=True)
class Subtitle:
    """Content of one subtitle."""

    seconds: float  # from the start of the video
    taken: datetime | None
    values: dict[str, float]  # latitude, longitude, abs_alt, rel_alt, focal_len, gb_yaw, ...
    coarse: bool = False  # latitude or longitude has few decimals

    @property
    def place(self) -> tuple[float, float, float] | None:
        """Latitude, longitude (degrees), and the altitude, else the height above take-off (m); None without a fix."""
        latitude, longitude = self.values.get("latitude"), self.values.get("longitude")
        up = self.values.get("rel_alt") if self.altitude is None else self.altitude
        if latitude is None or longitude is None or up is None or (latitude, longitude) == (0, 0):
            return None
        return latitude, longitude, up

    @property
    def altitude(self) -> float | None:
        """Metres above the maker's datum; None where at most the height above take-off is given."""
        return next((self.values[k] for k in ("abs_alt", "altitude") if k in self.values), None)


def read_srt(text: str) -> list[Subtitle]:
    """The telemetry of subtitles.

    Either each number has its name, as in `[latitude: 45.1]`, or a line is `GPS(149.0251,-20.2533,16) BAROMETER:1.9`.
    """
    out = []
    for block in re.split(r"\n\s*\n", text.replace("\r", "")):
        if (at := _TIME.search(block)) is None:
            continue
        h, m, s, ms = (int(v) for v in at.groups())
        written = {k.lower().replace("longtitude", "longitude"): v for k, v in _PAIR.findall(block[at.end() :])}
        written |= _bracketed(block[at.end() :])
        seconds = 3600 * h + 60 * m + s + ms / 10 ** len(at.group(4))
        decimals = [len(written[k].partition(".")[2]) for k in ("latitude", "longitude") if k in written]
        coarse = bool(decimals) and max(decimals) <= 4  # of a degree: 11 m
        out.append(Subtitle(seconds, _stamp(block), {k: float(v) for k, v in written.items()}, coarse))
    return out


def _bracketed(block: str) -> dict[str, str]:
    """Place and height above take-off of the older dialects, as they are written; empty in the others.

    With a unit (`0.0M`, Matrice 300) latitude comes first, without one (Mavic Pro, Phantom 4) longitude, unless that is
    no place on Earth. The third number is a count of satellites or nothing, the height is the barometer's.
    """
    found = _GPS.search(block)
    if found is None:
        return {}
    first, second, _, unit = found.groups()
    latitude, longitude = (first, second) if unit else (second, first)
    if abs(float(latitude)) > 90:
        latitude, longitude = longitude, latitude
    if abs(float(latitude)) > 90 or abs(float(longitude)) > 180:
        return {}
    up = _UP.search(block)
    height = {} if up is None else {"rel_alt": up.group(1) or up.group(2)}
    return {"latitude": latitude, "longitude": longitude} | height


def _stamp(block: str) -> datetime | None:
    if (found := _STAMP.search(block)) is None:
        return None
    *whole, fraction = found.groups()
    try:
        at = datetime(*(int(v) for v in whole), tzinfo=UTC)  # type: ignore[arg-type, misc]
    except ValueError:
        return None
    return at + timedelta(milliseconds=int((fraction or "0").ljust(3, "0")))


def open_video(path: Path, settings: Settings) -> Photos:
    """Extract frames from a video and open them as photos, in a temporary folder that lives as long as the source.

    Raises:
        InputError: it cannot be decoded, or there is no telemetry with a place.
    """
    subtitles = next((p for suffix in (".srt", ".SRT") if (p := path.with_suffix(suffix)).is_file()), None)
    if subtitles is None:
        raise InputError(
            f"{path}: has no telemetry; put {path.stem}.srt beside it (subtitles in the video: ffmpeg -i {path.name} "
            f"{path.stem}.srt)"
        )
    rows = [t for t in read_srt(subtitles.read_text(encoding="utf-8", errors="replace")) if t.place is not None]
    if not rows:
        raise InputError(
            f"{subtitles}: no place in it; needs subtitles with [latitude: ...] [longitude: ...] [abs_alt: ...], or "
            "with GPS(...) and BAROMETER:..."
        )
    folder = Path(tempfile.mkdtemp(prefix="alight-video-"))
    try:
        root = folder / path.stem
        root.mkdir()
        tags = {t.path: t for t in _write_frames(path, rows, root)}
        if not tags:
            raise InputError(
                f"{path}: not one frame could be decoded; convert it: ffmpeg -i {path.name} -c:v libx264 OUT.mp4"
            )
        source = Photos(root, list(tags), settings, read=lambda path: (tags[path], ""))
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    source.notes["video"] = f"{len(tags)} frames of {path.name}, chosen by the distance flown"
    weakref.finalize(source, shutil.rmtree, folder, True)
    return source


def _write_frames(path: Path, rows: Sequence[Subtitle], root: Path) -> Iterator[PhotoTags]:
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # or the decoder repeats our own messages on stderr
    film = cv2.VideoCapture(str(path))
    try:
        rate = film.get(cv2.CAP_PROP_FPS) or 30.0
        at, last = np.array([t.seconds for t in rows]), None
        for number in itertools.takewhile(lambda _: film.grab(), itertools.count()):
            row = rows[max(int(np.searchsorted(at, number / rate, side="right")) - 1, 0)]
            if last is not None and _apart(last, row) < _step(row, film):
                continue
            fine, frame = film.retrieve()
            if not fine:
                continue
            last = row
            file = root / f"frame_{number:06d}.jpg"
            Image.fromarray(np.ascontiguousarray(frame[..., ::-1])).save(file, "JPEG", quality=95)
            yield _tags(file, (frame.shape[1], frame.shape[0]), row, number / rate)
    finally:
        film.release()


def _apart(a: Subtitle, b: Subtitle) -> float:
    """Distance in metres between the places of two subtitles."""
    assert a.place is not None
    assert b.place is not None
    north = 111_194.0 * (b.place[0] - a.place[0])
    east = 111_194.0 * math.cos(math.radians(a.place[0])) * (b.place[1] - a.place[1])
    return math.hypot(east, north, b.place[2] - a.place[2])


def digital_zoom(row: Subtitle) -> float:
    """Factor of the digital zoom; some models write it in ten thousandths."""
    zoom = row.values.get("dzoom_ratio", 1.0)
    return max(zoom / 10_000 if zoom >= 1000 else zoom, 1.0)


def focal_px(row: Subtitle, width: float) -> float | None:
    """Focal length in pixels, without a digital zoom, from the 35 mm equivalent.

    DJI's sensors are 4:3, and their whole width is filmed.
    """
    film = row.values.get("focal_len")
    if not film or film <= 0:
        return None
    if film > 200 and film == int(film):  # mm; larger whole numbers are tenths of a millimetre
        film /= 10
    return film_focal_px(film, width, 4 / 3)


def _step(row: Subtitle, film: Any) -> float:
    """Distance in metres from one frame to the next, for the overlap `OVERLAP`; usual values where none is known."""
    width, height = film.get(cv2.CAP_PROP_FRAME_WIDTH), film.get(cv2.CAP_PROP_FRAME_HEIGHT)
    focal = focal_px(row, width)
    field = (
        0.56 if focal is None else height / (focal * digital_zoom(row))
    )  # ground of a frame's height over the distance
    return max((1 - OVERLAP) * field * max(row.values.get("rel_alt", 30.0), 1.0), 0.5)


def _tags(path: Path, size: tuple[int, int], row: Subtitle, seconds: float) -> PhotoTags:
    """The tags that a photo of the same drone would have; no altitude where it is not known."""
    assert row.place is not None
    taken = row.taken or datetime(2000, 1, 1, tzinfo=UTC) + timedelta(seconds=seconds)
    exif: dict[int, str] = {
        Base.Make: "video", Base.Model: "with telemetry", Base.DateTimeOriginal: f"{taken:%Y:%m:%d %H:%M:%S}",
        Base.SubsecTimeOriginal: f"{taken.microsecond // 1000:03d}", Base.DigitalZoomRatio: f"{digital_zoom(row):g}",
        Base.FocalLength: str(row.values.get("focal_len", "")),
    }  # fmt: skip
    xmp = {
        "dji:GpsLatitude": row.place[0], "dji:GpsLongitude": row.place[1], "dji:AbsoluteAltitude": row.altitude,
        "dji:RelativeAltitude": row.values.get("rel_alt"), "dji:CalibratedFocalLength": focal_px(row, size[0]),
        "dji:GimbalYawDegree": row.values.get("gb_yaw"), "dji:GimbalPitchDegree": row.values.get("gb_pitch"),
        "dji:GimbalRollDegree": row.values.get("gb_roll"), "camera:GPSXYAccuracy": 11.0 if row.coarse else None,
    }  # fmt: skip
    return PhotoTags(path, size, exif, {}, {k: str(v) for k, v in xmp.items() if v is not None})
