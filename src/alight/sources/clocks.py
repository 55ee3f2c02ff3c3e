"""Test of a recording's clocks: streams that do not overlap in time were stamped by different clocks."""

from __future__ import annotations

from alight.arrays import I64

TOGETHER = 2.0  # s: a gap at the ends of a stream, as of a recorder that starts later


def apart(times: I64, others: I64) -> float:
    """Seconds by which one stream (N,) ns lies wholly after another (M,) ns; below 0: before; 0: they overlap."""
    after = (int(times[0]) - int(others[-1])) / 1e9
    before = (int(others[0]) - int(times[-1])) / 1e9
    if after > TOGETHER:
        return after
    return -before if before > TOGETHER else 0.0


def said_apart(name: str, seconds: float, other: str) -> str:
    """A sentence about two streams that do not overlap in time."""
    where = "after the end" if seconds > 0 else "before the beginning"
    verb = "begins" if seconds > 0 else "ends"
    return (
        f"the clocks do not meet: {name} {verb} {abs(seconds):,.1f} s {where} of {other}, so {name} is left out; "
        "stamp both by one clock"
    )
