"""CSV streams of a flight log: a bad row is left out and named, never guessed."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from alight.arrays import I64
from alight.sources.source import Findings

LONGEST_NAME = 255  # bytes, of a file below the folder; file systems take no longer one
LATE_NS = 2_000_000_000  # by which a row may come after one of a later time: links deliver out of order
Row = tuple[int, int, list[str]]  # line number, time, the fields after the time


def rows_of(lines: Iterable[tuple[int, str]], columns: tuple[int, ...], group: str, findings: Findings) -> list[Row]:
    """The rows of numbered lines that have a time and so many columns; comments and empty lines are none."""
    rows: list[Row] = []
    for number, line in lines:
        text = line.strip()
        if not text or text.startswith("#"):
            continue
        stamp, *fields = [f.strip() for f in text.split(",")]
        if len(fields) + 1 not in columns:
            findings.lose(group, f"line {number}", f"{len(fields) + 1} columns instead of {columns[0]}")
        elif not stamp.isascii() or not stamp.isdigit() or len(stamp) > 19 or int(stamp) >= 2**63:
            findings.lose(group, f"line {number}", f"{stamp[:40]!r} is no time in integer nanoseconds, 0 or more")
        else:
            rows.append((number, int(stamp), fields))
    return rows


def _split(path: Path, columns: tuple[int, ...], group: str, findings: Findings) -> list[Row]:
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        lines = [(n, line) for n, line in enumerate(file, 1) if line.strip() and not line.strip().startswith("#")]
    findings.expect(group, len(lines))
    return rows_of(lines, columns, group, findings)


def rising(times: list[int]) -> list[bool]:
    """Mark the longest strictly rising subsequence of a list, so that one wrong time does not cost all later ones."""
    tails: list[int] = []  # smallest last time of a rising part of each length
    length = []
    for t in times:
        k = bisect_left(tails, t)
        tails[k : k + 1] = [t]
        length.append(k)
    keep, want, bound = [False] * len(times), len(tails) - 1, 2**64
    for i in range(len(times) - 1, -1, -1):
        if length[i] == want and times[i] < bound:
            keep[i], want, bound = True, want - 1, times[i]
    return keep


def _in_order(rows: list[Row], group: str, findings: Findings) -> list[Row]:
    """Rows sorted by time: of repeated times the first one, of times that go backwards only late rows."""
    times = [t for _, t, _ in rows]
    if all(a < b for a, b in pairwise(times)):
        return rows
    first = {t: number for number, t, _ in reversed(rows)}
    single = [row for row in rows if first[row[1]] == row[0]]
    used = [row for row, kept in zip(single, rising([t for _, t, _ in single]), strict=True) if kept]
    good = {number for number, _, _ in used} | _late(single, used)
    for number, t, _ in rows:
        if number not in good:
            findings.lose(
                group, f"line {number}", "the time is repeated" if first[t] != number else "time goes backwards"
            )
    return sorted((row for row in rows if row[0] in good), key=lambda row: row[1])


def _late(rows: list[Row], rising: list[Row]) -> set[int]:
    """Lines of rows that fall between the rising ones and came at most `LATE_NS` after a later one."""
    begin, newest, found = rising[0][1], 0, set()
    kept = {number for number, _, _ in rising}
    for number, t, _ in rows:
        newest = t if number in kept else newest
        if number not in kept and begin < t and 0 < newest - t <= LATE_NS:
            found.add(number)
    return found


def read_names(path: Path, group: str, findings: Findings) -> list[tuple[int, str]]:
    """Read `timestamp, filename` rows, in order of time."""
    rows = [r for r in _split(path, (2,), group, findings) if named(r, group, findings)]
    return [(t, fields[0]) for _, t, fields in _in_order(rows, group, findings)]


def named(row: Row, group: str, findings: Findings) -> bool:
    """True if a row names a file of the folder."""
    name = row[2][0]
    fits = len(name.encode(errors="replace")) <= LONGEST_NAME and "\0" not in name
    if name and fits and ".." not in Path(name).parts and not Path(name).is_absolute():
        return True
    findings.lose(group, f"line {row[0]}", f"{name[:40]!r} names no file of the folder")
    return False


def numbers_of(row: Row, group: str, findings: Findings) -> list[float] | None:
    """The numbers of a row, NaN for an empty field; None if a field is no finite number."""
    out = []
    for field in row[2]:
        try:
            value = float(field) if field else np.nan
        except ValueError:
            findings.lose(group, f"line {row[0]}", f"{field[:40]!r} is no number")
            return None
        if np.isinf(value):
            findings.lose(group, f"line {row[0]}", "a number is infinite")
            return None
        out.append(value)
    return out


def read_numbers(
    path: Path, columns: tuple[int, ...], group: str, findings: Findings
) -> tuple[I64, NDArray[np.float64], list[int]]:
    """Read rows of numbers in order of time.

    Returns:
        I64 (N,) ns, values (N, columns[0] - 1) with NaN for an empty field, and the (N,) line numbers.
        `columns` lists the numbers of columns that are allowed, time included; shorter rows are filled with NaN.
    """
    good: list[Row] = []
    values: dict[int, list[float]] = {}
    for row in _split(path, columns, group, findings):
        if (numbers := numbers_of(row, group, findings)) is not None:
            values[row[0]] = numbers
            good.append(row)
    good = _in_order(good, group, findings)
    table = np.full((len(good), columns[0] - 1), np.nan)
    for i, (number, _, _) in enumerate(good):
        table[i, : len(values[number])] = values[number]
    return np.array([t for _, t, _ in good], dtype=np.int64), table, [n for n, _, _ in good]
