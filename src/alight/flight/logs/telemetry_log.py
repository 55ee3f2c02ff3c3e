"""Telemetry recorded by a ground station, `.tlog`: MAVLink messages, each after its time of arrival."""

from __future__ import annotations

from collections import Counter, defaultdict
from pathlib import Path
from typing import Any

import numpy as np

from alight.flight.autopilot.framing import Framing, ReceivedMessage
from alight.flight.autopilot.positions import place_of
from alight.flight.autopilot.telemetry_events import IMU_UNITS
from alight.flight.autopilot.vehicle_state import gps_quality
from alight.flight.logs.logged import RESET, AutopilotLog, quaternions
from alight.records import FIX_3D, InputError
from alight.sources.logged_stream import LoggedStream

USED = ("ATTITUDE", "GLOBAL_POSITION_INT", "GPS_RAW_INT", *IMU_UNITS)
WRAP_NS = 2**32 * 1_000_000  # range of a stamp in milliseconds of 32 bits


def read_telemetry_log(path: Path) -> AutopilotLog:
    """Read the telemetry of one vehicle; if the autopilot booted several times, only the longest part.

    Raises:
        InputError: the file has no message of an autopilot.
    """
    framing, received = Framing(255, 0), list[ReceivedMessage]()
    with path.open("rb") as file:
        while data := file.read(1 << 16):  # the times of arrival are skipped as bytes between frames
            received += [m for m in framing.decode(data, framing.messages) if m.name in USED]
    senders = Counter((m.system, m.component) for m in received if m.name == "ATTITUDE")
    if not senders:
        raise InputError(f"{path}: no attitude of a vehicle in it; give the telemetry (.tlog) of a flight")
    sender = senders.most_common(1)[0][0]
    return max(
        map(_log_of, _starts([m for m in received if (m.system, m.component) == sender])), key=lambda s: s.length
    )


def boot_ns(m: Any) -> int:
    """Return the stamp of a message on the autopilot's clock, ns since boot."""
    return int(m.time_boot_ms) * 1_000_000 if hasattr(m, "time_boot_ms") else int(m.time_usec) * 1000


def _starts(received: list[ReceivedMessage]) -> list[list[tuple[int, ReceivedMessage]]]:
    """Split messages by boots of the autopilot; return (stamp in ns, message) lists, with 32-bit stamps unwrapped."""
    out: list[list[tuple[int, ReceivedMessage]]] = [[]]
    newest, wraps = 0, 0
    for m in received:
        t_ns = boot_ns(m.message)
        if m.name == "ATTITUDE":
            if t_ns + wraps * WRAP_NS < newest - RESET * 1e9:
                wrapped = newest % WRAP_NS > WRAP_NS - 60e9 and t_ns < 60e9
                wraps = wraps + 1 if wrapped else 0
                out += [] if wrapped else [[]]
            newest = t_ns + wraps * WRAP_NS
        out[-1].append((t_ns + (wraps * WRAP_NS if hasattr(m.message, "time_boot_ms") else 0), m))
    return out


def _log_of(start: list[tuple[int, ReceivedMessage]]) -> AutopilotLog:
    rows: dict[str, list[tuple[float, ...]]] = defaultdict(list)
    stamps: dict[str, list[int]] = defaultdict(list)
    separations: list[float] = []
    newest = 0
    for t_ns, received in start:
        m, name = received.message, received.name
        if name == "ATTITUDE":
            newest = t_ns
            row: tuple[float, ...] = (m.roll, m.pitch, m.yaw)
        elif name == "GLOBAL_POSITION_INT":
            place = place_of(m.lat, m.lon, m.alt, m.relative_alt)
            at = (np.nan,) * 3 if place is None else (place.latitude, place.longitude, place.altitude_msl)
            row = (*at, m.vx * 1e-2, m.vy * 1e-2, m.vz * 1e-2)
        elif name == "GPS_RAW_INT":
            gps = gps_quality(m)
            row = (gps.horizontal, gps.vertical, gps.speed)
            separations.append(gps.separation if gps.fix >= FIX_3D else np.nan)
            t_ns = newest  # its stamp may be the time of day
        else:
            rate, force = IMU_UNITS[name]
            row = (*(v * rate for v in (m.xgyro, m.ygyro, m.zgyro)), *(v * force for v in (m.xacc, m.yacc, m.zacc)))
        stamps[name].append(t_ns)
        rows[name].append(row)

    def stream(name: str, width: int) -> LoggedStream:
        return LoggedStream(name, np.array(stamps[name], np.int64), np.array(rows[name], float).reshape(-1, width))

    angles, places, accuracy = stream("ATTITUDE", 3), stream("GLOBAL_POSITION_INT", 6), stream("GPS_RAW_INT", 3)
    inertial = stream(next((name for name in IMU_UNITS if rows[name]), "RAW_IMU"), 6)
    return AutopilotLog(
        LoggedStream.of(angles.name, angles.t_ns, *quaternions(*angles.values.T)),
        LoggedStream(places.name, places.t_ns, places.values[:, :3]),
        LoggedStream(places.name, places.t_ns, places.values[:, 3:]), accuracy.in_order,
        LoggedStream(inertial.name, inertial.t_ns, inertial.values[:, :3]),
        LoggedStream(inertial.name, inertial.t_ns, inertial.values[:, 3:]), np.array(separations),
    )  # fmt: skip
