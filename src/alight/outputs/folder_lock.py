"""A lock that allows one run per folder; the system releases it however the run ends.

If a run ends before its folder is complete, the lock's file stays. It shows that the other files belong to a run.
"""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import IO

from alight.file_lock import locked
from alight.outputs.atomic_write import ANOTHER
from alight.records import OutputError

LOCK = ".alight.lock"
_held: dict[Path, IO[str]] = {}  # locked by this process


def lock_folder(out: Path) -> None:
    """Lock the folder for this process, until `release_folder` or its end; a second call has no effect.

    Raises:
        OutputError: another process has locked the folder.
        OSError: the folder cannot be written.
    """
    folder = out.resolve()
    if folder in _held:
        return
    file = (folder / LOCK).open("a+", encoding="ascii")
    if not locked(file):
        with file:
            file.seek(0)
            process = file.read(20).strip()
        raise OutputError(
            f"{out}: another run writes there (process {process or 'unknown'}); wait for its end or {ANOTHER}"
        )
    with suppress(OSError):  # a full disk is reported by the next write
        file.truncate(0)
        file.write(str(os.getpid()))
        file.flush()
    _held[folder] = file


def holds_folder(out: Path) -> bool:
    """Whether this process holds the lock of the folder."""
    folder = out.resolve()
    return folder in _held and (folder / LOCK).exists()


def release_folder(out: Path) -> None:
    """Release the folder and remove the lock's file."""
    folder = out.resolve()
    file = _held.pop(folder, None)
    if file is not None:
        (folder / LOCK).unlink(missing_ok=True)
        with suppress(OSError):
            file.close()


def release_all() -> None:
    """Release all folders of this process; the lock's file stays in folders that hold other files."""
    for folder in list(_held):
        with suppress(OSError):
            if {p.name for p in folder.iterdir()} <= {LOCK}:
                release_folder(folder)
        if (file := _held.pop(folder, None)) is not None:
            with suppress(OSError):
                file.close()
