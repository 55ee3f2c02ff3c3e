"""Telemetry of a film, independent of its format: rows by time, and interpolation between two rows."""

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

from alight.photos.reading.agreement import METRES_A_DEGREE

BETWEEN = ("latitude", "longitude", "abs_alt", "rel_alt")  # interpolated values


@dataclass(frozen=True)
class TelemetryRow:
    """Telemetry values at one time: position, heights, camera angles."""

    seconds: float  # on the clock of the telemetry
    values: dict[str, float]  # latitude, longitude [degrees], abs_alt, rel_alt [m], focal_len, gb_yaw, ...
    taken: datetime | None = None
    coarse: bool = False  # whether latitude and longitude have few decimals

    @property
    def place(self) -> tuple[float, float] | None:
        """Latitude and longitude in degrees; None without a fix."""
        latitude, longitude = self.values.get("latitude", math.nan), self.values.get("longitude", math.nan)
        on_earth = abs(latitude) <= 90 and abs(longitude) <= 180
        return (latitude, longitude) if on_earth and (latitude, longitude) != (0, 0) else None


@dataclass(frozen=True)
class FilmTelemetry:
    """Rows with a position, in order of time."""

    rows: tuple[TelemetryRow, ...]
    source: str  # file or track that the telemetry was read from
    found: str = ""  # what was inferred while reading, in words
    of_film: bool = True  # True: the clock begins with the film, if the film was not cut
    warning: str = ""  # what was not understood while reading, in words; empty: nothing

    @classmethod
    def of(cls, rows: Iterable[TelemetryRow], source: str, found: str = "", of_film: bool = True) -> FilmTelemetry:
        """Build telemetry from the rows that have a position; of rows with equal times, the first is used."""
        by_time = {r.seconds: r for r in reversed(list(rows)) if r.place is not None}
        return cls(tuple(by_time[t] for t in sorted(by_time)), source, found, of_film)

    @cached_property
    def seconds(self) -> list[float]:
        """Times of the rows in seconds."""
        return [r.seconds for r in self.rows]

    @cached_property
    def step(self) -> float:
        """Median time between rows, s; 1 for a single row."""
        return float(np.median(np.diff(self.seconds))) if len(self.rows) > 1 else 1.0

    @property
    def length(self) -> float:
        """Time from the first row to the end of the last row, s."""
        return self.seconds[-1] - self.seconds[0] + self.step

    @property
    def speed(self) -> float:
        """Mean ground speed, m/s."""
        return sum(abs(apart(a, b)) for a, b in pairwise(self.rows)) / self.length

    def at(self, seconds: float) -> TelemetryRow | None:
        """Interpolate positions and heights at a time, s; None outside the rows, and in gaps over 2 s and 3 steps."""
        k = bisect_right(self.seconds, seconds + 1e-6) - 1  # s: times are written in milliseconds at best
        row, later = self.rows[max(k, 0)], self.rows[min(k + 1, len(self.rows) - 1)]
        away, gap = seconds - row.seconds, later.seconds - row.seconds  # no gap before the first row and after the last
        if abs(away) > self.step if gap == 0 else away > 0 and gap > max(2.0, 3.0 * self.step):
            return None
        share = away / gap if gap and away > 0 else 0.0
        between = {n: row.values[n] + share * _difference(row, later, n)
                   for n in BETWEEN if n in row.values and n in later.values}  # fmt: skip
        first = self.rows[0].taken
        taken = None if first is None else first + timedelta(seconds=seconds - self.seconds[0])
        return replace(row, seconds=seconds, values=row.values | between, taken=taken)

    def path(self) -> NDArray[np.complex128]:
        """Return the (N,) path from the first row in metres, east + 1j north.

        If all rows have a height above take-off, the path is divided by this height. It then equals the path of the
        picture over level ground, in focal lengths.
        """
        steps = [(apart(a, b), min(a.values.get("rel_alt", 0.0), b.values.get("rel_alt", 0.0)))
                 for a, b in pairwise(self.rows)]  # fmt: skip
        relative = all(height > 1.0 for _, height in steps)
        path = np.cumsum([0.0, *(move / (height if relative else 1.0) for move, height in steps)])
        return np.asarray(path, np.complex128)


def apart(a: TelemetryRow, b: TelemetryRow) -> complex:
    """Return the vector from row `a` to row `b` in metres, east + 1j north."""
    east = math.cos(math.radians(a.values["latitude"])) * _difference(a, b, "longitude")
    return METRES_A_DEGREE * complex(east, _difference(a, b, "latitude"))


def _difference(a: TelemetryRow, b: TelemetryRow, name: str) -> float:
    difference = b.values[name] - a.values[name]
    return (difference + 180.0) % 360.0 - 180.0 if name == "longitude" else difference
