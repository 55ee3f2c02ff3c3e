"""The autopilot's reported positions of the last half minute, without positions that cannot have been reached."""

from __future__ import annotations

import math
from bisect import bisect_left, insort
from collections import deque
from dataclasses import dataclass, replace
from itertools import pairwise
from operator import attrgetter
from typing import Any

import numpy as np

from alight.arrays import F64
from alight.flight.autopilot.border import METRES_PER_DEGREE, enu, metres_between, metres_per_degree_east, shifted
from alight.flight.autopilot.clock import VehicleClock
from alight.records import Place
from alight.records.telemetry import HIGHEST

_KEPT = 300  # positions
_CARRIED_NS = 1_500_000_000  # longest extrapolation of a report, where reports are late or few
_BACK_NS = 400_000_000  # longest extrapolation backwards, before a report
_RESET = 0.3  # m, by which a position may differ from the one before it carried on: an acceleration gives 0.05 in 0.1 s
_NO_SPEED = np.iinfo(np.int16).max  # value of a speed that is not set
_stamp = attrgetter("boot_ns")


@dataclass(frozen=True, eq=False)
class PositionReport:
    """Position and velocity of one GLOBAL_POSITION_INT."""

    boot_ns: int  # the autopilot's clock
    place: Place
    velocity_ned: F64  # (3,) m/s

    def at(self, boot_ns: int) -> Place:
        """Return the position at another instant of the autopilot's clock, extrapolated by the velocity."""
        north, east, down = self.velocity_ned * ((boot_ns - self.boot_ns) * 1e-9)
        return shifted(self.place, north / METRES_PER_DEGREE, east / metres_per_degree_east(self.place), -down)

    def can_precede(self, new: PositionReport) -> bool:
        """Whether the vehicle can have flown from this position to the position of a new report."""
        dt = min(abs(new.boot_ns - self.boot_ns) * 1e-9, 60.0)  # s: an older report limits the positions no further
        speed = max(float(np.linalg.norm(self.velocity_ned)), 30.0)  # m/s
        error = 55.0  # m, of a report, plus the correction of an estimator
        return metres_between(self.at(self.boot_ns + round(dt * 1e9)), new.place) <= error + speed * dt


def place_of(latitude: int, longitude: int, altitude: int, above_home: int) -> Place | None:
    """Convert MAVLink's integers, in 1e-7 degrees and mm, to a position; None: they are impossible or not set.

    Latitude and longitude of exactly 0 are sent while the position is unknown.
    """
    off_earth = abs(latitude) > 90e7 or abs(longitude) > 180e7 or max(abs(altitude), abs(above_home)) > HIGHEST * 1e3
    if off_earth or (latitude == 0 and longitude == 0):
        return None
    return Place(latitude * 1e-7, longitude * 1e-7, altitude * 1e-3, above_home * 1e-3)


def report_of(m: Any) -> PositionReport | None:
    """Return the report of a GLOBAL_POSITION_INT; None: its values are impossible or not set."""
    place, speeds = place_of(m.lat, m.lon, m.alt, m.relative_alt), (m.vx, m.vy, m.vz)
    if place is None or max(map(abs, speeds)) >= _NO_SPEED:
        return None
    return PositionReport(m.time_boot_ms * 1_000_000, place, np.array(speeds) * 1e-2)


class PositionLog:
    """Accepted position reports in order of time.

    A report is accepted if the vehicle can have flown to its position. After a jump, reports are accepted once they
    have agreed with each other for a second, as the autopilot's estimator may have restarted.
    """

    def __init__(self) -> None:
        self.expects_resets = False  # whether the estimator may be reset by metres, as where its source changes
        self.resets = 0  # number of such resets
        self._reports: list[PositionReport] = []
        self._arrivals: deque[tuple[int, int]] = deque(maxlen=_KEPT)  # our clock, and the autopilot's stamp, ns
        self._newest: PositionReport | None = None  # report accepted last
        self._doubted: PositionReport | None = None  # newest report after a jump
        self._doubted_since_ns = 0  # stamp of the first report that it agrees with

    @property
    def doubted(self) -> bool:
        """Whether the newest reports contradict the accepted reports."""
        return self._doubted is not None

    def add(self, report: PositionReport, now_ns: int) -> bool:
        """Process a report that came at `now_ns` of our clock; return whether it is accepted."""
        if self._newest is not None and not self._newest.can_precede(report):
            if self._doubted is None or not self._doubted.can_precede(report):
                self._doubted_since_ns = report.boot_ns
            self._doubted = report
            if report.boot_ns - self._doubted_since_ns < 1_000_000_000:
                return False
            self._reports.clear()  # they belong to another estimate
        if self.expects_resets and self._reports and self._is_reset(report):
            self._reports.clear()  # positions before the reset differ by it; the nearest after it count
            self.resets += 1
        self._newest, self._doubted = report, None
        insort(self._reports, report, key=_stamp)  # the link may reorder them
        del self._reports[:-_KEPT]
        self._arrivals.append((now_ns, report.boot_ns))
        return True

    def _is_reset(self, new: PositionReport) -> bool:
        before = self._reports[-1]
        recent = 0 < new.boot_ns - before.boot_ns < _BACK_NS
        a, b = before.at(new.boot_ns), new.place
        return recent and metres_between(replace(a, altitude_msl=0.0), replace(b, altitude_msl=0.0)) > _RESET

    def at(self, boot_ns: int) -> Place | None:
        """Return the position at an instant of the autopilot's clock, extrapolated from the nearest report.

        None: no report is near that instant, or the newest reports contradict the accepted reports.
        """
        report = self._nearest(boot_ns)
        return None if report is None else report.at(boot_ns)

    def velocity_at(self, boot_ns: int) -> F64 | None:
        """Return the velocity at an instant of the autopilot's clock, (3,) m/s east, north, up; None: see `at`."""
        report = self._nearest(boot_ns)
        return None if report is None else enu(*report.velocity_ned)

    def _nearest(self, boot_ns: int) -> PositionReport | None:
        after = bisect_left(self._reports, boot_ns, key=_stamp)
        beside = self._reports[max(after - 1, 0) : after + 1]
        near = [r for r in beside if -_BACK_NS <= boot_ns - r.boot_ns <= _CARRIED_NS]
        return None if self.doubted else min(near, key=lambda r: abs(r.boot_ns - boot_ns), default=None)

    def age(self, boot_ns: int) -> float:
        """Return the seconds from the newest report to an instant of the autopilot's clock; inf: no report."""
        return (boot_ns - self._reports[-1].boot_ns) * 1e-9 if self._reports else math.inf

    def oldest(self, now_ns: int, clock: VehicleClock) -> float:
        """Return the greatest age, s, of the newest report at any time in the last five seconds; inf: no report.

        Args:
            clock: the autopilot's clock, which must be known.
        """
        recent = [a for a in self._arrivals if now_ns - a[0] <= 5_000_000_000]
        ends = [*(later[0] for _, later in pairwise(recent)), now_ns]
        ages = [(end - clock.ours_ns(boot_ns)) * 1e-9 for end, (_, boot_ns) in zip(ends, recent, strict=False)]
        return max(ages, default=math.inf)
