"""Mark of the tests for `make test-long`: further cases of a property that a shorter test covers already."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import pytest

long = pytest.mark.long


def first(count: int, values: Iterable[Any]) -> Sequence[Any]:
    """Parameters of a test; all but the first `count` are marked long."""
    return first_rows(count, ((value,) for value in values))


def first_rows(count: int, values: Iterable[Sequence[Any]]) -> Sequence[Any]:
    """As `first`, of a test with several parameters."""
    return [pytest.param(*row, marks=() if k < count else long) for k, row in enumerate(values)]


def in_turn(count: int, values: Sequence[Sequence[Any]]) -> Sequence[Any]:
    """Rows of an autopilot and its values: the first `count` on each autopilot in turn, the other rows marked long."""
    both = ("ardupilot", "px4")
    return first_rows(count, [(both[(k + turn) % 2], *row) for turn in range(2) for k, row in enumerate(values)])


# both autopilots; and one of them where the code under test is the same for both, the other in the long tests
BOTH = pytest.mark.parametrize("dialect", ["ardupilot", "px4"])
EITHER = pytest.mark.parametrize("dialect", first(1, ["ardupilot", "px4"]))
