"""Signatures of MAVLink 2: with a key, only messages of those who have it count."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from alight.flight.autopilot.dialect import mavlink

Stream = tuple[int, int, int]  # number of the link, system and component of the sender
AHEAD = 500_000  # time stamps, 10 microseconds each, that are stored ahead, so that few are written


@dataclass(frozen=True, eq=False)
class SigningKey:
    """Key of a link, and the time stamps of the messages that were accepted earlier.

    Args:
        secret: the key, 32 bytes.
        stamp: time stamp of the present, in units of 10 microseconds since 2015.
        old: the newest time stamp that may have been accepted before, by stream.
        store: called with `old` when a stamp in it has grown, before the message is used.
    """

    secret: bytes
    stamp: int
    old: dict[Stream, int] = field(default_factory=dict)
    store: Callable[[dict[Stream, int]], None] = lambda old: None


class SignatureCheck:
    """Signs what is sent, and decodes messages whose signature is right and newer than all before; counts the others.

    pymavlink records the time stamp of a message before it tests the signature. A forged message would thus shut out
    the vehicle, so the signature is tested before. This also makes a flood of forged messages cheap.

    Args:
        codec: encoder and decoder of the link; it signs from now on.
        dropped: counter of dropped messages by reason, which is added to.
    """

    def __init__(self, key: SigningKey, codec: mavlink.MAVLink, dropped: Counter[str]) -> None:
        self._key, self._codec, self._dropped = key, codec, dropped
        signing = codec.signing
        signing.secret_key, signing.sign_outgoing = key.secret, True
        signing.timestamp, signing.stream_timestamps = max(key.stamp, *key.old.values(), 0), dict(key.old)

    def decode(self, frame: bytearray) -> Any:
        """Return the message of a complete frame; raises MAVError if it is dropped."""
        if frame[0] != mavlink.PROTOCOL_MARKER_V2 or not frame[2] & mavlink.MAVLINK_IFLAG_SIGNED:
            self._dropped["unsigned"] += 1
            raise mavlink.MAVError("unsigned")
        if hashlib.sha256(self._key.secret + frame[:-6]).digest()[:6] != frame[-6:]:
            self._dropped["wrongly signed"] += 1
            raise mavlink.MAVError("wrongly signed")
        refused = self._codec.signing.badsig_count
        try:
            message = self._codec.decode(frame)
        except mavlink.MAVError:
            if self._codec.signing.badsig_count > refused:
                self._dropped["replayed"] += 1
            raise
        stream = frame[-13], frame[5], frame[6]
        stamp = self._codec.signing.stream_timestamps.get(stream, 0)
        if stamp > self._key.old.get(stream, -1):
            self._key.old[stream] = stamp + AHEAD
            self._key.store(self._key.old)
        return message
