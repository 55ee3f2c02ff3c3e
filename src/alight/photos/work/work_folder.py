"""Saved work of a long run, in one folder inside its output: an interrupted run continues from it."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, MutableMapping
from pathlib import Path
from typing import Any

from alight.documents import LARGEST_JSON, DocumentError, parse_json, read_bytes, read_text
from alight.outputs.atomic_write import output_error, write_whole
from alight.outputs.folder import WORK, remove_work
from alight.records import InputError

KEY = "run.json"  # identifies the run that the work belongs to
SUFFIX = ".part"
LARGEST_PIECE = 4_000_000_000  # bytes


class WorkFolder(MutableMapping[str, bytes]):
    """Pieces of work by name, each a file that is written whole or not at all.

    Args:
        out: folder of the results.
        key: everything that the work depends on: input, settings, version.
        resume: continue with the saved work; without it, saved work is removed.

    Raises:
        InputError: the saved work has another key, or its key is damaged.
        OutputError: the folder cannot be written.
    """

    def __init__(self, out: Path, key: Mapping[str, Any], resume: bool) -> None:
        self._folder = out / WORK
        there = _key_of(self._folder) if resume else None
        if there is not None and (other := _differing(there, json.loads(json.dumps(key)))):
            raise InputError(
                f"{out}: cannot be resumed, the interrupted run had {other}; give it the same again, or run without "
                "--resume to begin anew"
            )
        if there is None:
            remove_work(out)
            self._make()
            write_whole(self._folder / KEY, json.dumps(key, indent=1).encode())
        self.found = len(self)  # number of pieces that were saved before

    def _make(self) -> None:
        try:
            self._folder.mkdir(parents=True)
        except OSError as e:
            raise output_error(self._folder, e) from e

    def _path(self, name: str) -> Path:
        return self._folder / f"{name}{SUFFIX}"

    def __getitem__(self, name: str) -> bytes:
        try:
            return read_bytes(self._path(name), LARGEST_PIECE)
        except (OSError, DocumentError) as e:
            raise KeyError(name) from e

    def __setitem__(self, name: str, data: bytes) -> None:
        """Write a piece.

        Raises:
            OutputError: the disk is full.
        """
        write_whole(self._path(name), data, durable=False)  # a damaged piece is detected by its digest and done again

    def __delitem__(self, name: str) -> None:
        self._path(name).unlink()

    def __iter__(self) -> Iterator[str]:
        return (p.name.removesuffix(SUFFIX) for p in self._folder.iterdir() if p.suffix == SUFFIX)

    def __len__(self) -> int:
        return sum(1 for _ in self)


def _key_of(folder: Path) -> dict[str, Any] | None:
    """Key of the saved work; None: there is none."""
    try:
        tree = parse_json(read_text(folder / KEY, LARGEST_JSON))
    except FileNotFoundError:
        return None
    except (OSError, DocumentError) as e:
        raise InputError(f"{folder / KEY}: is damaged; run without --resume to begin anew") from e
    return tree if isinstance(tree, dict) else {}


def _differing(there: Any, wanted: Any, name: str = "") -> str:
    """The first difference of two keys, in words; empty where they are the same."""
    if there == wanted:
        return ""
    if isinstance(there, dict) and isinstance(wanted, dict):
        for part in [*wanted, *there]:
            inner = f"{name}.{part}" if name else str(part)
            if other := _differing(there.get(part), wanted.get(part), inner):
                return other
    old, new = (str(v) if len(str(v)) < 40 else "" for v in (there, wanted))
    return f"another {name}" + (f" ({old}, now {new})" if old and new else "")
