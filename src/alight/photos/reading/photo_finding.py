"""Search for the photos of a folder, as of a card or a survey."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff")
DEEPEST = 3  # levels of sub-folders in which photos are looked for


class FoundPhotos(NamedTuple):
    """Pictures of a folder, sorted, and its sub-folders that may not be read."""

    files: list[Path]
    closed: list[Path]


def find_photos(folder: Path) -> FoundPhotos:
    """Pictures of a folder and of its sub-folders (as `DCIM/100MEDIA` of a card).

    Hidden files are left out, as are thumbnails and the output of programs, Alight's included. A file that links reach
    as well is taken once.

    Raises:
        OSError: the folder itself cannot be read.
    """
    closed, files = list[Path](), dict[str, Path]()
    for path in _pictures(folder, DEEPEST, closed):
        real = os.path.realpath(path)
        if real not in files or real == str(path):
            files[real] = path
    return FoundPhotos(sorted(files.values()), sorted(closed))


def _pictures(folder: Path, depth: int, closed: list[Path]) -> Iterator[Path]:
    """Yield the pictures of a folder and of so many levels below it; folders without permission go to `closed`."""
    for path in sorted(folder.iterdir()):
        if not path.is_dir():
            if path.suffix.lower() in SUFFIXES and not path.name.startswith("."):
                yield path
        elif depth > 0:
            try:
                inside = list(_pictures(path, depth - 1, closed)) if _may_hold_photos(path) else []
            except PermissionError:
                closed.append(path)
            else:
                yield from inside


def _may_hold_photos(folder: Path) -> bool:
    name = folder.name.lower()
    output = name == "mav0" or name.startswith((".", "odm_", "thumb")) or "thumbnails" in name
    return not output and not (folder / "run.json").exists()
