"""Streams: each message is requested by name, and again whenever it stops or becomes slow.

A ground station on the same link may request other rates; ArduPilot obeys the newest request.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from alight.flight.autopilot.commands import CommandQueue
from alight.flight.autopilot.dialect import mavlink

_PATIENCE_NS = 2_000_000_000  # a stream is treated as stopped after this and three of its periods
_SUBSTITUTES = {"HIGHRES_IMU": "RAW_IMU"}  # for ArduPilot's small boards and older versions
_FIRST_NS, _LONGEST_NS = 3_000_000_000, 60_000_000_000  # between two requests for a stream that does not come


class StreamRate(NamedTuple):
    """Measured and wanted rate of one message, Hz."""

    measured: float  # NaN: not counted yet
    wanted: float

    @property
    def slow(self) -> bool:
        """Whether the rate is below 30 % of the wanted rate; loss and reordering on a link leave about 50 %."""
        return self.measured < 0.3 * self.wanted


@dataclass
class _Stream:
    rate: float
    received_ns: float = -math.inf
    requested_ns: int | None = None
    wait_ns: int = _FIRST_NS
    begin_ns: int | None = None  # start of the count
    count: int = 0  # messages after the one at `begin_ns`
    measured: float = math.nan  # Hz, of the newest full count

    @property
    def rates(self) -> StreamRate:
        return StreamRate(self.measured, self.rate)

    def on_message(self, t_ns: int) -> None:
        self.received_ns = t_ns
        if self.begin_ns is None:
            self.begin_ns, self.count = t_ns, 0
            return
        self.count += 1
        took = t_ns - self.begin_ns
        if took >= max(1e9, 10e9 / self.rate):  # a second, and ten periods
            self.measured = self.count * 1e9 / took
            self.begin_ns, self.count = t_ns, 0
            self.wait_ns = self.wait_ns if self.rates.slow else _FIRST_NS

    def is_missing(self, t_ns: int) -> bool:
        return t_ns - self.received_ns > _PATIENCE_NS + 3e9 / self.rate

    def is_due(self, t_ns: int) -> bool:
        if self.requested_ns is None:
            return True
        return (self.is_missing(t_ns) or self.rates.slow) and t_ns - self.requested_ns > self.wait_ns


class StreamKeeper:
    """Keeps streams flowing: a vehicle sends only requested messages, and forgets the requests at a reboot."""

    def __init__(self, rates: Mapping[str, float], commands: CommandQueue) -> None:
        self._streams = {name: _Stream(rate) for name, rate in rates.items()}
        self._commands = commands
        self._tickets: dict[int, str] = {}

    def rebooted(self) -> None:
        """Forget all requests and received messages, so that every stream is requested again."""
        self._streams = {name: _Stream(s.rate) for name, s in self._streams.items()}
        self._tickets.clear()

    def on_message(self, name: str, t_ns: int) -> None:
        """Note that a message called `name` has come; a message that was not requested has no effect."""
        if name in self._streams:
            self._streams[name].on_message(t_ns)

    def on_answer(self, ticket: int, refused: bool) -> bool:
        """Process the answer to the command `ticket`; return whether the command requested a stream.

        A message that the autopilot refuses is replaced by a message with the same content, if there is one; else it is
        seldom requested again.
        """
        name = self._tickets.pop(ticket, None)
        other = _SUBSTITUTES.get(name or "")
        if refused and name in self._streams and other is not None:
            self._streams.setdefault(other, _Stream(self._streams.pop(name).rate))
        elif refused and name in self._streams:
            self._streams[name].wait_ns = _LONGEST_NS
        return name is not None

    def tick(self, t_ns: int) -> None:
        """Request each stream that has not come, has stopped or is slow, at growing intervals."""
        for name, stream in list(self._streams.items()):
            if stream.is_due(t_ns):
                again = stream.requested_ns is not None
                stream.wait_ns = min(2 * stream.wait_ns, _LONGEST_NS) if again else _FIRST_NS
                stream.requested_ns, stream.begin_ns = t_ns, None
                number, message = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, getattr(mavlink, f"MAVLINK_MSG_ID_{name}")
                parameters = (float(message), 1e6 / stream.rate)
                ticket = self._commands.submit(f"stream {name}", number, parameters, t_ns, flies=False)
                self._tickets[ticket] = name

    def missing(self, t_ns: int) -> list[str]:
        """Return the names of requested messages that have not come, or no longer come."""
        return [n for n, s in self._streams.items() if s.is_missing(t_ns)]

    def rates(self, t_ns: int) -> dict[str, StreamRate]:
        """Return the rates of the messages that come, by name of the message."""
        return {n: s.rates for n, s in self._streams.items() if not s.is_missing(t_ns)}
