"""Independent tasks: done by this process or others, read from saved results, or done on other machines.

A stage defines the tasks (`Task`); the caller chooses the workers (`Jobs`). The results do not depend on the workers.
"""

from __future__ import annotations

import logging
import multiprocessing
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass
from queue import SimpleQueue
from typing import Any, Protocol

from threadpoolctl import threadpool_limits

from alight import compiled, memory
from alight.records import InputError

log = logging.getLogger(__name__)

FILES = 8  # open files in this process per process of `InProcesses`: queues and their wake-up pipes


@dataclass(frozen=True, eq=False)
class Sent:
    """A large argument that many tasks share. It is sent once to each machine, however many of the tasks run there."""

    name: str  # equal names mean equal values
    value: Any


@dataclass(frozen=True, eq=False)
class KeptHere:
    """An argument that each process makes for itself and keeps from task to task, such as a cache."""

    name: str  # equal names mean the same object
    make: Callable[[], Any]  # can be pickled; its result may be used by several threads


@dataclass(frozen=True, eq=False)
class Task:
    """One piece of work, whose result consists of records, arrays, numbers and text."""

    name: str  # unique in a run
    do: Callable[..., Any]  # a function of a module; any function if the task stays here
    arguments: tuple[Any, ...] = ()  # `Sent` and `KeptHere` are replaced by their values, also within a tuple
    about: str = ""  # further inputs of the result, as text; a result saved with another text is not used
    here: bool = False  # whether it runs in this process, as it is not worth sending or has tasks of its own
    tries: int = 4  # greatest number of attempts, if its worker or its arguments are lost
    if_lost: Callable[[], Any] | None = None  # gives the result after the last try; None: an InputError is raised


class Jobs(Protocol):
    """Interface of workers that do tasks."""

    def run(self, tasks: Iterable[Task], at_once: bool = False, any_order: bool = False) -> Iterator[Any]:
        """Yield the result of each task, in the order of the tasks.

        Args:
            tasks: the tasks; taken from the iterator while earlier tasks run.
            at_once: whether tasks of this process run in parallel, each on one thread; else in turn, on all threads.
            any_order: whether each result is yielded as soon as its task ends, in any order.

        Raises:
            InputError: the workers of a task were lost again and again.
        """


class LastKept:
    """Keeps the object of the last `KeptHere` for all threads; one object may take hundreds of megabytes."""

    def __init__(self) -> None:
        self._last: tuple[str, Any] = "", None
        self._making = threading.Lock()

    def get(self, kept: KeptHere) -> Any:
        """Return the object of `kept`; make it if the kept object has another name."""
        with self._making:
            if self._last[0] != kept.name:
                self._last = kept.name, kept.make()
            return self._last[1]


class InTurn:
    """Does tasks in this process, one after the other or in parallel on threads."""

    def __init__(self) -> None:
        self._kept = LastKept()

    def run(self, tasks: Iterable[Task], at_once: bool = False, any_order: bool = False) -> Iterator[Any]:
        """Yield the results; see `Jobs.run`. The kept object of a `KeptHere` is freed at the end."""
        threads = compiled.most_threads() if at_once else 1
        pool = ThreadPoolExecutor(threads, initializer=compiled.use_threads, initargs=(1,))  # starts none before a task
        try:  # few at a time: their arguments are large
            on_threads = results(tasks, lambda task: pool.submit(self.do, task), lambda: threads + 1)
            yield from on_threads if threads > 1 else map(self.do, tasks)
        finally:
            pool.shutdown(cancel_futures=True)
            self._kept = LastKept()
            memory.give_back()

    def do(self, task: Task) -> Any:
        """Do one task and return its result."""
        return task.do(*resolved(task.arguments, lambda sent: sent.value, self._kept.get))


class InProcesses:
    """Does tasks in `count` processes, one task at a time in each; a process that dies loses only its task."""

    def __init__(self, count: int) -> None:
        self._count = count

    def run(self, tasks: Iterable[Task], at_once: bool = False, any_order: bool = False) -> Iterator[Any]:
        """Yield the results; see `Jobs.run`. The processes end with the last task, or at an interruption."""
        _allow_files(FILES * self._count)
        before = set(multiprocessing.active_children())
        pools, free = list[ProcessPoolExecutor](), SimpleQueue[ProcessPoolExecutor | None]()
        for _ in range(self._count):
            free.put(None)  # started when it is needed

        def new() -> ProcessPoolExecutor:  # not forked: a forked process shares locks and threads of this one
            pools.append(ProcessPoolExecutor(1, multiprocessing.get_context("spawn")))
            return pools[-1]

        def submit(task: Task) -> Future[Any]:
            pool = free.get() or new()
            try:
                future = pool.submit(do_alone, task.do, *task.arguments)
            except BrokenProcessPool:  # its process has died
                pool = new()
                future = pool.submit(do_alone, task.do, *task.arguments)
            future.add_done_callback(lambda _: free.put(pool))
            return future

        try:
            yield from results(tasks, submit, lambda: self._count, any_order, (BrokenProcessPool,))
        finally:
            for pool in pools:
                pool.shutdown(wait=False, cancel_futures=True)
            for process in set(multiprocessing.active_children()) - before:
                process.terminate()  # or an interrupted run waits for tasks that it does not need any more


def _allow_files(more: int) -> None:
    """Let this process open `more` more files than now, if the system permits it."""
    with suppress(ImportError, ValueError, OSError):
        import resource  # not on Windows, which needs none of this

        soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, min(soft + more, hard)), hard))


@dataclass(eq=False)
class _Begun:
    task: Task
    future: Any = None
    tries: int = 0


def results(
    tasks: Iterable[Task],
    submit: Callable[[Task], Any],
    most: Callable[[], int],
    any_order: bool = False,
    lost: tuple[type[BaseException], ...] = (),
) -> Iterator[Any]:
    """Yield the results of tasks that threads, processes or machines do; see `Jobs.run`.

    Args:
        tasks: taken from the iterator while earlier tasks run; a task with `here` runs after all tasks before it.
        submit: begins a task and returns its future, which has `result` and `add_done_callback`.
        most: returns the number of tasks that may be under way, which limits the memory.
        any_order: whether each result is yielded as soon as its task ends.
        lost: exceptions of a future whose worker or arguments were lost; the task is then begun again.

    Raises:
        InputError: a task was lost at its last try.
    """
    under_way, ended = list[_Begun](), SimpleQueue[_Begun]()

    def begin(work: _Begun) -> None:
        work.future, work.tries = submit(work.task), work.tries + 1
        if any_order:
            work.future.add_done_callback(lambda _: ended.put(work))

    def next_result() -> Any:
        while True:
            work = ended.get() if any_order else under_way[0]
            try:
                value = work.future.result()
            except lost as e:
                name, tries, if_lost = work.task.name, work.task.tries, work.task.if_lost
                if work.tries < tries:
                    log.info("%s: begun again (%s)", name, type(e).__name__)
                    begin(work)
                    continue
                if if_lost is None:
                    why = f"the workers that had it were lost {tries} times; see their logs, and add memory"
                    raise InputError(f"{name}: {why}") from e
                value = if_lost()
            under_way.remove(work)
            return value

    for task in tasks:
        while task.here and under_way:
            yield next_result()
        if task.here:
            yield InTurn().do(task)
            continue
        under_way.append(_Begun(task))
        begin(under_way[-1])
        while len(under_way) >= most():
            yield next_result()
    while under_way:
        yield next_result()


def do_alone(do: Callable[..., Any], *arguments: Any) -> Any:
    """Do a task on one thread, so that every machine gives the same result, and return the result."""
    compiled.use_threads(1)
    with threadpool_limits(limits=1, user_api="blas"):
        return do(*resolved(arguments, lambda sent: sent.value, _here.get))


_here = LastKept()  # object kept for the tasks of `do_alone`


def resolved(
    arguments: tuple[Any, ...], sent: Callable[[Sent], Any], kept: Callable[[KeptHere], Any]
) -> tuple[Any, ...]:
    """Return the arguments; `sent` and `kept` replace each `Sent` and `KeptHere`, also within tuples, by its value."""

    def one(argument: Any) -> Any:
        if isinstance(argument, Sent):
            return sent(argument)
        if isinstance(argument, KeptHere):
            return kept(argument)
        if isinstance(argument, tuple) and any(isinstance(a, Sent | KeptHere) for a in argument):
            return tuple(map(one, argument))
        return argument

    return tuple(map(one, arguments))
