"""Conversion between bytes and messages. A damaged message is lost, but no message after it."""

from __future__ import annotations

import re
from collections import Counter
from typing import Any, NamedTuple

from alight.flight.autopilot.dialect import mavlink
from alight.flight.autopilot.interference import Allowance
from alight.flight.autopilot.signing import SignatureCheck, SigningKey

_RATE = 1000.0  # messages a second that are decoded without a key: five times as many as are requested
_MARKER = re.compile(bytes([mavlink.PROTOCOL_MARKER_V1]) + b"|" + bytes([mavlink.PROTOCOL_MARKER_V2]))


class ReceivedMessage(NamedTuple):
    """A received message with its sender and flags of its order among the sender's messages."""

    message: Any
    name: str
    system: int
    component: int
    late: bool  # overtaken by a newer message of its kind: not usable as a state
    overtaken: bool  # overtaken by a newer message of any kind
    clash: bool = False  # another message just before had its sequence number


class _Sequence:
    def __init__(self) -> None:
        self._newest: int | None = None
        self._newest_ns = 0
        self._of_kind: dict[str, int] = {}
        self._count = 0
        self._recent: dict[int, tuple[int, int, str, int]] = {}  # by sequence number: count, ns, type, checksum

    def repeats(self, sequence: int, name: str, checksum: int, now_ns: int) -> tuple[bool, bool]:
        """Add a message; return whether it is a copy of one of the last hundred, and whether it clashes with one.

        Two messages clash that are not alike and have one number within 0.3 s: too soon for the numbers to wrap.
        """
        before, self._count = self._recent.get(sequence), self._count + 1
        self._recent[sequence] = self._count, now_ns, name, checksum
        if before is None or self._count - before[0] > 100:
            return False, False
        same = before[2:] == (name, checksum)
        return same, not same and now_ns - before[1] < 300_000_000

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

    Args:
        system, component: the address from which messages are sent.
        key: signs what is sent; messages without its signature are dropped. None: nothing is signed.
    """

    def __init__(self, system: int, component: int, key: SigningKey | None = None) -> None:
        self.messages = 0  # number received since the link was opened
        self.dropped = Counter[str]()  # number of messages dropped since then, by reason
        self._mavlink = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)
        self._signatures = None if key is None else SignatureCheck(key, self._mavlink, self.dropped)
        self._allowances = {True: Allowance(_RATE), False: Allowance(_RATE)}  # of the vehicle, and of all others
        self._buffer, self._searched = bytearray(), 0  # and how many of its bytes hold no further message
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
        while (message := self._next(now_ns)) is not None:
            self.messages += 1
            sender, name = (message.get_srcSystem(), message.get_srcComponent()), message.get_type()
            sequence = self._senders.get(sender) or _Sequence()
            if len(self._senders) < 256:  # forged senders must not fill the memory
                self._senders[sender] = sequence
            copy, clash = sequence.repeats(message.get_seq(), name, message.get_crc(), now_ns)
            if not copy:
                flags = sequence.overtaken(name, message.get_seq(), now_ns)
                out.append(ReceivedMessage(message, name, *sender, *flags, clash))
        return out

    def _next(self, now_ns: int) -> Any | None:
        """Remove the next message from the buffer and return it; None: the buffer has no complete message.

        A frame that is not complete is waited for. With a key, what is behind it is decoded meanwhile: its header may
        be forged, and a signed message that is found there is not part of it.
        """
        waits_at, at = len(self._buffer), 0
        while (marker := _MARKER.search(self._buffer, at)) is not None:
            at = marker.start()
            end = at + self._frame_length(at)
            if end > len(self._buffer):
                waits_at = min(waits_at, at)
                if self._signatures is None:
                    break
            elif not self._is_affordable(at, now_ns):
                self.dropped[f"beyond {_RATE:,.0f} a second"] += 1
                at = end
                continue
            elif end > self._searched and (message := self._parsed(self._buffer[at:end])) is not None:
                self._remove(end)
                return message
            at += 1  # a false marker costs one byte
        self._remove(waits_at)
        self._searched = 0 if self._signatures is None else len(self._buffer)
        return None

    def _remove(self, count: int) -> None:
        del self._buffer[:count]
        self._searched = max(self._searched - count, 0)

    def _frame_length(self, at: int) -> int:
        """Length of the frame that begins at a byte of the buffer; 3 if the buffer ends before it shows the length."""
        header = self._buffer[at : at + 3]
        if len(header) < 3:
            return 3
        version, payload, flags = header
        if version == mavlink.PROTOCOL_MARKER_V1:
            return int(mavlink.HEADER_LEN_V1) + payload + 2
        signature = mavlink.MAVLINK_SIGNATURE_BLOCK_LEN if flags & mavlink.MAVLINK_IFLAG_SIGNED else 0
        return int(mavlink.HEADER_LEN_V2) + payload + 2 + int(signature)

    def _is_affordable(self, at: int, now_ns: int) -> bool:
        """Whether the frame at a byte of the buffer may be decoded. With a key all may: a forged one costs a hash."""
        if self._signatures is not None:
            return True
        first = at + (3 if self._buffer[at] == mavlink.PROTOCOL_MARKER_V1 else 5)
        us = self._mavlink.srcSystem, mavlink.MAV_COMP_ID_AUTOPILOT1  # we have the vehicle's system
        return self._allowances[tuple(self._buffer[first : first + 2]) == us].admits(now_ns)

    def _parsed(self, frame: bytearray) -> Any | None:
        """Return the message of a frame; None: it is damaged, or unknown, so that its checksum cannot be tested."""
        if frame[0] == mavlink.PROTOCOL_MARKER_V2 and frame[2] & ~mavlink.MAVLINK_IFLAG_SIGNED:
            return None
        try:
            message = (self._signatures or self._mavlink).decode(frame)
        except mavlink.MAVError:
            return None
        return None if message.get_type().startswith("UNKNOWN_") else message
