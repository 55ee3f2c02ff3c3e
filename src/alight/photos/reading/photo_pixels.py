"""Pictures of photos: read on demand, and the last ones kept, so that memory does not grow with a set."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from threading import Lock

import numpy as np
from numpy.typing import DTypeLike

from alight.arrays import U8
from alight.photos.reading.photo_selection import false_colours
from alight.photos.reading.photo_tags import PhotoTags
from alight.raster import grey_levels
from alight.records import InputError
from alight.sources.image_formats import Levels, levels_of
from alight.sources.images import read_image

LEVELS_OF = 24  # pictures by which the range of a set is found


class PictureReader:
    """Decodes the pictures of one set alike."""

    def __init__(self) -> None:
        self._levels: dict[Path, Levels] = {}  # of pictures with more than eight bits
        self._as_grey = False

    def read(self, path: Path, size: tuple[int, int]) -> U8:
        """The pixels of a file, (H, W) grey or (H, W, 3) RGB, of a (width, height).

        Raises:
            ValueError: as `read_image`.
        """
        pixels = read_image(path, size, self._levels.get(path))
        return grey_levels(pixels) if self._as_grey else pixels

    def pixels_of(self, photo: PhotoTags) -> U8:
        """As `read`, of a photo."""
        return self.read(photo.path, photo.size)

    def settle(self, photos: Sequence[PhotoTags]) -> dict[str, str]:
        """Find the range of pictures with more than eight bits, and whether colours are false: these become grey.

        Returns:
            Notes of what was found: `levels`, `false_colours`.
        """
        notes = dict[str, str]()
        deep = [p.path for p in photos if p.bits > 8]
        if levels := levels_of(deep[:: -(-len(deep) // LEVELS_OF)]) if deep else None:
            self._levels = dict.fromkeys(deep, levels)
            notes["levels"] = f"{levels.low:g} to {levels.high:g} of {len(deep)} pictures become 0 to 255"
        if shows := false_colours(photos, self.pixels_of):
            notes["false_colours"] = shows
        self._as_grey = bool(shows)
        return notes


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
