"""Lanes that raise, hang, die or are slow at given exposures; their processes import them from here."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from alight.flight.live.lanes import JudgingProcess, MappingProcess, NavigationProcess
from alight.pipeline.mapping import MapSnapshot, MapUpdate
from alight.pipeline.navigation import FrameBatch, Navigation


@dataclass(frozen=True)
class Fault:
    """A fault: `raise`, `hang`, `die` or `slow` (for `seconds`), at exposures of these stamps."""

    kind: str
    stamps: frozenset[int]
    seconds: float = 0.3

    def strike(self, t_ns: int) -> None:
        if t_ns not in self.stamps:
            return
        if self.kind == "raise":
            raise RuntimeError("a fault that a test wants")
        if self.kind == "die":
            os._exit(3)
        time.sleep(1000.0 if self.kind == "hang" else self.seconds)


class FaultyNavigation(NavigationProcess):
    def __init__(self, fault: Fault, *given: Any) -> None:
        super().__init__(*given)
        self._fault = fault

    def take(self, batch: FrameBatch) -> Navigation | None:
        if batch.frame is not None:
            self._fault.strike(batch.frame.t_ns)
        return super().take(batch)


class FaultyMapping(MappingProcess):
    def __init__(self, fault: Fault, *given: Any) -> None:
        super().__init__(*given)
        self._fault = fault

    def feed(self, navigation: Navigation, *more: Any) -> MapUpdate | None:
        self._fault.strike(navigation.frame.t_ns)
        return super().feed(navigation, *more)


class FaultyJudging(JudgingProcess):
    """Fails at its second map, counted over its processes in a file: `stamps` has one number, of the map."""

    def __init__(self, fault: Fault, count: Path, *given: Any) -> None:
        super().__init__(*given)
        self._fault, self._count = fault, count

    def judge_and_remember(self, seen: MapSnapshot) -> Any:
        with self._count.open("a") as f:
            f.write(".")
        self._fault.strike(self._count.stat().st_size)
        return super().judge_and_remember(seen)


class IdleOrBusy:
    """A lane that works or sleeps."""

    def work(self, seconds: float) -> float:
        """Use `seconds` of processor time."""
        begin = time.process_time()
        while time.process_time() - begin < seconds:
            pass
        return seconds

    def sleep(self, seconds: float) -> None:
        """Sleep for `seconds` without processor time."""
        time.sleep(seconds)
