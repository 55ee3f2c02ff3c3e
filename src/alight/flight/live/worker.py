"""A lane in a process of its own, and the handle by which the flight calls it.

The interpreter lets one thread run at a time, and a thread that hangs cannot be ended. So each lane is a process with
its own interpreter: it is killed when it does not answer, and another one takes its place.
"""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import socket
import time
import traceback
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import cv2

from alight import compiled
from alight.flight.live.block import Block, Parcel, new_block
from alight.flight.live.nursery import Nursery

log = logging.getLogger(__name__)

START = 30.0  # s that a lane may take until it is ready
POLL = 0.05  # s between two tests of a process that does not answer
STARVED = 6.0  # times its patience, after which a process is lost whatever it does


class LaneLost(Exception):  # noqa: N818  (an event of the flight; the flight goes on)
    """A lane raised, died or did not answer in time; its process is gone. The message gives the reason."""


@dataclass(frozen=True)
class Spec:
    """Recipe of a lane: `make(*given)`, called in its process, returns the object whose methods are called."""

    name: str
    make: Any
    given: tuple[Any, ...]
    niceness: int = 0  # larger: lower priority
    threads: int = 1  # of compiled loops


@dataclass(frozen=True)
class Reply:
    """The result of a call, or its failure as text."""

    parcel: Parcel | None
    failure: str = ""
    compiled: tuple[str, ...] = ()  # loops that had to be compiled since the process was ready


class Worker:
    """A handle on a lane's process.

    Args:
        nursery: forks the process.
        spec: recipe of the lane that runs in it.
    """

    def __init__(self, nursery: Nursery, spec: Spec) -> None:
        self.name = spec.name
        self.compiled: tuple[str, ...] = ()  # loops compiled in flight; after the warm-up there should be none
        ours, theirs = socket.socketpair()
        self._sent, self._answered = Block(new_block()), Block(new_block())
        self._pid = nursery.born((theirs.fileno(), self._sent.fileno, self._answered.fileno))
        theirs.close()
        self._line = Connection(ours.detach())
        self._ready = False
        self._line.send(spec)

    def wait_until_ready(self, timeout: float = START) -> None:
        """Wait until the lane is made.

        Raises:
            LaneLost: it could not be made.
        """
        if not self._ready:
            self._answer("start", timeout)
            self._ready = True

    def call(self, method: str, *given: Any, timeout: float) -> Any:
        """Call a method of the lane, wait for its result and return it.

        Raises:
            LaneLost: it raised, died, or gave no answer within `timeout` seconds.
        """
        self.wait_until_ready()
        try:
            self._line.send((method, self._sent.write(given)))
        except OSError as e:
            raise self._lost(f"{method}: the process has died") from e
        return self._answer(method, timeout)

    def close(self) -> None:
        """End the process; a call that waits for its answer gets `LaneLost`."""
        with contextlib.suppress(OSError):
            os.kill(self._pid, signal.SIGKILL)

    def _answer(self, method: str, timeout: float) -> Any:
        try:
            if not self._answers_within(timeout):
                raise self._lost(f"{method}: no answer within {timeout:g} s")
            reply: Reply = self._line.recv()
        except (EOFError, OSError) as e:
            raise self._lost(f"{method}: the process has died") from e
        self.compiled = reply.compiled
        if reply.parcel is None:
            raise self._lost(f"{method}: {reply.failure.strip().splitlines()[-1]}", reply.failure)
        return self._answered.read(reply.parcel)

    def _answers_within(self, patience: float) -> bool:
        """Wait for an answer; a process that is ready to run but gets no processor time is given more time.

        A process that sleeps is not given more, nor is one that has used `patience` seconds of processor time.
        """
        begin, worked = time.monotonic(), _activity(self._pid).seconds
        while not self._line.poll(POLL):
            waited = time.monotonic() - begin
            if waited < patience:
                continue
            now = _activity(self._pid)
            if not now.wants_to_run or now.seconds - worked >= patience or waited >= STARVED * patience:
                return False
        return True

    def _lost(self, why: str, more: str = "") -> LaneLost:
        log.debug("%s: %s\n%s", self.name, why, more)
        self.close()
        return LaneLost(why)


@dataclass(frozen=True)
class Activity:
    """Processor time of a process so far, and whether it is ready to run."""

    seconds: float  # of processor time
    wants_to_run: bool  # it runs, or waits for a processor or the disk


def _activity(pid: int) -> Activity:
    """Activity from /proc; without it a process counts as not ready to run, and only the clock counts."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except (OSError, ValueError):
        return Activity(0.0, False)
    return Activity((int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK"), fields[0] in "RD")


def serve(line_fileno: int, received_fileno: int, answers_fileno: int) -> None:
    """Run a lane in this process: make it, then answer one call after the other until the line is closed."""
    for s in (signal.SIGINT, signal.SIGTERM):
        signal.signal(s, signal.SIG_IGN)  # the flight ends its lanes itself, after it has taken their results
    line, received, answers = Connection(line_fileno), Block(received_fileno), Block(answers_fileno)
    with contextlib.suppress(EOFError, OSError):
        spec: Spec = line.recv()
        os.nice(spec.niceness)
        cv2.setNumThreads(1)
        compiled.use_threads(spec.threads)
        compiling = compiled.CompilationListener()
        lane: Any = None

        def answer(work: Any) -> None:
            try:
                reply = Reply(answers.write(work()), compiled=tuple(compiling.names))
            except Exception:
                reply = Reply(None, traceback.format_exc(), tuple(compiling.names))
            line.send(reply)

        def make() -> None:
            nonlocal lane
            lane = spec.make(*spec.given)

        answer(make)
        compiling.names.clear()
        while True:
            method, parcel = line.recv()
            answer(lambda method=method, parcel=parcel: getattr(lane, method)(*received.read(parcel)))
