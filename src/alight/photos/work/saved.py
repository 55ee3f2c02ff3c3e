"""Work on a set of photos, saved piece by piece in the output folder, so that an interrupted run can continue."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, MutableMapping
from hashlib import blake2b
from pathlib import Path
from typing import Any

from alight import __version__
from alight.documents import LARGEST_JSON, DocumentError, parse_json, read_bytes, read_text
from alight.jobs import Jobs, Task
from alight.outputs.atomic_write import output_error, write_whole
from alight.outputs.folder import WORK, remove_work
from alight.photos.work.packing import is_whole, pack_result, unpack_result
from alight.records import InputError
from alight.settings import Settings
from alight.sources import Source

KEY = "run.json"  # identifies the run that the work belongs to
SUFFIX = ".part"


class WorkFolder(MutableMapping[str, bytes]):
    """Pieces of work by name, each a file that is written whole or not at all.

    Args:
        out: folder of the results.
        key: everything that the work depends on: input, settings, version.
        resume: whether to continue with saved work; otherwise saved work is removed.

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
            try:
                self._folder.mkdir(parents=True)
            except OSError as e:
                raise output_error(self._folder, e) from e
            write_whole(self._folder / KEY, json.dumps(key, indent=1).encode())

    def _path(self, name: str) -> Path:
        return self._folder / f"{name}{SUFFIX}"

    def __getitem__(self, name: str) -> bytes:
        try:
            return read_bytes(self._path(name), 4_000_000_000)
        except (OSError, DocumentError) as e:
            raise KeyError(name) from e

    def __setitem__(self, name: str, data: bytes) -> None:
        write_whole(self._path(name), data, durable=False)  # a damaged piece is detected by its digest and done again

    def __delitem__(self, name: str) -> None:
        self._path(name).unlink()

    def __iter__(self) -> Iterator[str]:
        return (p.name.removesuffix(SUFFIX) for p in self._folder.iterdir() if p.suffix == SUFFIX)

    def __len__(self) -> int:
        return sum(1 for _ in self)


def _key_of(folder: Path) -> dict[str, Any] | None:
    try:
        tree = parse_json(read_text(folder / KEY, LARGEST_JSON))
    except FileNotFoundError:
        return None
    except (OSError, DocumentError) as e:
        raise InputError(f"{folder / KEY}: is damaged; run without --resume to begin anew") from e
    return tree if isinstance(tree, dict) else {}


def _differing(there: Any, wanted: Any, name: str = "") -> str:
    """Return the first difference of the saved key `there` from the key `wanted`, in words; empty if they are equal."""
    if there == wanted:
        return ""
    if isinstance(there, dict) and isinstance(wanted, dict):
        for part in [*wanted, *there]:
            inner = f"{name}.{part}" if name else str(part)
            if other := _differing(there.get(part), wanted.get(part), inner):
                return other
    old, new = (str(v) if len(str(v)) < 40 else "" for v in (there, wanted))
    return f"another {name}" + (f" ({old}, now {new})" if old and new else "")


class SavedJobs:
    """Jobs that reuse saved results, run the remaining tasks, and save their results.

    Args:
        doing: runs the remaining tasks.
        saved: pieces of work by task name.
    """

    def __init__(self, doing: Jobs, saved: MutableMapping[str, bytes]) -> None:
        self._doing, self._saved = doing, saved
        self.done: list[str] = []  # names of the tasks that were not saved before

    def run(self, tasks: Iterable[Task], at_once: bool = False, any_order: bool = False) -> Iterator[Any]:
        """Run tasks as `Jobs.run` does, but yield results in the order of the tasks; `any_order` has no effect."""
        drawn = deque[tuple[Task, bool]]()  # each task, and whether its result is saved

        def open_tasks() -> Iterator[Task]:
            for task in tasks:
                saved = is_whole(self._saved.get(task.name, b""), task.about)
                drawn.append((task, saved))
                if not saved:
                    yield task

        for value in self._doing.run(open_tasks(), at_once):
            yield from self._saved_results(drawn)
            task, _ = drawn.popleft()
            self._saved[task.name] = pack_result(value, task.about)
            self.done.append(task.name)
            yield value
        yield from self._saved_results(drawn)

    def _saved_results(self, drawn: deque[tuple[Task, bool]]) -> Iterator[Any]:
        """Pop the tasks in `drawn` up to the first without a saved result, and yield the saved results."""
        while drawn and drawn[0][1]:
            name = drawn.popleft()[0].name
            try:
                value = unpack_result(self._saved[name])
            except ValueError as e:
                raise InputError(f"the saved work {name} is damaged; run without --resume to begin anew") from e
            yield value


def work_key(source: Source, digest: str, settings: Settings, *files: Path) -> dict[str, Any]:
    """Return the key of a run's work, made from all its inputs; saved work with another key is not used.

    Args:
        source: the photos.
        digest: digest of the photos.
        settings: all settings.
        files: further input files, such as given poses.
    """
    rest = blake2b(repr((source.rig, source.local)).encode())
    for file in files:
        rest.update(file.read_bytes())
    return {
        "alight": __version__,
        "photos": digest,
        "settings": settings.model_dump(mode="json"),
        "calibration, or poses": rest.hexdigest(),
    }
