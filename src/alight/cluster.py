"""Work on a Dask cluster: tasks go to workers with the same program, and the results are the same as on one machine."""

from __future__ import annotations

import hashlib
import platform
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from alight.jobs import InProcesses, InTurn, Jobs, KeptHere, Sent, Task, do_alone, resolved, results
from alight.records import InputError, MissingExtraError

OTHERS = "a worker has another Alight than this program; install the same everywhere, and start the workers again"
WAIT = "20s"  # longest wait for the scheduler to answer, and for its first worker


@cache
def sources_digest() -> str:
    """Return a digest of the program's files, so that landings of two versions of it are not mixed."""
    digest = hashlib.sha256()
    for root in (Path(__file__).parents[1] / name for name in ("alight", "alight_sim")):  # installed together
        for path in sorted(p for p in root.rglob("*") if p.suffix in (".py", ".npz", ".yaml")):
            digest.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()[:16]


@contextmanager
def open_jobs(scheduler: str | None, processes: int = 1) -> Iterator[Jobs]:
    """Open the workers that a user chose: a Dask cluster, several processes of this machine, or this process.

    Args:
        scheduler: address of the cluster, such as tcp://host:8786; None: no cluster.
        processes: number of processes of this machine; 1: this process.

    Raises:
        MissingExtraError: Dask is not installed.
        InputError: no scheduler answers, the scheduler has no worker, or a worker has another version of Alight.
    """
    if scheduler is None:
        yield InProcesses(processes) if processes > 1 else InTurn()
        return
    try:
        import distributed
    except ImportError as e:
        raise MissingExtraError("distributed (Dask)", "cluster") from e
    try:
        client = distributed.Client(scheduler, timeout=WAIT, set_as_default=False)
    except (OSError, ValueError) as e:
        raise InputError(
            f"--scheduler {scheduler}: no Dask scheduler answers there; start one with 'dask scheduler'"
        ) from e
    with client:
        try:
            client.wait_for_workers(1, timeout=WAIT)
        except TimeoutError as e:
            raise InputError(f"--scheduler {scheduler}: has no worker; start one with 'dask worker {scheduler}'") from e
        try:
            client.run(do_alike, sources_digest(), bool)
        except (AttributeError, ImportError) as e:  # it does not even have the function
            raise InputError(f"--scheduler {scheduler}: {OTHERS}") from e
        yield ClusterJobs(client)


class ClusterJobs:
    """Does tasks on the workers of a Dask cluster.

    Args:
        client: client of `distributed`. Its `get_executor` is not used: its futures never end if a worker is lost.
    """

    def __init__(self, client: Any) -> None:
        self._client = client
        self._sent = dict[str, tuple[Any, int]]()  # future and bytes of each argument, least recently used first

    def run(self, tasks: Iterable[Task], at_once: bool = False, any_order: bool = False) -> Iterator[Any]:
        """Yield the results; see `Jobs.run`. `at_once` has no effect.

        With `any_order`, all tasks are submitted immediately, so that workers that join later get some of them.
        """
        from distributed import CancelledError, KilledWorker

        most = self._ahead if not any_order else lambda: sys.maxsize
        yield from results(tasks, self._submit, most, any_order, (KilledWorker, CancelledError))

    def _ahead(self) -> int:
        return 2 * max(sum(int(n) for n in self._client.nthreads().values()), 1)

    def _submit(self, task: Task) -> Any:
        def of_client(kept: KeptHere) -> KeptHere:  # a worker also keeps objects of other clients
            return replace(kept, name=f"{self._client.id} {kept.name}")

        arguments = resolved(task.arguments, self._send, of_client)
        return self._client.submit(do_alike, sources_digest(), task.do, *arguments, pure=False, retries=task.tries)

    def _send(self, sent: Sent) -> Any:
        """Return the cluster's future of an argument; send the argument first if the cluster does not hold it."""
        there = self._sent.pop(sent.name, None)
        if there is None or there[0].status != "finished":
            value = np.asarray(sent.value) if hasattr(sent.value, "__array__") else sent.value
            there = self._client.scatter(value, hash=False), getattr(value, "nbytes", 0)
        self._sent[sent.name] = there
        while sum(size for _, size in self._sent.values()) > 2e9 and len(self._sent) > 1:
            del self._sent[next(iter(self._sent))]
        return there[0]


def do_alike(digest: str, do: Callable[..., Any], *arguments: Any) -> Any:
    """Do a task on a worker and return its result.

    Args:
        digest: `sources_digest()` of the program that sent the task.
        do, arguments: function of the task, and its arguments.

    Raises:
        InputError: the worker has another version of Alight, so its results would differ.
    """
    if digest != sources_digest():
        raise InputError(f"{platform.node()}: {OTHERS}")
    return do_alone(do, *arguments)
