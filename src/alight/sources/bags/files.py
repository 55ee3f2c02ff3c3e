"""Read the messages of ROS bags in the order of the file: `.bag`, `.db3` and `.mcap`.

Bags are read from the front, without their index. So memory does not grow with a bag, and a bag that was never closed
is read as far as it goes.
"""

from __future__ import annotations

import sqlite3
import struct
import sys
from bz2 import decompress as from_bz2
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from functools import lru_cache, partial
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO
from urllib.parse import quote

from lz4.frame import decompress as from_lz4

from alight.sources.bags.growth import GrowingFile, Growth
from alight.sources.bags.mcap_file import MessageType, RawMessage, read_mcap, up_to_damage
from alight.sources.source import Findings

BAG_HEADER, CHUNK, CONNECTION, MESSAGE = b"\x03", b"\x05", b"\x07", b"\x02"  # kinds of records of a ROS 1 bag
Wanted = Callable[[str, str], bool]  # of a topic and its type
DECOMPRESS: dict[bytes, Callable[[bytes], bytes]] = {b"none": bytes, b"bz2": from_bz2, b"lz4": from_lz4}


def messages_of(
    files: Iterable[Path], wanted: Wanted, findings: Findings, growth: Growth | None = None
) -> Iterator[RawMessage]:
    """Yield the messages whose topic and type are `wanted`; if a file ends early, warn and stop reading it.

    Args:
        growth: how to wait for files that are being written, whose early end is no fault; None: they are complete.

    Raises:
        InputError: nothing of a file can be read.
    """
    for path in files:
        read = {".db3": _of_sqlite, ".mcap": _of_mcap}.get(path.suffix.lower(), _of_ros1)
        early = f"{path.name} ends early, as after a loss of power: what came before it is used"
        at_end = partial(findings.warn, early) if growth is None else lambda: None
        yield from up_to_damage(read(path, wanted, growth), path, "no message can be read ({})", at_end)


def _of_ros1(path: Path, wanted: Wanted, growth: Growth | None) -> Iterator[RawMessage]:
    from rosbags.typesys.msg import normalize_msgtype

    topics = dict[bytes, tuple[str, MessageType]]()
    with path.open("rb") if growth is None else GrowingFile(path, growth) as file:
        file.readline()
        for fields, data in _ros1_records(file, path.stat().st_size if growth is None else sys.maxsize):
            if fields[b"op"] == CONNECTION and fields[b"conn"] not in topics:
                head = _fields(data)
                name = normalize_msgtype(head[b"type"].decode())
                kind = MessageType(name, "ros1", "ros2msg", head[b"message_definition"].decode(errors="replace"))
                topics[fields[b"conn"]] = fields[b"topic"].decode(), kind
            elif fields[b"op"] == MESSAGE:
                topic, kind = topics[fields[b"conn"]]
                if wanted(topic, kind.name):
                    seconds, nanoseconds = struct.unpack("<LL", fields[b"time"])
                    yield RawMessage(topic, kind, seconds * 10**9 + nanoseconds, data)


def _ros1_records(file: BinaryIO | GrowingFile, size: int) -> Iterator[tuple[dict[bytes, bytes], bytes]]:
    """Yield (header fields, data) of the records of a ROS 1 bag, and of the records in its chunks; `size`: in bytes.

    Raises:
        EOFError: the file ends within a record.
    """

    def block() -> bytes:
        count = struct.unpack("<L", file.read(4).ljust(4, b"\xff"))[0]
        data = file.read(min(count, size - file.tell()))
        if len(data) < count:
            raise EOFError("it ends within a record")
        return data

    never_closed = False
    while file.tell() < size:
        fields, data = _fields(block()), block()
        if fields[b"op"] == CHUNK:
            chunk = DECOMPRESS[fields[b"compression"]](data)
            yield from _ros1_records(BytesIO(chunk), len(chunk))
        else:
            never_closed = never_closed or (fields[b"op"] == BAG_HEADER and not any(fields[b"index_pos"]))
            yield fields, data
    if never_closed:
        raise EOFError("it was never closed")


def _fields(header: bytes) -> dict[bytes, bytes]:
    out, at = dict[bytes, bytes](), 0
    while at < len(header):
        (count,) = struct.unpack_from("<L", header, at)
        name, _, value = header[at + 4 : at + 4 + count].partition(b"=")
        out[name] = value
        at += 4 + count
    return out


def _of_mcap(path: Path, wanted: Wanted, growth: Growth | None) -> Iterator[RawMessage]:
    with path.open("rb") if growth is None else GrowingFile(path, growth) as file:
        for m in read_mcap(file):
            if isinstance(m, RawMessage) and wanted(m.topic, m.type.name):
                yield m


def _of_sqlite(path: Path, wanted: Wanted, growth: Growth | None) -> Iterator[RawMessage]:
    base, newest = _connected(path), -1
    try:
        while True:
            known = base.execute("SELECT name FROM sqlite_master WHERE name = 'message_definitions'").fetchone()
            texts = "topic_type, encoding, encoded_message_definition FROM message_definitions"
            of_type = {row[0]: row[1:] for row in base.execute(f"SELECT {texts}")} if known else {}
            topics = {
                number: (topic, MessageType(name, "cdr", *of_type.get(name, ())))
                for number, topic, name in base.execute("SELECT id, name, type FROM topics")
                if wanted(topic, name)
            }
            chosen = f"id > {newest} AND topic_id IN ({','.join(map(str, topics))})"
            query = f"SELECT id, topic_id, timestamp, data FROM messages WHERE {chosen} ORDER BY id"
            for one, number, t_ns, data in base.execute(query):
                newest = one
                yield RawMessage(*topics[number], t_ns, data)
                if growth is not None:
                    growth.came()
            if growth is None or not growth.goes_on():
                return
    finally:
        base.close()


def _connected(path: Path) -> sqlite3.Connection:
    """Open a database with its write-ahead log, or without if the log cannot be opened, as in a read-only folder."""
    for mode in ("mode=ro", "immutable=1"):
        base = sqlite3.connect(f"file:{quote(str(path))}?{mode}", uri=True)
        base.execute("PRAGMA writable_schema = ON")  # a file that was cut is opened too
        with suppress(sqlite3.OperationalError):
            base.execute("SELECT name FROM sqlite_master")
            break
        base.close()
    return base


def decode(message: RawMessage) -> Any:
    """Return a message as an object with the fields of its type, as the bag defines it, else ROS 2 Humble.

    Raises:
        ValueError: it is damaged, or its type is defined nowhere.
    """
    kind = message.type
    try:
        store = _store_of(kind)
        as_object = store.deserialize_ros1 if kind.encoding == "ros1" else store.deserialize_cdr
        return as_object(message.data, kind.name)
    except Exception as e:  # damaged bytes can make the library raise any exception
        raise ValueError(f"it is no {kind.name} ({' '.join(str(e).split())[:80]})") from e


@lru_cache(maxsize=64)
def _store_of(kind: MessageType) -> Any:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    if kind.language != "ros2msg":
        return get_typestore(Stores.ROS2_HUMBLE)
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(kind.definition, kind.name))
    return store
