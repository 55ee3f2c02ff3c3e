"""Find the files of a bag by their names and first bytes."""

from __future__ import annotations

import re
from pathlib import Path

from alight.records import InputError
from alight.sources.bags.mcap_file import is_ros_mcap

MAGIC = {".bag": b"#ROSBAG V2.0", ".active": b"#ROSBAG V2.0", ".db3": b"SQLite format 3\0", ".mcap": b"\x89MCAP0\r\n"}


def is_bag(path: Path) -> bool:
    """Whether a file is a bag, by its suffix and first bytes; a recording of Alight, also an MCAP file, is none."""
    if (start := MAGIC.get(path.suffix.lower())) is None or not path.is_file():
        return False
    with path.open("rb") as file:
        if file.read(len(start)) != start:
            return False
        return path.suffix.lower() != ".mcap" or is_ros_mcap(file)


def bag_files(path: Path) -> list[Path]:
    """Return the files of a bag in order: of a folder, the numbered parts of one bag; empty if `path` is no bag.

    Raises:
        InputError: the folder has several bags.
    """
    if not path.is_dir():
        return [path] if is_bag(path) else []
    found = sorted((p for p in path.iterdir() if is_bag(p)), key=lambda p: (len(p.name), p.name))
    numbers = [re.search(r"_(\d+)\.[a-z0-9]+$", p.name) for p in found]
    if len(found) > 1 and [int(n[1]) if n else None for n in numbers] != list(range(len(found))):
        raise InputError(
            f"{path}: holds {len(found)} bags, not the parts _0, _1, ... of one; name one of them, such as {found[0]}"
        )
    return found
