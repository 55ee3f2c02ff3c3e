"""Flight log: EuRoC's folders plus `nav0`, the autopilot's GPS/INS solution (formats/flight-log.md)."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from alight.arrays import I64
from alight.records import Event, Frame, InputError
from alight.settings import Settings
from alight.sources.calibrated_folder import CalibratedFolder
from alight.sources.images import UNREADABLE, image_size
from alight.sources.streams import (
    Table,
    imu_samples,
    nav_samples,
    read_names,
    read_table,
    read_trajectory,
    usable_imu,
    usable_nav,
)


@dataclass(frozen=True)
class Exposure:
    """One exposure: its time and the image file of each camera; None for a camera without an image."""

    t_ns: int
    names: tuple[str | None, ...]


class FlightLog(CalibratedFolder):
    """One flight on disk.

    Raises:
        InputError: cam0 or its images are missing, or the calibration is invalid.
    """

    def __init__(self, root: Path, settings: Settings) -> None:
        super().__init__(root, settings)
        self._nav = self._read_nav()
        self._imu = self._read_imu()
        self._exposures = self._read_exposures()[settings.sources.skip :: settings.sources.every]
        if not self._exposures:
            raise InputError(f"{root}: no exposure is left; lower sources.skip ({settings.sources.skip})")
        self.length = len(self._exposures)
        shift = round(1e9 * settings.motion.filter.time_offset)
        stamps = np.array([e.t_ns - shift for e in (self._exposures[0], self._exposures[-1])])
        self._nav = self._overlapping(self._nav, "nav0 (GPS/INS)", stamps)
        self._imu = self._overlapping(self._imu, "imu0", stamps)
        self.truth_trajectory = read_trajectory(self._root, self.findings)
        self._note(self._nav is not None, self._imu is not None)

    def events(self) -> Iterator[Event]:
        streams: list[Iterator[Event]] = [
            nav_samples(self._nav, self.local) if self._nav else iter(()),
            imu_samples(self._imu) if self._imu else iter(()),
            self._frames(),
        ]
        return heapq.merge(*streams, key=lambda event: event.t_ns)  # equal times in the order of this list

    def _table(self, stream: str) -> Table | None:
        """Return all rows of `nav0` or `imu0`, in order of time; None: the recording has none."""
        return read_table(self._root, stream, self.findings)

    def _where(self, stream: str, file: str = "data.csv") -> str:
        """Return the start of an error message about a stream."""
        return str(self._root / stream / file)

    def _size_of(self, cam: str, name: str) -> tuple[int, int] | None:
        """Return (width, height) of a stored image; None if it cannot be read."""
        with suppress(*UNREADABLE):
            return image_size(self._image_path(cam, name))
        return None

    def _read_nav(self) -> Table | None:
        """Return the usable rows of `nav0`, or None; raise InputError if the world's origin is far from the rows."""
        nav = usable_nav(self._table("nav0"), self.findings)
        if nav is None:
            if self.georeferenced:
                self.findings.warn("nav0 has no usable row: there is no GPS/INS, so the flight's place is not known")
            return None
        known = np.isfinite(nav.values[:, :3])
        if known.all(axis=1).any():
            place = nav.values[known.all(axis=1), :3]
            east, north, up = np.abs(np.median(self.local.to_enu(*place.T), axis=0)) / 1e3
            if max(east, north) > 100.0 or up > 10.0:
                raise InputError(
                    f"{self._where('nav0', 'sensor.yaml')}: origin is {np.hypot(east, north):,.0f} km away from the "
                    f"rows of nav0/data.csv and {up:,.1f} km above or below; write a place of this flight"
                )
        if low := int((known[:, 0] & known[:, 1] & ~known[:, 2]).sum()):
            self.findings.warn(
                f"nav0: {low} rows have latitude and longitude, but no height, so they are no position; write metres "
                "above the WGS84 ellipsoid"
            )
        return nav

    def _read_imu(self) -> Table | None:
        imu = usable_imu(self._table("imu0"), self._body_from_imu, self.findings)
        force = 9.8 if imu is None else float(np.median(np.linalg.norm(imu.values[:, 3:], axis=1)))
        if not 3.0 <= force <= 30.0:  # gravity and manoeuvres
            self.findings.warn(
                f"imu0: half of its accelerations are below {force:.3g} m/s^2, and an aircraft measures about 9.8; "
                "write m/s^2 with gravity in them"
            )
        return imu

    def _read_exposures(self) -> list[Exposure]:
        ahead = zip(self.rig.cameras, self._ahead_ns, strict=True)
        streams = [[(t_ns - late, name) for t_ns, name in self._images(c.name)] for c, late in ahead]
        if not streams[0]:
            why = self.findings.loss("cam0 images") or "it has no row"
            raise InputError(
                f"{self._where('cam0', '')}: no image of data.csv is there ({why}); write lines of "
                "'timestamp [ns],filename', and put the images into cam0/data/"
            )
        for cam, stream in zip(self.rig.cameras, streams, strict=True):
            self._check_size(cam.name, (cam.camera.width, cam.camera.height), stream)
        stamps = [np.array([t for t, _ in s], dtype=np.int64) for s in streams]
        if len(stamps[0]) > 1 and (gap := float(np.median(np.diff(stamps[0])))) < 1e9 / 400.0:  # 400 exposures per s
            raise InputError(
                f"{self._where('cam0')}: its images are {gap / 1e6:.2g} ms apart, as of no camera; write "
                "the times of all streams in nanoseconds"
            )
        for k in range(1, len(streams)):
            if streams[k] and (why := _no_overlap(self.rig.cameras[k].name, stamps[k], "cam0", stamps[0])):
                self.findings.warn(why)
                streams[k] = []
        exposures, between = group_exposures(streams)
        if between:
            self.findings.warn(f"the cameras do not expose together: paired images are {between / 1e6:.1f} ms apart")
        for k in range(1, len(streams)):
            if streams[k] and not any(e.names[0] and e.names[k] for e in exposures):
                self.findings.warn(
                    f"{self.rig.cameras[k].name} never exposes together with cam0: no pair of images shows one moment"
                )
        return exposures

    def _overlapping(self, table: Table | None, name: str, stamps: I64) -> Table | None:
        """Return the table of the stream `name`; None, with a warning, if it has no time in common with the images."""
        if table is None or not (why := _no_overlap(name, table.t_ns, "the images", stamps)):
            return table
        self.findings.warn(why)
        return None

    def _images(self, cam: str) -> list[tuple[int, str]]:
        """Return (ns, name) of the images in folder `cam`; record missing ones as lost, except at the start and end."""
        table, group = self._root / cam / "data.csv", f"{cam} images"
        if not table.is_file():
            raise InputError(f"{table}: missing, or no plain file; write lines of 'timestamp [ns],filename'")
        rows = read_names(table, group, self.findings)
        there = [self._image_path(cam, name).is_file() for _, name in rows]
        first, last = (there.index(True), len(there) - there[::-1].index(True)) if any(there) else (0, len(rows))
        if last - first < len(rows):
            self.notes[f"{cam} excerpt"] = f"rows {first + 1} to {last} of {len(rows)} have images"
            self.findings.expect(group, self.findings.counts[group] - len(rows) + last - first)
        for (_, name), here in zip(rows[first:last], there[first:last], strict=True):
            if not here:
                exists = self._image_path(cam, name).exists()
                self.findings.lose(group, name, "it is no plain file" if exists else "the file is missing")
        return [row for row, here in zip(rows, there, strict=True) if here]

    def _check_size(self, cam: str, size: tuple[int, int], stream: list[tuple[int, str]]) -> None:
        """Raise InputError if the first readable image of `stream` (ns, name) does not have the calibrated `size`."""
        sizes = ((name, real) for _, name in stream if (real := self._size_of(cam, name)) is not None)
        name, real = next(sizes, ("", size))
        if real != size:
            raise InputError(
                f"{self._where(cam, 'sensor.yaml')}: resolution is {size[0]}x{size[1]} but {name} is "
                f"{real[0]}x{real[1]}; write the calibration of these images"
            )

    def _frames(self) -> Iterator[Frame]:
        for exposure in self._exposures:
            images = tuple(self._image(k, name) for k, name in enumerate(exposure.names))
            if any(image is not None for image in images):
                yield Frame(exposure.t_ns, images, next(n for n in exposure.names if n))


def group_exposures(streams: Sequence[Sequence[tuple[int, str]]]) -> tuple[list[Exposure], int]:
    """Group images into exposures: equal times first, then the nearest time within half a frame period.

    Args:
        streams: (time ns, file name) rows in order of time, for each camera.

    Returns:
        Exposures in order of time, including those with a single image, and the largest time difference in ns between
        images that were paired.
    """
    found: dict[int, list[str | None]] = {t: [name] + [None] * (len(streams) - 1) for t, name in streams[0]}
    apart = 0
    for k, stream in enumerate(streams[1:], 1):
        times = np.array(sorted(found), dtype=np.int64)
        tolerance = int(np.median(np.diff(times))) // 2 if len(times) > 1 else 0
        for t, name in sorted(stream, key=lambda row: row[0] not in found):  # equal times come first
            i = int(np.searchsorted(times, t))
            around = times[max(i - 1, 0) : i + 1]
            partner = int(around[np.argmin(np.abs(around - t))])
            if abs(partner - t) < max(tolerance, 1) and found[partner][k] is None:
                found[partner][k] = name
                apart = max(apart, abs(partner - t))
            else:
                found.setdefault(t, [None] * len(streams))[k] = name
    return [Exposure(t, tuple(found[t])) for t in sorted(found)], apart


def _no_overlap(name: str, times: I64, other: str, others: I64) -> str:
    """Return a warning if the times (N,) and (M,), ns, of two streams do not overlap; empty if they do.

    A gap of up to two seconds is accepted, because recorders do not start at the same time.
    """
    after, before = (int(times[0]) - int(others[-1])) / 1e9, (int(others[0]) - int(times[-1])) / 1e9
    if max(after, before) <= 2.0:
        return ""
    where = f"begins {after:,.1f} s after the end" if after > 2.0 else f"ends {before:,.1f} s before the beginning"
    return f"the clocks do not meet: {name} {where} of {other}, so {name} is left out; stamp both by one clock"
