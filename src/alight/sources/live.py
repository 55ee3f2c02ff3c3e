"""Sources of a live run: the only module that takes the name of such a source."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from alight.records import Event, InputError, Telemetry
from alight.settings import Settings
from alight.sources.capture import PREFIXES, Cameras
from alight.sources.growing import GrowingLog, wait_for_calibration
from alight.sources.opening import open_source
from alight.sources.paced import paced
from alight.sources.source import Source

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
    if name.startswith(PREFIXES):
        if rig is None:
            raise InputError(f"{name}: cameras need their calibration; give a folder with cam0/sensor.yaml as --rig")
        cameras = Cameras(BETWEEN.split(name), rig, settings)
        return LiveSource(cameras, cameras.events(stopped), True)
    if follow:
        wait_for_calibration(Path(name), PATIENCE)
        growing = GrowingLog(Path(name), settings, IDLE)
        return LiveSource(growing, growing.events(stopped), True)
    source = open_source(name, settings)
    if source.kind != "flight":
        raise InputError(f"{name}: photos have no speed of their own; use alight run")
    return LiveSource(source, paced(source.events(), speed, stopped), False)
