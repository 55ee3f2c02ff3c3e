"""Frames and an autopilot's log next to them as one source, on the clock of the log."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from alight.checks.clock_offset import ClockOffset, offset_of_frames
from alight.checks.evidence import ImuTable, NavTable
from alight.flight.logs.logged import AutopilotLog, LoggedFlight, streams_of
from alight.records import Event, Frame, InputError
from alight.settings import Settings
from alight.sources.calibrated_folder import CalibratedFolder
from alight.sources.source import Source
from alight.sources.streams import imu_samples, nav_samples


def read_log(path: Path) -> AutopilotLog:
    """Read an autopilot's log in the format that the suffix of its name gives.

    Raises:
        InputError: the suffix is of no PX4, ArduPilot or ground station log, or the log is damaged.
    """
    kind = path.suffix.lower()
    if kind == ".ulg":
        from alight.flight.logs.ulog import read_ulog

        return read_ulog(path)
    if kind == ".bin":
        from alight.flight.logs.dataflash import read_dataflash

        return read_dataflash(path)
    if kind == ".tlog":
        from alight.flight.logs.telemetry_log import read_telemetry_log

        return read_telemetry_log(path)
    raise InputError(f"{path}: no log of an autopilot; give a file that ends in .ulg, .bin or .tlog")


def log_tables(log: LoggedFlight) -> tuple[NavTable, ImuTable]:
    """Return the GPS/INS and the IMU of a log as tables for `alight.checks.clock_offset`."""
    nav = NavTable.of(list(nav_samples(log.nav, log.local)))
    if log.imu is None:
        return nav, ImuTable.of([])
    return nav, ImuTable(log.imu.t_ns, log.imu.values[:, :3], log.imu.values[:, 3:])


class LoggedFrames(Source):
    """A source of frames with the GPS/INS and IMU of an autopilot's log.

    Args:
        frames: the frames with their calibration, stamped by their own clock.
        path: the log.

    Raises:
        InputError: the log cannot be used, or the offset between the two clocks is unclear.
    """

    georeferenced = True

    def __init__(self, frames: CalibratedFolder, path: Path, settings: Settings) -> None:
        super().__init__()
        if settings.motion.filter.time_offset:
            raise InputError(f"{path}: motion.filter.time_offset is for one clock; set sources.time_offset instead")
        self._frames, self.findings = frames, frames.findings
        self._log = streams_of(read_log(path), str(path), settings.sources.separation, self.findings)
        frames.locate(self._log.local)
        self.name, self.rig, self.local, self.length = frames.name, frames.rig, self._log.local, frames.length
        offset = self._offset(path, settings.sources.time_offset)
        self._offset_ns = round(1e9 * offset.seconds)
        sigma = f" +- {offset.sigma:.4f}" if offset.sigma else ""  # 0: given
        self.notes = frames.notes | {
            "nav": True, "imu": self._log.imu is not None, "log": [
                *(f"{path.name}: {line}" for line in self._log.found),
                f"frames: {self.length}, times from {frames.notes.get('frame_times', 'data.csv')}, "
                f"{offset.seconds:+.4f}{sigma} s ahead of {path.name}",
            ],
        }  # fmt: skip

    def events(self) -> Iterator[Event]:
        streams: list[Iterator[Event]] = [
            nav_samples(self._log.nav, self.local),
            imu_samples(self._log.imu) if self._log.imu else iter(()),
            (replace(frame, t_ns=frame.t_ns - self._offset_ns) for frame in self._exposures()),
        ]
        return heapq.merge(*streams, key=lambda event: event.t_ns)  # at equal times in the order of this list

    def _exposures(self) -> Iterator[Frame]:
        return (event for event in self._frames.events() if isinstance(event, Frame))

    def _offset(self, path: Path, given: float | None) -> ClockOffset:
        if given is not None:
            return ClockOffset(given, 0.0)
        found = offset_of_frames(self.rig, self._exposures(), *log_tables(self._log))
        if found.unclear:
            raise InputError(
                f"{path}: the offset between the clocks of frames and log is not clear: {found.unclear}; set "
                "sources.time_offset=SECONDS by which the frames are ahead (0: one clock)"
            )
        return found
