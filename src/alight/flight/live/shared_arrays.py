"""Messages between processes: large arrays go through memory that both share, the rest through the pipe."""

from __future__ import annotations

import mmap
import os
import pickle
from contextlib import suppress
from itertools import accumulate
from multiprocessing.connection import Connection
from multiprocessing.reduction import recv_handle, send_handle
from typing import Any

LARGE = 1 << 16  # bytes from which an array is shared
ALIGNED = 64  # bytes, a multiple of which each array starts at


def send(line: Connection, message: object) -> bool:
    """Send a message to a process that reads it by `receive`; return whether any of its arrays was shared.

    Contiguous arrays of 64 kB or more are shared, and copied once. `line` must be an end of a duplex pipe. Without
    `memfd_create` (Linux) everything goes through the pipe.
    """
    arrays = list[memoryview]()

    def stays_inside(buffer: pickle.PickleBuffer) -> bool:
        with suppress(BufferError):  # not contiguous
            raw = buffer.raw()
            if raw.nbytes >= LARGE:
                arrays.append(raw)
                return False
        return True

    shares = hasattr(os, "memfd_create")
    head = pickle.dumps(message, protocol=5, buffer_callback=stays_inside if shares else None)
    starts = list(accumulate((-(-a.nbytes // ALIGNED) * ALIGNED for a in arrays), initial=0))
    line.send((head, starts, [a.nbytes for a in arrays]))
    if not arrays:
        return False
    file = os.memfd_create("arrays")
    try:
        os.truncate(file, starts[-1])
        with mmap.mmap(file, starts[-1]) as memory:
            for start, array in zip(starts, arrays, strict=False):
                memory[start : start + array.nbytes] = array
        send_handle(line, file, os.getpid())  # the receiver has the other end
    finally:
        os.close(file)
    return True


def receive(line: Connection) -> Any:
    """Return the next message of `send`; its arrays can be written to, and nobody else sees that.

    Raises:
        EOFError, OSError: the other end is closed.
    """
    head, starts, sizes = line.recv()
    if not sizes:
        return pickle.loads(head)
    file = recv_handle(line)
    try:
        memory = memoryview(mmap.mmap(file, starts[-1], access=mmap.ACCESS_COPY))
    finally:
        os.close(file)
    return pickle.loads(head, buffers=[memory[s : s + n] for s, n in zip(starts, sizes, strict=False)])
