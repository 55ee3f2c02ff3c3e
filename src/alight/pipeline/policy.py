"""The policy of the lanes: which exposures are used, with how much effort, and when a map is judged about what place.

Replay, live runs and trials use the same object. Time is that of the events.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from alight.arrays import F64
from alight.pipeline.mapping import MapUpdate
from alight.pipeline.navigation import Navigation
from alight.records import Event, Frame, Schedule
from alight.records.executive import Need

DEADLINE = 0.25  # s that a step of the map may take
MOST = 3  # the least that can be done (`MappingLane.feed`)
CALM = 6  # steps in a row below half the deadline, after which more is done again


@dataclass(frozen=True, eq=False)
class DueVerdict:
    """A verdict on the map that is due."""

    about: F64 | None = None  # (2,) metres in the map's frame, a place that the judged map shows too; None: none


class LanePolicy(Protocol):
    """Choice of the exposures that each lane uses, of the effort, and of the maps that are judged."""

    @property
    def navigation_anew(self) -> Collection[int]:
        """Stamps of the exposures before which the navigation lane begins anew."""

    @property
    def mapping_anew(self) -> Collection[int]:
        """Stamps of the exposures before which the mapping lane begins anew."""

    def tracks(self, event: Event) -> bool:
        """Whether the navigation lane takes an event."""

    def maps(self, navigation: Navigation) -> bool:
        """Whether the mapping lane takes an exposure."""

    def effort(self, navigation: Navigation) -> int:
        """Effort of the mapping lane for an exposure, from 0 (full) to 3 (least)."""

    def due_verdict(self, navigation: Navigation, update: MapUpdate | None, free: bool = True) -> DueVerdict | None:
        """The verdict that is due after an exposure; None: none is. Call it once for each mapped exposure.

        Args:
            navigation: the exposure.
            update: the change of the map by it; None: the map did not change.
            free: the judging lane is free; while it is not, no verdict is due.
        """


class EffortControl:
    """Lowers the effort when a step of the map is late, and raises it when steps have been fast for a while.

    Args:
        deadline: s.
    """

    def __init__(self, deadline: float = DEADLINE) -> None:
        self._deadline, self._calm = deadline, 0
        self.effort = 0  # 0: all of it

    def took(self, seconds: float) -> bool:
        """Take the seconds of a step of the map; return whether `effort` has changed."""
        before = self.effort
        self._calm = self._calm + 1 if seconds < 0.5 * self._deadline else 0
        if seconds > self._deadline:
            self.effort = min(self.effort + 1, MOST)
        elif self._calm >= CALM:
            self.effort, self._calm = max(self.effort - 1, 0), 0
        return self.effort != before


class FlightPolicy:
    """Every exposure is used; the map is judged every few keyframes, and as often as somebody needs it.

    The effort is full unless a live run reports the time of its steps to `effort_control`.

    Args:
        every: keyframes from one judgement to the next; 0: the map is judged where `need` calls for it only.
    """

    navigation_anew = mapping_anew = ()

    def __init__(self, every: int) -> None:
        self._every, self._since = every, 0  # keyframes
        self._judged_ns: int | None = None  # exposure of the last judgement
        self.need: Need | None = None  # of whoever decides by the verdicts, who sets it, from any thread; None: none
        self.effort_control = EffortControl()

    def tracks(self, event: Event) -> bool:
        """True always."""
        return True

    def maps(self, navigation: Navigation) -> bool:
        """True always."""
        return True

    def effort(self, navigation: Navigation) -> int:
        """Effort as the time of the last steps allows."""
        return self.effort_control.effort

    def due_verdict(self, navigation: Navigation, update: MapUpdate | None, free: bool = True) -> DueVerdict | None:
        """A verdict every few keyframes, and where the last judged exposure is older than the need allows."""
        self._since += 0 if update is None else update.steps
        need = self.need
        due = (self._every and self._since >= self._every) or self._is_overdue(navigation.frame.t_ns, need)
        if not (due and free):
            return None
        self._since, self._judged_ns = 0, navigation.frame.t_ns
        return DueVerdict(None if need is None else need.about)

    def _is_overdue(self, t_ns: int, need: Need | None) -> bool:
        if need is None or self._judged_ns is None:
            return need is not None
        return (t_ns - self._judged_ns) * 1e-9 >= need.seconds


class ScheduledPolicy:
    """The exposures of a recorded schedule only; GPS/INS and IMU rows are never dropped."""

    def __init__(self, schedule: Schedule) -> None:
        self._tracked, self._mapped = frozenset(schedule.tracked), frozenset(schedule.mapped)
        self._about = dict(zip(schedule.judged, schedule.about, strict=True))
        self._effort = dict(zip(schedule.mapped, schedule.effort, strict=True))
        self.navigation_anew, self.mapping_anew = schedule.navigation_anew, schedule.mapping_anew

    def tracks(self, event: Event) -> bool:
        """True for rows, and for the exposures that were tracked."""
        return not isinstance(event, Frame) or event.t_ns in self._tracked

    def maps(self, navigation: Navigation) -> bool:
        """True for the exposures that were mapped."""
        return navigation.frame.t_ns in self._mapped

    def effort(self, navigation: Navigation) -> int:
        """Effort as in flight."""
        return self._effort[navigation.frame.t_ns]

    def due_verdict(self, navigation: Navigation, update: MapUpdate | None, free: bool = True) -> DueVerdict | None:
        """The verdict as in flight, about the same place."""
        if navigation.frame.t_ns not in self._about:
            return None
        about = self._about[navigation.frame.t_ns]
        return DueVerdict(None if about is None else np.array(about))
