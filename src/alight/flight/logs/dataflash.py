"""ArduPilot's log, `.bin`, read by pymavlink."""

from __future__ import annotations

import io
import re
from collections import defaultdict
from contextlib import ExitStack, redirect_stderr, redirect_stdout
from pathlib import Path

import numpy as np

from alight.arrays import F64
from alight.flight.autopilot import border
from alight.flight.logs.logged import AutopilotLog, quaternions
from alight.records import FIX_3D, InputError, MissingExtraError
from alight.sources.logged_stream import LoggedStream

MAGIC = b"\xa3\x95"  # bytes before each message
FIELDS = {  # fields to read, by message
    "ATT": ("Roll", "Pitch", "Yaw"), "POS": ("Lat", "Lng", "Alt"),
    "IMU": ("GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ"),
    "XKF1": ("VN", "VE", "VD"), "NKF1": ("VN", "VE", "VD"), "GPA": ("HAcc", "VAcc", "SAcc", "Und", "AEl"),
    "GPS": ("Status", "Spd", "GCrs", "VZ", "Lat", "Lng", "Alt"),
}  # fmt: skip


def read_dataflash(path: Path) -> AutopilotLog:
    """Read a log of ArduPilot: its first IMU, first receiver and first core of the estimator.

    Raises:
        InputError: the file is not a log of ArduPilot, or is damaged.
        MissingExtraError: pymavlink is not installed.
    """
    try:
        from pymavlink import DFReader
    except ImportError as e:
        raise MissingExtraError("pymavlink", "logs") from e
    with path.open("rb") as file:
        if file.read(2) != MAGIC:
            raise InputError(f"{path}: no log of ArduPilot; give a .bin of its data flash")
    rows: dict[str, list[tuple[float, ...]]] = defaultdict(list)
    is_novatel = False
    with ExitStack() as stack:
        for redirect in (redirect_stderr, redirect_stdout):  # the library prints what it skips
            stack.enter_context(redirect(io.StringIO()))
        try:
            log = DFReader.DFReader_binary(str(path), zero_time_base=False)
            stack.callback(log.filehandle.close)
            stack.callback(log.data_map.close)
            while (m := log.recv_match(type=[*FIELDS, "MSG"], strict=True)) is not None:
                if (name := m.get_type()) == "MSG":
                    is_novatel = is_novatel or re.match("GPS 1: .*NOVA", m.Message) is not None
                    continue
                if getattr(m, "I", 0) or getattr(m, "C", 0):
                    continue
                rows[name].append((m.TimeUS, *(float(getattr(m, f, np.nan)) for f in FIELDS[name])))
        except OSError:
            raise
        except Exception as e:  # damaged bytes can make the library raise any exception
            raise InputError(f"{path}: no log of ArduPilot ({' '.join(str(e).split())}); copy it again") from e
    return _log_of(rows, is_novatel)


def _log_of(rows: dict[str, list[tuple[float, ...]]], is_novatel: bool) -> AutopilotLog:
    def stream(name: str) -> LoggedStream:
        table = np.array(rows[name], np.float64).reshape(-1, 1 + len(FIELDS[name]))
        return LoggedStream(name, np.round(table[:, 0] * 1e3).astype(np.int64), table[:, 1:])

    angles, inertial, gps, accuracy = stream("ATT"), stream("IMU"), stream("GPS"), stream("GPA")
    gps = gps.where(gps.values[:, 0] >= FIX_3D)
    position, velocity = stream("POS"), stream("XKF1" if rows["XKF1"] else "NKF1")
    if not len(position.t_ns):
        position = LoggedStream("GPS", gps.t_ns, gps.values[:, 4:7])
    if not len(velocity.t_ns):
        speed, course, down = gps.values[:, 1:4].T
        course = np.radians(course)
        velocity = LoggedStream.of("GPS", gps.t_ns, speed * np.cos(course), speed * np.sin(course), down)
    return AutopilotLog(
        LoggedStream.of("ATT", angles.t_ns, *quaternions(*np.radians(angles.values).T)), position, velocity,
        LoggedStream("GPA", accuracy.t_ns, accuracy.values[:, :3]),
        LoggedStream("IMU", inertial.t_ns, inertial.values[:, :3]),
        LoggedStream("IMU", inertial.t_ns, inertial.values[:, 3:]),
        np.empty(0) if is_novatel else _separations(gps, accuracy),
    )  # fmt: skip


def _separations(gps: LoggedStream, accuracy: LoggedStream) -> F64:
    """Return the separation, metres, at each row of `accuracy` (GPA), by its undulation or its ellipsoidal altitude.

    `gps`: stream of GPS messages, for the altitude above the sea. ArduPilot's undulation is this altitude minus the
    ellipsoidal height; only its driver for NovAtel's receivers has the opposite sign.
    """
    undulation, ellipsoid = accuracy.values[:, 3:].T
    _, at, of_gps = np.intersect1d(accuracy.t_ns, gps.t_ns, return_indices=True)
    msl = np.full(len(undulation), np.nan)
    msl[at] = gps.values[of_gps, 6]
    undulation = np.where(np.isfinite(undulation), undulation, msl - ellipsoid)
    return np.array([border.separation_of(-u, 0.0) for u in undulation])
