"""Files written whole or not at all: beside, to the disk, then renamed."""

from __future__ import annotations

import errno
import os
from pathlib import Path

from alight.records import OutputError

ANOTHER = "choose another folder with --out"


def output_error(path: Path, error: OSError) -> OutputError:
    """Convert an error of the operating system into one line that a user can act on."""
    if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
        return OutputError(f"{path}: the disk is full; free some space or {ANOTHER}")
    if isinstance(error, PermissionError) or error.errno == errno.EROFS:
        return OutputError(f"{path}: no permission to write; {ANOTHER}")
    return OutputError(f"{path}: cannot be written ({error.strerror or error}); {ANOTHER}")


def partial_path(path: Path) -> Path:
    """The name under which a file is written before it is whole."""
    return path.with_name(f".{path.name}.tmp")


def write_whole(path: Path, data: bytes, durable: bool = True) -> None:
    """Write `data` to `path` as a whole: no reader sees half of it, and no crash or Ctrl-C leaves half of it.

    Not `durable`: a loss of power may damage or remove the file, and the call does not wait for the disk.

    Raises:
        OutputError: the disk is full or the place may not be written; the old file, if any, is untouched.
    """
    part = partial_path(path)
    try:
        with part.open("wb") as f:
            f.write(data)
            f.flush()
            if durable:
                os.fsync(f.fileno())
        os.replace(part, path)
        if durable:
            folder = os.open(path.parent, os.O_RDONLY)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)
    except OSError as e:
        raise output_error(path, e) from e
    finally:
        part.unlink(missing_ok=True)  # left by an error or Ctrl-C
