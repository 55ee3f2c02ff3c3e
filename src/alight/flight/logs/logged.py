"""The streams of an autopilot's log in its own units, and the tables of GPS/INS and IMU made from them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from alight.arrays import F64
from alight.flight.autopilot import border
from alight.geometry import LocalFrame, Pose
from alight.records import InputError
from alight.sources.logged_stream import LoggedStream, attitude_at
from alight.sources.source import Findings
from alight.sources.streams import Table, usable_imu, usable_nav

RESET = 1.0  # s; a clock that goes back by more was restarted


@dataclass(frozen=True, eq=False)
class AutopilotLog:
    """Streams of one log between two boots of the autopilot: NED and FRD, altitudes above sea level."""

    attitude: LoggedStream  # w, x, y, z of ned_from_frd
    position: LoggedStream  # latitude, longitude [degrees], altitude above the sea [m]
    velocity: LoggedStream  # north, east, down [m/s]
    accuracy: LoggedStream  # horizontal, vertical [m], speed [m/s]; 1-sigma, NaN: not reported
    gyroscope: LoggedStream  # x, y, z [rad/s]
    accelerometer: LoggedStream  # x, y, z [m/s^2], at the times of the gyroscope
    separations: F64  # (N,) m, ellipsoidal height minus altitude above the sea; NaN: not reported

    @property
    def length(self) -> float:
        """Seconds from the first position to the last; 0 without positions."""
        t = self.position.t_ns
        return float(t.max() - t.min()) * 1e-9 if len(t) else 0.0


@dataclass(frozen=True, eq=False)
class LoggedFlight:
    """A log as tables of GPS/INS and IMU with the columns of a flight log, stamped by the autopilot's clock."""

    local: LocalFrame  # origin at the first position
    nav: Table
    imu: Table | None
    found: tuple[str, ...]  # one line per stream: messages, rows, rate, span


def quaternions(roll: F64, pitch: F64, yaw: F64) -> list[F64]:
    """Return the quaternion columns w, x, y, z, (N,) each, of roll, pitch and yaw (N,) in radians."""
    q = Rotation.from_euler("ZYX", np.stack([yaw, pitch, roll], axis=-1)).as_quat()
    return [q[:, 3], q[:, 0], q[:, 1], q[:, 2]]


def streams_of(log: AutopilotLog, path: str, separation: float | None, findings: Findings) -> LoggedFlight:
    """Convert a log to the tables of GPS/INS and IMU.

    Args:
        log: the log in the autopilot's units.
        path: name of the file, for messages.
        separation: ellipsoidal height minus altitude above the sea, metres; None: as reported by the receiver.
        findings: collects warnings and the numbers of rejected rows.

    Raises:
        InputError: the log has no position or no attitude, or its heights are above sea level only.
    """
    attitude, position, velocity, accuracy = (
        stream.in_order for stream in (log.attitude, log.position, log.velocity, log.accuracy)
    )
    position = position.where(np.asarray((position.values[:, :2] != 0).any(axis=1)))  # latitude and longitude 0: no fix
    for stream, what in ((position, "position on Earth"), (attitude, "attitude")):
        if len(stream.t_ns) < 3:
            raise InputError(f"{path}: logs no {what}; give the log of a flight with GPS")
    known = log.separations[np.isfinite(log.separations)]
    if separation is None and not len(known):
        raise InputError(
            f"{path}: logs heights above the sea alone; set sources.separation=METRES from the sea to the ellipsoid "
            "there, as a geoid calculator gives it"
        )
    apart = float(np.median(known)) if separation is None else separation
    t = position.t_ns
    imu = _imu_table(log)
    used = None if imu is None else usable_imu(imu, Pose(), findings)
    rates = np.full((len(t), 3), np.nan)
    if used is not None and (used.t_ns[0] > t[-1] or used.t_ns[-1] < t[0]):
        findings.warn(f"{path}: its IMU is stamped by another clock than its position and is left out")
        used = None
    if used is not None:
        rates = LoggedStream("", used.t_ns, used.values[:, :3]).at(t)
    sigma = accuracy.in_order.at(t)
    values = np.concatenate([
        position.values[:, :2], position.values[:, 2:] + apart, _enu_from_flu(attitude_at(attitude, t)),
        border.enu(*velocity.at(t).T).T, rates, sigma[:, [0, 0, 1]], np.full((len(t), 3), np.nan), sigma[:, [2, 2, 2]],
    ], axis=1)  # fmt: skip
    nav = usable_nav(Table(t, values, list(range(1, len(t) + 1))), findings)
    if nav is None:
        raise InputError(f"{path}: logs no usable position ({findings.loss('nav0 rows')})")
    streams = (attitude, position, velocity, accuracy, log.gyroscope)
    found = [line for s in streams if (line := _line(s))]
    origin = "the receiver" if separation is None else "sources.separation"
    origin += f"; the receiver has {np.median(known):+.1f} m" if separation is not None and len(known) else ""
    found.append(f"ellipsoid above sea level: {apart:+.1f} m, by {origin}")
    return LoggedFlight(LocalFrame(*nav.values[0, :3].tolist()), nav, used, tuple(found))


def _imu_table(log: AutopilotLog) -> Table | None:
    gyro, force = log.gyroscope, log.accelerometer
    if not len(gyro.t_ns):
        return None
    values = np.concatenate([border.flu(*gyro.values.T).T, border.flu(*force.values.T).T], axis=1)
    both = LoggedStream(gyro.name, gyro.t_ns, values).in_order
    return Table(both.t_ns, both.values, list(range(1, len(both.t_ns) + 1))) if len(both.t_ns) else None


def _enu_from_flu(ned_from_frd: F64) -> F64:
    """Convert quaternions w, x, y, z, (M, 4), from NED and FRD; NaN stays NaN."""
    out, known = np.full(ned_from_frd.shape, np.nan), np.isfinite(ned_from_frd).all(axis=1)
    if known.any():
        turns = Rotation.from_quat(np.roll(ned_from_frd[known], -1, axis=1)).as_matrix()
        out[known] = np.roll(Rotation.from_matrix(border.world_from_body_of(turns)).as_quat(), 1, axis=1)
    return out


def _line(stream: LoggedStream) -> str:
    if len(stream.t_ns) < 2:
        return ""
    span = float(stream.t_ns[-1] - stream.t_ns[0]) * 1e-9
    rate = 1e9 / float(np.median(np.diff(stream.t_ns)).clip(1))
    start = 1e-9 * float(stream.t_ns[0])
    return f"{stream.name}: {len(stream.t_ns)} rows, {rate:.0f} Hz, from {start:.1f} s for {span:.1f} s"
