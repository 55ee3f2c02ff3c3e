"""MAVLink telemetry as GPS/INS: messages in, `NavSample` and `ImuSample` out."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np

from alight.arrays import F64
from alight.flight.autopilot import border
from alight.flight.autopilot.clock import VehicleClock
from alight.flight.autopilot.place_watch import report_of
from alight.flight.autopilot.vehicle_state import gps_quality
from alight.geometry import LocalFrame, slerp, so3_exp
from alight.records import FIX_3D, GpsQuality, ImuSample, NavSample, is_absolute

_MILLI = 1e-3
_GAP_NS = 300_000_000  # between two attitudes, at most, to turn from one to the other
_REACH_NS = 100_000_000  # from an attitude, at most, to turn on at its rate
_IMU = ("HIGHRES_IMU", "RAW_IMU", "SCALED_IMU")  # the best first
_WAITING = 20  # positions that wait for an attitude


@dataclass(frozen=True, eq=False)
class _Attitude:
    boot_ns: int
    world_from_body: F64
    rates: F64  # FLU


@dataclass(frozen=True)
class _Fix:
    boot_ns: int
    message: Any


class TelemetryEvents:
    """Rows of GPS/INS from the autopilot's own solution, with its receiver's accuracies, on our clock.

    A row is made for each GLOBAL_POSITION_INT with the attitude of the same instant, interpolated. It leaves as soon as
    an attitude of a later instant has come. HIGHRES_IMU, RAW_IMU (as ArduPilot scales it) or SCALED_IMU become IMU
    samples: the first of these that comes, as the others repeat it with less. No sample is given out before TIMESYNC
    has tied the clocks.

    Args:
        local: the world; None: made at the first good position.
        separation: metres, ellipsoid minus sea level; None: the receiver's (`alt_ellipsoid`). MAVLink's
            altitudes are above sea level, and without either no position is given out.
    """

    def __init__(self, local: LocalFrame | None = None, separation: float | None = None) -> None:
        self.local = local
        self._given_separation = separation
        self._gps: GpsQuality | None = None
        self._flags: int | None = None
        self._attitudes: deque[_Attitude] = deque(maxlen=10)
        self._waiting: deque[_Fix] = deque()
        self._imu_rank = len(_IMU)  # of the best kind that has come
        self.starts = 1  # number of the autopilot's start that these events belong to

    @property
    def missing(self) -> str:
        """Reason why no position is given out; empty: nothing is missing."""
        if self._gps is None or self._gps.fix < FIX_3D:
            return "the autopilot's GPS has no 3D fix"
        if self._flags is not None and not is_absolute(self._flags):
            return "the autopilot's estimator has no absolute position"
        if self._separation is None:
            return "height above the ellipsoid: GPS_RAW_INT has no alt_ellipsoid; give the geoid's separation"
        return ""

    @property
    def _separation(self) -> float | None:
        if self._given_separation is not None:
            return self._given_separation
        found = self._gps.separation if self._gps is not None else float("nan")
        return found if np.isfinite(found) else None

    def forget(self, starts: int) -> None:
        """Begin anew after a restart of the autopilot; the world stays.

        Args:
            starts: number of the autopilot's starts so far.
        """
        self.starts = starts
        self._gps = self._flags = None
        self._imu_rank = len(_IMU)
        self._attitudes.clear()
        self._waiting.clear()

    def feed(self, name: str, message: Any, clock: VehicleClock) -> list[NavSample | ImuSample]:
        """Take a message of the vehicle; return the samples that are complete now, in order."""
        if name in _IMU:
            rank = _IMU.index(name)
            if rank > self._imu_rank:
                return []
            self._imu_rank = rank
        take = getattr(self, f"_{name.lower()}", None)
        found: ImuSample | None = None if take is None else take(message, clock)
        return [*self._complete(clock), *([] if found is None else [found])]

    def _gps_raw_int(self, m: Any, clock: VehicleClock) -> None:
        self._gps = gps_quality(m)

    def _ekf_status_report(self, m: Any, clock: VehicleClock) -> None:
        self._flags = int(m.flags)

    def _estimator_status(self, m: Any, clock: VehicleClock) -> None:
        self._flags = int(m.flags)

    def _global_position_int(self, m: Any, clock: VehicleClock) -> None:
        self._waiting.append(_Fix(m.time_boot_ms * 1_000_000, m))

    def _attitude_quaternion(self, m: Any, clock: VehicleClock) -> None:
        self._turn(m, border.world_from_body_of_quaternion([m.q1, m.q2, m.q3, m.q4]))

    def _attitude(self, m: Any, clock: VehicleClock) -> None:
        self._turn(m, border.world_from_body_of_angles(m.roll, m.pitch, m.yaw))

    def _turn(self, m: Any, world_from_body: F64 | None) -> None:
        rates = border.flu(m.rollspeed, m.pitchspeed, m.yawspeed)
        if world_from_body is None or not np.isfinite(rates).all():
            return
        new = _Attitude(m.time_boot_ms * 1_000_000, world_from_body, rates)
        if not self._attitudes or new.boot_ns > self._attitudes[-1].boot_ns:
            self._attitudes.append(new)

    def _highres_imu(self, m: Any, clock: VehicleClock) -> ImuSample | None:
        rates, force = border.flu(m.xgyro, m.ygyro, m.zgyro), border.flu(m.xacc, m.yacc, m.zacc)
        return self._imu(m.time_usec * 1000, rates, force, clock)

    def _scaled_imu(self, m: Any, clock: VehicleClock) -> ImuSample | None:
        return self._milli_imu(m.time_boot_ms * 1_000_000, m, clock)

    def _raw_imu(self, m: Any, clock: VehicleClock) -> ImuSample | None:
        return self._milli_imu(m.time_usec * 1000, m, clock)

    def _milli_imu(self, boot_ns: int, m: Any, clock: VehicleClock) -> ImuSample | None:
        rates = border.flu(m.xgyro, m.ygyro, m.zgyro) * _MILLI
        return self._imu(boot_ns, rates, border.flu(m.xacc, m.yacc, m.zacc) * (_MILLI * border.GRAVITY), clock)

    def _imu(self, boot_ns: int, rates: F64, force: F64, clock: VehicleClock) -> ImuSample | None:
        if not (clock.known and np.isfinite(rates).all() and np.isfinite(force).all()):
            return None
        return ImuSample(clock.ours_ns(boot_ns), rates, force)

    def _complete(self, clock: VehicleClock) -> list[NavSample]:
        newest = self._attitudes[-1].boot_ns if self._attitudes else -1
        out = []
        while self._waiting and (self._waiting[0].boot_ns <= newest or len(self._waiting) > _WAITING):
            fix = self._waiting.popleft()
            if clock.known:
                out.append(self._sample(fix, clock))
        return out

    def _sample(self, fix: _Fix, clock: VehicleClock) -> NavSample:
        m, gps = fix.message, self._gps or GpsQuality()
        attitude = self._attitude_at(fix.boot_ns)
        return NavSample(
            clock.ours_ns(fix.boot_ns),
            self._position(m),
            None if attitude is None else attitude.world_from_body,
            border.enu(m.vx, m.vy, m.vz) * 1e-2,
            None if attitude is None else attitude.rates,
            sigma_position=_sigmas(gps.horizontal, gps.vertical),
            sigma_velocity=_sigmas(gps.speed, gps.speed),
        )

    def _position(self, m: Any) -> F64 | None:
        separation, report = self._separation, report_of(m)
        if self.missing or separation is None or report is None:
            return None
        at = (report.place.latitude, report.place.longitude, report.place.altitude_msl + separation)
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
    """Sigmas (3,) of east, north, up, in the unit given; None: not reported."""
    known = np.isfinite([horizontal, vertical]).all()
    return np.array([horizontal, horizontal, vertical]) if known else None
