"""An MCAP file with messages of ROS 2 that other tools open: definitions of the types, small chunks, an index."""

from __future__ import annotations

import struct
from collections import defaultdict
from collections.abc import Iterable
from itertools import chain
from typing import BinaryIO

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC

from alight import __version__
from alight.outputs.ros_messages import RosMessage, definition_of


def _bytes_of(records: Iterable[McapRecord]) -> bytes:
    out = RecordBuilder()
    for record in records:
        record.write(out)
    return bytes(out.end())


def _head(kind: Opcode, form: str, *fields: int, rest: int) -> bytes:
    """Return the beginning of a record, which `rest` more bytes follow, from its first fields (struct)."""
    head = struct.pack(f"<{form}", *fields)
    return struct.pack("<BQ", kind, len(head) + rest) + head


class RosFile:
    """Writer of messages into a file that is open for writing; channels are made when their first message comes.

    The pixels of a picture go from the camera's memory to the file without a copy: `mcap.writer.Writer` makes three.

    Args:
        file: where to write.
        chunk: bytes of a chunk; a picture exceeds them, so that it is in the file at once.
    """

    def __init__(self, file: BinaryIO, chunk: int = 1 << 14) -> None:
        self._file, self._size, self._at = file, chunk, 0
        self._schemas, self._channels = dict[str, Schema](), dict[str, Channel]()
        self._chunks, self._metadata = list[ChunkIndex](), list[MetadataIndex]()
        self._counts: defaultdict[int, int] = defaultdict(int)  # of messages by channel
        self._put(MCAP0_MAGIC, _bytes_of([Header("ros2", f"alight {__version__}")]))
        self._begin()

    def _begin(self) -> None:
        """Begin a new chunk."""
        self._parts, self._filled = list[bytes | memoryview](), 0
        self._index: defaultdict[int, list[tuple[int, int]]] = defaultdict(list)  # by channel: log time, place

    def _put(self, *parts: bytes | memoryview) -> None:
        self._file.writelines(parts)
        self._at += sum(map(len, parts))

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Write a record of metadata."""
        self._end_chunk()
        record = _bytes_of([Metadata(name=name, metadata=values)])
        self._metadata.append(MetadataIndex(offset=self._at, length=len(record), name=name))
        self._put(record)

    def write(self, message: RosMessage, now_ns: int) -> None:
        """Write a message; `now_ns` is its log time, its stamp the publish time.

        Raises:
            OSError: the file cannot be written.
        """
        channel = (self._channels.get(message.topic) or self._channel(message)).id
        stamp = min(max(message.t_ns, 0), 2**63 - 1)  # stamps of MCAP are unsigned
        number = self._counts[channel]
        self._counts[channel] = number + 1
        self._index[channel].append((now_ns, self._filled))
        self._add(_head(Opcode.MESSAGE, "HIQQ", channel, number, now_ns, stamp, rest=message.size), *message.parts)
        if self._filled > self._size:
            self._end_chunk()

    def _channel(self, message: RosMessage) -> Channel:
        """Add the channel of a message, and the definition of its type, to the chunk."""
        kind, topic = message.type, message.topic
        if kind not in self._schemas:
            self._schemas[kind] = Schema(len(self._schemas) + 1, definition_of(kind), "ros2msg", kind)
            self._add(_bytes_of([self._schemas[kind]]))
        self._channels[topic] = Channel(len(self._channels) + 1, topic, "cdr", {}, self._schemas[kind].id)
        self._add(_bytes_of([self._channels[topic]]))
        return self._channels[topic]

    def _add(self, *parts: bytes | memoryview) -> None:
        self._parts += parts
        self._filled += sum(map(len, parts))

    def _end_chunk(self) -> None:
        """Write the chunk and its index; without messages, do nothing."""
        if not self._index:
            return
        start, size, times = self._at, self._filled, [t for rows in self._index.values() for t, _ in rows]
        first, last = min(times), max(times)
        self._put(_head(Opcode.CHUNK, "QQQIIQ", first, last, size, 0, 0, size, rest=size), *self._parts)
        end, places = self._at, dict[int, int]()
        for channel, rows in self._index.items():
            places[channel] = self._at
            index = struct.pack(f"<{2 * len(rows)}Q", *chain.from_iterable(rows))
            self._put(_head(Opcode.MESSAGE_INDEX, "HI", channel, len(index), rest=len(index)), index)
        self._chunks.append(
            ChunkIndex(
                chunk_length=end - start, chunk_start_offset=start, compression="", compressed_size=size,
                uncompressed_size=size, message_index_length=self._at - end, message_index_offsets=places,
                message_start_time=first, message_end_time=last,
            )
        )  # fmt: skip
        self._begin()

    def finish(self) -> None:
        """Write what is left, and the index; the file stays open."""
        self._end_chunk()
        self._put(_bytes_of([DataEnd(0)]))
        start, offsets, chunks = self._at, list[SummaryOffset](), self._chunks
        counts = Statistics(
            attachment_count=0, channel_count=len(self._channels), channel_message_counts=self._counts,
            chunk_count=len(chunks), message_count=sum(self._counts.values()), metadata_count=len(self._metadata),
            message_start_time=min((c.message_start_time for c in chunks), default=0),
            message_end_time=max((c.message_end_time for c in chunks), default=0), schema_count=len(self._schemas),
        )  # fmt: skip
        groups: dict[Opcode, Iterable[McapRecord]] = {
            Opcode.SCHEMA: self._schemas.values(), Opcode.CHANNEL: self._channels.values(),
            Opcode.STATISTICS: [counts], Opcode.CHUNK_INDEX: chunks, Opcode.METADATA_INDEX: self._metadata,
        }  # fmt: skip
        for kind, records in groups.items():
            group = _bytes_of(records)
            offsets.append(SummaryOffset(kind, self._at, len(group)))
            self._put(group)
        self._put(_bytes_of([*offsets, Footer(start, self._at, 0)]), MCAP0_MAGIC)
