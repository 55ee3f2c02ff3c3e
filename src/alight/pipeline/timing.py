"""Run time of the stages, measured with the caller's clock, as the core has none."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from itertools import takewhile

Clock = Callable[[], float]  # seconds
Progress = Callable[[float], None]  # share done (0 to 1)
StageProgress = Callable[[str, float], None]  # stage, share done (0 to 1)


WHOLE = "whole"  # name of the progress of all stages together


def with_whole(progress: StageProgress, parts: Mapping[str, float]) -> StageProgress:
    """Return a function that also reports the progress of the whole, before that of a stage.

    `parts`: usual duration of each stage, in order, in any unit.
    """

    def report(stage: str, share: float) -> None:
        before = [parts[k] for k in takewhile(lambda k: k != stage, parts)]
        progress(WHOLE, (sum(before) + share * parts.get(stage, 0.0)) / sum(parts.values()))
        progress(stage, share)

    return report


def unreported(stage: str, share: float) -> None:
    """Ignore reported progress; a module-level function, so that other processes can import it."""


class Timings:
    """Durations of steps in seconds, by stage; without `history`, only of the last 1000 steps."""

    def __init__(self, clock: Clock = lambda: 0.0, history: bool = True) -> None:
        self._clock, self._most = clock, None if history else 1000
        self.stages: dict[str, deque[float]] = {}

    @contextmanager
    def of(self, stage: str) -> Iterator[None]:
        """Time one step of a stage; a step that raises is not recorded."""
        start = self._clock()
        yield
        self.add(stage, self._clock() - start)

    def add(self, stage: str, seconds: float) -> None:
        """Record the duration of one step of a stage."""
        self.stages.setdefault(stage, deque(maxlen=self._most)).append(seconds)
