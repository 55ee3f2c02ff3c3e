"""Choice of the events for each lane: all of them in turn, or those in the schedule of a live run."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from alight.arrays import F64
from alight.pipeline.mapping import MapUpdate
from alight.pipeline.navigation import Navigation
from alight.records import Event, Frame, Schedule


class Turns(Protocol):
    """Choice of the events that each lane takes."""

    def takes(self, event: Event) -> bool:
        """True if the navigation lane takes an event."""

    def maps(self, navigation: Navigation) -> bool:
        """True if the mapping lane takes an exposure."""

    def effort(self, navigation: Navigation) -> int:
        """Effort of the mapping lane for an exposure, from 0 (full) to 3 (least)."""

    def judges(self, navigation: Navigation, update: MapUpdate | None) -> bool:
        """True if the map is judged after an exposure; `update` is None where that did not change the map."""

    def about(self, navigation: Navigation) -> F64 | None:
        """(2,) metres in the map's frame, a place that the judged map shows too; None: none."""


class EveryTurn:
    """All events are taken; the map is judged every few keyframes.

    Args:
        every: keyframes from one judgement to the next; 0: never in flight.
    """

    def __init__(self, every: int) -> None:
        self._every, self._since = every, 0

    def takes(self, event: Event) -> bool:
        """True always."""
        return True

    def maps(self, navigation: Navigation) -> bool:
        """True always."""
        return True

    def effort(self, navigation: Navigation) -> int:
        """Full effort, 0."""
        return 0

    def judges(self, navigation: Navigation, update: MapUpdate | None) -> bool:
        """True every few keyframes."""
        self._since += 0 if update is None else update.steps
        if update is None or not self._every or self._since < self._every:
            return False
        self._since = 0
        return True

    def about(self, navigation: Navigation) -> F64 | None:
        """None: the ground below is judged."""
        return None


class ScheduledTurns:
    """Events in the schedule only; GPS/INS and IMU rows are never dropped."""

    def __init__(self, schedule: Schedule) -> None:
        self._tracked, self._mapped = frozenset(schedule.tracked), frozenset(schedule.mapped)
        places = schedule.about or (None,) * len(schedule.judged)  # older recordings have none
        self._judged = dict(zip(schedule.judged, places, strict=False))
        self._effort = dict(zip(schedule.mapped, schedule.effort, strict=False))

    def takes(self, event: Event) -> bool:
        """True for rows, and for the exposures that were tracked."""
        return not isinstance(event, Frame) or event.t_ns in self._tracked

    def maps(self, navigation: Navigation) -> bool:
        """True for the exposures that were mapped."""
        return navigation.frame.t_ns in self._mapped

    def effort(self, navigation: Navigation) -> int:
        """Effort as in flight."""
        return self._effort.get(navigation.frame.t_ns, 0)

    def judges(self, navigation: Navigation, update: MapUpdate | None) -> bool:
        """True for the exposures whose map was judged."""
        return navigation.frame.t_ns in self._judged

    def about(self, navigation: Navigation) -> F64 | None:
        """Place as in flight, (2,) metres; None: none."""
        place = self._judged[navigation.frame.t_ns]
        return None if place is None else np.array(place)


def turns(schedule: Schedule | None, every: int) -> Turns:
    """All events in turn, or those of a schedule."""
    return EveryTurn(every) if schedule is None else ScheduledTurns(schedule)
