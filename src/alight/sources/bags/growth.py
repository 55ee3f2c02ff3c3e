"""Files that another program is writing: a read waits for what is to come."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path

from alight.sources.bags.finding import bag_files

POLL = 0.01  # s between two reads


class Growth:
    """How long to wait for files that grow.

    Args:
        stopped: polled regularly; True ends the waiting.
        idle: s without anything new after which the files are complete; 0: they are read as they are.
    """

    def __init__(self, stopped: Callable[[], bool] = lambda: False, idle: float = 0.0) -> None:
        self.stopped, self._idle, self._last = stopped, idle, time.monotonic()

    def came(self) -> None:
        """Note that something new was read."""
        self._last = time.monotonic()

    def goes_on(self) -> bool:
        """Wait a little, and return whether more may come."""
        if not self._idle or self.stopped() or time.monotonic() - self._last > self._idle:
            return False
        time.sleep(POLL)
        return True

    def files(self, path: Path) -> Iterator[Path]:
        """Yield the files of a bag in order, those that appear later too, until `metadata.yaml` closes its folder."""
        done = 0
        while True:
            closed = path.is_file() or (path / "metadata.yaml").is_file()
            new = bag_files(path)[done:]
            yield from new[:1]
            done += len(new[:1])
            if not new and (closed or not self.goes_on()):
                return


class GrowingFile:
    """The bytes of a file that grows: a read returns fewer than it was asked for only if no more come."""

    def __init__(self, path: Path, growth: Growth) -> None:
        self._file, self._growth = path.open("rb"), growth

    def __enter__(self) -> GrowingFile:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def read(self, count: int) -> bytes:
        """Read bytes; wait until they are there."""
        data = self._file.read(count)
        while len(data) < count and self._growth.goes_on():
            more = self._file.read(count - len(data))
            data += more
            if more:
                self._growth.came()
        if data:
            self._growth.came()
        return data

    def readline(self) -> bytes:
        """Read a line that is there."""
        return self._file.readline()

    def tell(self) -> int:
        """Return the number of bytes before the next."""
        return self._file.tell()
