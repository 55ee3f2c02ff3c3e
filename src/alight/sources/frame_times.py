"""Times of the frames in a folder, from a table next to them, their names, or a constant rate. No unit is guessed."""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import suppress
from datetime import datetime
from decimal import Decimal
from pathlib import Path
from typing import NamedTuple

import numpy as np

from alight.documents import DocumentError, read_text
from alight.records import InputError

TABLES = ("data.csv", "timestamps.csv", "timestamps.txt", "times.txt", "times.csv", "timestamp.txt")
UNITS = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1_000, "ns": 1}
INTERVALS = (2e-3, 1.99)  # s, plausible median interval; limits differ by less than 1000, so that one unit fits
DIGITS = 10  # least digits of a time in a name; a shorter number is a count
_NUMBER = re.compile(r"\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
_CALENDAR = re.compile(  # such as 20240102100059, 240102100059, 2024-01-02_10-00-59.250
    r"(?<!\d)((?:(?:19|20)\d\d)([-_]?)\d\d\2\d\d[-_T ]?\d\d([-_.]?)\d\d\3\d\d)(?:[-_.]?((?:\d{3}){1,3}))?(?!\d)"
)
_DATE = re.compile(r"(\d{4}-\d\d-\d\d[ T]\d\d:\d\d:\d\d)(?:\.(\d+))?")


class FrameTimes(NamedTuple):
    """Frames with their times, in order of time."""

    rows: list[tuple[int, str]]  # time [ns], file name
    source: str  # where the times come from, in words


def frame_times(folder: Path, names: Sequence[str], rate: float | None) -> FrameTimes:
    """Determine the times of the frames in a folder.

    Args:
        names: file names of the frames.
        rate: frames per second; None: read a table (`TABLES`) in the folder or its parent, else the file names.

    Raises:
        InputError: the frames have no times, or no unit gives an interval of a camera.
    """
    ordered = sorted(names, key=_natural)
    if rate is not None:
        return FrameTimes([(round(1e9 * k / rate), name) for k, name in enumerate(ordered)], f"{rate:g} Hz as given")
    for path in (place / name for place in (folder, folder.parent) for name in TABLES):
        if path.is_file() and (found := _table(path, ordered)) is not None:
            return found
    dates = [date for name in ordered if (date := _date_in(Path(name).stem))]
    if len(dates) == len(ordered) and dates:
        if len(set(dates)) < len(dates):
            raise InputError(f"{folder}: several frames have one date and time in their names; set sources.rate=HZ")
        return _timed(list(zip(dates, ordered, strict=True)), "dates in the names of the frames", str(folder), "time_s")
    stamps = [max(_NUMBER.findall(Path(name).stem), key=len, default="") for name in ordered]
    if all(len(s.replace(".", "")) >= DIGITS for s in stamps):
        return _timed(list(zip(stamps, ordered, strict=True)), "the names of the frames", str(folder))
    raise InputError(
        f"{folder}: its frames have no times; name them by time (1700000000123456789.png), put a table beside them "
        f"({', '.join(TABLES[:4])}), or set sources.rate=HZ"
    )


def _date_in(stem: str) -> str:
    """Return the date and time in a file name (without suffix) as text, seconds since 1970; empty if there is none."""
    found = _CALENDAR.search(re.sub(r"(?<!\d)(\d{12})(?!\d)", r"20\1", stem))
    return _epoch(found[1], found[4]) if found else ""


def _epoch(date: str, fraction: str | None) -> str:
    """Return a date and time as text, seconds since 1970; empty if there is no such date: another number."""
    with suppress(ValueError):  # such as a month of 13
        whole = datetime.strptime(re.sub(r"\D", "", date) + "+0000", "%Y%m%d%H%M%S%z")
        return f"{int(whole.timestamp())}.{fraction or 0}"
    return ""


def _natural(name: str) -> list[str | Decimal]:
    """Return a key that sorts frame_10 after frame_9."""
    parts = re.split(r"(\d+)", name)
    return [Decimal(p) if k % 2 else p for k, p in enumerate(parts)]


def _table(path: Path, names: Sequence[str]) -> FrameTimes | None:
    """Read a table with one time per file name, or per frame in the order of `names`; None if it is no such table."""
    try:
        lines = read_text(path, 100_000_000).splitlines()
    except (OSError, DocumentError) as e:
        raise InputError(f"{path}: {e}; mend it, take it away, or set sources.rate=HZ") from e
    by_name = {key: name for name in names for key in (Path(name).stem, name)}
    named, bare = list[tuple[str, str]](), list[str]()
    for line in lines:
        fields = [Path(f).name for f in re.split(r"[,;\s]+", _DATE.sub(lambda m: _epoch(m[1], m[2]), line.strip()))]
        label = next((f for f in fields if f in by_name), None)
        numbers = [f for f in fields if _NUMBER.fullmatch(f)]
        time = max((f for f in numbers if f != label), key=len, default=numbers[0] if numbers else "")
        if time and label is not None:
            named.append((time, by_name[label]))
        elif time and not line.lstrip().startswith("#"):
            bare.append(time)
    rows = named or (list(zip(bare, names, strict=True)) if len(bare) == len(names) else [])
    return _timed(rows, path.name, str(path), lines[0].lower()) if rows else None


def _timed(stamps: Sequence[tuple[str, str]], source: str, where: str, head: str = "") -> FrameTimes:
    """Convert (time, name) pairs to frames with times in ns, by the unit in `head`, else by the only plausible unit.

    `source`: origin of the times, in words; `where`: start of error messages; `head`: header of a table.
    """
    numbers = np.sort(np.array([float(t) for t, _ in stamps]))
    steps = np.diff(numbers)
    step = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    named = re.search(r"[\[(_ ](ns|us|ms|s)\b", head)
    unit = named[1] if named else None
    fitting = [u for u, ns in UNITS.items() if INTERVALS[0] <= 1e-9 * step * ns <= INTERVALS[1]]
    if (unit is None and len(fitting) != 1) or (unit is not None and unit not in fitting):
        raise InputError(
            f"{where}: the times of the frames are {step:g} apart, in no unit an interval of a camera; write "
            "nanoseconds, or set sources.rate=HZ"
        )
    unit = unit or fitting[0]
    scale = UNITS[unit]
    rows = sorted((int((Decimal(t) * scale).to_integral_value()), name) for t, name in stamps)
    return FrameTimes(rows, f"{source}, in {unit}")
