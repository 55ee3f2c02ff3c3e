"""Work on a Dask cluster: features, pairs and tiles go to its workers, and the results are the same."""

from __future__ import annotations

import logging
import threading
from collections import OrderedDict, deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from alight import compiled
from alight.jobs import InTurn, Jobs, KeptHere, Sent, Task, resolved
from alight.records import InputError
from alight.runner.dask_client import dask_workers, submit

log = logging.getLogger(__name__)

AHEAD = 2  # tasks a thread of the cluster that are sent before their turn
TRIES = 4  # of a task whose worker or whose arguments were lost
MOST_SENT = 2_000_000_000  # bytes of arguments that the cluster must hold
_here = threading.local()  # of a worker's thread: the object that it keeps from task to task


@contextmanager
def cluster_jobs(scheduler: str | None) -> Iterator[Jobs]:
    """Connect to a cluster that does the work; without a scheduler it is done in this process.

    Args:
        scheduler: address such as tcp://host:8786; None: there is none.

    Raises:
        MissingExtraError: Dask is not installed.
        InputError: no scheduler answers there, it has no worker, or a worker has another state of Alight.
    """
    if scheduler is None:
        yield InTurn()
        return
    with dask_workers(scheduler) as client:
        yield ClusterJobs(client)


class ClusterJobs:
    """Tasks done by the workers of a Dask cluster, few at a time, so that memory does not grow with their number.

    Args:
        client: of `distributed`.
    """

    def __init__(self, client: Any) -> None:
        self._client = client
        self._sent: OrderedDict[str, tuple[Any, int]] = OrderedDict()  # future and bytes of an argument

    def run(self, tasks: Iterable[Task], at_once: bool = False) -> Iterator[Any]:
        """As `Jobs`.

        Raises:
            InputError: the workers that had a task were lost time and again.
        """
        under_way = deque[tuple[Task, Any]]()
        try:
            for task in tasks:
                while under_way and (task.here or len(under_way) >= self._ahead()):
                    yield self._finished(*under_way.popleft())
                if task.here:
                    yield InTurn().do(task)
                else:
                    under_way.append((task, self._submitted(task)))
            while under_way:
                yield self._finished(*under_way.popleft())
        finally:
            self._client.cancel([future for _, future in under_way])

    def _ahead(self) -> int:
        return AHEAD * max(sum(int(n) for n in self._client.nthreads().values()), 1)

    def _submitted(self, task: Task) -> Any:
        arguments = resolved(task.arguments, self._send, lambda kept: kept)
        return submit(self._client, do_here, self._client.id, task.do, *arguments, retries=TRIES)

    def _finished(self, task: Task, future: Any) -> Any:
        """Wait for the result of a task; one whose arguments were lost with a worker is sent again."""
        from distributed import KilledWorker
        from distributed.client import FutureCancelledError

        for _ in range(TRIES):
            try:
                return future.result()
            except (KilledWorker, FutureCancelledError) as e:
                log.info("%s: sent again (%s)", task.name, type(e).__name__)
                self._forget_lost()
                future = self._submitted(task)
        raise InputError(
            f"{task.name}: the workers that had it were lost {TRIES} times; see their logs, and add memory"
        )

    def _send(self, sent: Sent) -> Any:
        if sent.name not in self._sent:
            value = np.asarray(sent.value) if hasattr(sent.value, "__array__") else sent.value
            size = getattr(value, "nbytes", 0)
            self._sent[sent.name] = self._client.scatter(value, hash=False), size
            while sum(n for _, n in self._sent.values()) > MOST_SENT and len(self._sent) > 1:
                self._sent.popitem(last=False)
        self._sent.move_to_end(sent.name)
        return self._sent[sent.name][0]

    def _forget_lost(self) -> None:
        for name in [name for name, (future, _) in self._sent.items() if future.status != "finished"]:
            del self._sent[name]


def do_here(run: str, do: Callable[..., Any], *arguments: Any) -> Any:
    """Do a task on a worker, on one thread like its sender, for the same results."""
    compiled.use_threads(1)
    with threadpool_limits(limits=1, user_api="blas"):
        return do(*resolved(arguments, lambda sent: sent.value, partial(_kept, run)))


def _kept(run: str, kept: KeptHere) -> Any:
    """The last object that this thread made for itself, or a new one in its place."""
    if getattr(_here, "name", None) != (run, kept.name):
        _here.name, _here.value = (run, kept.name), kept.make()
    return _here.value
