"""Mark of the tests for `make test-long`: further cases of a property that a shorter test covers already."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import pytest

long = pytest.mark.long


def first(count: int, values: Iterable[Any]) -> Sequence[Any]:
    """Parameters of a test; all but the first `count` are marked long."""
    return [pytest.param(v, marks=() if k < count else long) for k, v in enumerate(values)]
