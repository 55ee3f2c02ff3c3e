"""An MCAP file with messages of ROS 2 that other tools open: definitions of the types, small chunks, an index."""

from __future__ import annotations

from typing import BinaryIO

from mcap.writer import CompressionType, Writer

from alight import __version__
from alight.outputs.ros_messages import RosMessage, definition_of


class RosFile:
    """Writer of messages into a file that is open for writing; channels are made when their first message comes.

    Args:
        file: where to write.
        chunk: bytes of a chunk; a picture exceeds them, so that it is in the file at once.
    """

    def __init__(self, file: BinaryIO, chunk: int = 1 << 14) -> None:
        self._writer = Writer(file, chunk_size=chunk, compression=CompressionType.NONE, enable_crcs=False)
        self._writer.start("ros2", f"alight {__version__}")
        self._schemas, self._channels = dict[str, int](), dict[str, int]()
        self._number = 0  # of the next message

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Write a record of metadata."""
        self._writer.add_metadata(name, values)

    def write(self, message: RosMessage, now_ns: int) -> None:
        """Write a message; `now_ns` is its log time, its stamp the publish time.

        Raises:
            OSError: the file cannot be written.
        """
        kind, stamp = message.type, min(max(message.t_ns, 0), 2**63 - 1)  # stamps of MCAP are unsigned
        if kind not in self._schemas:
            self._schemas[kind] = self._writer.register_schema(kind, "ros2msg", definition_of(kind))
        if message.topic not in self._channels:
            self._channels[message.topic] = self._writer.register_channel(message.topic, "cdr", self._schemas[kind])
        data = message.parts[0] if len(message.parts) == 1 else b"".join(message.parts)
        self._writer.add_message(self._channels[message.topic], now_ns, bytes(data), stamp, self._number)
        self._number += 1

    def finish(self) -> None:
        """Write what is left, and the index; the file stays open."""
        self._writer.finish()
