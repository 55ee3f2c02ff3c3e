"""Atomic writing: a temporary file in the same folder is synced to the disk, then renamed."""

from __future__ import annotations

import errno
import os
from pathlib import Path

from alight.records import OutputError

ANOTHER = "choose another folder with --out"


def output_error(path: Path, error: OSError) -> OutputError:
    """Return an error with one line that the user can act on, from an error of the operating system."""
    if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
        return OutputError(f"{path}: the disk is full; free some space or {ANOTHER}")
    if not path.parent.is_dir():
        return OutputError(f"{path}: cannot be written, as there is no folder {path.parent}; make it first")
    if isinstance(error, PermissionError) or error.errno == errno.EROFS:
        return OutputError(f"{path}: no permission to write; {ANOTHER}")
    return OutputError(f"{path}: cannot be written ({error.strerror or error}); {ANOTHER}")


def partial_path(path: Path) -> Path:
    """Return the path of the temporary file that becomes `path` once it is complete."""
    return path.with_name(f".{path.name}.tmp")


def write_whole(path: Path, data: bytes | Path, durable: bool = True) -> None:
    """Write `data` to `path` atomically: no reader sees an incomplete file, and no crash or Ctrl-C leaves one.

    Args:
        path: file to write.
        data: its content, or a file of the same disk with the content, which is moved.
        durable: whether to wait until the disk has the file; if false, a loss of power may damage or remove it.

    Raises:
        OutputError: the disk is full or writing is not permitted; the old file, if any, is untouched.
    """
    part = partial_path(path)
    try:
        if isinstance(data, Path):
            os.replace(data, part)
        with part.open("ab" if isinstance(data, Path) else "wb") as f:
            f.write(b"" if isinstance(data, Path) else data)
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
