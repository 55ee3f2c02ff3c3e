"""What was done when: a live run writes it down, and a replay does the same again."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Protocol

from alight.pipeline.mapping import MapUpdate
from alight.pipeline.navigation import Navigation
from alight.records import Event, Frame


@dataclass(frozen=True)
class Schedule:
    """Which events of a flight each lane used; the rest was dropped because the lane was busy."""

    tracked: tuple[int, ...]  # ns, exposures that the navigation lane took
    mapped: tuple[int, ...]  # ns, exposures that the mapping lane took
    judged: tuple[int, ...]  # steps of the map (`MapUpdate.step`) after which it was judged

    def to_json(self) -> str:
        """As text."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> Schedule:
        """The way back."""
        tree = json.loads(text)
        return cls(*(tuple(int(v) for v in tree[k]) for k in ("tracked", "mapped", "judged")))


class Turns(Protocol):
    """Decides what each lane takes."""

    def takes(self, event: Event) -> bool:
        """Whether the navigation lane takes an event."""

    def maps(self, navigation: Navigation) -> bool:
        """Whether the mapping lane takes an exposure."""

    def judges(self, update: MapUpdate) -> bool:
        """Whether the map is judged as it is after an update."""


class EveryTurn:
    """Everything is taken; the map is judged every few keyframes.

    Args:
        every: keyframes from one judgement to the next; 0: never in flight.
    """

    def __init__(self, every: int) -> None:
        self._every, self._since = every, 0

    def takes(self, event: Event) -> bool:
        """Always."""
        return True

    def maps(self, navigation: Navigation) -> bool:
        """Always."""
        return True

    def judges(self, update: MapUpdate) -> bool:
        """Every few keyframes."""
        self._since += update.steps
        if not self._every or self._since < self._every:
            return False
        self._since = 0
        return True


class ScheduledTurns:
    """What the schedule says, and nothing else; GPS/INS and IMU rows are never dropped."""

    def __init__(self, schedule: Schedule) -> None:
        self._tracked, self._mapped = frozenset(schedule.tracked), frozenset(schedule.mapped)
        self._judged = frozenset(schedule.judged)

    def takes(self, event: Event) -> bool:
        """Rows, and the exposures that were tracked."""
        return not isinstance(event, Frame) or event.t_ns in self._tracked

    def maps(self, navigation: Navigation) -> bool:
        """The exposures that were mapped."""
        return navigation.frame.t_ns in self._mapped

    def judges(self, update: MapUpdate) -> bool:
        """After the steps that were judged after."""
        return update.step in self._judged


def turns(schedule: Schedule | None, every: int) -> Turns:
    """Everything in its turn, or what a schedule says."""
    return EveryTurn(every) if schedule is None else ScheduledTurns(schedule)
