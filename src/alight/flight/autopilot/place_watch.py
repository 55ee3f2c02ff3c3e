"""The watch over reported positions: a position is accepted if it is on Earth and the vehicle can have reached it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from alight.arrays import F64
from alight.flight.autopilot.border import METRES_PER_DEGREE, metres_between, metres_per_degree_east
from alight.records import Place
from alight.records.telemetry import HIGHEST

_MARGIN = 55.0  # m, error of a report plus the correction of an estimator
_FASTEST = 30.0  # m/s, where the vehicle was slower when it was last heard
_LONGEST = 60.0  # s, for which an old report limits the places of the vehicle
_AGREED_NS = 1_000_000_000  # of reports that agree with each other, until a jump is accepted
_NO_SPEED = 32_767  # of an int16 that is not filled


@dataclass(frozen=True, eq=False)
class PlaceReport:
    """GLOBAL_POSITION_INT."""

    boot_ns: int  # the autopilot's clock
    place: Place
    velocity_ned: F64  # (3,) m/s

    def at(self, boot_ns: int) -> Place:
        """Return the place extrapolated by its velocity to another instant of the autopilot's clock."""
        north, east, down = self.velocity_ned * ((boot_ns - self.boot_ns) * 1e-9)
        place = self.place
        return Place(
            place.latitude + north / METRES_PER_DEGREE,
            place.longitude + east / metres_per_degree_east(place),
            place.altitude_msl - down,
            place.above_home - down,
        )


def place_of(latitude: int, longitude: int, altitude: int, above_home: int) -> Place | None:
    """Return a place of MAVLink's integers, 1e-7 degrees and mm; None: they are no place, or not filled.

    A latitude and longitude of exactly 0 are sent while the position is unknown.
    """
    off_earth = abs(latitude) > 90e7 or abs(longitude) > 180e7 or max(abs(altitude), abs(above_home)) > HIGHEST * 1e3
    if off_earth or (latitude == 0 and longitude == 0):
        return None
    return Place(latitude * 1e-7, longitude * 1e-7, altitude * 1e-3, above_home * 1e-3)


def report_of(m: Any) -> PlaceReport | None:
    """Return a GLOBAL_POSITION_INT as a report; None: its numbers are impossible or not filled."""
    place, speeds = place_of(m.lat, m.lon, m.alt, m.relative_alt), (m.vx, m.vy, m.vz)
    if place is None or max(map(abs, speeds)) >= _NO_SPEED:
        return None
    return PlaceReport(m.time_boot_ms * 1_000_000, place, np.array(speeds) * 1e-2)


class PlaceWatch:
    """Accepts a report that the vehicle can have flown to, and a jump once reports have agreed on it for a second.

    An estimator may begin anew somewhere else: a jump must not be rejected for ever.
    """

    def __init__(self) -> None:
        self._believed: PlaceReport | None = None
        self._doubted: PlaceReport | None = None  # the newest after a jump
        self._since_ns = 0  # the first one that it agrees with
        self.jumps = 0  # number of accepted jumps: reports before one do not fit those after it

    @property
    def doubts(self) -> bool:
        """True if the newest reports contradict the accepted ones."""
        return self._doubted is not None

    def believes(self, new: PlaceReport) -> bool:
        """Take a report; False: it must not be used."""
        if self._believed is None or _can_follow(self._believed, new):
            self._believed, self._doubted = new, None
            return True
        if self._doubted is None or not _can_follow(self._doubted, new):
            self._since_ns = new.boot_ns
        self._doubted = new
        if new.boot_ns - self._since_ns < _AGREED_NS:
            return False
        self._believed, self._doubted = new, None
        self.jumps += 1
        return True


def _can_follow(old: PlaceReport, new: PlaceReport) -> bool:
    """True if a vehicle that reported the old place can be at the new one."""
    dt = min(abs(new.boot_ns - old.boot_ns) * 1e-9, _LONGEST)
    speed = max(float(np.linalg.norm(old.velocity_ned)), _FASTEST)
    expected = old.at(old.boot_ns + round(dt * 1e9))
    return metres_between(expected, new.place) <= _MARGIN + speed * dt
