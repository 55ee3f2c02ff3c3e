"""The only module that takes the name of an input and determines the kind of the input."""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from alight.outputs import is_finished
from alight.records import InputError
from alight.settings import Settings
from alight.sources import Source
from alight.sources.bags.finding import bag_files
from alight.sources.source import Findings

if TYPE_CHECKING:
    from alight.photos.reading.film_telemetry import FilmTelemetry
    from alight.sources.calibrated_folder import CalibratedFolder
    from alight.sources.live import LiveSource

VIDEOS = (".mp4", ".mov", ".m4v")
LOGS = {".ulg": rb"ULog", ".bin": rb"\xa3\x95", ".tlog": rb".{8}[\xfd\xfe]"}  # first bytes of autopilots' logs
LOOKED_FOR = (
    "a flight log (a folder with mav0/), a recording (.mcap), a ROS bag (.bag, .db3, .mcap), a folder of photos, "
    "frames with an autopilot's log (.ulg, .bin, .tlog), or a video (.mp4) with a .srt or .gpx"
)


def open_source(
    path: str | Path,
    settings: Settings | None = None,
    *,
    places: str | Path | None = None,
    geoid: str | Path | None = None,
    topics: Mapping[str, str] | None = None,
) -> Source:
    """Open the source of a path: a flight log, a recording, frames with a log, photos, or a video.

    Args:
        path: file or folder of the input.
        settings: settings of the run; None: the defaults.
        places: for photos: file with their positions; `tags`: no file is used; None: a file found with the photos.
        geoid: for photos: grid of geoid heights, for altitudes above sea level.
        topics: for a ROS bag: topics by role (left, right, position, attitude, velocity, imu), empty for none; those
            of other roles are chosen.

    Raises:
        InputError: the input is of no known kind, or cannot be used; the message names what was looked for.
    """
    path = Path(path)
    try:
        files = (None if file is None else Path(file).expanduser() for file in (places, geoid))
        source = _open_bag(path, settings or Settings(), topics or {}) or _open(path, settings or Settings(), *files)
    except OSError as e:
        raise InputError(f"{e.filename or path}: cannot be read ({e.strerror}); check the permissions") from e
    if places is not None and (source.kind != "photos" or path.is_file()):
        raise InputError(f"--places {places}: is for a folder of photos; run it without")
    return source


def _open_bag(path: Path, settings: Settings, topics: Mapping[str, str]) -> Source | None:
    """Open a ROS bag; None: the path is none."""
    parts = [] if (path / "mav0").is_dir() else bag_files(path)
    if not parts and topics and path.exists():
        raise InputError(f"{path}: --topic is for a ROS bag; run it without")
    if not parts:
        return None
    from alight.sources.bags.bag import BagFlight

    return BagFlight(path, parts, settings, topics)


def _open(path: Path, settings: Settings, places: Path | None, geoid: Path | None) -> Source:
    if not path.exists():
        raise InputError(f"{path}: no such folder or file; give {LOOKED_FOR}")
    if path.is_file() and path.suffix.lower() == ".mcap":
        from alight.sources.recording import Recording

        return Recording(path, settings)
    if path.is_file() and path.suffix.lower() in VIDEOS:
        from alight.photos.reading.video import open_video

        return open_video(path, settings, lambda own: _telemetry_of_log(path, settings, own))
    if not path.is_dir():
        raise InputError(f"{path}: not a file that can be read; give {LOOKED_FOR}")
    root = path.resolve()
    if (root / "mav0").is_dir() or root.name == "mav0" or (root / "cam0" / "data.csv").is_file():
        from alight.sources.flight_log import FlightLog

        flight = FlightLog(root, settings)
        log = None if flight.georeferenced else log_in(root)
        return flight if log is None else _with_log(flight, log, settings)
    beside = sorted(p.name for p in root.iterdir() if p.suffix.lower() in LOGS)
    if beside and _have_places(root):
        beside = []
    if beside and (log := log_in(root)) is not None:
        from alight.sources.frame_folder import FrameFolder

        return _with_log(FrameFolder(root, settings), log, settings)
    if is_finished(root):
        raise InputError(
            f"{path}: holds the results of a run; give what it was made from, or see 'alight judge --help'"
        )
    from alight.photos.reading.photo_selection import find_photos

    if (found := find_photos(root)).files:
        from alight.photos.reading.photos import Photos

        try:
            return Photos(root, found.files, settings, found.closed, places=places, geoid=geoid)
        except InputError as e:
            if beside:
                raise InputError(f"{e}; no autopilot's log, by the first bytes: {', '.join(beside)}") from e
            raise
    if not any(root.iterdir()):
        raise InputError(f"{path}: the folder is empty; give {LOOKED_FOR}")
    if inside := sorted(p.parent.name for p in root.glob("*/mav0")):
        raise InputError(f"{path}: holds {len(inside)} flight log(s); name one of them, such as {path / inside[0]}")
    closed = f" (no permission to read {', '.join(p.name for p in found.closed)})" if found.closed else ""
    raise InputError(
        f"{path}: nothing usable in it{closed}; looked for mav0/ and for .jpg, .png or .tif files, give {LOOKED_FOR}"
    )


def log_in(folder: Path) -> Path | None:
    """Return the autopilot's log in a folder of frames, by suffix and first bytes; None: the folder has no log.

    Raises:
        InputError: the folder has several logs.
    """
    found = sorted(p for p in folder.iterdir() if _is_log(p))
    if len(found) > 1:
        raise InputError(f"{folder}: holds {len(found)} logs of an autopilot; leave the one of these frames in it")
    return found[0] if found else None


def _is_log(path: Path) -> bool:
    """Whether a file is an autopilot's log. Cameras and receivers write files with the suffix .bin as well."""
    if path.suffix.lower() not in LOGS or not path.is_file():
        return False
    with path.open("rb") as file:
        return re.match(LOGS[path.suffix.lower()], file.read(9), re.DOTALL) is not None


def _telemetry_of_log(film: Path, settings: Settings, own: bool) -> FilmTelemetry | None:
    """Return positions for a film, from the log of the same name if `own`, else from its folder's log; None: no log."""
    named = (p for p in sorted(film.parent.iterdir()) if p.stem == film.stem and _is_log(p))
    log = next(named, None) if own else log_in(film.parent)
    if log is None:
        return None
    from alight.flight.logs.logged import streams_of
    from alight.flight.logs.logged_frames import read_log
    from alight.photos.reading.film_telemetry import FilmTelemetry, TelemetryRow

    flight = streams_of(read_log(log), str(log), settings.sources.separation, Findings())
    nav = flight.nav
    return FilmTelemetry.of(
        (TelemetryRow(1e-9 * (t - nav.t_ns[0]), dict(zip(("latitude", "longitude", "abs_alt"), place, strict=True)))
         for t, place in zip(nav.t_ns.tolist(), nav.values[:, :3].tolist(), strict=True)),
        str(log), flight.found[-1], of_film=False,
    )  # fmt: skip


def _have_places(folder: Path) -> bool:
    """Whether one of about eight pictures of a folder has a position in its tags; True if there are no pictures."""
    from alight.photos.reading.photo_tags import read_tags
    from alight.sources.frame_folder import frames_in
    from alight.sources.images import UNREADABLE

    found = frames_in(folder)
    for path in found[:: len(found) // 8 + 1]:  # the first may be taken before the receiver's first fix
        with suppress(*UNREADABLE):
            if read_tags(path)[0].place is not None:
                return True
    return not found


def _with_log(frames: CalibratedFolder, log: Path, settings: Settings) -> Source:
    from alight.flight.logs.logged_frames import LoggedFrames

    return LoggedFrames(frames, log, settings)


def open_live(
    name: str,
    settings: Settings,
    speed: float = 1.0,
    follow: bool = False,
    rig: Path | None = None,
    topics: Mapping[str, str] | None = None,
) -> LiveSource:
    """Open the source of a live run.

    Args:
        name: flight log, recording, bag, folder or bag that is being filled, or cameras separated by commas.
        speed: playback speed of a recording; 2 is twice as fast as the flight.
        follow: whether `name` is a folder or a bag that is being filled.
        rig: folder with the calibration of cameras.
        topics: for a ROS bag, as for `open_source`.

    Raises:
        InputError: the name is no source, or cannot be used; the message names what was looked for.
    """
    from alight.sources.bags.growing_bag import is_growing_bag, open_growing_bag
    from alight.sources.bags.growth import Growth
    from alight.sources.live import PATIENCE, LiveSource, is_cameras, open_sensors, paced

    if follow and not is_cameras(name) and is_growing_bag(Path(name), PATIENCE):
        bag = open_growing_bag(Path(name), settings, topics or {}, Growth(idle=10.0), PATIENCE)  # s
        return LiveSource(bag, bag.events(), True)
    if follow or is_cameras(name):
        return open_sensors(name, settings, rig)
    source = open_source(name, settings, topics=topics)
    if source.kind != "flight":
        raise InputError(f"{name}: photos have no speed of their own; use alight run")
    return LiveSource(source, paced(source.events(), speed), False)
