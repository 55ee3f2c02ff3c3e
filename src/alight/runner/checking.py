"""Check a recording of any kind: the rig of a flight, or a set of photos."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from alight.checks.result import CheckResult
from alight.records import PhotoRow
from alight.runner.opening import open_source
from alight.settings import Settings


def check(
    path: Path, settings: Settings, seconds: float, start: float, progress: Callable[[float], None]
) -> tuple[list[CheckResult], list[PhotoRow]]:
    """Check a recording; return the results, and the rows of the photos (of a flight: none).

    Args:
        path: of a flight log, a recording, a folder of photos or a film.
        settings: of the run that is planned.
        seconds, start: part of a flight that is read, s from the first exposure.
        progress: called with the share that is done.

    Raises:
        InputError: it is no source, cannot be used, or has no exposure in that part.
    """
    source = open_source(path, settings)
    if source.kind == "flight":
        from alight.checks.checking import check_source

        return check_source(source, seconds, start, progress), []
    from alight.photos.check.checking import check_photos
    from alight.photos.reading.photos import Photos

    assert isinstance(source, Photos)
    return check_photos(source, settings, progress), [PhotoRow(p, None) for p in source.photos]
