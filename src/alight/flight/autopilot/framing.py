"""Conversion between bytes and messages. A damaged message is lost, but no message after it."""

from __future__ import annotations

import re
from collections import deque
from typing import Any, NamedTuple

from alight.flight.autopilot.dialect import mavlink

_MARKER = re.compile(bytes([mavlink.PROTOCOL_MARKER_V1]) + b"|" + bytes([mavlink.PROTOCOL_MARKER_V2]))


class ReceivedMessage(NamedTuple):
    """A received message with its sender, and two flags that mark a message overtaken by newer messages."""

    message: Any
    name: str
    system: int
    component: int
    late: bool  # overtaken by a newer message of its kind: not usable as a state
    overtaken: bool  # overtaken by a newer message of any kind


class _Sequence:
    def __init__(self) -> None:
        self._newest: int | None = None
        self._newest_ns = 0
        self._of_kind: dict[str, int] = {}
        self._recent: deque[tuple[int, str, int]] = deque(maxlen=100)  # fewer than numbers until they wrap

    def is_copy(self, sequence: int, name: str, checksum: int) -> bool:
        entry = (sequence, name, checksum)
        repeated = entry in self._recent
        self._recent.append(entry)
        return repeated

    def overtaken(self, name: str, sequence: int, now_ns: int) -> tuple[bool, bool]:
        """Add a message; return two flags: a newer message of its type `name`, and one of any type, came before it.

        After a second without a higher number, a lower number is treated as a restart of the sender.
        """
        if self._newest is None or now_ns - self._newest_ns > 1_000_000_000:
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
    """Packs and decodes MAVLink 2 with pymavlink, but finds the frames itself, so that no intact message is lost.

    pymavlink's own search trusts the length in a damaged header, and drops whatever lies within that length.
    """

    def __init__(self, system: int, component: int) -> None:
        self.messages = 0  # number received since the link was opened
        self._mavlink = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)
        self._buffer = bytearray()
        self._senders: dict[tuple[int, int], _Sequence] = {}

    def set_sender(self, system: int, component: int) -> None:
        """Set the address from which messages are sent."""
        self._mavlink.srcSystem, self._mavlink.srcComponent = system, component

    def encode(self, message: Any) -> bytes:
        """Return the bytes of a message with the next sequence number."""
        data = bytes(message.pack(self._mavlink))
        self._mavlink.seq = (self._mavlink.seq + 1) % 256
        return data

    def decode(self, data: bytes, now_ns: int) -> list[ReceivedMessage]:
        """Process received bytes, in pieces of any length; return the complete messages, without duplicates."""
        self._buffer += data
        out = []
        while (message := self._next()) is not None:
            self.messages += 1
            sender, name = (message.get_srcSystem(), message.get_srcComponent()), message.get_type()
            sequence = self._senders.setdefault(sender, _Sequence())
            if not sequence.is_copy(message.get_seq(), name, message.get_crc()):
                flags = sequence.overtaken(name, message.get_seq(), now_ns)
                out.append(ReceivedMessage(message, name, *sender, *flags))
        return out

    def _next(self) -> Any | None:
        """Remove the next message from the buffer and return it; None: the buffer has no complete message."""
        while (marker := _MARKER.search(self._buffer)) is not None:
            del self._buffer[: marker.start()]
            if len(self._buffer) < 3 or len(self._buffer) < (length := self._frame_length()):
                return None
            message = self._parsed(self._buffer[:length])
            del self._buffer[: 1 if message is None else length]  # a false marker costs one byte
            if message is not None:
                return message
        self._buffer.clear()
        return None

    def _frame_length(self) -> int:
        version, payload, flags = self._buffer[:3]
        if version == mavlink.PROTOCOL_MARKER_V1:
            return int(mavlink.HEADER_LEN_V1) + payload + 2
        signature = mavlink.MAVLINK_SIGNATURE_BLOCK_LEN if flags & mavlink.MAVLINK_IFLAG_SIGNED else 0
        return int(mavlink.HEADER_LEN_V2) + payload + 2 + int(signature)

    def _parsed(self, frame: bytearray) -> Any | None:
        """Return the message of a frame; None: it is damaged, or unknown, so that its checksum cannot be tested."""
        if frame[0] == mavlink.PROTOCOL_MARKER_V2 and frame[2] & ~mavlink.MAVLINK_IFLAG_SIGNED:
            return None
        try:
            message = self._mavlink.decode(frame)
        except mavlink.MAVError:
            return None
        return None if message.get_type().startswith("UNKNOWN_") else message
