"""Sources for a flight, with events in order of arrival: cameras, or a folder that is being filled."""

from __future__ import annotations

import queue
import re
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from alight.records import Event, InputError, Motion, Telemetry
from alight.settings import Settings
from alight.sources.source import Source

PREFIXES = ("camera:", "rtsp:", "gst:", "video:")
PATIENCE = 30.0  # s to wait for the calibration of a folder


@dataclass(frozen=True)
class LiveSource:
    """A source, its events as they arrive, and whether they come from sensors in real time."""

    source: Source
    events: Iterator[Event]
    real_time: bool
    telemetry: Callable[[], Telemetry | None] = lambda: None  # newest of an autopilot used as GPS/INS
    on_motion: Callable[[Motion], None] = lambda motion: None  # receives each motion; it sends odometry


def is_cameras(name: str) -> bool:
    """Whether a source's name is a list of cameras, and not the path of a file or folder."""
    return name.startswith(PREFIXES)


def open_sensors(
    name: str, settings: Settings, rig: Path | None = None, stopped: Callable[[], bool] = lambda: False,
    idle: float = 10.0,
) -> LiveSource:  # fmt: skip
    """Open cameras, or a folder that is being filled.

    Args:
        name: camera names separated by commas, or a folder.
        rig: folder with the calibration of the cameras; None: not given.
        stopped: polled regularly; True ends the events.
        idle: s without anything new in a folder after which it is complete.

    Raises:
        InputError: the source does not exist or cannot be used; the message names what was missing.
    """
    if not is_cameras(name):
        from alight.sources.growing import GrowingLog, wait_for_calibration

        wait_for_calibration(Path(name), PATIENCE)
        growing = GrowingLog(Path(name), settings, idle)
        return LiveSource(growing, growing.events(stopped), True)
    if rig is None:
        raise InputError(f"{name}: cameras need their calibration; give a folder with cam0/sensor.yaml as --rig")
    from alight.sources.capture import Cameras

    names = re.split(rf",\s*(?={'|'.join(PREFIXES)})", name)  # a pipeline or an address may contain commas
    cameras = Cameras(names, rig, settings)
    return LiveSource(cameras, cameras.events(stopped), True)


def as_they_arrive(last: Iterator[Event], *others: Iterator[Event], most: int = 0) -> Iterator[Event]:
    """Yield the events of several sources in order of arrival, until `last` ends; a thread reads each source.

    Args:
        last: source whose end ends the iteration.
        others: sources that may end earlier.
        most: greatest number of events that are read ahead; 0: no limit.

    Raises:
        Exception: the exception that a source raised while it was read.
    """
    arrived: queue.Queue[Event | BaseException | None] = queue.Queue(most)
    over = threading.Event()

    def put(item: Event | BaseException | None) -> None:
        while not over.is_set():
            with suppress(queue.Full):
                arrived.put(item, timeout=0.2)
                return

    def read(events: Iterator[Event]) -> None:
        try:
            for event in events:
                put(event)
                if over.is_set():
                    return
            if events is last:
                put(None)
        except BaseException as e:
            put(e)

    for events in (*others, last):
        threading.Thread(target=read, args=(events,), daemon=True).start()
    try:
        while (item := arrived.get()) is not None:
            if isinstance(item, BaseException):
                raise item
            yield item
    finally:
        over.set()


def paced(events: Iterator[Event], speed: float, stopped: Callable[[], bool] = lambda: False) -> Iterator[Event]:
    """Yield the events of a recording at the times of their stamps; overdue events are yielded at once.

    Args:
        speed: playback speed over real time; 2 is twice as fast as the flight.
        stopped: called before each event; True ends the iteration.
    """
    begin, first = time.perf_counter(), None
    for event in as_they_arrive(events, most=64):  # 64 events are read, and their pictures decoded, before they are due
        if first is None:
            begin, first = time.perf_counter(), event.t_ns
        while not stopped():
            wait = 1e-9 * (event.t_ns - first) / speed - (time.perf_counter() - begin)
            if wait <= 0:
                break
            time.sleep(min(wait, 0.1))
        if stopped():
            return
        yield event
