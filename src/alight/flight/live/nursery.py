"""The nursery of the lanes: a process that has imported everything and loaded the compiled loops, and then only forks.

A lost lane is replaced in a few milliseconds, and the memory of the imports is shared by all lanes. The nursery runs no
compiled loop and starts no thread: after either, a fork is not safe.
"""

from __future__ import annotations

import os
import socket
import struct
import subprocess
import sys
from collections.abc import Sequence

from alight.records import AlightError

PID = struct.Struct("q")
ONE_THREAD = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")  # of linear algebra, in every lane


class Nursery:
    """A handle on the process from which lanes are forked.

    Args:
        threads: most threads that compiled loops of a lane may use.
    """

    def __init__(self, threads: int = 1) -> None:
        self._line, theirs = socket.socketpair()
        env = os.environ | dict.fromkeys(ONE_THREAD, "1") | {"NUMBA_NUM_THREADS": str(threads)}
        command = [sys.executable, "-m", "alight.flight.live", str(theirs.fileno())]
        self._process = subprocess.Popen(
            command, pass_fds=(theirs.fileno(),), env=env, stdin=subprocess.DEVNULL, start_new_session=True
        )
        theirs.close()

    def born(self, filenos: Sequence[int]) -> int:
        """Fork a lane that communicates through these three files; return its process number.

        Raises:
            AlightError: the nursery is gone.
        """
        try:
            socket.send_fds(self._line, [b"."], list(filenos))
            answer = self._line.recv(PID.size)
        except OSError:
            answer = b""
        if len(answer) < PID.size:
            raise AlightError("the process that starts the lanes is gone; start again, and see that memory suffices")
        return int(PID.unpack(answer)[0])

    def close(self) -> None:
        """End it; lanes that still run go on until they are closed."""
        self._line.close()
        self._process.wait()
