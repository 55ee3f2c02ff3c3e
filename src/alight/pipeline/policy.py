"""Policy of the lanes: which exposures are used, with how much effort, and when the map is judged.

Replay, live runs and trials use the same object. Time is the time of the events.
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
    """Request to judge the map now."""

    about: F64 | None = None  # (2,) metres in the map frame, a position that the map must also show; None: no position


class EffortControl:
    """Effort of the map's steps: lowered when a step is late, raised after six fast steps in a row.

    `deadline`: longest time of a step, s; a step within half of it is fast.
    """

    def __init__(self, deadline: float = 0.25) -> None:
        self._deadline, self._calm = deadline, 0
        self.effort = 0  # 0: full; 3: least (`MappingLane.feed`)

    def took(self, seconds: float) -> bool:
        """Update the effort with the duration of a step, s; return whether `effort` has changed."""
        before = self.effort
        self._calm = self._calm + 1 if seconds < 0.5 * self._deadline else 0
        if seconds > self._deadline:
            self.effort = min(self.effort + 1, 3)
        elif self._calm >= 6:
            self.effort, self._calm = max(self.effort - 1, 0), 0
        return self.effort != before


class FlightPolicy:
    """Policy that uses every exposure, and judges the map every few keyframes and as often as `need` requires.

    The effort is full unless a live run reports the duration of its steps to `effort_control`.

    Args:
        every: keyframes between judgements; 0: the map is judged only as `need` requires.
    """

    navigation_anew: Collection[int] = ()  # times of exposures before which the navigation lane is restarted
    mapping_anew: Collection[int] = ()  # times of exposures before which the mapping lane is restarted

    def __init__(self, every: int) -> None:
        self._every, self._since = every, 0  # keyframes
        self._judged_ns: int | None = None  # exposure of the last judgement
        self.need: Need | None = None  # set by the user of the verdicts, from any thread; None: no need
        self.effort_control = EffortControl()

    def tracks(self, event: Event) -> bool:
        """Whether the navigation lane uses an event."""
        return True

    def maps(self, navigation: Navigation) -> bool:
        """Whether the mapping lane uses an exposure."""
        return True

    def effort(self, navigation: Navigation) -> int:
        """Return the mapping lane's effort for an exposure, 0 (full) to 3 (least), as the time of its steps allows."""
        return self.effort_control.effort

    def due_verdict(self, navigation: Navigation, keyframes: int, free: bool = True) -> DueVerdict | None:
        """Return the verdict request that is due after an exposure, or None. Call it once per mapped exposure.

        Args:
            navigation: the exposure.
            keyframes: number of keyframes that the map was improved with.
            free: whether the judging lane is free; if not, no verdict is due.
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
    """Policy that uses only the exposures of a recorded schedule; rows of GPS/INS and IMU are never dropped."""

    def __init__(self, schedule: Schedule) -> None:
        super().__init__(every=0)
        self._tracked = frozenset(schedule.tracked)
        self._about = dict(zip(schedule.judged, schedule.about, strict=True))
        self._effort = dict(zip(schedule.mapped, schedule.effort, strict=True))
        self.navigation_anew, self.mapping_anew = schedule.navigation_anew, schedule.mapping_anew

    def tracks(self, event: Event) -> bool:
        """Whether the event is a row, or an exposure that was tracked in flight."""
        return not isinstance(event, Frame) or event.t_ns in self._tracked

    def maps(self, navigation: Navigation) -> bool:
        """Whether the exposure was mapped in flight."""
        return navigation.frame.t_ns in self._effort

    def effort(self, navigation: Navigation) -> int:
        """Return the mapping lane's effort in flight."""
        return self._effort[navigation.frame.t_ns]

    def due_verdict(self, navigation: Navigation, keyframes: int, free: bool = True) -> DueVerdict | None:
        """Return the verdict request that was due in flight, with the same position; None if no verdict was due."""
        if navigation.frame.t_ns not in self._about:
            return None
        about = self._about[navigation.frame.t_ns]
        return DueVerdict(None if about is None else np.array(about))
