"""A flight log that is still being written: rows and pictures are read as they appear."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np

from alight.records import Event, Frame, InputError
from alight.settings import Settings
from alight.sources.bags.growth import POLL
from alight.sources.calibrated_folder import CalibratedFolder
from alight.sources.streams import (
    COLUMNS,
    Table,
    imu_samples,
    names_file,
    nav_samples,
    rows_of,
    table_of,
    usable_imu,
    usable_nav,
)

PARTNER = 0.15  # s that an image waits for the image of another camera
WRITTEN = 1.0  # s allowed from an image's row until its file is complete

Item = TypeVar("Item")


class GrowingTable:
    """A CSV file that grows; a line is read once its line break has been written."""

    def __init__(self, path: Path) -> None:
        self._path, self._at, self._line, self._rest = path, 0, 0, b""

    def new_lines(self) -> list[tuple[int, str]]:
        """Return the (line number, text) pairs added since the last call."""
        try:
            with self._path.open("rb") as f:
                f.seek(self._at)
                data = f.read()
        except OSError:
            return []
        self._at += len(data)
        *whole, self._rest = (self._rest + data).split(b"\n")
        out = [(self._line + k, text.decode("utf-8-sig", "replace")) for k, text in enumerate(whole, 1)]
        self._line += len(whole)
        return out


class WaitingExposures(Generic[Item]):
    """Exposures that wait until each camera has delivered its item: an image or its file name."""

    def __init__(self, cameras: int) -> None:
        self.items: dict[int, list[Item | None]] = {}  # one item per camera, by stamp
        self._since: dict[int, float] = {}  # s, arrival of the first item
        self._cameras = cameras
        self._stamps: deque[int] = deque(maxlen=32)  # ns, latest stamps of the first camera, which give its period
        self._newest = -1  # latest stamp that was yielded

    def add(self, camera: int, t_ns: int, item: Item, now: float) -> None:
        """Add a camera's item to the exposure of equal or nearest time within half a period, or to a new exposure.

        `camera`: index; `now`: present time in s, from which a new exposure waits.
        """
        if camera == 0:
            self._stamps.append(t_ns)
        steps = np.abs(np.diff(np.array(self._stamps, np.int64)))
        half = max(int(np.median(steps) if len(steps) else 1e9 / 30) // 2, 1)
        near = [t for t, items in self.items.items() if items[camera] is None and abs(t - t_ns) < half]
        found = t_ns if t_ns in self.items else min(near, key=lambda t: abs(t - t_ns), default=t_ns)
        items = self.items.pop(found, [None] * self._cameras)
        items[camera] = item
        at = t_ns if camera == 0 else found  # an exposure has the stamp of the first camera
        self.items[at], self._since[at] = items, self._since.pop(found, now)

    def ready(self, now: float) -> Iterator[tuple[int, list[Item | None], float]]:
        """Yield and drop (stamp ns, items, waiting time s) in order of time, up to the first exposure that must wait.

        `now` is the present time in s. An exposure that lacks an item waits for `PARTNER` seconds. An exposure older
        than one already yielded does not wait, because its partner has been yielded alone.
        """
        for t_ns in sorted(self.items):
            items, waited = self.items[t_ns], now - self._since[t_ns]
            if t_ns > self._newest and waited < PARTNER and any(item is None for item in items):
                return
            yield t_ns, items, waited
            del self.items[t_ns], self._since[t_ns]
            self._newest = max(self._newest, t_ns)


class GrowingLog(CalibratedFolder):
    """A folder in the layout of a flight log, which another program is filling.

    Args:
        root: folder that has the calibration from the beginning: `cam0/sensor.yaml`, and files of other sensors.
        idle: s without new rows or pictures after which the log is complete.

    Raises:
        InputError: the calibration is missing or invalid.
    """

    def __init__(self, root: Path, settings: Settings, idle: float = 10.0) -> None:
        super().__init__(root, settings)
        self._idle = idle
        self._tables = {name: GrowingTable(self._root / name / "data.csv") for name in ("nav0", "imu0")}
        self._cams = [GrowingTable(self._root / c.name / "data.csv") for c in self.rig.cameras]
        self._waiting = WaitingExposures[str](len(self._cams))
        self._note((self._root / "nav0").is_dir(), (self._root / "imu0").is_dir())

    def events(self, stopped: Callable[[], bool] = lambda: False) -> Iterator[Event]:
        """Yield events as they appear; events found at once are sorted by time.

        The iteration ends when `stopped` returns True, or after `idle` seconds without an event.
        """
        last = time.monotonic()
        while not stopped():
            found = [*self._new_rows(), *self._new_exposures()]
            yield from sorted(found, key=lambda e: (e.t_ns, isinstance(e, Frame)))
            now = time.monotonic()
            last = now if found or self._waiting.items else last
            if now - last > self._idle:
                return
            if not found:
                time.sleep(POLL)

    def _new_rows(self) -> list[Event]:
        out: list[Event] = []
        if not self.georeferenced and (self._root / "nav0" / "data.csv").is_file():
            self.findings.warn(
                "nav0 came after the start and is not used: put nav0/sensor.yaml there before the start, and start "
                "again with it"
            )
        elif nav := usable_nav(self._read("nav0"), self.findings):
            out += nav_samples(nav, self.local)
        if imu := usable_imu(self._read("imu0"), self._body_from_imu, self.findings):
            out += imu_samples(imu)
        return out

    def _read(self, stream: str) -> Table | None:
        group = f"{stream} rows"
        rows = rows_of(self._tables[stream].new_lines(), COLUMNS[stream], group, self.findings)
        table = table_of(rows, stream, self.findings, in_order=False)
        self.findings.counts[group] = self.findings.counts.get(group, 0) + len(table.lines)
        return table if table.lines else None

    def _new_exposures(self) -> Iterator[Frame]:
        now = time.monotonic()
        for k, table in enumerate(self._cams):
            group = f"{self.rig.cameras[k].name} images"
            for row in rows_of(table.new_lines(), (2,), group, self.findings):
                if names_file(row, group, self.findings):
                    self._waiting.add(k, row.t_ns - self._ahead_ns[k], row.fields[0], now)
        for t_ns, names, waited in self._waiting.ready(now):
            try:
                images = tuple(self._image(k, n, unfinished=waited <= WRITTEN) for k, n in enumerate(names))
            except ValueError:  # an image may be incomplete
                return
            if any(i is not None for i in images):
                self.length += 1
                yield Frame(t_ns, images, next(n for n in names if n))


def wait_for_calibration(root: Path, seconds: float) -> None:
    """Wait until a folder has the calibration of its first camera.

    Raises:
        InputError: no calibration appears within `seconds`.
    """
    end = time.monotonic() + seconds
    while not any((folder / "cam0" / "sensor.yaml").is_file() for folder in (root, root / "mav0")):
        if time.monotonic() > end:
            raise InputError(f"{root}: cam0/sensor.yaml does not appear; a folder that is filled has it from the start")
        time.sleep(POLL)
