"""MAVLink telemetry as GPS/INS: messages in, `NavSample` and `ImuSample` out."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.constants import g, milli

from alight.arrays import F64
from alight.flight.autopilot import border
from alight.flight.autopilot.clock import VehicleClock
from alight.flight.autopilot.positions import place_of, report_of
from alight.flight.autopilot.vehicle_state import attitude_of, gps_quality
from alight.geometry import LocalFrame, slerp, so3_exp
from alight.records import FIX_3D, GpsQuality, ImuSample, NavSample, Place, is_absolute

_GAP_NS = 300_000_000  # longest interval between two attitudes that is interpolated
_REACH_NS = 100_000_000  # longest extrapolation of an attitude by its rates
IMU_UNITS = {  # units of the rates, rad/s, and of the force, m/s^2; the best first
    "HIGHRES_IMU": (1.0, 1.0),
    "RAW_IMU": (milli, milli * g),
    "SCALED_IMU": (milli, milli * g),
}


@dataclass(frozen=True, eq=False)
class _Attitude:
    boot_ns: int
    world_from_body: F64
    rates: F64  # FLU


class TelemetryEvents:
    """Makes GPS/INS rows from the autopilot's own solution, and IMU samples, on our clock.

    A row is made for each GLOBAL_POSITION_INT, with the attitude interpolated to the same instant and the receiver's
    accuracies. It is returned once a later attitude has come. IMU samples are made from the best of HIGHRES_IMU,
    RAW_IMU (as ArduPilot scales it) and SCALED_IMU. No sample is returned before TIMESYNC has tied the clocks.

    While the autopilot flies `by_sight`, its position and velocity are our own estimate. Its rows then have only the
    attitude and the height of the barometer, and there is a row with the position of each GPS_RAW_INT.

    Args:
        local: the world frame; None: made at the first good position.
        separation: ellipsoidal height minus altitude above the sea, metres; None: as reported by the receiver
            (`alt_ellipsoid`). If it is unknown, rows have no position, as MAVLink's altitudes are above sea level.
    """

    def __init__(self, local: LocalFrame | None = None, separation: float | None = None) -> None:
        self.local = local
        self._given_separation = math.nan if separation is None else separation
        self._attitudes: deque[_Attitude] = deque(maxlen=10)
        self._waiting: deque[Any] = deque()  # GLOBAL_POSITION_INT; up to 20 wait for an attitude
        self.by_sight = False
        self.restart(1)

    def restart(self, starts: int) -> None:
        """Begin anew after a reboot of the autopilot, but keep the world; `starts` is the number of boots so far."""
        self.starts = starts  # number of the autopilot's boot that these events belong to
        self._gps: GpsQuality | None = None
        self._flags: int | None = None
        self._imu_rank = len(IMU_UNITS)  # rank of the best IMU message that has come
        self._attitudes.clear()
        self._waiting.clear()

    @property
    def missing(self) -> str:
        """Reason why GPS/INS rows have no position, in words; empty: they have one."""
        if self._gps is None or self._gps.fix < FIX_3D:
            return "the autopilot's GPS has no 3D fix"
        if self._flags is not None and not is_absolute(self._flags):
            return "the autopilot's estimator has no absolute position"
        if not math.isfinite(self._separation):
            return "height above the ellipsoid: GPS_RAW_INT has no credible alt_ellipsoid; give the --separation"
        return ""

    @property
    def _separation(self) -> float:
        given, gps = self._given_separation, self._gps
        return given if not math.isnan(given) else math.nan if gps is None else gps.separation

    def feed(self, name: str, message: Any, clock: VehicleClock) -> list[NavSample | ImuSample]:
        """Process a message of the vehicle; see `TelemetryReader.feed`."""
        if name == "GPS_RAW_INT":
            self._gps = gps_quality(message)
        elif name in ("EKF_STATUS_REPORT", "ESTIMATOR_STATUS"):
            self._flags = int(message.flags)
        elif name == "GLOBAL_POSITION_INT":
            self._waiting.append(message)
        elif name in ("ATTITUDE", "ATTITUDE_QUATERNION"):
            self._add_attitude(message)
        received = [] if name != "GPS_RAW_INT" or not self.by_sight else self._received(message, clock)
        return [*self._complete(clock), *received, *self._imu(name, message, clock)]

    def _add_attitude(self, m: Any) -> None:
        (world_from_body, rates), boot_ns = attitude_of(m), m.time_boot_ms * 1_000_000
        if world_from_body is None or not np.isfinite(rates).all():
            return
        if not self._attitudes or boot_ns > self._attitudes[-1].boot_ns:
            self._attitudes.append(_Attitude(boot_ns, world_from_body, rates))

    def _imu(self, name: str, m: Any, clock: VehicleClock) -> list[ImuSample]:
        rank = list(IMU_UNITS).index(name) if name in IMU_UNITS else len(IMU_UNITS)
        if rank == len(IMU_UNITS) or rank > self._imu_rank:
            return []
        self._imu_rank = rank
        boot_ns = m.time_boot_ms * 1_000_000 if name == "SCALED_IMU" else m.time_usec * 1000
        rate_unit, force_unit = IMU_UNITS[name]
        rates, force = border.flu(m.xgyro, m.ygyro, m.zgyro), border.flu(m.xacc, m.yacc, m.zacc)
        if not (clock.known and np.isfinite(rates).all() and np.isfinite(force).all()):
            return []
        return [ImuSample(clock.ours_ns(boot_ns), rates * rate_unit, force * force_unit)]

    def _complete(self, clock: VehicleClock) -> list[NavSample]:
        newest = self._attitudes[-1].boot_ns if self._attitudes else -1
        out = []
        while self._waiting and (self._waiting[0].time_boot_ms * 1_000_000 <= newest or len(self._waiting) > 20):
            m = self._waiting.popleft()
            if clock.known:
                out.append(self._sample(m, clock))
        return out

    def _sample(self, m: Any, clock: VehicleClock) -> NavSample:
        boot_ns, gps = m.time_boot_ms * 1_000_000, self._gps or GpsQuality()
        attitude, report = self._attitude_at(boot_ns), report_of(m)
        world_from_body, rates = (None, None) if attitude is None else (attitude.world_from_body, attitude.rates)
        if self.by_sight:
            height = None if report is None else self._position(report.place)
            up = None if height is None else float(height[2])
            return NavSample(clock.ours_ns(boot_ns), None, world_from_body, None, rates, height_world=up)
        return NavSample(
            clock.ours_ns(boot_ns),
            None if self.missing or report is None else self._position(report.place),
            world_from_body,
            border.enu(m.vx, m.vy, m.vz) * 1e-2,
            rates,
            sigma_position=_sigmas(gps.horizontal, gps.vertical),
            sigma_velocity=_sigmas(gps.speed, gps.speed),
        )

    def _received(self, m: Any, clock: VehicleClock) -> list[NavSample]:
        """Return the row of a GPS_RAW_INT: the receiver's own position."""
        gps, place = self._gps or GpsQuality(), place_of(m.lat, m.lon, m.alt, 0)
        position = None if gps.fix < FIX_3D or place is None else self._position(place)
        if position is None or not clock.known:
            return []
        sigma = _sigmas(gps.horizontal, gps.vertical)
        return [NavSample(clock.ours_ns(m.time_usec * 1000), position, None, sigma_position=sigma)]

    def _position(self, place: Place) -> F64 | None:
        """Return a position in the world, (3,) metres; None: its height above the ellipsoid is unknown."""
        if not math.isfinite(self._separation):
            return None
        at = (place.latitude, place.longitude, place.altitude_msl + self._separation)
        if self.local is None:
            self.local = LocalFrame(*at)
        return self.local.to_enu(*at)

    def _attitude_at(self, boot_ns: int) -> _Attitude | None:
        after = next((a for a in self._attitudes if a.boot_ns >= boot_ns), None)
        before = next((a for a in reversed(self._attitudes) if a.boot_ns <= boot_ns), None)
        if after is not None and before is not None and after.boot_ns - before.boot_ns <= _GAP_NS:
            share = (boot_ns - before.boot_ns) / max(after.boot_ns - before.boot_ns, 1)
            R = slerp(before.world_from_body, after.world_from_body, share)
            return _Attitude(boot_ns, R, before.rates + share * (after.rates - before.rates))
        near = min((a for a in (before, after) if a is not None), key=lambda a: abs(a.boot_ns - boot_ns), default=None)
        if near is None or abs(near.boot_ns - boot_ns) > _REACH_NS:
            return None
        turned = near.world_from_body @ so3_exp(near.rates * ((boot_ns - near.boot_ns) * 1e-9))
        return _Attitude(boot_ns, turned, near.rates)


def _sigmas(horizontal: float, vertical: float) -> F64 | None:
    known = np.isfinite([horizontal, vertical]).all()
    return np.array([horizontal, horizontal, vertical]) if known else None
