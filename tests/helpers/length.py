"""Which tests are left to `make test-long`: more cases of what a shorter test has already shown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import pytest

long = pytest.mark.long


def first(count: int, values: Iterable[Any]) -> Sequence[Any]:
    """Parameters of a test, of which all but the first `count` are long."""
    return [pytest.param(v, marks=() if k < count else long) for k, v in enumerate(values)]
