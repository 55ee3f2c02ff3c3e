"""Run time of the stages, by a clock of the caller: the core has none of its own."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager

Clock = Callable[[], float]  # seconds
Progress = Callable[[float], None]  # share done
StageProgress = Callable[[str, float], None]  # stage, share done


def unreported(stage: str, share: float) -> None:
    """Report no progress. Another process can import this function, and call it."""


class Timings:
    """Seconds of every step, by stage; without `history`, of the last steps alone."""

    def __init__(self, clock: Clock = lambda: 0.0, history: bool = True) -> None:
        self._clock, self._most = clock, None if history else 1000
        self.stages: dict[str, deque[float]] = {}

    @contextmanager
    def of(self, stage: str) -> Iterator[None]:
        """Measure a step of a stage; one that fails is not counted."""
        start = self._clock()
        yield
        self.add(stage, self._clock() - start)

    def add(self, stage: str, seconds: float) -> None:
        """Add a step of a stage."""
        self.stages.setdefault(stage, deque(maxlen=self._most)).append(seconds)
