"""The telemetry of a film, whatever it was read from: rows by time, and the values between two of them."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

BETWEEN = ("latitude", "longitude", "abs_alt", "rel_alt")  # values that are interpolated


@dataclass(frozen=True)
class TelemetryRow:
    """Values of one moment."""

    seconds: float  # on the clock of the telemetry
    values: dict[str, float]  # latitude, longitude [degrees], abs_alt, rel_alt [m], focal_len, gb_yaw, ...
    taken: datetime | None = None
    coarse: bool = False  # latitude and longitude have few decimals

    @property
    def place(self) -> tuple[float, float] | None:
        """Latitude and longitude in degrees; None without a fix."""
        latitude, longitude = self.values.get("latitude", math.nan), self.values.get("longitude", math.nan)
        on_earth = abs(latitude) <= 90 and abs(longitude) <= 180
        return (latitude, longitude) if on_earth and (latitude, longitude) != (0, 0) else None


@dataclass(frozen=True)
class FilmTelemetry:
    """Rows with a place, in order of time."""

    rows: tuple[TelemetryRow, ...]
    source: str  # where it was read
    found: str = ""  # what was settled on reading it
    of_film: bool = True  # its clock begins with the film, unless the film was cut

    @classmethod
    def of(cls, rows: Iterable[TelemetryRow], source: str, found: str = "", of_film: bool = True) -> FilmTelemetry:
        """Sort the rows that have a place; of several at one time the first counts."""
        by_time = {r.seconds: r for r in reversed(list(rows)) if r.place is not None}
        return cls(tuple(by_time[t] for t in sorted(by_time)), source, found, of_film)

    @cached_property
    def seconds(self) -> list[float]:
        """Times of the rows."""
        return [r.seconds for r in self.rows]

    @cached_property
    def step(self) -> float:
        """Usual time from one row to the next, s."""
        return float(np.median(np.diff(self.seconds))) if len(self.rows) > 1 else 1.0

    @property
    def length(self) -> float:
        """Seconds from the first row to the end of the last."""
        return self.seconds[-1] - self.seconds[0] + self.step

    @property
    def speed(self) -> float:
        """Mean speed over the ground, m/s."""
        return sum(abs(apart(a, b)) for a, b in pairwise(self.rows)) / self.length

    def at(self, seconds: float) -> TelemetryRow | None:
        """Return the values at a time, places and heights interpolated; None outside, and in a gap of 2 s or more."""
        k = bisect_right(self.seconds, seconds + 1e-6) - 1  # s: times are written in milliseconds at best
        reach = max(2.0, 3.0 * self.step)
        if k < 0 or seconds - self.seconds[k] > (reach if k + 1 < len(self.rows) else self.step):
            near = k < 0 and self.seconds[0] - seconds <= self.step
            return self._moved(self.rows[0], seconds) if near else None
        row = self.rows[k]
        if k + 1 == len(self.rows) or seconds <= row.seconds:
            return self._moved(row, seconds)
        later = self.rows[k + 1]
        if later.seconds - row.seconds > reach:
            return None
        share = (seconds - row.seconds) / (later.seconds - row.seconds)
        between = {n: row.values[n] + share * _difference(row, later, n)
                   for n in BETWEEN if n in row.values and n in later.values}  # fmt: skip
        return self._moved(replace(row, values=row.values | between), seconds)

    def _moved(self, row: TelemetryRow, seconds: float) -> TelemetryRow:
        """A row at another time; its date follows from that of the first row."""
        first = self.rows[0]
        taken = None if first.taken is None else first.taken + timedelta(seconds=seconds - first.seconds)
        return replace(row, seconds=seconds, taken=taken)

    def path(self) -> NDArray[np.complex128]:
        """(N,) metres east + 1j north from the first row, divided by the height above take-off where all rows have it.

        So divided, it is the path that the picture of level ground moves by, in focal lengths.
        """
        steps = [(apart(a, b), min(a.values.get("rel_alt", 0.0), b.values.get("rel_alt", 0.0)))
                 for a, b in pairwise(self.rows)]  # fmt: skip
        relative = all(height > 1.0 for _, height in steps)
        path = np.cumsum([0.0, *(move / (height if relative else 1.0) for move, height in steps)])
        return np.asarray(path, np.complex128)


def apart(a: TelemetryRow, b: TelemetryRow) -> complex:
    """Metres east + 1j north from one row to another."""
    assert a.place is not None
    scale = 111_194.0  # m a degree
    east = math.cos(math.radians(a.place[0])) * _difference(a, b, "longitude")
    return scale * complex(east, _difference(a, b, "latitude"))


def _difference(a: TelemetryRow, b: TelemetryRow, name: str) -> float:
    difference = b.values[name] - a.values[name]
    return (difference + 180.0) % 360.0 - 180.0 if name == "longitude" else difference
