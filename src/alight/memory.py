"""The C library's heap: large arrays that are freed go back to the system. Without glibc all of this does nothing."""

import ctypes
from contextlib import suppress

LARGE_ARRAY = 4 << 20  # bytes from which an array has pages of its own
_MMAP_THRESHOLD, _ARENA_MAX = -3, -8  # parameters of mallopt


def keep_little() -> None:
    """Give back each large array as it is freed, and have one heap for all threads; called before threads start.

    Else glibc keeps arrays of less than 32 MB, a third of the peak, and half a gigabyte more in heaps of the threads.
    """
    _call("mallopt", _MMAP_THRESHOLD, LARGE_ARRAY)
    _call("mallopt", _ARENA_MAX, 1)


def give_back() -> None:
    """Return the free memory of the heap to the system, after a step that had many smaller arrays."""
    _call("malloc_trim", 0)


def _call(name: str, *arguments: int) -> None:
    with suppress(OSError, AttributeError):  # another C library: it has its own way
        getattr(ctypes.CDLL(None), name)(*arguments)
