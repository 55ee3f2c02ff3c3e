"""Check an opened recording of any kind: the rig of a flight, or a set of photos."""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

from alight.checks.result import CheckResult
from alight.settings import Settings
from alight.sources import Source


def check_opened(
    source: Source,
    settings: Settings,
    seconds: float,
    start: float,
    progress: Callable[[float], None] = lambda share: None,
) -> list[CheckResult]:
    """Return the checks of a recording; for photos, the last check is the verdict.

    Args:
        source: a flight, or photos.
        settings: settings of the planned run.
        seconds, start: length of the part of a flight that is read, and its start after the first exposure, s.
        progress: called with the share that is done.

    Raises:
        InputError: there is no exposure in that part.
    """
    if source.kind == "photos":
        from alight.photos.check.checking import check_photos
        from alight.photos.reading.photos import Photos

        return check_photos(cast(Photos, source), settings, progress)
    from alight.checks.checking import check_source

    return check_source(source, settings, seconds, start, progress)
