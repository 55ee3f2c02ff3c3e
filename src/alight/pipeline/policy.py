"""The policy of the lanes: which exposures are used, with how much effort, and when a map is judged about what place.

Replay, live runs and trials use the same object. Time is that of the events.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from alight.arrays import F64
from alight.pipeline.navigation import Navigation
from alight.records import Event, Frame, Schedule
from alight.records.executive import Need


@dataclass(frozen=True, eq=False)
class DueVerdict:
    """A verdict on the map that is due."""

    about: F64 | None = None  # (2,) metres in the map's frame, a place that the judged map shows too; None: none


class EffortControl:
    """Lowers the effort when a step of the map is late, and raises it when six steps in a row have been fast.

    Args:
        deadline: s that a step may take; half of it is fast.
    """

    def __init__(self, deadline: float = 0.25) -> None:
        self._deadline, self._calm = deadline, 0
        self.effort = 0  # 0: all of it; 3: the least (`MappingLane.feed`)

    def took(self, seconds: float) -> bool:
        """Take the seconds of a step of the map; return whether `effort` has changed."""
        before = self.effort
        self._calm = self._calm + 1 if seconds < 0.5 * self._deadline else 0
        if seconds > self._deadline:
            self.effort = min(self.effort + 1, 3)
        elif self._calm >= 6:
            self.effort, self._calm = max(self.effort - 1, 0), 0
        return self.effort != before


class FlightPolicy:
    """Every exposure is used; the map is judged every few keyframes, and as often as somebody needs it.

    The effort is full unless a live run reports the time of its steps to `effort_control`.

    Args:
        every: keyframes from one judgement to the next; 0: the map is judged where `need` calls for it only.
    """

    navigation_anew: Collection[int] = ()  # stamps of the exposures before which the navigation lane begins anew
    mapping_anew: Collection[int] = ()  # the same of the mapping lane

    def __init__(self, every: int) -> None:
        self._every, self._since = every, 0  # keyframes
        self._judged_ns: int | None = None  # exposure of the last judgement
        self.need: Need | None = None  # of whoever decides by the verdicts, who sets it, from any thread; None: none
        self.effort_control = EffortControl()

    def tracks(self, event: Event) -> bool:
        """Whether the navigation lane takes an event."""
        return True

    def maps(self, navigation: Navigation) -> bool:
        """Whether the mapping lane takes an exposure."""
        return True

    def effort(self, navigation: Navigation) -> int:
        """Effort of the mapping lane for an exposure, from 0 (full) to 3 (least), as the time of its steps allows."""
        return self.effort_control.effort

    def due_verdict(self, navigation: Navigation, keyframes: int, free: bool = True) -> DueVerdict | None:
        """The verdict that is due after an exposure; None: none is. Call it once for each mapped exposure.

        Args:
            navigation: the exposure.
            keyframes: number of keyframes that the map was improved with.
            free: the judging lane is free; while it is not, no verdict is due.
        """
        self._since += keyframes
        need, t_ns = self.need, navigation.frame.t_ns
        due = bool(self._every) and self._since >= self._every
        if need is not None:
            due |= self._judged_ns is None or (t_ns - self._judged_ns) * 1e-9 >= need.seconds
        if not (due and free):
            return None
        self._since, self._judged_ns = 0, t_ns
        return DueVerdict(None if need is None else need.about)


class ScheduledPolicy(FlightPolicy):
    """The exposures of a recorded schedule only; GPS/INS and IMU rows are never dropped."""

    def __init__(self, schedule: Schedule) -> None:
        super().__init__(every=0)
        self._tracked = frozenset(schedule.tracked)
        self._about = dict(zip(schedule.judged, schedule.about, strict=True))
        self._effort = dict(zip(schedule.mapped, schedule.effort, strict=True))
        self.navigation_anew, self.mapping_anew = schedule.navigation_anew, schedule.mapping_anew

    def tracks(self, event: Event) -> bool:
        """True for rows, and for the exposures that were tracked."""
        return not isinstance(event, Frame) or event.t_ns in self._tracked

    def maps(self, navigation: Navigation) -> bool:
        """True for the exposures that were mapped."""
        return navigation.frame.t_ns in self._effort

    def effort(self, navigation: Navigation) -> int:
        """Effort as in flight."""
        return self._effort[navigation.frame.t_ns]

    def due_verdict(self, navigation: Navigation, keyframes: int, free: bool = True) -> DueVerdict | None:
        """The verdict as in flight, about the same place."""
        if navigation.frame.t_ns not in self._about:
            return None
        about = self._about[navigation.frame.t_ns]
        return DueVerdict(None if about is None else np.array(about))
