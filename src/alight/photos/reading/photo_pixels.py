"""Pictures of photos: read on demand, and the last ones kept, so that memory does not grow with a set."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from threading import Lock

import numpy as np
from numpy.typing import DTypeLike

from alight.arrays import U8
from alight.records import InputError
from alight.sources.images import read_image


class PictureMemory:
    """Cache of the pictures that were used last.

    Args:
        most_bytes: limit of its memory; the newest picture is kept however large.
        read: decodes a file of a (width, height), as `read_image`.
    """

    def __init__(self, most_bytes: float, read: Callable[[Path, tuple[int, int]], U8] = read_image) -> None:
        self._most, self._read = most_bytes, read
        self._pictures: dict[Path, U8] = {}  # the newest one last
        self._lock = Lock()  # features are found by several threads

    @property
    def held_bytes(self) -> int:
        """Size of the pictures."""
        return sum(pixels.nbytes for pixels in self._pictures.values())

    def get(self, path: Path, size: tuple[int, int]) -> U8:
        """The pixels of a file, (H, W) grey or (H, W, 3) RGB, of a (width, height).

        Raises:
            ValueError: as `read_image`.
        """
        with self._lock:
            found = self._pictures.get(path)
        pixels = self._read(path, size) if found is None else found
        with self._lock:
            self._pictures.pop(path, None)
            self._pictures[path] = pixels
            while self.held_bytes > self._most and len(self._pictures) > 1:
                del self._pictures[next(iter(self._pictures))]
        return pixels

    def let_go(self, path: Path) -> None:
        """Forget the pixels of a file."""
        with self._lock:
            self._pictures.pop(path, None)


class PhotoPixels:
    """The picture of one photo, read on demand; it has been read as a whole before."""

    nbytes = 0

    def __init__(self, path: Path, size: tuple[int, int], memory: PictureMemory) -> None:
        self._path, self._size, self._memory = path, size, memory

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> U8:
        """The pixels.

        Raises:
            InputError: the file has changed since it was read first.
        """
        try:
            pixels = self._memory.get(self._path, self._size)
        except ValueError as e:
            raise InputError(f"{self._path.name}: changed or vanished during the run ({e}); run again") from e
        return np.array(pixels, dtype) if copy else np.asarray(pixels, dtype)

    def let_go(self) -> None:
        """Keep no copy of the pixels."""
        self._memory.let_go(self._path)
