"""The flight log: EuRoC's folders plus `nav0`, the autopilot's GPS/INS solution (formats/flight-log.md)."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from alight.arrays import I64, U8
from alight.records import Event, Frame, InputError
from alight.settings import Settings
from alight.sources.calibrated_folder import CalibratedFolder
from alight.sources.clocks import apart, said_apart
from alight.sources.exposures import Exposure, group_exposures
from alight.sources.images import UNREADABLE, image_size, read_image
from alight.sources.streams import (
    Table,
    imu_samples,
    median_force,
    nav_samples,
    read_imu,
    read_nav,
    read_trajectory,
    without_height,
)
from alight.sources.tables import read_names

FASTEST_CAMERA = 400.0  # exposures a second
WEIGHT = (3.0, 30.0)  # m/s^2, the median force on an aircraft: gravity, and some turns
FARTHEST = (100.0, 10.0)  # km that a flight may be from its origin, across and up: heights are single precision


class FlightLog(CalibratedFolder):
    """One flight on disk.

    Raises:
        InputError: no cam0, no image of it, or an invalid calibration.
    """

    def __init__(self, root: Path, settings: Settings) -> None:
        super().__init__(root, settings)
        self._nav = read_nav(self._root, self._findings)
        if self._nav is not None:
            self._check_origin(self._nav)
        if self._nav is not None and (low := without_height(self._nav)):
            self._findings.say(
                f"nav0: {low} rows have latitude and longitude, but no height, so they are no position; write metres "
                "above the WGS84 ellipsoid"
            )
        if self.georeferenced and self._nav is None:
            self._findings.say("nav0 has no usable row: there is no GPS/INS, so the flight's place is not known")
        self._imu = read_imu(self._root, self._body_from_imu, self._findings)
        if self._imu is not None and not WEIGHT[0] <= (force := median_force(self._imu)) <= WEIGHT[1]:
            self._findings.say(
                f"imu0: half of its accelerations are below {force:.3g} m/s^2, and an aircraft measures about 9.8; "
                "write m/s^2 with gravity in them"
            )
        self._exposures = self._read_exposures()[settings.sources.skip :: settings.sources.every]
        if not self._exposures:
            raise InputError(f"{root}: no exposure is left; lower sources.skip ({settings.sources.skip})")
        self.length = len(self._exposures)
        shift = round(1e9 * settings.motion.filter.time_offset)
        stamps = np.array([e.t_ns - shift for e in (self._exposures[0], self._exposures[-1])])
        self._nav = self._meeting(self._nav, "nav0 (GPS/INS)", stamps)
        self._imu = self._meeting(self._imu, "imu0", stamps)
        self.truth_trajectory = read_trajectory(self._root, self._findings)
        self._note(self._nav is not None, self._imu is not None)

    def events(self) -> Iterator[Event]:
        streams: list[Iterator[Event]] = [
            nav_samples(self._nav, self.local) if self._nav else iter(()),
            imu_samples(self._imu) if self._imu else iter(()),
            self._frames(),
        ]
        return heapq.merge(*streams, key=lambda event: event.t_ns)  # ties in the order of this list

    def _check_origin(self, nav: Table) -> None:
        """Refuse an origin that is farther than `FARTHEST` from this flight."""
        place = nav.values[np.isfinite(nav.values[:, :3]).all(axis=1), :3]
        if not len(place):
            return
        east, north, up = np.abs(np.median(self.local.to_enu(*place.T), axis=0)) / 1e3
        if max(east, north) > FARTHEST[0] or up > FARTHEST[1]:
            raise InputError(
                f"{self._root / 'nav0' / 'sensor.yaml'}: origin is {np.hypot(east, north):,.0f} km away from the rows "
                f"of nav0/data.csv and {up:,.1f} km above or below; write a place of this flight"
            )

    def _read_exposures(self) -> list[Exposure]:
        streams = [self._images(c.name) for c in self.rig.cameras]
        if not streams[0]:
            why = self._findings.loss("cam0 images") or "it has no row"
            raise InputError(
                f"{self._root / 'cam0'}: no image of data.csv is there ({why}); write lines of "
                "'timestamp [ns],filename', and put the images into cam0/data/"
            )
        for cam, stream in zip(self.rig.cameras, streams, strict=True):
            self._check_size(cam.name, (cam.camera.width, cam.camera.height), stream)
        stamps = [np.array([t for t, _ in s], dtype=np.int64) for s in streams]
        if len(stamps[0]) > 1 and (gap := float(np.median(np.diff(stamps[0])))) * FASTEST_CAMERA < 1e9:
            raise InputError(
                f"{self._root / 'cam0' / 'data.csv'}: its images are {gap / 1e6:.2g} ms apart, as of no camera; write "
                "the times of all streams in nanoseconds"
            )
        for k in range(1, len(streams)):
            if streams[k] and (gap := apart(stamps[k], stamps[0])):
                self._findings.say(said_apart(self.rig.cameras[k].name, gap, "cam0"))
                streams[k] = []
        exposures, between = group_exposures(streams)
        if between:
            self._findings.say(f"the cameras do not expose together: paired images are {between / 1e6:.1f} ms apart")
        for k in range(1, len(streams)):
            if streams[k] and not any(e.names[0] and e.names[k] for e in exposures):
                self._findings.say(
                    f"{self.rig.cameras[k].name} never exposes together with cam0: no pair of images shows one moment"
                )
        return exposures

    def _meeting(self, table: Table | None, name: str, stamps: I64) -> Table | None:
        """Return a stream, or None, with a warning, if it does not overlap with the images in time."""
        if table is None or not (gap := apart(table.t_ns, stamps)):
            return table
        self._findings.say(said_apart(name, gap, "the images"))
        return None

    def _images(self, cam: str) -> list[tuple[int, str]]:
        """The images of a camera that exist; rows without image at the ends mean an excerpt, not a loss."""
        table, group = self._root / cam / "data.csv", f"{cam} images"
        if not table.is_file():
            raise InputError(f"{table}: missing, or no plain file; write lines of 'timestamp [ns],filename'")
        rows = read_names(table, group, self._findings)
        there = [(self._root / cam / "data" / name).is_file() for _, name in rows]
        first, last = (there.index(True), len(there) - there[::-1].index(True)) if any(there) else (0, len(rows))
        if last - first < len(rows):
            self.notes[f"{cam} excerpt"] = f"rows {first + 1} to {last} of {len(rows)} have images"
            self._findings.expect(group, self._findings.counts[group] - len(rows) + last - first)
        for (_, name), here in zip(rows[first:last], there[first:last], strict=True):
            if not here:
                there_is = (self._root / cam / "data" / name).exists()
                self._findings.lose(group, name, "it is no plain file" if there_is else "the file is missing")
        return [row for row, here in zip(rows, there, strict=True) if here]

    def _check_size(self, cam: str, size: tuple[int, int], stream: list[tuple[int, str]]) -> None:
        """Refuse a calibration for images of another size; the first readable image is compared."""
        for _, name in stream:
            try:
                real = image_size(self._root / cam / "data" / name)
            except UNREADABLE:
                continue
            if real != size:
                raise InputError(
                    f"{self._root / cam / 'sensor.yaml'}: resolution is {size[0]}x{size[1]} but {name} is "
                    f"{real[0]}x{real[1]}; write the calibration of these images"
                )
            return

    def _frames(self) -> Iterator[Frame]:
        for exposure in self._exposures:
            images = tuple(self._image(k, name) for k, name in enumerate(exposure.names))
            if any(image is not None for image in images):
                yield Frame(exposure.t_ns, images, next(n for n in exposure.names if n))

    def _image(self, index: int, name: str | None) -> U8 | None:
        if name is None:
            return None
        cam = self.rig.cameras[index]
        try:
            return read_image(self._root / cam.name / "data" / name, (cam.camera.width, cam.camera.height))
        except ValueError as e:
            self._findings.lose(f"{cam.name} images", name, str(e))
            return None
