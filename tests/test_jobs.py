"""Tasks that are done in turn, by processes or by a cluster: the same results, also after a loss."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import pytest
from length import first

from alight.cluster import ClusterJobs
from alight.jobs import InProcesses, InTurn, KeptHere, Sent, Task
from alight.records import InputError


def add(cache: list[int], both: tuple[int, int], c: int) -> int:
    return len(cache) + sum(both) + c


def test_arguments_are_sent_and_kept() -> None:
    made: list[int] = []

    def make() -> list[int]:
        made.append(1)
        return made

    jobs = InTurn()
    work = [Task(f"{k}", add, (KeptHere("cache", make), (Sent("a", 10), 20), 30)) for k in range(3)]
    assert list(jobs.run(work)) == [61, 61, 61]
    assert list(jobs.run(work)) == [62, 62, 62]  # made anew: the objects of a step are released at its end


def may_die(folder: Path, k: int) -> int:
    """Kill the process that has a number, as often as the file of that name states."""
    path = folder / str(k)
    if path.exists() and (left := int(path.read_text())):
        path.write_text(str(left - 1))
        os.kill(os.getpid(), signal.SIGKILL)
    return k


@pytest.mark.skipif(sys.platform == "win32", reason="needs kill -9")
@pytest.mark.parametrize("any_order", first(1, [False, True]))
def test_a_process_that_dies_loses_its_own_task_alone(any_order: bool, tmp_path: Path) -> None:
    def run(count: int, numbers: range, if_lost: Callable[[], int] | None = None) -> list[int]:
        for k, times in ((1, 1), (3, 2)):
            (tmp_path / str(k)).write_text(str(times))
        work = [Task(f"number {k}", may_die, (tmp_path, k), tries=2, if_lost=if_lost) for k in numbers]
        return list(InProcesses(count).run(work, any_order=any_order))

    found = run(2, range(5), lambda: -1)
    assert (sorted(found) if any_order else found) == (sorted if any_order else list)([0, 1, 2, -1, 4])
    with pytest.raises(InputError, match="number 3: the workers that had it were lost 2 times"):
        run(1, range(3, 5))


class LostError(Exception):
    """A worker, or an argument on it, was lost."""


class SmallCluster(SimpleNamespace):
    """A stand-in for Dask's client: threads do the tasks, and the first of them loses all arguments."""

    def __init__(self) -> None:
        super().__init__(id="client", pool=ThreadPoolExecutor(2), scattered=[], lose=True)

    def nthreads(self) -> dict[str, int]:
        return {"one": 1, "two": 1}

    def scatter(self, value: object, hash: bool) -> SimpleNamespace:
        self.scattered.append(SimpleNamespace(value=value, status="finished"))
        return self.scattered[-1]  # type: ignore[no-any-return]

    def submit(self, do: Callable[..., object], *arguments: object, pure: bool, retries: int) -> Future[object]:
        def work() -> object:
            if self.lose:
                self.lose = False
                for future in self.scattered:
                    future.status = "cancelled"
                raise LostError
            return do(*(a.value if isinstance(a, SimpleNamespace) else a for a in arguments))

        return self.pool.submit(work)


@pytest.mark.parametrize("any_order", [False, True])
def test_arguments_that_a_cluster_lost_are_sent_again(any_order: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", SimpleNamespace(CancelledError=LostError, KilledWorker=LostError))
    client = SmallCluster()
    work = [Task(f"{k}", add, ([], Sent("a", (1, 1)), k), here=k == 3) for k in range(5)]
    found = list(ClusterJobs(client).run(work, any_order=any_order))
    assert (sorted(found) if any_order else found) == [2, 3, 4, 5, 6]
    assert 2 <= len(client.scattered) <= 3  # once, and again after the loss
    client.pool.shutdown()
