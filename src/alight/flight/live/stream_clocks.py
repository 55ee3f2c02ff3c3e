"""Reliable stamps: late events are found, and a jump of a sensor's clock is corrected.

Stamps come from the sensors; the arrival only serves to find a jump of a clock. A stamp is behind its arrival by a
delay that varies little. One that is ahead of that by more than `JUMP` is a jump of the clock, as no event comes from
the future. One that is behind by more is late, and left out; when a stream stays behind for two seconds, its clock has
jumped back. The jump is taken out of all later stamps, so that time is continuous.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, field, replace

from alight.records import Event, Frame, ImuSample, NavSample

log = logging.getLogger(__name__)

JUMP = 1.0  # s, more than any expected variation of the delay

STREAMS: dict[type, str] = {Frame: "frames", NavSample: "GPS/INS rows", ImuSample: "IMU rows"}


@dataclass
class StreamClock:
    """The clock of one stream.

    Args:
        on_jump: called with a sentence on each jump.
    """

    name: str
    on_jump: Callable[[str], None]
    late: int = 0  # events left out
    _shift_ns: int = 0  # added to all stamps
    _ahead: float | None = None  # s, stamp less arrival, of the last event on time
    _behind: list[tuple[float, float]] = field(default_factory=list)  # arrivals of late events, and their delays in s

    def stamp(self, t_ns: int, arrival: float) -> int | None:
        """Return a stamp with all jumps taken out; None: the event is late and must be left out.

        Args:
            t_ns: stamp of the event.
            arrival: s of a steady clock.
        """
        ahead = 1e-9 * (t_ns + self._shift_ns) - arrival
        if self._ahead is None:
            self._ahead = ahead
        off = ahead - self._ahead
        if off > JUMP:
            self._take_out(off)
        elif off < -JUMP:
            self._behind.append((arrival, off))
            if arrival - self._behind[0][0] < 2.0:
                self.late += 1
                return None
            self._take_out(max(by for _, by in self._behind))
        else:
            self._ahead = ahead
        self._behind.clear()
        return t_ns + self._shift_ns

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
        """As `StreamClock.stamp` for an event of any stream."""
        t_ns = self.streams[type(event)].stamp(event.t_ns, arrival)
        if t_ns is None:
            return None
        return event if t_ns == event.t_ns else replace(event, t_ns=t_ns)

    @property
    def late(self) -> dict[str, int]:
        """Number of events that were left out, by stream."""
        return {c.name: c.late for c in self.streams.values()}
