"""Which tests are left to `make test-long`: more cases of what a shorter test has already shown."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import pytest

long = pytest.mark.long


def cases(values: Iterable[Any], short: Callable[[Any], bool]) -> Sequence[Any]:
    """Parameters of a test, of which those that are not `short` are long."""
    return [pytest.param(v, marks=() if short(v) else long) for v in values]


def first(count: int, values: Iterable[Any]) -> Sequence[Any]:
    """The same, of which all but the first `count` are long."""
    return [pytest.param(v, marks=() if k < count else long) for k, v in enumerate(values)]
