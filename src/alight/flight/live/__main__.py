"""The nursery's process: `python -m alight.flight.live FILENO` imports everything, loads the loops, and forks lanes."""

from __future__ import annotations

import os
import signal
import socket
import sys

from alight import compiled
from alight.flight.live import worker
from alight.flight.live.nursery import PID


def main(fileno: int) -> None:
    """Fork a lane for each three files that are received, until the socket is closed."""
    line = socket.socket(fileno=fileno)
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # children that end leave no zombie processes
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    compiled.load_cached(parallel=False)
    while True:
        said, filenos, _, _ = socket.recv_fds(line, 16, 3)
        if not said:
            return
        pid = os.fork()
        if pid == 0:
            line.close()
            worker.serve(*filenos)
            os._exit(0)
        for f in filenos:
            os.close(f)
        line.send(PID.pack(pid))


if __name__ == "__main__":
    main(int(sys.argv[1]))
