"""State, times and counts of the lanes: for the status line, the recording and `run.json`."""

from __future__ import annotations

import threading
import time
from collections import Counter, OrderedDict, deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from enum import Enum

from alight.pipeline.timing import Timings


class LaneState(Enum):
    """The state of a lane's process."""

    WAITING = "waiting"  # for work
    BUSY = "busy"
    LATE = "late"  # busy for longer than 0.9 s; not killed yet
    STARTING = "starting"  # its process is new
    LOST = "lost"  # given up


@dataclass(frozen=True)
class FlightHealth:
    """State, rates and counts of the lanes at one moment."""

    lanes: Mapping[str, LaneState]
    restarts: Mapping[str, int]
    rate: float  # motions a second, over the last seconds
    median_ms: Mapping[str, float]  # of each measured time
    left_out: int  # exposures that navigation did not use
    effort: int  # of mapping
    frame_id: int | None  # of the newest motion

    @property
    def line(self) -> str:
        """One line for a terminal."""
        lanes = " ".join(f"{name} {state.value}" for name, state in self.lanes.items())
        times = ", ".join(f"{name} {ms:.0f} ms" for name, ms in self.median_ms.items())
        lost = ", ".join(f"{name} restarted {n} times" for name, n in self.restarts.items() if n)
        effort = f"; mapping at effort {self.effort}" if self.effort else ""
        return f"{self.rate:.0f} frames/s, {self.left_out} left out; {times}; {lanes}{effort}" + (
            f"; {lost}" if lost else ""
        )


class Watch:
    """Times, counts and states of a flight, from all its threads. Memory does not grow with the flight."""

    def __init__(self, lanes: Sequence[str]) -> None:
        self._lock = threading.Lock()
        self._arrived: OrderedDict[int, float] = OrderedDict()
        self._since: dict[str, float | None] = dict.fromkeys(lanes)
        self._state = dict.fromkeys(lanes, LaneState.STARTING)
        self._motions: deque[float] = deque(maxlen=100)
        self.timings = Timings(history=False)
        self.counts: Counter[str] = Counter()
        self.restarts: Counter[str] = Counter()

    def arrived(self, t_ns: int) -> None:
        """Note the time at which an exposure arrived."""
        with self._lock:
            self._arrived[t_ns] = time.perf_counter()
            if len(self._arrived) > 1000:
                self._arrived.popitem(last=False)

    def reached(self, what: str, t_ns: int) -> None:
        """Take the time since an exposure arrived, under the name `what`; a pose counts for the rate as well."""
        now = time.perf_counter()
        with self._lock:
            if (then := self._arrived.get(t_ns)) is not None:
                self.timings.add(what, now - then)
            if what == POSE:
                self._motions.append(now)

    @contextmanager
    def work(self, lane: str, what: str = "") -> Iterator[None]:
        """Count a lane as busy meanwhile, and take the time under the name `what`, if given; a failure is not timed."""
        begin = time.perf_counter()
        self._since[lane], self._state[lane] = begin, LaneState.BUSY
        try:
            yield
        except BaseException:
            self._state[lane] = LaneState.STARTING
            raise
        else:
            self._state[lane] = LaneState.WAITING
            if what:
                self.timings.add(what, time.perf_counter() - begin)
        finally:
            self._since[lane] = None

    def gave_up(self, lane: str) -> None:
        """Count a lane as lost for the rest of the flight."""
        self._state[lane] = LaneState.LOST

    def state(self, lane: str) -> LaneState:
        """The state of a lane now; busy for longer than 0.9 s is late."""
        since, state = self._since[lane], self._state[lane]
        if state is LaneState.BUSY and since is not None and time.perf_counter() - since > 0.9:
            return LaneState.LATE
        return state

    def health(self, effort: int, frame_id: int | None) -> FlightHealth:
        """Sum up all lanes.

        Args:
            effort: of mapping.
            frame_id: of the newest motion; None: there is none.
        """
        now = time.perf_counter()
        with self._lock:
            recent = [t for t in self._motions if now - t < 3.0]
            rate = (len(recent) - 1) / (recent[-1] - recent[0]) if len(recent) > 1 else 0.0
            median = {k: 1e3 * sorted(v)[len(v) // 2] for k, v in list(self.timings.stages.items())}
        return FlightHealth(
            {name: self.state(name) for name in self._since}, dict(self.restarts), rate, median,
            sum(n for name, n in self.counts.items() if name.startswith("navigation: exposures left out")),
            effort, frame_id,
        )  # fmt: skip


POSE, STEP, VERDICT = "frame to pose", "map step", "frame to verdict"
