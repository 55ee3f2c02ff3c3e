"""Landings as tasks: for this process, several of this machine, or a Dask cluster, with the same results."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial

from alight.cluster import open_jobs
from alight.jobs import InProcesses, Task
from alight.records import InputError
from alight.records.campaign import Conditions
from alight.trials.campaign.flying import Flown, failed

TRIES = 2  # of a landing whose process died


class WorkerLostError(Exception):
    """The process of a landing died; `records.campaign.LOST` is its name."""


def fly_all(
    conditions: Sequence[Conditions], job: Callable[[Conditions], Flown], jobs: int, scheduler: str | None
) -> Iterator[Flown]:
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
    with open_jobs(scheduler, jobs) as workers:
        tasks = (
            Task(
                f"landing {c.landing}", job, (c,), tries=TRIES,
                if_lost=partial(_lost, c) if scheduler is None else None,
            )
            for c in conditions
        )  # fmt: skip
        yield from workers.run(tasks, any_order=True)


def _lost(conditions: Conditions) -> Flown:
    """Record of a landing whose process died, which may not be the cause: test whether processes start at all.

    Raises:
        InputError: a process without work dies as well.
    """
    try:
        list(InProcesses(1).run([Task("start", int, tries=1)]))
    except InputError as e:
        raise InputError(
            "the processes that fly landings die at their start; a Python script that asks for several jobs needs its "
            'call below `if __name__ == "__main__":`'
        ) from e
    return failed(conditions, WorkerLostError("the process that flew it died"))
