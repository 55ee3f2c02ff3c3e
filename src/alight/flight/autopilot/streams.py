"""Streams: requested message by message, and again whenever one stops or becomes slow.

A ground station on the same link may request other rates; ArduPilot obeys the newest request.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from alight.flight.autopilot.commands import CommandQueue
from alight.flight.autopilot.pymavlink_dialect import message_id

SET_MESSAGE_INTERVAL = 511  # MAV_CMD
_PATIENCE_NS = 2_000_000_000  # a stream counts as stopped after this and three of its periods
_SUBSTITUTES = {"HIGHRES_IMU": "RAW_IMU"}  # of ArduPilot's small boards and older versions
_FIRST_NS, _LONGEST_NS = 3_000_000_000, 60_000_000_000  # between two requests for a stream that does not come
_SLOW = 0.3  # of the requested rate; a link that loses and reorders halves it by itself
_COUNTED, _LEAST_NS = 10.0, 1_000_000_000  # periods, and time at least, over which messages are counted


class StreamRate(NamedTuple):
    """Messages a second."""

    measured: float  # NaN: not counted yet
    wanted: float

    @property
    def slow(self) -> bool:
        """True if so few come that they are requested again."""
        return self.measured < _SLOW * self.wanted


@dataclass
class _Stream:
    rate: float
    heard_ns: int = -1
    asked_ns: int | None = None
    wait_ns: int = _FIRST_NS
    begin_ns: int | None = None  # of the count
    count: int = 0  # messages after the one at `begin_ns`
    measured: float = math.nan  # Hz, of the newest full count

    @property
    def told(self) -> StreamRate:
        return StreamRate(self.measured, self.rate)

    def hear(self, t_ns: int) -> None:
        self.heard_ns = t_ns
        if self.begin_ns is None:
            self.begin_ns, self.count = t_ns, 0
            return
        self.count += 1
        took = t_ns - self.begin_ns
        if took >= max(_LEAST_NS, _COUNTED * 1e9 / self.rate):
            self.measured = self.count * 1e9 / took
            self.begin_ns, self.count = t_ns, 0
            self.wait_ns = self.wait_ns if self.told.slow else _FIRST_NS

    def ask(self, t_ns: int) -> None:
        self.wait_ns = _FIRST_NS if self.asked_ns is None else min(2 * self.wait_ns, _LONGEST_NS)
        self.asked_ns, self.begin_ns = t_ns, None


class StreamKeeper:
    """Keeps the streams of a vehicle flowing (it sends only requested messages, and forgets requests at a reboot)."""

    def __init__(self, rates: Mapping[str, float], commands: CommandQueue) -> None:
        self._streams = {name: _Stream(rate) for name, rate in rates.items()}
        self._commands = commands
        self._tickets: dict[int, str] = {}

    def rebooted(self) -> None:
        """Forget all requests and received messages, so that every stream is requested again."""
        self._streams = {name: _Stream(s.rate) for name, s in self._streams.items()}
        self._tickets.clear()

    def hear(self, name: str, t_ns: int) -> None:
        """Note that a message of a stream has come."""
        stream = self._streams.get(name)
        if stream is not None:
            stream.hear(t_ns)

    def answered(self, ticket: int, refused: bool) -> bool:
        """Take an answer; False: it belongs to no request for a stream.

        A message that the autopilot does not have is replaced by one of the same content, if there is one.
        """
        name = self._tickets.pop(ticket, None)
        other = _SUBSTITUTES.get(name or "")
        if refused and name in self._streams and other is not None:
            self._streams.setdefault(other, _Stream(self._streams.pop(name).rate))
        return name is not None

    def tick(self, t_ns: int) -> None:
        """Request each stream that has not come, has stopped or is slow, at growing intervals."""
        for name, stream in list(self._streams.items()):
            if self._missing(stream, t_ns):
                self._ask(name, stream, t_ns)

    def dry(self, t_ns: int) -> list[str]:
        """Return the names of the messages that were requested and have not come, or come no more."""
        return [n for n, s in self._streams.items() if s.heard_ns < 0 or self._late(s, t_ns)]

    def rates(self, t_ns: int) -> dict[str, StreamRate]:
        """Return the rates of the messages that come, by name."""
        return {n: s.told for n, s in self._streams.items() if not self._late(s, t_ns)}

    def _late(self, stream: _Stream, t_ns: int) -> bool:
        return t_ns - stream.heard_ns > _PATIENCE_NS + 3e9 / stream.rate

    def _missing(self, stream: _Stream, t_ns: int) -> bool:
        if stream.asked_ns is None:
            return True
        wanting = stream.heard_ns < 0 or self._late(stream, t_ns) or stream.told.slow
        return wanting and t_ns - stream.asked_ns > stream.wait_ns

    def _ask(self, name: str, stream: _Stream, t_ns: int) -> None:
        stream.ask(t_ns)
        parameters = (float(message_id(name)), 1e6 / stream.rate)
        ticket = self._commands.submit(f"stream {name}", SET_MESSAGE_INTERVAL, parameters, t_ns, flies=False)
        self._tickets[ticket] = name
