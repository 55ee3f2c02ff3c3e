"""Workers that fly the landings: this process, several of this machine, or a Dask cluster, with the same results."""

from __future__ import annotations

import multiprocessing
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool

from alight import compiled
from alight.records import InputError
from alight.records.campaign import Conditions
from alight.runner.dask_client import dask_workers, submit
from alight.trials.campaign.flying import Flown, failed

Job = Callable[[Conditions], Flown]
TRIES = 2  # of a landing whose process died


class WorkerLostError(Exception):
    """The process of a landing died; `records.campaign.LOST` is its name."""


def fly_all(conditions: Sequence[Conditions], job: Job, jobs: int, scheduler: str | None) -> Iterator[Flown]:
    """Yield each landing when it ends, in any order.

    Args:
        conditions: of the landings.
        job: function that flies one landing; it can be pickled.
        jobs: processes of this machine; 1: this one.
        scheduler: address of a Dask cluster instead, such as tcp://host:8786.

    Raises:
        MissingExtraError: Dask is not installed.
        InputError: no scheduler answers there, its workers have another Alight or are lost time and again; or no
            process starts on this machine, or a landing cannot begin.
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
    """Fly in processes. One that dies ends its pool: a new pool flies the other landings, suspects one at a time."""
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
                _see_that_processes_start()
                yield failed(left.pop(landing), WorkerLostError("the process that flew it died"))


def _pooled(conditions: Sequence[Conditions], job: Job, jobs: int) -> Iterator[tuple[int, Flown | None]]:
    """Yield landings by number with their results; None for those that were in flight when a process died."""
    before = set(multiprocessing.active_children())
    spawn = multiprocessing.get_context("spawn")  # a forked process shares locks and threads of this one
    pool = ProcessPoolExecutor(min(jobs, len(conditions)), spawn, initializer=_one_thread)
    waiting, flying = list(reversed(conditions)), dict[Future[Flown], int]()
    try:
        while waiting or flying:
            while waiting and len(flying) < jobs:  # no more than are in flight: only those are suspects
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
            process.terminate()  # or an interrupted campaign waits for landings that it does not need any more


def _see_that_processes_start() -> None:
    """Test whether processes start at all: a landing whose process died may not be the cause.

    Raises:
        InputError: a process without work dies as well.
    """
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        try:
            pool.submit(int).result()
        except BrokenProcessPool as e:
            raise InputError(
                "the processes that fly landings die at their start; a Python script that asks for several jobs needs "
                'its call below `if __name__ == "__main__":`'
            ) from e


def _alone(job: Job, conditions: Conditions) -> Flown:
    """Fly a landing on a worker: on one thread, as a process of this machine does."""
    _one_thread()
    return job(conditions)


def _on_cluster(conditions: Sequence[Conditions], job: Job, scheduler: str) -> Iterator[Flown]:
    """Fly on a Dask cluster, which flies a landing again on another worker when its own is lost."""
    with dask_workers(scheduler) as client:
        import distributed
        from distributed.client import FutureCancelledError

        flying, tries = {submit(client, _alone, job, c): c for c in conditions}, Counter[int]()
        ended = distributed.as_completed(list(flying), loop=client.loop)
        for future in ended:
            c = flying.pop(future)
            try:
                yield future.result()
            except (distributed.KilledWorker, FutureCancelledError) as e:
                tries[c.landing] += 1
                if tries[c.landing] >= TRIES:
                    raise InputError(
                        f"landing {c.landing}: the workers that had it were lost {TRIES} times; see their logs"
                    ) from e
                again = submit(client, _alone, job, c)
                flying[again] = c
                ended.add(again)
            future.release()
