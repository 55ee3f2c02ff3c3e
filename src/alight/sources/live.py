"""Sources of a flight: cameras, or a folder that is being filled."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from alight.records import Event, InputError, Telemetry
from alight.settings import Settings
from alight.sources.source import Source

PREFIXES = ("camera:", "rtsp:", "gst:", "video:")
IDLE = 10.0  # s without new rows or pictures, after which a folder counts as complete
PATIENCE = 30.0  # s that a folder may take to get its calibration
BETWEEN = re.compile(rf",\s*(?={'|'.join(PREFIXES)})")  # two cameras; a pipeline or an address may hold commas itself


@dataclass(frozen=True)
class LiveSource:
    """A source, its events as they come, and whether they come from sensors in real time."""

    source: Source
    events: Iterator[Event]
    real_time: bool
    heard: Callable[[], Telemetry | None] = lambda: None  # newest telemetry of the autopilot that gives GPS/INS


def never() -> bool:
    """Return False: never stopped."""
    return False


def is_cameras(name: str) -> bool:
    """True for cameras; else it is the name of a file or a folder."""
    return name.startswith(PREFIXES)


def open_sensors(
    name: str, settings: Settings, rig: Path | None = None, stopped: Callable[[], bool] = never
) -> LiveSource:
    """Open cameras, or a folder that is being filled.

    Args:
        name: cameras with commas between them, or a folder.
        rig: folder with the calibration of cameras.
        stopped: called now and then; True ends the events.

    Raises:
        InputError: it is no source, or cannot be used; the message names what was looked for.
    """
    if not is_cameras(name):
        from alight.sources.growing import GrowingLog, wait_for_calibration

        wait_for_calibration(Path(name), PATIENCE)
        growing = GrowingLog(Path(name), settings, IDLE)
        return LiveSource(growing, growing.events(stopped), True)
    if rig is None:
        raise InputError(f"{name}: cameras need their calibration; give a folder with cam0/sensor.yaml as --rig")
    from alight.sources.capture import Cameras

    cameras = Cameras(BETWEEN.split(name), rig, settings)
    return LiveSource(cameras, cameras.events(stopped), True)
