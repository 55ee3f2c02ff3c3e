"""A recording at its own speed: each event comes when it came in flight."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress

from alight.records import Event

AHEAD = 64  # events that are read, and their pictures decoded, before they are due


def paced(events: Iterator[Event], speed: float, stopped: Callable[[], bool] = lambda: False) -> Iterator[Event]:
    """Yield events by their stamps; what comes late is not waited for.

    Args:
        speed: 2 is twice as fast as it was.
        stopped: asked before each event; True ends it.
    """
    begin, first = time.perf_counter(), None
    for event in read_ahead(events, AHEAD):
        if first is None:
            begin, first = time.perf_counter(), event.t_ns
        while not stopped():
            wait = 1e-9 * (event.t_ns - first) / speed - (time.perf_counter() - begin)
            if wait <= 0:
                break
            time.sleep(min(wait, 0.1))
        if stopped():
            return
        yield event


def read_ahead(events: Iterator[Event], most: int) -> Iterator[Event]:
    """Yield the events, read on a thread of its own, at most so many ahead.

    Raises:
        Exception: what reading them has failed with.
    """
    waiting: queue.Queue[Event | BaseException | None] = queue.Queue(most)
    ended = threading.Event()

    def put(item: Event | BaseException | None) -> None:
        while not ended.is_set():
            with suppress(queue.Full):
                waiting.put(item, timeout=0.2)
                return

    def read() -> None:
        try:
            for event in events:
                put(event)
                if ended.is_set():
                    return
            put(None)
        except BaseException as e:
            put(e)

    threading.Thread(target=read, daemon=True).start()
    try:
        while (item := waiting.get()) is not None:
            if isinstance(item, BaseException):
                raise item
            yield item
    finally:
        ended.set()
