"""Who flies the landings: this process, several of this machine, or a Dask cluster. The results are the same."""

from __future__ import annotations

import multiprocessing
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool

from alight import compiled
from alight.records.campaign import Conditions
from alight.runner.campaign.flying import Flown, failed
from alight.runner.dask_client import dask_client

Job = Callable[[Conditions], Flown]
TRIES = 2  # of a landing whose process died


class WorkerLostError(Exception):
    """The process of a landing died."""


def fly_all(conditions: Sequence[Conditions], job: Job, jobs: int, scheduler: str | None) -> Iterator[Flown]:
    """Yield each landing when it ends, in any order.

    Args:
        conditions: of the landings.
        job: flies one; it can be pickled.
        jobs: processes of this machine; 1: this one.
        scheduler: address of a Dask cluster instead, such as tcp://host:8786.

    Raises:
        MissingExtraError: Dask is not installed.
        InputError: no scheduler answers there.
    """
    if scheduler is not None:
        yield from _on_cluster(conditions, job, scheduler)
    elif jobs > 1:
        yield from _in_processes(conditions, job, jobs)
    else:
        yield from map(job, conditions)


def _one_thread() -> None:
    compiled.use_threads(1)


def _in_processes(conditions: Sequence[Conditions], job: Job, jobs: int) -> Iterator[Flown]:
    """A process that dies takes the pool with it: a new pool flies what is left, the suspects one at a time."""
    left, died = {c.landing: c for c in conditions}, Counter[int]()
    while left:
        suspects = [c for c in left.values() if died[c.landing]]
        together = suspects[:1] or list(left.values())
        for landing, flown in _pooled(together, job, 1 if suspects else jobs):
            if flown is not None:
                del left[landing]
                yield flown
                continue
            died[landing] += 1
            if died[landing] >= TRIES:
                yield failed(left.pop(landing), WorkerLostError("the process that flew it died"))


def _pooled(conditions: Sequence[Conditions], job: Job, jobs: int) -> Iterator[tuple[int, Flown | None]]:
    """Yield landings with what came of them; None for those that were in flight when a process died."""
    before = set(multiprocessing.active_children())
    spawn = multiprocessing.get_context("spawn")  # a forked process shares locks and threads of this one
    pool = ProcessPoolExecutor(min(jobs, len(conditions)), spawn, initializer=_one_thread)
    waiting, flying = list(reversed(conditions)), dict[Future[Flown], int]()
    try:
        while waiting or flying:
            while waiting and len(flying) < jobs:  # no more than are flown: only those are suspects
                c = waiting.pop()
                flying[pool.submit(job, c)] = c.landing
            done = next(as_completed(flying))
            yield flying[done], done.result()
            del flying[done]
    except BrokenProcessPool:
        for future, landing in flying.items():
            whole = future.done() and future.exception() is None
            yield landing, future.result() if whole else None
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
        for process in set(multiprocessing.active_children()) - before:
            process.terminate()  # or an interrupted campaign waits for what it does not want any more


def _on_cluster(conditions: Sequence[Conditions], job: Job, scheduler: str) -> Iterator[Flown]:
    """Dask flies a landing again, elsewhere, when its worker is lost."""
    with dask_client(scheduler) as client:
        import distributed

        flying = {client.submit(job, c, pure=False): c for c in conditions}
        for future in distributed.as_completed(list(flying), loop=client.loop):
            error = future.exception()
            yield future.result() if error is None else failed(flying[future], WorkerLostError(str(error)))
            future.release()
