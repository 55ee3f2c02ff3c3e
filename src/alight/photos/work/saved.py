"""Work that is saved piece by piece, so that an interrupted run continues from there."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, MutableMapping
from hashlib import blake2b
from pathlib import Path
from typing import Any

from alight import __version__
from alight.jobs import Jobs, Task
from alight.photos.work.packing import is_whole, pack_result, unpack_result
from alight.records import InputError
from alight.settings import Settings
from alight.sources import Source


class SavedJobs:
    """Takes saved results, has the other tasks done, and saves their results.

    Args:
        doing: workers for the other tasks.
        saved: pieces of work by the names of their tasks.
    """

    def __init__(self, doing: Jobs, saved: MutableMapping[str, bytes]) -> None:
        self._doing, self._saved = doing, saved
        self.done: list[str] = []  # names of the tasks that were not saved before

    def run(self, tasks: Iterable[Task], at_once: bool = False, any_order: bool = False) -> Iterator[Any]:
        """As `Jobs`, always in the order of the tasks."""
        drawn = deque[tuple[Task, bool]]()  # and whether it is saved

        def open_tasks() -> Iterator[Task]:
            for task in tasks:
                known = is_whole(self._saved.get(task.name, b""), task.about)
                drawn.append((task, known))
                if not known:
                    yield task

        for value in self._doing.run(open_tasks(), at_once):
            yield from self._known(drawn)
            task, _ = drawn.popleft()
            self._saved[task.name] = pack_result(value, task.about)
            self.done.append(task.name)
            yield value
        yield from self._known(drawn)

    def _known(self, drawn: deque[tuple[Task, bool]]) -> Iterator[Any]:
        """Yield saved results, up to the next task without one.

        Raises:
            InputError: a piece is whole, but no packed result.
        """
        while drawn and drawn[0][1]:
            name = drawn.popleft()[0].name
            try:
                value = unpack_result(self._saved[name])
            except ValueError as e:
                raise InputError(f"the saved work {name} is damaged; run without --resume to begin anew") from e
            yield value


def work_key(source: Source, digest: str, settings: Settings, *files: Path) -> dict[str, Any]:
    """Return the key of a run's work, with all its inputs: saved work of another key is not used.

    Args:
        source: the photos.
        digest: of the photos.
        settings: all settings.
        files: further inputs, such as given poses.
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
