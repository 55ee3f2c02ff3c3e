"""PX4's log, `.ulg`, read by pyulog."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from alight.arrays import F64
from alight.flight.autopilot import border
from alight.flight.logs.logged import AutopilotLog
from alight.records import InputError, MissingExtraError
from alight.sources.logged_stream import LoggedStream

TOPICS = (
    "vehicle_attitude", "vehicle_global_position", "vehicle_local_position", "vehicle_gps_position", "sensor_gps",
    "sensor_combined",
)  # fmt: skip


def read_ulog(path: Path) -> AutopilotLog:
    """Read a log of PX4.

    Raises:
        InputError: the file is not a log of PX4, or is damaged.
        MissingExtraError: pyulog is not installed.
    """
    try:
        from pyulog import ULog
    except ImportError as e:
        raise MissingExtraError("pyulog", "logs") from e
    try:
        with path.open("rb") as file:
            log = ULog(file, list(TOPICS), disable_str_exceptions=True)
    except OSError:
        raise
    except Exception as e:  # damaged bytes can make the library raise any exception
        raise InputError(f"{path}: no log of PX4 ({' '.join(str(e).split())}); copy it again") from e
    topics: dict[str, dict[str, Any]] = {}
    for entry in sorted(log.data_list, key=lambda d: -int(d.multi_id)):
        topics[entry.name] = entry.data  # the first instance overwrites the others
    gps = topics.get("vehicle_gps_position") or topics.get("sensor_gps") or {}
    local, place = topics.get("vehicle_local_position", {}), topics.get("vehicle_global_position", {})
    inertial = topics.get("sensor_combined", {})
    return AutopilotLog(
        _stream("vehicle_attitude", topics.get("vehicle_attitude", {}), _indexed("q", 4)),
        _stream("vehicle_global_position", place, ("lat", "lon", "alt")),
        _stream("vehicle_local_position", local, ("vx", "vy", "vz")),
        _accuracy(place, local),
        _stream("sensor_combined", inertial, _indexed("gyro_rad", 3)),
        _stream("sensor_combined", inertial, _indexed("accelerometer_m_s2", 3)),
        _separations(gps),
    )


def _indexed(name: str, count: int) -> list[str]:
    return [f"{name}[{k}]" for k in range(count)]


def _stream(name: str, data: dict[str, Any], fields: Sequence[str]) -> LoggedStream:
    """Return the stream of the columns `fields` of a topic; `data`: its columns by name. Empty if one is missing."""
    if any(f not in data for f in ("timestamp", *fields)):
        return LoggedStream(name, values=np.empty((0, len(fields))))
    return LoggedStream.of(name, np.asarray(data["timestamp"], np.int64) * 1000, *(data[f] for f in fields))


def _accuracy(place: dict[str, Any], local: dict[str, Any]) -> LoggedStream:
    where, speed = _stream("", place, ("eph", "epv")), _stream("", local, ("evh",)).in_order
    if not len(where.t_ns):
        return LoggedStream(values=np.empty((0, 3)))
    return LoggedStream("accuracies", where.t_ns, np.concatenate([where.values, speed.at(where.t_ns)], axis=1))


def _separations(gps: dict[str, Any]) -> F64:
    """Return the separations, (N,) metres, from the receiver's topic, `gps`: columns by name. Empty without heights.

    Heights are in metres since PX4 1.14, in millimetres before.
    """
    for ellipsoid, msl, unit in (("altitude_ellipsoid_m", "altitude_msl_m", 1.0), ("alt_ellipsoid", "alt", 1e-3)):
        if ellipsoid in gps and msl in gps:
            fixed = np.asarray(gps.get("fix_type", np.full(len(gps[msl]), 3))) >= 3
            heights = (np.asarray(gps[name], np.float64)[fixed] * unit for name in (ellipsoid, msl))
            return np.array([border.separation_of(a, b) if a else np.nan for a, b in zip(*heights, strict=True)])
    return np.empty(0)
