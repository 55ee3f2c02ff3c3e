"""The connection to a Dask cluster."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from alight import __version__
from alight.records import InputError, MissingExtraError

WAIT = "20s"  # for the scheduler to answer, and for its first worker


@contextmanager
def dask_client(scheduler: str) -> Iterator[Any]:
    """Connect to a scheduler such as tcp://host:8786; the `distributed.Client` is closed at the end.

    Raises:
        MissingExtraError: Dask is not installed.
        InputError: no scheduler answers there.
    """
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
        yield client


@contextmanager
def dask_workers(scheduler: str) -> Iterator[Any]:
    """Connect as `dask_client`, and see that there are workers with the same Alight.

    Raises:
        MissingExtraError: Dask is not installed.
        InputError: no scheduler answers there, it has no worker, or a worker has another version of Alight.
    """
    with dask_client(scheduler) as client:
        try:
            client.wait_for_workers(1, timeout=WAIT)
        except TimeoutError as e:
            raise InputError(f"--scheduler {scheduler}: has no worker; start one with 'dask worker {scheduler}'") from e
        for worker, version in client.run(alight_version).items():
            if version != __version__:
                raise InputError(f"{worker}: has Alight {version}, this is {__version__}; install the same everywhere")
        yield client


def alight_version() -> str:
    """Return the version of Alight where this runs: on a worker."""
    return __version__
