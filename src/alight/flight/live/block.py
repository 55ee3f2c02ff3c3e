"""Memory that two processes share: an object goes through it with one copy of its arrays in and one out.

A block is a nameless file in memory that only the processes which were given it can reach. The system takes it back
however they end. It grows to the largest object that went through it, and then stays as it is.
"""

from __future__ import annotations

import mmap
import os
import pickle
import tempfile
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

ALIGNED = 64  # bytes
SHARED = "/dev/shm"  # where the system keeps files in memory


@dataclass(frozen=True)
class Parcel:
    """An object in a block: its pickle without the arrays, and the spans of these."""

    pickled: bytes
    spans: tuple[tuple[int, int], ...]  # first byte and number of bytes

    @property
    def end(self) -> int:
        """Number of bytes of the block that it takes."""
        return max((first + size for first, size in self.spans), default=0)


def new_block() -> int:
    """Return the file number of a new block."""
    if hasattr(os, "memfd_create"):
        return os.memfd_create("alight")
    with tempfile.TemporaryFile(dir=SHARED if os.path.isdir(SHARED) else None) as file:
        return os.dup(file.fileno())


class Block:
    """One process's end of a block.

    Args:
        fileno: of the block; closed when this object is deleted.
    """

    def __init__(self, fileno: int) -> None:
        self.fileno = fileno
        self._memory: mmap.mmap | None = None

    def write(self, content: Any) -> Parcel:
        """Write an object, which replaces the one before."""
        buffers: list[pickle.PickleBuffer] = []
        pickled = pickle.dumps(content, protocol=5, buffer_callback=buffers.append)
        arrays, spans, first = [b.raw() for b in buffers], list[tuple[int, int]](), 0
        for array in arrays:
            spans.append((first, array.nbytes))
            first += -(-array.nbytes // ALIGNED) * ALIGNED
        parcel = Parcel(pickled, tuple(spans))
        if os.fstat(self.fileno).st_size < parcel.end:
            os.ftruncate(self.fileno, parcel.end)
        bytes_ = self._bytes(parcel.end)
        for array, (at, size) in zip(arrays, spans, strict=True):
            np.copyto(bytes_[at : at + size], np.frombuffer(array, np.uint8))  # lets other threads run meanwhile
        return parcel

    def read(self, parcel: Parcel) -> Any:
        """Read an object; it shares no memory with the block."""
        bytes_ = self._bytes(parcel.end)
        return pickle.loads(parcel.pickled, buffers=[bytes_[at : at + size].copy() for at, size in parcel.spans])

    def __del__(self) -> None:
        with suppress(OSError):
            os.close(self.fileno)

    def _bytes(self, size: int) -> np.ndarray[tuple[int], np.dtype[np.uint8]]:
        if not size:
            return np.empty(0, np.uint8)
        if self._memory is None or len(self._memory) < size:
            self._memory = mmap.mmap(self.fileno, os.fstat(self.fileno).st_size)
        return np.frombuffer(self._memory, np.uint8)
