"""The only module that takes the name of an input and decides its kind."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from alight.records import InputError
from alight.settings import Settings
from alight.sources import Source

if TYPE_CHECKING:
    from alight.sources.live import LiveSource

VIDEOS = (".mp4", ".mov", ".m4v")
LOOKED_FOR = "a flight log (a folder with mav0/), a recording (.mcap), a folder of photos or a video (.mp4) with a .srt"


def open_source(
    path: str | Path,
    settings: Settings | None = None,
    *,
    places: str | Path | None = None,
    geoid: str | Path | None = None,
) -> Source:
    """Open a flight log, a recording of a live run, or a folder of photos.

    Args:
        path: of the recording.
        settings: of the run; None: the defaults.
        places: of a folder of photos: file with their places; `tags`: none; None: one that stands beside them.
        geoid: of a folder of photos: grid of geoid heights, for altitudes that count from the sea level.

    Raises:
        InputError: it is none of them, or cannot be used; the message names what was looked for.
    """
    path = Path(path)
    try:
        files = (None if file is None else Path(file).expanduser() for file in (places, geoid))
        source = _open(path, settings or Settings(), *files)
    except OSError as e:
        raise InputError(f"{e.filename or path}: cannot be read ({e.strerror}); check the permissions") from e
    if places is not None and (source.kind != "photos" or path.is_file()):
        raise InputError(f"--places {places}: is for a folder of photos; run it without")
    return source


def _open(path: Path, settings: Settings, places: Path | None, geoid: Path | None) -> Source:
    if not path.exists():
        raise InputError(f"{path}: no such folder; give {LOOKED_FOR}")
    if path.is_file() and path.suffix.lower() == ".mcap":
        from alight.sources.recording import Recording

        return Recording(path, settings)
    if path.is_file() and path.suffix.lower() in VIDEOS:
        from alight.photos.reading.video import open_video

        return open_video(path, settings)
    if not path.is_dir():
        raise InputError(f"{path}: a file; give {LOOKED_FOR}")
    root = path.resolve()
    if (root / "mav0").is_dir() or root.name == "mav0" or (root / "cam0" / "data.csv").is_file():
        from alight.sources.flight_log import FlightLog

        return FlightLog(root, settings)
    from alight.photos.reading.photo_selection import find_photos

    if (found := find_photos(root)).files:
        from alight.photos.reading.photos import Photos

        return Photos(root, found.files, settings, found.closed, places=places, geoid=geoid)
    if not any(root.iterdir()):
        raise InputError(f"{path}: the folder is empty; give {LOOKED_FOR}")
    if inside := sorted(p.parent.name for p in root.glob("*/mav0")):
        raise InputError(f"{path}: holds {len(inside)} flight log(s); name one of them, such as {path / inside[0]}")
    closed = f" (no permission to read {', '.join(p.name for p in found.closed)})" if found.closed else ""
    raise InputError(
        f"{path}: nothing usable in it{closed}; looked for mav0/ and for .jpg, .png or .tif files, give {LOOKED_FOR}"
    )


def open_live(
    name: str,
    settings: Settings,
    speed: float = 1.0,
    follow: bool = False,
    rig: Path | None = None,
    stopped: Callable[[], bool] = lambda: False,
) -> LiveSource:
    """Open the source of a live run.

    Args:
        name: a flight log or a recording, a folder that is being filled, or cameras with commas between them.
        speed: of a recording: 2 is twice as fast as the flight.
        follow: the folder is being filled.
        rig: folder with the calibration of cameras.
        stopped: called now and then; True ends the events.

    Raises:
        InputError: it is no source, or cannot be used; the message names what was looked for.
    """
    from alight.sources.live import LiveSource, is_cameras, open_sensors, paced

    if follow or is_cameras(name):
        return open_sensors(name, settings, rig, stopped)
    source = open_source(name, settings)
    if source.kind != "flight":
        raise InputError(f"{name}: photos have no speed of their own; use alight run")
    return LiveSource(source, paced(source.events(), speed, stopped), False)
