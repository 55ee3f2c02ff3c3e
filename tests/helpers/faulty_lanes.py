"""Lanes that raise, hang, die or are slow at given exposures; their processes import them from here."""

from __future__ import annotations

import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from alight import compiled
from alight.flight.live.lanes import NavigationProcess
from alight.pipeline import Verdict
from alight.pipeline.judging import JudgingLane
from alight.pipeline.mapping import MapSnapshot
from alight.pipeline.mapping.recursive_map import RecursiveMapper
from alight.pipeline.navigation import Navigation
from alight.pipeline.navigation.filter_lane import FrameBatch
from alight.pipeline.timing import Timings
from alight.records import Rig
from alight.settings import StageSettings


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
            os.kill(os.getpid(), signal.SIGKILL)
        time.sleep(1000.0 if self.kind == "hang" else self.seconds)


class FaultyNavigation(NavigationProcess):
    def __init__(self, fault: Fault, *given: Any) -> None:
        super().__init__(*given)
        self._fault = fault

    def take(self, batch: FrameBatch) -> Navigation | None:
        if batch.frame is not None:
            self._fault.strike(batch.frame.t_ns)
        return super().take(batch)


class FaultyMapping(RecursiveMapper):
    def __init__(self, fault: Fault, rig: Rig, settings: StageSettings, folder: Path) -> None:
        compiled.load_cached(parallel=True)
        super().__init__(rig, settings, None, Timings(), history=False)
        self._fault = fault

    def feed(self, navigation: Navigation, effort: int = 0) -> int:
        self._fault.strike(navigation.frame.t_ns)
        return super().feed(navigation, effort)


class FaultyJudging(JudgingLane):
    """Fails at its second map, counted over its processes in a file: `stamps` has one number, of the map."""

    def __init__(self, fault: Fault, count: Path, settings: StageSettings, *more: Any) -> None:
        appearance, zones, memory = more
        super().__init__(settings, appearance, Timings(), memory, zones)
        self._fault, self._count = fault, count

    def judge_at_end(self, seen: MapSnapshot) -> Verdict:
        with self._count.open("a") as f:
            f.write(".")
        self._fault.strike(self._count.stat().st_size)
        return super().judge_at_end(seen)


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
