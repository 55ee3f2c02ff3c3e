"""Read an MCAP file from the front, without its index: messages of ROS, and metadata."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, NamedTuple, TypeVar

from mcap.records import Channel, Message, Metadata, Schema
from mcap.stream_reader import StreamReader

from alight.records import InputError
from alight.records.codec import HEAD

if TYPE_CHECKING:
    from alight.sources.bags.growth import GrowingFile

Found = TypeVar("Found")


class MessageType(NamedTuple):
    """Type of the messages of a topic, and how they are stored."""

    name: str  # such as sensor_msgs/msg/Image
    encoding: str  # ros1 or cdr
    language: str = ""  # of the definition: ros2msg, ros2idl, or empty without a definition
    definition: str = ""


class RawMessage(NamedTuple):
    """One message of a bag."""

    topic: str
    type: MessageType
    t_ns: int  # time of arrival
    data: bytes


def read_mcap(file: BinaryIO | GrowingFile) -> Iterator[RawMessage | Metadata]:
    """Yield messages of ROS 1 and ROS 2, and metadata, in the order of the file; others are passed over.

    Damaged bytes can make it raise any exception.
    """
    schemas: dict[int, Schema] = {}
    topics: dict[int, tuple[str, MessageType]] = {}
    for record in StreamReader(file).records:
        if isinstance(record, Metadata):
            yield record
        elif isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel) and record.message_encoding in ("cdr", "ros1"):
            schema = schemas[record.schema_id]
            name = schema.name if "/msg/" in schema.name else schema.name.replace("/", "/msg/", 1)
            text = schema.data.decode(errors="replace")
            language = "ros2msg" if schema.encoding == "ros1msg" else schema.encoding
            topics[record.id] = record.topic, MessageType(name, record.message_encoding, language, text)
        elif isinstance(record, Message) and record.channel_id in topics:
            topic, kind = topics[record.channel_id]
            yield RawMessage(topic, kind, record.log_time, record.data)


def up_to_damage(found: Iterable[Found], path: Path, damaged: str, on_early_end: Callable[[], None]) -> Iterator[Found]:
    """Yield what is read of a file; if it ends early, call `on_early_end` and stop.

    Raises:
        InputError: the system cannot read the file, or nothing was read; then `damaged`, with {} for the error.
    """
    some = False
    try:
        for one in found:
            some = True
            yield one
    except OSError as e:
        raise InputError(f"{path}: cannot be read ({e.strerror or e}); check the permissions") from e
    except Exception as e:  # damaged bytes can make the libraries raise any exception
        if not some:
            raise InputError(f"{path}: {damaged.format(' '.join(str(e).split()))}; copy it again") from e
        on_early_end()


def is_ros_mcap(file: BinaryIO) -> bool:
    """Whether an MCAP file has a message of ROS before any sign of being a recording of Alight."""
    file.seek(0)
    try:
        for found in read_mcap(file):
            if isinstance(found, RawMessage) or found.name == HEAD:
                return isinstance(found, RawMessage)
    except Exception:  # damaged bytes can make the library raise any exception
        return False
    return False
