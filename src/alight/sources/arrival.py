"""Events of several sources in the order of their arrival: each source is read on a thread of its own."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterator
from contextlib import suppress

from alight.records import Event

_ASK = 0.2  # s between two tests whether the events are still wanted, while the queue is full


def as_they_arrive(last: Iterator[Event], *others: Iterator[Event], most: int = 0) -> Iterator[Event]:
    """Yield the events of all sources, until `last` ends.

    Args:
        last: the source whose end ends the iteration.
        others: sources that may end before.
        most: events that are read ahead; 0: any number.

    Raises:
        Exception: the one that a source raised while it was read.
    """
    arrived: queue.Queue[Event | BaseException | None] = queue.Queue(most)
    over = threading.Event()

    def put(item: Event | BaseException | None) -> None:
        while not over.is_set():
            with suppress(queue.Full):
                arrived.put(item, timeout=_ASK)
                return

    def read(events: Iterator[Event]) -> None:
        try:
            for event in events:
                put(event)
                if over.is_set():
                    return
            if events is last:
                put(None)
        except BaseException as e:
            put(e)

    for events in (*others, last):
        threading.Thread(target=read, args=(events,), daemon=True).start()
    try:
        while (item := arrived.get()) is not None:
            if isinstance(item, BaseException):
                raise item
            yield item
    finally:
        over.set()
