"""The connection to a Dask cluster."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

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
