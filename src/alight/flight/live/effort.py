"""Adaptive effort: the work that the mapping lane may spend on a keyframe."""

from __future__ import annotations

DEADLINE = 0.25  # s that a step of the map may take
MOST = 3  # the least that can be done (`MappingLane.feed`)
CALM = 6  # steps in a row below half the deadline, after which more is done again


class EffortControl:
    """Lowers the effort when a step is late, and raises it when steps have been fast for a while.

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
