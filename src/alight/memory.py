"""The C library's heap: large arrays that are freed go back to the system. Without glibc nothing here has an effect."""

import ctypes
from contextlib import suppress

LARGE_ARRAY = 4 << 20  # bytes from which an array has memory pages of its own
_TRIM_THRESHOLD, _MMAP_THRESHOLD, _ARENA_MAX = -1, -3, -8  # parameters of mallopt


def keep_little() -> None:
    """Make the C library free large arrays at once and use one heap for all threads. Call it before threads start.

    By default glibc keeps freed arrays of less than 32 MB (a third of the peak) and a heap per thread (0.5 GB in all).
    """
    _call("mallopt", _MMAP_THRESHOLD, LARGE_ARRAY)
    _call("mallopt", _ARENA_MAX, 1)


def keep_pages() -> None:
    """Keep up to 64 MB of freed memory, whose pages cost a landing a seventh of its CPU, and photos of their memory."""
    _call("mallopt", _TRIM_THRESHOLD, 16 * LARGE_ARRAY)


def give_back() -> None:
    """Return the free memory of the heap to the system; for use after a step that had many smaller arrays."""
    _call("malloc_trim", 0)


def _call(name: str, *arguments: int) -> None:
    with suppress(OSError, AttributeError):  # another C library
        getattr(ctypes.CDLL(None), name)(*arguments)
