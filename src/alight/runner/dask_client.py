"""The connection to a Dask cluster."""

from __future__ import annotations

import platform
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from alight.records import InputError, MissingExtraError
from alight.runner.program import sources_digest

OTHERS = "a worker has another Alight than this program; install the same everywhere, and start the workers again"
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
    """Connect as `dask_client`, and see that there are workers with the same Alight; `submit` sees to later ones.

    Raises:
        MissingExtraError: Dask is not installed.
        InputError: no scheduler answers there, it has no worker, or a worker has another state of Alight.
    """
    with dask_client(scheduler) as client:
        try:
            client.wait_for_workers(1, timeout=WAIT)
        except TimeoutError as e:
            raise InputError(f"--scheduler {scheduler}: has no worker; start one with 'dask worker {scheduler}'") from e
        try:
            client.run(check_program, sources_digest())
        except (AttributeError, ImportError) as e:  # it does not even know the question
            raise InputError(f"--scheduler {scheduler}: {OTHERS}") from e
        yield client


def submit(client: Any, do: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
    """Send a call to the workers of `dask_workers`; one with another Alight raises an InputError instead.

    Args:
        client: of `distributed`.
        do: function that can be pickled, and its arguments.
        options: of `client.submit`.

    Returns:
        The future.
    """
    return client.submit(done_alike, sources_digest(), do, *arguments, pure=False, **options)


def done_alike(digest: str, do: Callable[..., Any], *arguments: Any) -> Any:
    """On a worker: return what `do` returns. Raises and `digest` as of `check_program`."""
    check_program(digest)
    return do(*arguments)


def check_program(digest: str) -> None:
    """Compare the Alight of this process, a worker's, with that of the sender of the work.

    Args:
        digest: `sources_digest()` of the sender.

    Raises:
        InputError: they differ: the results would, too.
    """
    if digest != sources_digest():
        raise InputError(f"{platform.node()}: {OTHERS}")
