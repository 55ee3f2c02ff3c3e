"""A recording at its own speed: each event comes at its time in flight."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

from alight.records import Event
from alight.sources.arrival import as_they_arrive

AHEAD = 64  # events that are read, and their pictures decoded, before they are due


def paced(events: Iterator[Event], speed: float, stopped: Callable[[], bool] = lambda: False) -> Iterator[Event]:
    """Yield events at the times of their stamps; an event whose time has passed comes at once.

    Args:
        speed: 2 is twice as fast as the flight.
        stopped: called before each event; True ends the iteration.
    """
    begin, first = time.perf_counter(), None
    for event in as_they_arrive(events, most=AHEAD):
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
