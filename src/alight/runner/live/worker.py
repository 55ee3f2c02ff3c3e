"""A lane in a process of its own, and the handle by which the flight calls it.

The interpreter lets one thread run at a time, and a thread that hangs cannot be ended. So each lane is a process: it
has its own interpreter, it is killed when it does not answer, and another one takes its place.
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
from typing import Any

import cv2

from alight import compiled
from alight.runner.live.block import Block, Parcel, new_block
from alight.runner.live.nursery import Nursery

log = logging.getLogger(__name__)

START = 30.0  # s that a lane may take until it is ready


class LaneLost(Exception):  # noqa: N818  (an event of the flight; the flight goes on)
    """A lane raised, died or did not answer in time; its process is gone. The message says which and why."""


@dataclass(frozen=True)
class Spec:
    """How a lane is made in its process: `make(*given)` gives the object whose methods are called."""

    name: str
    make: Any
    given: tuple[Any, ...]
    niceness: int = 0  # the larger, the more it gives way
    threads: int = 1  # of compiled loops


@dataclass(frozen=True)
class Reply:
    """What a call gave, or what it failed with, as text."""

    parcel: Parcel | None
    failure: str = ""
    compiled: tuple[str, ...] = ()  # loops that had to be compiled since the process was ready


class Worker:
    """A handle on a lane's process.

    Args:
        nursery: where the process is born.
        spec: what runs in it.
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
        """Call a method of the lane and wait for what it returns.

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
        """End the process; a call that waits for its answer is told that the process has died."""
        with contextlib.suppress(OSError):
            os.kill(self._pid, signal.SIGKILL)

    def _answer(self, method: str, timeout: float) -> Any:
        try:
            if not self._line.poll(timeout):
                raise self._lost(f"{method}: no answer within {timeout:g} s")
            reply: Reply = self._line.recv()
        except (EOFError, OSError) as e:
            raise self._lost(f"{method}: the process has died") from e
        self.compiled = reply.compiled
        if reply.parcel is None:
            raise self._lost(f"{method}: {reply.failure.strip().splitlines()[-1]}", reply.failure)
        return self._answered.read(reply.parcel)

    def _lost(self, why: str, more: str = "") -> LaneLost:
        log.debug("%s: %s\n%s", self.name, why, more)
        self.close()
        return LaneLost(why)


def serve(line_fileno: int, received_fileno: int, answers_fileno: int) -> None:
    """Be a lane: make it, then answer one call after the other until nobody is left to ask."""
    for s in (signal.SIGINT, signal.SIGTERM):
        signal.signal(s, signal.SIG_IGN)  # the flight ends its lanes itself, after they have given what they have
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


def pause(seconds: float) -> None:
    """Sleep; a fault that tests let a lane have."""
    time.sleep(seconds)
