"""A lane in a process of its own, which is replaced if it raises, dies or does not answer.

The interpreter runs one thread at a time, and a thread that hangs cannot be ended. So each lane has a process. All
processes are forked from the fork server of `multiprocessing`, which has imported all modules (`preload`).
"""

from __future__ import annotations

import atexit
import contextlib
import logging
import multiprocessing
import os
import signal
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from threading import Thread
from typing import Any, NamedTuple

import cv2

from alight import compiled
from alight.flight.live.shared_arrays import receive, send
from alight.memory import give_back

log = logging.getLogger(__name__)

START = 30.0  # s that a lane may take until it is ready
POLL = 0.05  # s between two checks of a process that does not answer
HARD_TIMEOUT_FACTOR = 6.0  # times its patience, after which a process is lost in any case
# the lanes, and the imports of the command's script, which each new process runs
PRELOAD = ["alight.flight.live.preload", "alight.cli"]


class LaneLost(Exception):  # noqa: N818  (an event of the flight; the flight goes on)
    """A lane raised, died or did not answer in time, and its process was killed. The message gives the reason."""


@dataclass(frozen=True)
class LaneSpec:
    """Recipe of a lane: `make(*given, memory)`, called in the lane's process, returns the object that does the work."""

    name: str
    make: Callable[..., Any]
    given: tuple[Any, ...]
    patience: float = START  # s without an answer, after which the process is lost
    memory: str = ""  # attribute of the lane that is passed to its replacement; empty: no attribute
    first: Any = None  # memory of the first process
    niceness: int = 0  # larger: lower priority


class Reply(NamedTuple):
    """Reply of a lane to a call: the result, or the failure as text."""

    result: Any
    memory: Any  # the lane's attribute that `LaneSpec.memory` names; None: no attribute
    failure: str  # traceback; empty: the call succeeded
    compiled: tuple[str, ...]  # loops that had to be compiled since the process was ready


class LaneProcess:
    """Proxy of a lane: a method that is called here runs in the lane's process.

    A call raises `LaneLost` if the lane raises, dies or does not answer; the next call goes to a new process.

    Args:
        spec: recipe of the lane.
        on_lost: called with the lane's name and the reason whenever a process is lost.
    """

    def __init__(self, spec: LaneSpec, on_lost: Callable[[str, str], None] = lambda lane, why: None) -> None:
        self.memory, self.patience = spec.first, spec.patience
        self.compiled: set[str] = set()  # loops compiled in flight; after the warm-up there should be none
        self.given_up = ""  # reason why no other process is started; empty: one is started after a loss
        self._spec, self._on_lost, self._ready = spec, on_lost, False
        self._start()
        atexit.register(self.close)  # or `multiprocessing` would wait for a process that waits for this one

    def __getattr__(self, method: str) -> Callable[..., Any]:
        if method.startswith("_"):
            raise AttributeError(method)
        return partial(self.call, method)

    def call(self, method: str, *given: Any) -> Any:
        """Call a method of the lane in its process; wait for the result and return it.

        Raises:
            LaneLost: the lane raised, died, or gave no answer within `patience` seconds.
        """
        if self.given_up:
            raise LaneLost(self.given_up)
        try:
            self.wait_until_ready()
            Thread(target=self._send, args=(self._line, (method, given)), daemon=True).start()
            return self._answer(method, self.patience)
        except LaneLost as e:
            if not self.given_up:
                self.given_up = "" if self._ready else f"it cannot be started: {e}"
                self._on_lost(self._spec.name, str(e))
            if not self.given_up:
                self._start()
            if self.given_up:  # closed meanwhile
                self._process.kill()
            raise

    def wait_until_ready(self) -> None:
        """Wait until the lane is made in its process.

        Raises:
            LaneLost: the lane could not be made.
        """
        if not self._ready:
            self._answer("start", START)
            self._ready = True

    def close(self) -> None:
        """End the process for good; a call in progress raises `LaneLost`."""
        atexit.unregister(self.close)
        self.given_up = self.given_up or "the flight is over"
        self._process.kill()

    def _start(self) -> None:
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload(PRELOAD)
        self._line, theirs = context.Pipe()
        memory = (self.memory,) if self._spec.memory else ()
        self._process = context.Process(target=serve, args=(theirs, self._spec, memory), daemon=True)
        self._process.start()
        theirs.close()
        self._ready = False

    @staticmethod
    def _send(line: Connection, request: tuple[str, tuple[Any, ...]]) -> None:
        """Send a request, (method, arguments); runs on a thread of its own, as it blocks if the process hangs."""
        with contextlib.suppress(OSError):
            send(line, request)

    def _answer(self, method: str, timeout: float) -> Any:
        try:
            if not self._answers_within(timeout):
                raise self._lost(f"{method}: no answer within {timeout:g} s")
            reply: Reply = receive(self._line)
        except (EOFError, OSError) as e:
            raise self._lost(f"{method}: the process has died") from e
        self.compiled.update(reply.compiled)
        if reply.failure:
            raise self._lost(f"{method}: {reply.failure.strip().splitlines()[-1]}", reply.failure)
        self.memory = reply.memory
        return reply.result

    def _answers_within(self, patience: float) -> bool:
        """Wait for an answer; return whether it came within `patience` seconds.

        A process that is ready to run but gets no processor time is given more time. A process that sleeps, or has used
        `patience` seconds of processor time, gets no more.
        """
        begin, pid = time.monotonic(), self._process.pid
        worked = _activity(pid).seconds
        while not self._line.poll(POLL):
            waited = time.monotonic() - begin
            if waited < patience:
                continue
            now = _activity(pid)
            if not now.wants_to_run or now.seconds - worked >= patience or waited >= HARD_TIMEOUT_FACTOR * patience:
                return False
        return True

    def _lost(self, why: str, details: str = "") -> LaneLost:
        log.debug("%s: %s\n%s", self._spec.name, why, details)
        self._process.kill()
        return LaneLost(why)


class Activity(NamedTuple):
    """Processor time that a process has used, and whether the process is ready to run."""

    seconds: float  # of processor time
    wants_to_run: bool  # whether it runs, or waits for a processor or the disk


def _activity(pid: int | None) -> Activity:
    """Return the activity of a process from /proc; without /proc, zero time and not ready to run."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except (OSError, ValueError):
        return Activity(0.0, False)
    return Activity((int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK"), fields[0] in "RD")


def serve(line: Connection, spec: LaneSpec, memory: tuple[Any, ...]) -> None:
    """Run a lane in this process: make it, then answer the calls of a `LaneProcess` over `line` until it is closed.

    `memory`: further arguments for making the lane: none, or the memory of the lane that it replaces.
    """
    for s in (signal.SIGINT, signal.SIGTERM):
        signal.signal(s, signal.SIG_IGN)  # the flight ends its lanes itself, after it has taken their results
    multiprocessing.set_start_method("spawn", force=True)  # else Numba makes a lock that a killed process leaves behind
    os.nice(spec.niceness)
    cv2.setNumThreads(1)
    compiled.use_threads(1)
    compiling = compiled.CompilationListener()
    lane: Any = None

    call, given = spec.make, (*spec.given, *memory)
    with contextlib.suppress(EOFError, OSError):
        while True:
            result, failure = None, ""
            try:
                result = call(*given)
            except Exception:
                failure = traceback.format_exc()
            made = lane is None
            if made:
                lane, result = result, None
            remembered = getattr(lane, spec.memory) if spec.memory and lane is not None else None
            is_large = send(line, Reply(result, remembered, failure, tuple(compiling.names)))
            result, given = None, ()
            if is_large:
                give_back()
            if made:
                compiling.names.clear()
            method, given = receive(line)
            call = getattr(lane, method)
