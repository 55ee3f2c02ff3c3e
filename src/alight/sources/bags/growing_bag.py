"""A bag that is still being written, as a source: its topics are chosen by its first seconds, the rest as it comes."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from alight.arrays import U8
from alight.records import Event, Frame, ImuSample, InputError, NavSample
from alight.settings import Settings
from alight.sources.bags.bag import BagFlight
from alight.sources.bags.files import messages_of
from alight.sources.bags.finding import MAGIC, bag_files
from alight.sources.bags.growth import POLL, Growth
from alight.sources.bags.images import pixels_of
from alight.sources.bags.mcap_file import RawMessage
from alight.sources.bags.streams import decoded, stamp_of
from alight.sources.growing import WaitingExposures
from alight.sources.streams import LATE_NS, Table, imu_samples, nav_samples, usable_imu, usable_nav


class GrowingBag(BagFlight):
    """One flight in a bag that another program is writing.

    Args:
        path: the bag: a file, or a folder whose parts appear one after the other.
        topics: as for `BagFlight`.
        growth: how long to wait for messages.

    Raises:
        InputError: what is in the bag so far has no pictures, calibration or transform, or leaves a question.
    """

    growth = Growth()  # what is there is read at once

    def __init__(self, path: Path, settings: Settings, topics: Mapping[str, str], growth: Growth) -> None:
        super().__init__(path, bag_files(path), settings, topics)
        self._later, self._path, self.length = growth, path, 0
        self._waiting = WaitingExposures[U8](len(self.rig.cameras))
        self._newest_nav, self._newest_imu = -1, -1  # ns

    @property
    def seconds(self) -> float:
        """Time between the first and the last exposure that were there when it was opened, s."""
        return 1e-9 * (self._exposures[-1].t_ns - self._exposures[0].t_ns)

    def events(self) -> Iterator[Event]:
        """Yield the events from the beginning of the bag; at its end, as they are written."""
        t = self._topics
        number = {s.topic: k for k, s in enumerate(t.cameras)}
        streams = {s.topic: s for s in (t.position, t.attitude, t.velocity, t.imu) if s is not None}
        for stream in streams.values():
            stream.keep_after(math.inf)
        used = {*number, *streams}
        messages = messages_of(
            self._later.files(self._path), lambda topic, _: topic in used, self.findings, self._later
        )
        self._later.came()
        for raw, message in decoded(messages, self.findings):
            if self._later.stopped():
                return
            if raw.topic in number:
                self._add_image(number[raw.topic], raw, message)
                yield from self._ready(time.monotonic())
                continue
            try:
                streams[raw.topic].add(raw, message)
            except (ValueError, TypeError, AttributeError, OverflowError) as e:
                self.findings.lose(f"{raw.topic} messages", f"of {raw.t_ns} ns", str(e))
                continue
            if t.imu is streams[raw.topic]:
                yield from self._new_imu()
            yield from self._new_nav()
        yield from self._ready(math.inf)

    def _add_image(self, camera: int, raw: RawMessage, message: Any) -> None:
        cam = self.rig.cameras[camera]
        t_ns = self._topics.cameras[camera].time_of(stamp_of(message), raw.t_ns)
        try:
            pixels = pixels_of(message, (cam.camera.width, cam.camera.height))
            self._waiting.add(camera, t_ns - self._ahead_ns[camera], pixels, time.monotonic())
        except ValueError as e:
            self.findings.lose(f"{cam.name} images", str(t_ns), str(e))

    def _ready(self, now: float) -> Iterator[Frame]:
        for t_ns, images, _ in self._waiting.ready(now):
            self.length += 1
            yield Frame(t_ns, tuple(images), str(t_ns))

    def _new_imu(self) -> Iterator[ImuSample]:
        """Yield the newest inertial sample, if it is later than those before it."""
        imu = self._topics.imu
        assert imu is not None
        t_ns = imu.t_ns[-1:]
        if t_ns[0] > self._newest_imu:
            values = np.concatenate([imu.part("rates")[-1:], imu.part("force")[-1:]], axis=1)
            if usable := usable_imu(
                Table(t_ns, values, [self._count("imu0 rows")]), self._body_from_imu, self.findings
            ):
                yield from imu_samples(usable)
            self._newest_imu = int(t_ns[0])
            imu.keep_after(self._newest_imu - LATE_NS)

    def _new_nav(self) -> Iterator[NavSample]:
        """Yield the positions for which later attitudes and velocities have come, or which have waited too long."""
        position = self._topics.position
        if position is None or not len(t_ns := position.t_ns) or t_ns[-1] <= self._newest_nav:
            return
        others = [s for s in (self._topics.attitude, self._topics.velocity) if s is not None and s is not position]
        known = min((int(s.t_ns[-1]) if len(s.t_ns) > 1 else -1 for s in others), default=int(t_ns[-1]))
        known = max(known, int(t_ns[-1]) - LATE_NS)
        if not ((t_ns > self._newest_nav) & (t_ns <= known)).any() or (table := self._nav_table()) is None:
            return
        new = (table.t_ns > self._newest_nav) & (table.t_ns <= known)
        count = [self._count("nav0 rows") for _ in range(int(new.sum()))]
        if usable := usable_nav(Table(table.t_ns[new], table.values[new], count), self.findings):
            yield from nav_samples(usable, self.local)
        self._newest_nav = known
        for stream in (position, *others):
            stream.keep_after(known - LATE_NS)

    def _count(self, group: str) -> int:
        self.findings.counts[group] = self.findings.counts.get(group, 0) + 1
        return self.findings.counts[group]


def is_growing_bag(path: Path, seconds: float) -> bool:
    """Wait until a path is a bag or the calibration of a folder in the layout of a flight log; return whether a bag."""
    end = time.monotonic() + seconds
    while not (found := bool(bag_files(path))) and time.monotonic() < end:
        if any((folder / "cam0" / "sensor.yaml").is_file() for folder in (path, path / "mav0")):
            return False
        time.sleep(POLL)
    if not found and path.suffix.lower() in MAGIC:
        raise InputError(f"{path}: no message of ROS appears; name the bag that is being written")
    return found


def open_growing_bag(
    path: Path, settings: Settings, topics: Mapping[str, str], growth: Growth, patience: float, begin: float = 2.0
) -> GrowingBag:
    """Open a bag that is being written once it has `begin` s of pictures, or after `patience` s if it can be used.

    Raises:
        InputError: it still cannot be used.
    """
    end = time.monotonic() + patience
    while True:
        try:
            bag = GrowingBag(path, settings, topics, growth)
            if bag.seconds >= begin or time.monotonic() > end:
                return bag
        except InputError:
            if time.monotonic() > end:
                raise
        time.sleep(begin / 4)
