"""Convert the CSV streams of a flight log to samples. A bad row is left out and reported, never guessed."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from alight.arrays import F64, I64, Mask
from alight.geometry import LocalFrame, Pose, matrix_from_quaternion
from alight.records import ImuSample, NavSample
from alight.sources.source import LARGEST, SIGMAS, Findings, Trajectory

TRUTH = "state_groundtruth_estimate0"
COLUMNS = {"nav0": (23,), "imu0": (7,), TRUTH: (17, 8)}  # allowed column counts; 8: truth without velocity and biases
LATE_NS = 2_000_000_000  # ns; a row may follow a row that is later by up to this, because links deliver out of order


class StreamRow(NamedTuple):
    """One row of a stream: line number, time, and the fields after the time."""

    line: int
    t_ns: int
    fields: list[str]


@dataclass(frozen=True, eq=False)
class Table:
    """Usable rows of one stream."""

    t_ns: I64  # (N,)
    values: F64  # (N, columns - 1), NaN = not measured
    lines: list[int]  # line numbers in the file

    def without(self, bad: Mapping[str, Mask], stream: str, findings: Findings) -> Table | None:
        """Return the rows that no mask in `bad` marks; None if no row is left.

        Marked rows are recorded in `findings` as lost from `stream`, with the mask's key as the reason.
        """
        why = {int(i): reason for reason, rows in bad.items() for i in np.flatnonzero(rows)}
        for i in sorted(why):
            findings.lose(f"{stream} rows", f"line {self.lines[i]}", why[i])
        keep = np.setdiff1d(np.arange(len(self.lines)), list(why)).astype(np.intp)
        return Table(self.t_ns[keep], self.values[keep], [self.lines[i] for i in keep]) if len(keep) else None


def rows_of(
    lines: Iterable[tuple[int, str]], columns: tuple[int, ...], group: str, findings: Findings
) -> list[StreamRow]:
    """Split (line number, text) pairs into rows that have a time in ns and one of the allowed numbers of `columns`.

    Other lines are recorded in `findings` as lost from `group`, except comments and empty lines.
    """
    rows: list[StreamRow] = []
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
            rows.append(StreamRow(number, int(stamp), fields))
    return rows


def _read_rows(path: Path, columns: tuple[int, ...], group: str, findings: Findings) -> list[StreamRow]:
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        lines = [(n, line) for n, line in enumerate(file, 1) if line.strip() and not line.strip().startswith("#")]
    findings.expect(group, len(lines))
    return rows_of(lines, columns, group, findings)


def rising(times: list[int]) -> list[bool]:
    """Return the mask of the longest rising subsequence; one wrong time thus does not exclude all later times."""
    tails: list[int] = []  # smallest last time of a rising subsequence of each length
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


def ordered_rows(rows: list[StreamRow], group: str, findings: Findings) -> list[StreamRow]:
    """Return rows sorted by time; record as lost repeated times, and times further back than late delivery explains."""
    if all(a.t_ns < b.t_ns for a, b in pairwise(rows)):
        return rows
    first = {row.t_ns: row.line for row in reversed(rows)}
    single = [row for row in rows if first[row.t_ns] == row.line]
    used = {row.line for row, kept in zip(single, rising([r.t_ns for r in single]), strict=True) if kept}
    begin, newest, late = min(r.t_ns for r in single if r.line in used), 0, set()
    for row in single:
        if row.line in used:
            newest = row.t_ns
        elif begin < row.t_ns and 0 < newest - row.t_ns <= LATE_NS:
            late.add(row.line)
    for row in rows:
        if row.line not in used | late:
            repeated = first[row.t_ns] != row.line
            findings.lose(group, f"line {row.line}", "the time is repeated" if repeated else "time goes backwards")
    return sorted((row for row in rows if row.line in used | late), key=lambda row: row.t_ns)


def read_names(path: Path, group: str, findings: Findings) -> list[tuple[int, str]]:
    """Read `timestamp, filename` rows as (ns, name), in order of time; record unusable rows as lost from `group`."""
    rows = [r for r in _read_rows(path, (2,), group, findings) if names_file(r, group, findings)]
    return [(row.t_ns, row.fields[0]) for row in ordered_rows(rows, group, findings)]


def names_file(row: StreamRow, group: str, findings: Findings) -> bool:
    """Whether a row names a file inside the folder; if not, the row is recorded in `findings` as lost from `group`."""
    name = row.fields[0]
    fits = len(name.encode(errors="replace")) <= 255 and "\0" not in name  # bytes; file systems allow no longer name
    if name and fits and ".." not in Path(name).parts and not Path(name).is_absolute():
        return True
    findings.lose(group, f"line {row.line}", f"{name[:40]!r} names no file of the folder")
    return False


def _numbers(row: StreamRow, group: str, findings: Findings) -> list[float] | None:
    """Return the numbers of a row, NaN for empty fields; None if a field is not a finite number.

    In that case the row is recorded in `findings` as lost from `group`.
    """
    out = []
    for field in row.fields:
        try:
            value = float(field) if field else np.nan
        except ValueError:
            findings.lose(group, f"line {row.line}", f"{field[:40]!r} is no number")
            return None
        if np.isinf(value):
            findings.lose(group, f"line {row.line}", "a number is infinite")
            return None
        out.append(value)
    return out


def table_of(rows: Iterable[StreamRow], stream: str, findings: Findings, in_order: bool = True) -> Table:
    """Convert rows of a stream to numbers; rows with a field that is not a number are recorded as lost.

    Shorter rows are padded with NaN. With `in_order`, rows are sorted by time, or lost if their time goes backwards.
    """
    group, width = f"{stream} rows", COLUMNS[stream][0] - 1
    read = {row.line: (row, v) for row in rows if (v := _numbers(row, group, findings)) is not None}
    good = [row for row, _ in read.values()]
    good = ordered_rows(good, group, findings) if in_order else good
    values = np.full((len(good), width), np.nan)
    for i, row in enumerate(good):
        values[i, : len(row.fields)] = read[row.line][1]
    return Table(np.array([row.t_ns for row in good], np.int64), values, [row.line for row in good])


def read_table(root: Path, stream: str, findings: Findings) -> Table | None:
    """Read all usable rows of the stream in the folder `root/stream`, in order of time; None if there is no stream."""
    path = root / stream / "data.csv"
    if path.exists() and not path.is_file():
        findings.warn(f"{stream}/data.csv is no plain file and is not read; give a file")
    if not path.is_file():
        return None
    return table_of(_read_rows(path, COLUMNS[stream], f"{stream} rows", findings), stream, findings)


def usable_nav(table: Table | None, findings: Findings) -> Table | None:
    """Return the rows of `nav0` with possible values, and record the others as lost; None if no row is left."""
    if table is None:
        return None
    v = table.values
    sigma = v[:, 13:22]
    with np.errstate(over="ignore", invalid="ignore"):
        bad = {
            "latitude or longitude is no place on Earth": (np.abs(v[:, 0]) > 90) | (np.abs(v[:, 1]) > 360),
            "the quaternion is not of unit length": np.abs(np.linalg.norm(v[:, 3:7], axis=1) - 1) > 0.05,
            "the height is none of an aircraft": np.abs(v[:, 2]) > LARGEST["height"],
            "the velocity is none of an aircraft": (np.abs(v[:, 7:10]) > LARGEST["velocity_world"]).any(axis=1),
            "the angular rate is none of an aircraft": (
                np.abs(v[:, 10:13]) > LARGEST["angular_velocity_body"]
            ).any(axis=1),
            "a sigma is negative": (sigma < 0).any(axis=1),
            f"a sigma is not between {SIGMAS[0]:g} and {SIGMAS[1]:g}": (
                (sigma > 0) & ((sigma < SIGMAS[0]) | (sigma > SIGMAS[1]))  # 0: unknown
            ).any(axis=1),
        }  # fmt: skip
    return table.without(bad, "nav0", findings)


def usable_imu(table: Table | None, body_from_imu: Pose, findings: Findings) -> Table | None:
    """Return the usable rows of `imu0`, rotated into the body's axes; record others as lost. None: no row is left."""
    if table is None:
        return None
    with np.errstate(invalid="ignore"):
        rates, forces = (np.abs(table.values[:, a:b]).max(axis=1) for a, b in ((0, 3), (3, 6)))
    large = (rates > LARGEST["angular_velocity_body"]) | (forces > LARGEST["specific_force_body"])
    bad = {
        "no turn or acceleration of an aircraft": large,
        "a field is empty": ~np.isfinite(table.values).all(axis=1),
    }
    if (used := table.without(bad, "imu0", findings)) is None:
        return None
    R = body_from_imu.rotation
    values = np.concatenate([used.values[:, :3] @ R.T, used.values[:, 3:] @ R.T], axis=1)
    return Table(used.t_ns, values, used.lines)


def read_trajectory(root: Path, findings: Findings) -> Trajectory | None:
    """Read the true body poses in the world from the log in the folder `root`; None if it has none."""
    if (found := read_table(root, TRUTH, findings)) is None:
        return None
    v = found.values[:, :7]
    with np.errstate(over="ignore", invalid="ignore"):
        unit = np.abs(np.linalg.norm(v[:, 3:7], axis=1) - 1) < 0.05
        near = (np.abs(v[:, :3]) < LARGEST["position_world"]).all(axis=1)
    table = found.without({"no position or no unit quaternion": ~(unit & near)}, TRUTH, findings)
    if table is None:
        return None
    return table.t_ns, [Pose.from_quaternion(row[3:7], row[:3]) for row in table.values]


def _measured(values: F64, positive: bool = False) -> F64 | None:
    """Return a copy of the values if all are finite (and, with `positive`, above 0), else None."""
    return values.copy() if np.isfinite(values).all() and not (positive and (values <= 0).any()) else None


def nav_samples(table: Table, local: LocalFrame) -> Iterator[NavSample]:
    """Yield the samples of `nav0`, with positions in the world around `local`."""
    places = local.to_enu(*table.values[:, :3].T)
    for t, place, v in zip(table.t_ns, places, table.values, strict=True):
        q, lone = _measured(v[3:7]), np.isfinite(v[2]) and not np.isfinite(v[:2]).all()
        position, attitude, velocity = (_measured(v[a : a + 3], True) for a in (13, 16, 19))
        yield NavSample(
            int(t), _measured(place), None if q is None else matrix_from_quaternion(q), _measured(v[7:10]),
            _measured(v[10:13]), position, attitude, velocity, float(v[2] - local.height) if lone else None,
        )  # fmt: skip


def imu_samples(table: Table) -> Iterator[ImuSample]:
    """Yield the samples of `imu0`, in the body's axes."""
    for t, row in zip(table.t_ns, table.values, strict=True):
        yield ImuSample(int(t), row[:3].copy(), row[3:].copy())
