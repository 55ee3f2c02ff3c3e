"""The parts of a live run that its caller gives: the listener, the capacity and the diary."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from alight.pipeline import Verdict
from alight.records import Event, Motion
from alight.records.schedule import Spot


@dataclass(frozen=True)
class Listener:
    """Functions that are called with results as soon as they exist, each on its lane's thread."""

    motion: Callable[[Motion], None] = lambda motion: None
    verdict: Callable[[Verdict, int], None] = lambda verdict, t_ns: None  # with the stamp of its newest exposure
    lost: Callable[[str, str], None] = lambda lane, why: None


SILENT = Listener()


@dataclass(frozen=True)
class Capacity:
    """Number of items that may wait for a busy lane.

    `drop`: with a mailbox full, leave out the oldest exposure (flight) instead of waiting (recordings).
    """

    tracking: int = 2  # exposures
    mapping: int = 2  # exposures
    drop: bool = True
    schedule: int | None = 1000  # last entries of the schedule that are kept; None: all of them


IN_FLIGHT = Capacity()


class Diary(Protocol):
    """Log of a live run, from all its threads; the recorder is one."""

    def event(self, event: Event) -> None:
        """Write an event that came in."""

    def entry(self, kind: str, t_ns: int, value: int = 0, about: Spot | None = None) -> None:
        """Write that a lane used an exposure.

        Args:
            kind: a field of `Schedule`.
            t_ns: of the exposure.
            value: effort of mapping.
            about: east, north, metres in the map's frame: a place that a judged map shows as well.
        """

    def note(self, lane: str, words: str) -> None:
        """Write a note on a lane, in words."""


class NoDiary:
    """A diary that writes nothing."""

    def event(self, event: Event) -> None:
        """As `Diary`."""

    def entry(self, kind: str, t_ns: int, value: int = 0, about: Spot | None = None) -> None:
        """As `Diary`."""

    def note(self, lane: str, words: str) -> None:
        """As `Diary`."""
