"""State, times and counts of the lanes: for the status line, the recording and `run.json`."""

from __future__ import annotations

import threading
import time
from collections import Counter, OrderedDict, deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from enum import Enum

from alight.pipeline.timing import Timings
from alight.records import Sites, p_safe_text

POSE, STEP, VERDICT = "frame to pose", "map step", "frame to verdict"


class LaneState(Enum):
    """State of the process of a lane."""

    WAITING = "waiting"  # for work
    BUSY = "busy"
    LATE = "late"  # busy for longer than 0.9 s, but not killed yet
    STARTING = "starting"  # its process is new
    LOST = "lost"  # given up


class Watch:
    """Collects times, counts and states of a flight from all its threads, in constant memory."""

    def __init__(self, lanes: Sequence[str]) -> None:
        self._lock = threading.Lock()
        self._arrived: OrderedDict[int, float] = OrderedDict()
        self._state = {lane: (LaneState.STARTING, 0.0) for lane in lanes}  # state, and since when in s
        self._motions: deque[float] = deque(maxlen=100)
        self._answer: tuple[str, float] | None = None  # newest verdict in words, and when its exposure arrived, s
        self.timings = Timings(history=False)
        self.counts: Counter[str] = Counter()
        self.restarts: Counter[str] = Counter()

    def arrived(self, t_ns: int) -> None:
        """Note that the exposure stamped `t_ns` arrives now."""
        with self._lock:
            self._arrived[t_ns] = time.perf_counter()
            if len(self._arrived) > 1000:
                self._arrived.popitem(last=False)

    def judged(self, t_ns: int, sites: Sites) -> None:
        """Record the sites, in the world, of a map whose newest exposure is stamped `t_ns`."""
        self.reached(VERDICT, t_ns)
        words = "no place"
        if found := [*sites.sites, *sites.candidates][:1]:
            s = found[0]
            words = f"{s.kind} at east {s.east:.1f} north {s.north:.1f} m, P(safe) {p_safe_text(s.p_safe)}"
        with self._lock:
            self._answer = words, self._arrived.get(t_ns, time.perf_counter())

    def reached(self, what: str, t_ns: int) -> None:
        """Record as `what` how long ago the exposure stamped `t_ns` arrived; `POSE` also updates the frame rate."""
        now = time.perf_counter()
        with self._lock:
            if (then := self._arrived.get(t_ns)) is not None:
                self.timings.add(what, now - then)
            if what == POSE:
                self._motions.append(now)

    @contextmanager
    def work(self, lane: str, what: str = "") -> Iterator[None]:
        """Mark a lane as busy within the context; on success, record the duration under the name `what`, if given."""
        begin, after = time.perf_counter(), LaneState.STARTING
        self.enter(lane, LaneState.BUSY)
        try:
            yield
            after = LaneState.WAITING
            if what:
                self.timings.add(what, time.perf_counter() - begin)
        finally:
            if self._state[lane][0] is not LaneState.LOST:
                self.enter(lane, after)

    def enter(self, lane: str, state: LaneState) -> None:
        """Set the state of a lane."""
        self._state[lane] = state, time.perf_counter()

    def state(self, lane: str) -> LaneState:
        """Return the present state of a lane; a lane that is busy for longer than 0.9 s is late."""
        state, since = self._state[lane]
        late = state is LaneState.BUSY and time.perf_counter() - since > 0.9
        return LaneState.LATE if late else state

    def line(self, effort: int) -> str:
        """Return the newest verdict with its age, and states, rates and counts of the lanes, as one line of text.

        `effort`: effort of mapping.
        """
        now = time.perf_counter()
        with self._lock:
            recent = [t for t in self._motions if now - t < 3.0]
            rate = (len(recent) - 1) / (recent[-1] - recent[0]) if len(recent) > 1 else 0.0
            median = {k: 1e3 * sorted(v)[len(v) // 2] for k, v in list(self.timings.stages.items())}
        left_out = sum(n for name, n in self.counts.items() if name.startswith("navigation: exposures left out"))
        answer = "no verdict yet" if self._answer is None else f"{self._answer[0]}, {now - self._answer[1]:.1f} s old"
        parts = [
            answer,
            f"{rate:.0f} frames/s, {left_out} left out",
            ", ".join(f"{name} {ms:.0f} ms" for name, ms in median.items()),
            " ".join(f"{name} {self.state(name).value}" for name in self._state),
            f"mapping at effort {effort}" if effort else "",
            ", ".join(f"{name} restarted {n} times" for name, n in self.restarts.items() if n),
        ]
        return "; ".join(filter(None, parts))
