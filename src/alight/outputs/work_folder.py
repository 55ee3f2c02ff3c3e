"""The place of unfinished work in an output folder."""

from __future__ import annotations

import shutil
from pathlib import Path

WORK = "unfinished-work"  # its name in the output


def is_work(path: Path) -> bool:
    """True if a path is a folder of unfinished work."""
    return path.name == WORK and path.is_dir() and not path.is_symlink()


def remove_work(out: Path) -> None:
    """Remove the saved work of an interrupted run from its output."""
    if is_work(out / WORK):
        shutil.rmtree(out / WORK, ignore_errors=True)
