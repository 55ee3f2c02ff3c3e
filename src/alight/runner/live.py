"""The source of a live run: sensors, or a recording at its own speed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from alight.records import InputError
from alight.runner.opening import open_source
from alight.settings import Settings
from alight.sources.live import LiveSource, is_cameras, never, open_sensors, paced


def open_live(
    name: str,
    settings: Settings,
    speed: float = 1.0,
    follow: bool = False,
    rig: Path | None = None,
    stopped: Callable[[], bool] = never,
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
    if follow or is_cameras(name):
        return open_sensors(name, settings, rig, stopped)
    source = open_source(name, settings)
    if source.kind != "flight":
        raise InputError(f"{name}: photos have no speed of their own; use alight run")
    return LiveSource(source, paced(source.events(), speed, stopped), False)
