"""A film with telemetry as photos: frames selected by the distance flown, with tags for `Photos`."""

from __future__ import annotations

import math
import weakref
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from tempfile import TemporaryDirectory

from PIL import ExifTags, Image

from alight.photos.reading.film_clock import film_offset, picture_path
from alight.photos.reading.film_frames import FilmFrames
from alight.photos.reading.film_telemetry import FilmTelemetry, TelemetryRow, apart
from alight.photos.reading.film_tracks import telemetry_beside, telemetry_inside
from alight.photos.reading.photo_camera import film_focal_px
from alight.photos.reading.photo_tags import PhotoTags
from alight.photos.reading.photos import Photos
from alight.records import InputError
from alight.settings import Settings

Base = ExifTags.Base

OVERLAP = 0.8  # share of a frame that the next one repeats, along the flight
IN_STEP = 0.3  # s; a smaller clock offset is not corrected, because the pictures do not show it more exactly


@dataclass(frozen=True)
class FilmClock:
    """Clock offset between a film and its telemetry."""

    offset: float  # s, to be added to the film's time
    found: str  # how the offset was found, in words
    warning: str = ""
    accuracy: float = 0.0  # m, error of positions by a possibly wrong offset; 0: the offset is reliable


def open_video(
    path: Path, settings: Settings, log: Callable[[bool], FilmTelemetry | None] = lambda own: None
) -> Photos:
    """Open a film as photos; its frames are extracted to a temporary folder that lives as long as the source.

    Args:
        path: the film.
        settings: all settings of the run.
        log: returns the telemetry of the autopilot's log with the film's name if its argument is true, else of the only
            log next to the film; None: there is none.

    Raises:
        InputError: the film cannot be decoded, has no telemetry with positions, or its clock offset is unclear.
    """
    with FilmFrames(path) as frames:
        seconds = frames.seconds
    telemetry = telemetry_beside(path) or log(True)
    if telemetry is None:
        try:
            telemetry = telemetry_inside(path, seconds) or log(False)
        except InputError:  # no reader of tracks is installed
            if (telemetry := log(False)) is None:
                raise
    if telemetry is None:
        raise InputError(f"{path}: has no telemetry; put {path.stem}.srt or {path.stem}.gpx beside it")
    clock = film_clock(path, seconds, telemetry, settings.sources.time_offset)
    with ExitStack() as stack:
        root = Path(stack.enter_context(TemporaryDirectory(prefix="alight-video-"))) / path.stem
        root.mkdir()
        tags = {t.path: t for t in _write_frames(path, telemetry, clock, root)}
        if not tags:
            raise InputError(
                f"{path}: not one frame could be decoded within the time of its telemetry; convert it: ffmpeg -i "
                f"{path.name} -c:v libx264 OUT.mp4"
            )
        source = Photos(root, list(tags), settings, read=lambda path: (tags[path], ""))
        weakref.finalize(source, stack.pop_all().close)
    source.notes["video"] = f"{len(tags)} frames of {path.name}, chosen by the distance flown"
    source.notes["telemetry"] = "; ".join(
        part for part in (f"{telemetry.source}: {len(telemetry.rows)} places", telemetry.found, clock.found) if part
    )
    for warning in filter(None, (telemetry.warning, clock.warning)):
        source.findings.warn(warning)
    return source


def film_clock(path: Path, seconds: float, telemetry: FilmTelemetry, given: float | None) -> FilmClock:
    """Determine the clock offset between a film and its telemetry.

    Args:
        path: the film.
        seconds: length of the film; 0: unknown.
        telemetry: positions of the film.
        given: `sources.time_offset`, s, the telemetry's zero on the film's clock; None: estimate it from the pictures.

    Raises:
        InputError: the offset is unclear, and the telemetry has a clock of its own.
    """
    if given is not None:
        return FilmClock(-given, f"the {_earlier(-given)}, by sources.time_offset")
    found = film_offset(picture_path(path), telemetry)
    line = f"the {_earlier(found.seconds)}, by the pictures"
    if not telemetry.of_film:
        if found.unclear:
            raise InputError(
                f"{telemetry.source}: the time between it and the film is not clear from the pictures: "
                f"{found.unclear}; set sources.time_offset=SECONDS from the film's first frame to the track's first "
                "place (negative: the place comes first)"
            )
        return FilmClock(found.seconds, line)
    longer = telemetry.length - seconds
    cut = seconds > 0 and abs(longer) > 1.0 + telemetry.step  # 0: the header does not give the length
    warnings = [f"the telemetry lasts {telemetry.length:.1f} s, the film {seconds:.1f} s"] if cut else []
    if found.unclear:
        line = f"whether film and telemetry are in step is not clear from the pictures: {found.unclear}"
        accuracy = abs(longer) * telemetry.speed if cut else 0.0
        return FilmClock(0.0, line, ": ".join([*warnings, line]), accuracy)
    if abs(found.seconds) < IN_STEP:
        return FilmClock(0.0, "in step with the pictures", "".join(warnings))
    return FilmClock(found.seconds, line, "; ".join([*warnings, f"{line}: places are corrected"]))


def _earlier(offset: float) -> str:
    return f"telemetry begins {abs(offset):.1f} s {'earlier' if offset >= 0 else 'later'} than the film"


def _write_frames(path: Path, telemetry: FilmTelemetry, clock: FilmClock, root: Path) -> Iterator[PhotoTags]:
    """Save the selected frames of a film in `root` and yield their tags; frames without telemetry are left out."""
    last, climbed = None, 0.0
    with FilmFrames(path) as frames:
        for t in frames:
            if (row := telemetry.at(t + clock.offset)) is None:
                continue
            height = row.values.get("abs_alt", row.values.get("rel_alt", 0.0))
            if last is not None and math.hypot(abs(apart(last, row)), climbed - height) < _step(last, frames.size):
                continue
            if (image := frames.image()) is None:
                continue
            last, climbed = row, height
            file = root / f"frame_{frames.number:06d}.jpg"
            Image.fromarray(image).save(file, "JPEG", quality=95)
            yield _tags(file, frames, row, max(11.0 * row.coarse, clock.accuracy))


def digital_zoom(row: TelemetryRow) -> float:
    """Return the factor of the digital zoom; some models write it in ten-thousandths."""
    zoom = row.values.get("dzoom_ratio", 1.0)
    return max(zoom / 10_000 if zoom >= 1000 else zoom, 1.0)


def focal_px(row: TelemetryRow, longer: float) -> float | None:
    """Compute the focal length in pixels without digital zoom, from the 35 mm equivalent; None if not given.

    `longer` is the longer side of a frame in pixels. DJI's sensors are 4:3, and films use their whole longer side.
    """
    film = row.values.get("focal_len")
    if not film or film <= 0:
        return None
    if film > 200 and film == int(film):  # mm; larger whole numbers are tenths of a millimetre
        film /= 10
    return film_focal_px(film, longer, 4 / 3)


def _step(row: TelemetryRow, size: tuple[int, int]) -> float:
    """Return metres from one selected frame to the next, for overlap `OVERLAP`; usual values replace missing ones."""
    focal = focal_px(row, max(size))
    field = 0.56 if focal is None else min(size) / (focal * digital_zoom(row))  # extent on the ground over height
    return max((1 - OVERLAP) * field * max(row.values.get("rel_alt", 30.0), 1.0), 0.5)


def _tags(path: Path, frames: FilmFrames, row: TelemetryRow, accuracy: float) -> PhotoTags:
    """Build the tags that a photo of the same drone would have; an unknown altitude is left out.

    `path`: file of the frame; `accuracy`: error of the position in metres, 0: not given.
    """
    assert row.place is not None
    taken = row.taken or datetime(2000, 1, 1, tzinfo=UTC) + timedelta(seconds=row.seconds)
    exif: dict[int, str] = {
        Base.Make: "video", Base.Model: "with telemetry", Base.DateTimeOriginal: f"{taken:%Y:%m:%d %H:%M:%S}",
        Base.SubsecTimeOriginal: f"{taken.microsecond // 1000:03d}", Base.DigitalZoomRatio: f"{digital_zoom(row):g}",
        Base.FocalLength: str(row.values.get("focal_len", "")), Base.Orientation: str(frames.orientation),
    }  # fmt: skip
    xmp = {
        "dji:GpsLatitude": row.place[0], "dji:GpsLongitude": row.place[1],
        "dji:AbsoluteAltitude": row.values.get("abs_alt"), "dji:RelativeAltitude": row.values.get("rel_alt"),
        "dji:CalibratedFocalLength": focal_px(row, max(frames.size)),
        "dji:CalibratedOpticalCenterX": frames.size[0] / 2, "dji:CalibratedOpticalCenterY": frames.size[1] / 2,
        "dji:GimbalYawDegree": row.values.get("gb_yaw"), "dji:GimbalPitchDegree": row.values.get("gb_pitch"),
        "dji:GimbalRollDegree": row.values.get("gb_roll"), "camera:GPSXYAccuracy": accuracy or None,
    }  # fmt: skip
    return PhotoTags(path, frames.size, exif, {}, {k: str(v) for k, v in xmp.items() if v is not None})
