"""What a live run is given by its caller: who listens, how much may wait, and where it writes what it does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from alight.pipeline import Verdict
from alight.records import Event, Motion
from alight.records.schedule import Spot


@dataclass(frozen=True)
class Listener:
    """Who is told of results as soon as they are known, each on its lane's thread."""

    motion: Callable[[Motion], None] = lambda motion: None
    verdict: Callable[[Verdict, int], None] = lambda verdict, t_ns: None  # with the stamp of its newest exposure
    lost: Callable[[str, str], None] = lambda lane, why: None


SILENT = Listener()


@dataclass(frozen=True)
class Capacity:
    """What waits for a busy lane.

    `drop`: with a mailbox full, leave out the oldest exposure (flight) instead of waiting (recordings).
    """

    tracking: int = 2  # exposures
    mapping: int = 2  # exposures
    drop: bool = True
    schedule: int | None = 1000  # last entries of the schedule that are kept; None: all of them


IN_FLIGHT = Capacity()


class Diary(Protocol):
    """Where a live run writes what it does; the recorder is one."""

    def event(self, event: Event) -> None:
        """Something came in."""

    def entry(self, kind: str, t_ns: int, value: int = 0, about: Spot | None = None) -> None:
        """A lane used an exposure: `kind` is a field of `Schedule`, `about` a place that a judged map showed too."""

    def note(self, lane: str, words: str) -> None:
        """Something happened to a lane."""


class NoDiary:
    """Nothing is written."""

    def event(self, event: Event) -> None:
        """Something came in."""

    def entry(self, kind: str, t_ns: int, value: int = 0, about: Spot | None = None) -> None:
        """A lane used an exposure."""

    def note(self, lane: str, words: str) -> None:
        """Something happened to a lane."""
