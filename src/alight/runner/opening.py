"""The only module that takes the name of an input and decides its kind."""

from __future__ import annotations

from pathlib import Path

from alight.records import InputError
from alight.settings import Settings
from alight.sources import Source

VIDEOS = (".mp4", ".mov", ".m4v")
LOOKED_FOR = "a flight log (a folder with mav0/), a recording (.mcap), a folder of photos or a video (.mp4) with a .srt"


def open_source(path: str | Path, settings: Settings | None = None) -> Source:
    """Open a flight log, a recording of a live run, or a folder of photos.

    Raises:
        InputError: it is none of them, or cannot be used; the message names what was looked for.
    """
    path = Path(path)
    try:
        return _open(path, settings or Settings())
    except OSError as e:
        raise InputError(f"{e.filename or path}: cannot be read ({e.strerror}); check the permissions") from e


def _open(path: Path, settings: Settings) -> Source:
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

        return Photos(root, found.files, settings, found.closed)
    if not any(root.iterdir()):
        raise InputError(f"{path}: the folder is empty; give {LOOKED_FOR}")
    if inside := sorted(p.parent.name for p in root.glob("*/mav0")):
        raise InputError(f"{path}: holds {len(inside)} flight log(s); name one of them, such as {path / inside[0]}")
    closed = f" (no permission to read {', '.join(p.name for p in found.closed)})" if found.closed else ""
    raise InputError(
        f"{path}: nothing usable in it{closed}; looked for mav0/ and for .jpg, .png or .tif files, give {LOOKED_FOR}"
    )
