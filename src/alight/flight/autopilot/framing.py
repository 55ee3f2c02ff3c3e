"""Bytes to messages and back. A damaged message is lost, but no message after it."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

from alight.flight.autopilot.pymavlink_dialect import dialect

_V1, _V2 = 0xFE, 0xFD
_SIGNED, _SIGNATURE, _CHECKSUM = 1, 13, 2
_COPIES = 100  # messages of a sender among which a copy is looked for: less than the sequence numbers take to wrap
_REMEMBERED_NS = 1_000_000_000  # after this long without a newer one, an old sequence number is a new start


@dataclass
class FrameCounts:
    """Counts of a link since it was opened."""

    messages: int = 0
    damaged: int = 0  # bytes that belong to no whole message
    unknown: int = 0  # messages that the dialect does not have


@dataclass(frozen=True)
class Heard:
    """A message with its sender, and two flags that mark one overtaken by newer messages."""

    message: Any
    name: str
    system: int
    component: int
    late: bool  # overtaken by a newer one of its own kind: of no use as a state
    overtaken: bool  # by a newer one of any kind


class _Order:
    """Sequence numbers of one sender, unwrapped."""

    def __init__(self) -> None:
        self._newest: int | None = None
        self._newest_ns = 0
        self._of_kind: dict[str, int] = {}
        self._recent: deque[tuple[int, str, int]] = deque(maxlen=_COPIES)

    def is_copy(self, sequence: int, name: str, checksum: int) -> bool:
        """Remember a message; True: a copy of it is among the last `_COPIES` messages."""
        entry = (sequence, name, checksum)
        known = entry in self._recent
        self._recent.append(entry)
        return known

    def place(self, name: str, sequence: int, now_ns: int) -> tuple[bool, bool]:
        """Sort in a message; return whether a newer one of its kind, and whether any newer one, came before it."""
        if self._newest is None or now_ns - self._newest_ns > _REMEMBERED_NS:
            self._newest, self._newest_ns = sequence, now_ns
            self._of_kind = {name: sequence}
            return False, False
        index = self._newest + (sequence - self._newest + 128) % 256 - 128
        overtaken = index <= self._newest
        if not overtaken:
            self._newest, self._newest_ns = index, now_ns
        late = index <= self._of_kind.get(name, index - 1)
        self._of_kind[name] = max(index, self._of_kind.get(name, index))
        return late, overtaken


class Framing:
    """MAVLink 2 by pymavlink's packing and checksums, with a search for frames that loses no good one.

    pymavlink's own search trusts the length in a damaged header and drops whatever lies within it.
    """

    def __init__(self, system: int, component: int) -> None:
        self.counts = FrameCounts()
        self._mavlink = dialect().MAVLink(None, srcSystem=system, srcComponent=component)
        self._buffer = bytearray()
        self._unknown_left = 0  # bytes left of an unknown message, which may be no message at all
        self._orders: dict[tuple[int, int], _Order] = {}

    def speak_as(self, system: int, component: int) -> None:
        """Use another address from now on."""
        self._mavlink.srcSystem, self._mavlink.srcComponent = system, component

    def encode(self, message: Any) -> bytes:
        """Pack a message with the next sequence number."""
        data = bytes(message.pack(self._mavlink))
        self._mavlink.seq = (self._mavlink.seq + 1) % 256
        return data

    def decode(self, data: bytes, now_ns: int) -> list[Heard]:
        """Take bytes as they come, in pieces of any length; return the whole messages, without copies."""
        self._buffer += data
        out = []
        while (message := self._next()) is not None:
            self.counts.messages += 1
            sender, name = (message.get_srcSystem(), message.get_srcComponent()), message.get_type()
            order = self._orders.setdefault(sender, _Order())
            if order.is_copy(message.get_seq(), name, message.get_crc()):
                continue
            out.append(Heard(message, name, *sender, *order.place(name, message.get_seq(), now_ns)))
        return out

    def _next(self) -> Any | None:
        while True:
            self._skip_to_marker()
            length = self._frame_length()
            if length is None or len(self._buffer) < length:
                return None
            message = self._parsed(length)
            if message is not None:
                return message

    def _skip_to_marker(self) -> None:
        found = (i for i in (self._buffer.find(_V1), self._buffer.find(_V2)) if i >= 0)
        start = min(found, default=len(self._buffer))
        self._drop(start)

    def _frame_length(self) -> int | None:
        """Length in bytes of the frame that the buffer seems to start with; None: not enough of it yet."""
        if len(self._buffer) < 3:
            return None
        if self._buffer[0] == _V1:
            return 6 + self._buffer[1] + _CHECKSUM
        signed = _SIGNATURE if self._buffer[2] & _SIGNED else 0
        return 10 + self._buffer[1] + _CHECKSUM + signed

    def _parsed(self, length: int) -> Any | None:
        """Take the message of the buffer's first `length` bytes; if it is invalid, drop one byte and return None."""
        module = dialect()
        frame = self._buffer[:length]
        try:
            if frame[0] == _V2 and frame[2] & ~_SIGNED:
                raise module.MAVError("incompatible")
            message = self._mavlink.decode(bytearray(frame))
        except module.MAVError:
            self._drop(1)
            return None
        if message.get_type().startswith("UNKNOWN_"):  # its checksum cannot be tested
            following = self._buffer[length : length + 1]
            if not following or following[0] in (_V1, _V2):  # it may be random bytes that contain good messages
                self.counts.unknown += not self._unknown_left
                self._unknown_left = max(self._unknown_left, length)
            self._drop(1)
            return None
        del self._buffer[:length]
        self._unknown_left = max(self._unknown_left - length, 0)
        return message

    def _drop(self, count: int) -> None:
        unknown = min(self._unknown_left, count)
        self._unknown_left -= unknown
        self.counts.damaged += count - unknown
        del self._buffer[:count]
