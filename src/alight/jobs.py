"""Independent tasks: done in turn, read from saved results, or done on other machines.

A stage defines the tasks (`Task`); the caller chooses the workers (`Jobs`). The results are the same.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from threading import Lock
from typing import Any, Protocol

from alight import compiled, memory


@dataclass(frozen=True, eq=False)
class Sent:
    """A large argument that many tasks share: it is sent to a process once, however many of them run there."""

    name: str  # the same name is the same value
    value: Any


@dataclass(frozen=True, eq=False)
class KeptHere:
    """An argument that a process, or a thread of it, makes for itself and keeps from task to task, such as a cache."""

    name: str  # the same name is the same object
    make: Callable[[], Any]  # can be pickled; its result may be used by several threads


@dataclass(frozen=True, eq=False)
class Task:
    """One piece of work. Its result consists of records, arrays, numbers and text."""

    name: str  # unique in a run
    do: Callable[..., Any]  # a function of a module; any function if the task stays here
    arguments: tuple[Any, ...] = ()  # `Sent` and `KeptHere` are replaced by their values, also within a tuple
    about: str = ""  # further inputs of the result, as text; a result saved with another text is not used
    here: bool = False  # stays in this process: not worth sending, or has tasks of its own


class Jobs(Protocol):
    """Workers that do tasks."""

    def run(self, tasks: Iterable[Task], at_once: bool = False) -> Iterator[Any]:
        """Yield the result of each task, in the order of the tasks.

        Args:
            tasks: drawn from the iterable as they are done.
            at_once: this machine does as many tasks at a time as it has threads, each with compiled loops on one.
        """


class InTurn:
    """Tasks done by this process, in turn or on its threads."""

    def __init__(self) -> None:
        self._kept: tuple[str, Any] = "", None  # the last one: a step has one, hundreds of megabytes
        self._making = Lock()

    def run(self, tasks: Iterable[Task], at_once: bool = False) -> Iterator[Any]:
        """As `Jobs`. The object that is kept from task to task (`KeptHere`) is freed after the last task."""
        try:
            yield from self._run(tasks, compiled.most_threads() if at_once else 1)
        finally:
            self._kept = "", None
            memory.give_back()

    def _run(self, tasks: Iterable[Task], threads: int) -> Iterator[Any]:
        if threads <= 1:
            yield from map(self.do, tasks)
            return
        pool = ThreadPoolExecutor(threads, initializer=compiled.use_threads, initargs=(1,))
        under_way = deque[Future[Any]]()
        try:
            for task in tasks:  # few at a time: their arguments are large
                if len(under_way) > threads:
                    yield under_way.popleft().result()
                under_way.append(pool.submit(self.do, task))
            while under_way:
                yield under_way.popleft().result()
        finally:
            pool.shutdown(cancel_futures=True)

    def do(self, task: Task) -> Any:
        """Do one task."""
        return task.do(*resolved(task.arguments, lambda sent: sent.value, self._keep))

    def _keep(self, kept: KeptHere) -> Any:
        with self._making:
            if self._kept[0] != kept.name:
                self._kept = kept.name, kept.make()
            return self._kept[1]


def resolved(
    arguments: tuple[Any, ...], sent: Callable[[Sent], Any], kept: Callable[[KeptHere], Any]
) -> tuple[Any, ...]:
    """The arguments, and those within a tuple, with the values of `Sent` and `KeptHere` in their places."""

    def one(argument: Any) -> Any:
        if isinstance(argument, Sent):
            return sent(argument)
        if isinstance(argument, KeptHere):
            return kept(argument)
        if isinstance(argument, tuple) and any(isinstance(a, Sent | KeptHere) for a in argument):
            return tuple(map(one, argument))
        return argument

    return tuple(map(one, arguments))
