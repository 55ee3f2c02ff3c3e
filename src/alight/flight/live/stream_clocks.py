"""Reliable stamps: late events are found, and jumps of a sensor's clock are corrected.

Stamps come from the sensors; arrival times only serve to find jumps of a clock. A stamp precedes its arrival by a
delay that varies little. A stamp that is ahead of this delay by more than `JUMP` is a jump of the clock, as no event
comes from the future. An event whose stamp is behind by more is late and dropped. If the stamps have stepped back
and stay behind for two seconds, the clock has jumped back: stamps of a backlog go on where the last one was. A jump is
subtracted from all later stamps, so that time is continuous. Events that are late for `USUAL` seconds are used again.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace

from alight.records import Event, Frame, ImuSample, NavSample

log = logging.getLogger(__name__)

JUMP = 1.0  # s, more than any expected variation of the delay
USUAL = 30.0  # s, over which the least delay counts as the usual one: a backlog has longer delays only

STREAMS: dict[type, str] = {Frame: "frames", NavSample: "GPS/INS rows", ImuSample: "IMU rows"}


@dataclass
class StreamClock:
    """The clock of one stream of events.

    Args:
        on_jump: called with a sentence about each jump.
    """

    name: str
    on_jump: Callable[[str], None]
    late: int = 0  # number of dropped events
    _shift_ns: int = 0  # added to all stamps
    _ahead: deque[tuple[float, float]] = field(default_factory=deque)  # s, (arrival, stamp minus arrival) of events on
    # time in the last `USUAL` seconds, each followed by smaller ones only; so the first is the largest
    _newest_ns: int | None = None  # stamp of the last event, as it came
    _behind: list[tuple[float, float]] = field(default_factory=list)  # s, (arrival, delay) of late events since a step
    # back of the stamps

    def stamp(self, t_ns: int, arrival: float) -> int | None:
        """Return a stamp corrected for all jumps of the clock; None: the event is late and must be dropped.

        Args:
            t_ns: stamp of the event.
            arrival: arrival of the event by a steady clock, s.
        """
        ahead = 1e-9 * (t_ns + self._shift_ns) - arrival
        off = ahead - self._ahead[0][1] if self._ahead else 0.0
        # half a jump: the time between two events makes the step of the stamps smaller than the jump
        stepped = self._newest_ns is not None and 1e-9 * (self._newest_ns - t_ns) > JUMP / 2
        self._newest_ns = t_ns
        if off > JUMP:
            self._take_out(off)
        elif off < -JUMP:
            if stepped or self._behind:
                self._behind.append((arrival, off))
            else:
                self._forget(arrival)
            if not self._behind or arrival - self._behind[0][0] < 2.0:
                self.late += 1
                return None
            self._take_out(max(by for _, by in self._behind))
        else:
            self._note(arrival, ahead)
        self._behind.clear()
        return t_ns + self._shift_ns

    def _note(self, arrival: float, ahead: float) -> None:
        while self._ahead and self._ahead[-1][1] <= ahead:
            self._ahead.pop()
        self._ahead.append((arrival, ahead))
        self._forget(arrival)

    def _forget(self, arrival: float) -> None:
        while self._ahead and self._ahead[0][0] < arrival - USUAL:
            self._ahead.popleft()

    def _take_out(self, jump: float) -> None:
        self._shift_ns -= round(jump * 1e9)
        sentence = f"{self.name}: their clock jumped by {jump:+.1f} s; it is put back, to about 20 ms"
        log.warning(sentence)
        self.on_jump(sentence)


class StreamClocks:
    """The clocks of all streams of a flight."""

    def __init__(self, on_jump: Callable[[str], None]) -> None:
        self.streams = {kind: StreamClock(name, on_jump) for kind, name in STREAMS.items()}

    def stamped(self, event: Event, arrival: float) -> Event | None:
        """Return an event with its stamp corrected (see `StreamClock.stamp`); None: the event is late, drop it."""
        t_ns = self.streams[type(event)].stamp(event.t_ns, arrival)
        if t_ns is None:
            return None
        return event if t_ns == event.t_ns else replace(event, t_ns=t_ns)

    @property
    def late(self) -> dict[str, int]:
        """Number of dropped late events, by name of the stream."""
        return {c.name: c.late for c in self.streams.values()}
