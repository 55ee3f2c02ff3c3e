"""Storage on disk for the map tiles that the vehicle has left behind, which saves memory."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, MutableMapping
from pathlib import Path

from alight.elevation import Name
from alight.outputs.atomic_write import output_error


class FileStore(MutableMapping[Name, bytes]):
    """Packed tiles by name, in one anonymous temporary file that the system removes however the run ends.

    A tile that is written again overwrites its old bytes if it fits; otherwise it is appended to the file.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._size: dict[Name, int] = {}
        self._room: dict[Name, tuple[int, int]] = {}  # offset and size in bytes, kept after a deletion
        try:
            self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115  (lives as long as the run)
        except OSError as e:
            raise output_error(folder, e) from e

    def __setitem__(self, name: Name, packed: bytes) -> None:
        """Write a packed tile.

        Raises:
            OutputError: the tile cannot be written, such as when the disk is full.
        """
        where, room = self._room.get(name, (0, 0))
        try:
            if len(packed) > room:
                where, room = self._file.seek(0, 2), len(packed)
            self._file.seek(where)
            self._file.write(packed)
        except OSError as e:
            raise output_error(self._folder, e) from e
        self._size[name], self._room[name] = len(packed), (where, room)

    def __getitem__(self, name: Name) -> bytes:
        size = self._size[name]
        self._file.seek(self._room[name][0])
        return self._file.read(size)

    def __delitem__(self, name: Name) -> None:
        del self._size[name]

    def __iter__(self) -> Iterator[Name]:
        return iter(self._size)

    def __len__(self) -> int:
        return len(self._size)

    @property
    def size(self) -> int:
        """Size of the file in bytes."""
        return self._file.seek(0, 2)

    def close(self) -> None:
        """Close the file, which frees its space on the disk."""
        self._file.close()
