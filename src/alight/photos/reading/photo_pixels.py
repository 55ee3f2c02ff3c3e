"""Pictures of photos, decoded on demand. The last used ones are cached, so that memory does not grow with the set."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
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
from alight.sources.images import UNREADABLE, hidden_pixels, read_image


class PictureReader:
    """Decoder for the pictures of one set: all with one range of levels, all in colour or all in grey."""

    def __init__(self) -> None:
        self._levels: dict[Path, Levels] = {}  # range of each picture with more than eight bits
        self._as_grey = False

    def read(self, path: Path, size: tuple[int, int]) -> U8:
        """Decode a file of `size` (width, height) to (H, W) grey or (H, W, 3) RGB.

        Raises:
            ValueError: the file cannot be decoded or has another size; see `read_image`.
        """
        pixels = read_image(path, size, self._levels.get(path))
        return grey_levels(pixels) if self._as_grey else pixels

    def pixels_of(self, photo: PhotoTags) -> U8:
        """Decode a photo; see `read` for shapes and errors."""
        return self.read(photo.path, photo.size)

    def settle(self, photos: Sequence[PhotoTags]) -> dict[str, str]:
        """Determine the range of pictures with more than eight bits, and whether to convert false colours to grey.

        Returns:
            Notes on the findings: `levels`, `hidden`, `false_colours`; each is absent if it does not apply.
        """
        notes = dict[str, str]()
        for photo in photos[:: -(-len(photos) // 3)]:
            with suppress(*UNREADABLE):
                if (mask := hidden_pixels(photo.path)) is not None:
                    notes["hidden"] = f"{mask.mean():.1%} of {photo.path.name}"
        deep = [p.path for p in photos if p.bits > 8]
        if levels := levels_of(deep):
            self._levels = dict.fromkeys(deep, levels)
            notes["levels"] = f"{levels.low:g} to {levels.high:g} of {len(deep)} pictures become 0 to 255"
        if shows := false_colours(photos, self.pixels_of):
            notes["false_colours"] = shows
        self._as_grey = bool(shows)
        return notes


class PictureMemory:
    """Cache of the most recently used pictures.

    Args:
        most_bytes: limit of the cache's size; the newest picture is kept even if it is larger.
        read: decodes a file of a given (width, height); see `read_image`.
    """

    def __init__(self, most_bytes: float, read: Callable[[Path, tuple[int, int]], U8] = read_image) -> None:
        self._most, self._read = most_bytes, read
        self._pictures: dict[Path, U8] = {}  # the most recently used picture last
        self._lock = Lock()  # several threads extract features

    @property
    def held_bytes(self) -> int:
        """Size of the cached pictures in bytes."""
        return sum(pixels.nbytes for pixels in self._pictures.values())

    def get(self, path: Path, size: tuple[int, int]) -> U8:
        """Return the pixels of a file; see `PictureReader.read` for arguments, shapes and errors."""
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
        """Drop the pixels of a file from the cache."""
        with self._lock:
            self._pictures.pop(path, None)


class PhotoPixels:
    """The picture of one photo, decoded on demand; its file must have been decoded without error before."""

    nbytes = 0

    def __init__(self, path: Path, size: tuple[int, int], memory: PictureMemory) -> None:
        self._path, self._size, self._memory = path, size, memory

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> U8:
        """Return the pixels.

        Raises:
            InputError: the file has changed or vanished since it was first read.
        """
        try:
            pixels = self._memory.get(self._path, self._size)
        except ValueError as e:
            raise InputError(f"{self._path.name}: changed or vanished during the run ({e}); run again") from e
        return np.array(pixels, dtype) if copy else np.asarray(pixels, dtype)

    def let_go(self) -> None:
        """Drop the pixels from the cache."""
        self._memory.let_go(self._path)
