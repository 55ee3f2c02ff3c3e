"""Stamps that can be relied on: what comes late is known as late, and a clock that jumps is put back.

Stamps come from the sensors; the arrival only tells when a clock has jumped. A stamp is behind its arrival by a delay
that varies little. One that is ahead of that by more than `JUMP` is a jump of the clock: nothing comes from the future.
One that is behind by more is late, and left out; when a stream stays behind for `PERSISTS`, its clock has jumped back.
The jump is taken out of all later stamps, so that time goes on.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, field, replace

from alight.records import Event, Frame, ImuSample, NavSample

log = logging.getLogger(__name__)

JUMP = 1.0  # s, more than any delay that is expected to vary
PERSISTS = 2.0  # s of arrivals

STREAMS: dict[type, str] = {Frame: "frames", NavSample: "GPS/INS rows", ImuSample: "IMU rows"}


@dataclass
class StreamClock:
    """The clock of one stream.

    Args:
        say: is told of each jump, in a sentence.
    """

    name: str
    say: Callable[[str], None]
    late: int = 0  # events left out
    _shift_ns: int = 0  # added to all stamps
    _ahead: float | None = None  # s, stamp less arrival, of what came last in time
    _behind: list[tuple[float, float]] = field(default_factory=list)  # arrivals that were late, and by how much

    def stamp(self, t_ns: int, arrival: float) -> int | None:
        """Return a stamp with all jumps taken out; None: the event is late and to be left out.

        Args:
            t_ns: as the event bears it.
            arrival: s of a clock that goes on steadily.
        """
        ahead = 1e-9 * (t_ns + self._shift_ns) - arrival
        if self._ahead is None:
            self._ahead = ahead
        off = ahead - self._ahead
        if off > JUMP:
            self._take_out(off)
        elif off < -JUMP:
            self._behind.append((arrival, off))
            if arrival - self._behind[0][0] < PERSISTS:
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
        self.say(sentence)


class Clocks:
    """The clocks of all streams of a flight.

    Args:
        say: is told of each jump, in a sentence.
    """

    def __init__(self, say: Callable[[str], None]) -> None:
        self.streams = {kind: StreamClock(name, say) for kind, name in STREAMS.items()}

    def stamped(self, event: Event, arrival: float) -> Event | None:
        """Return an event with a stamp that can be relied on; None: it is late and to be left out.

        Args:
            event: as it came.
            arrival: s of a clock that goes on steadily.
        """
        t_ns = self.streams[type(event)].stamp(event.t_ns, arrival)
        if t_ns is None:
            return None
        return event if t_ns == event.t_ns else replace(event, t_ns=t_ns)

    @property
    def late(self) -> dict[str, int]:
        """Number of events that were left out, by stream."""
        return {c.name: c.late for c in self.streams.values()}
