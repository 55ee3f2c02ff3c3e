"""The flight log: EuRoC's folders plus `nav0`, the autopilot's GPS/INS solution (formats/flight-log.md)."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from alight.geometry import LocalFrame, Pose, matrix_from_quaternion
from alight.records import U8, Event, Frame, ImuSample, InputError, NavSample, Rig
from alight.settings import Settings
from alight.sources.exposures import Exposure, group_exposures
from alight.sources.images import UNREADABLE, image_size, read_image
from alight.sources.kalibr import read_camchain
from alight.sources.sensors import body_from_sensor, load_yaml, origin, rig_camera
from alight.sources.source import Findings, Trajectory
from alight.sources.tables import Times, read_names, read_numbers

F64 = NDArray[np.float64]


class FlightLog:
    """One flight on disk.

    Raises:
        InputError: no cam0, no image of it, or a calibration that is none.
    """

    kind: Literal["flight"] = "flight"

    def __init__(self, root: Path, settings: Settings) -> None:
        self._findings = Findings()
        self._root = root / "mav0" if (root / "mav0").is_dir() else root
        self.name = self._root.parent.name if self._root.name == "mav0" else root.name
        self.notes: dict[str, Any] = {}
        self.local, self.georeferenced = self._origin()
        self._nav = self._read_nav()
        self._imu = self._read_imu()
        self.rig = self._read_rig(settings)
        self._exposures = self._read_exposures()[settings.sources.skip :: settings.sources.every]
        if not self._exposures:
            raise InputError(f"{root}: no exposure is left; lower sources.skip ({settings.sources.skip})")
        self.length = len(self._exposures)
        self.truth_trajectory = self._read_truth()
        self._note()

    @property
    def counts(self) -> dict[str, int]:
        return {**self._findings.counts, "exposures": self.length}

    @property
    def warnings(self) -> list[str]:
        return self._findings.warnings

    def events(self) -> Iterator[Event]:
        streams: list[Iterator[Event]] = [self._nav_samples(), self._imu_samples(), self._frames()]
        return heapq.merge(*streams, key=lambda event: event.t_ns)

    # -- opening

    def _origin(self) -> tuple[LocalFrame, bool]:
        if (self._root / "nav0").is_dir():
            return origin(self._root / "nav0" / "sensor.yaml"), True
        self._findings.say(
            "nav0 is missing: there is no GPS/INS, so heights and places are relative and nothing can be put on a map"
        )
        return LocalFrame(0.0, 0.0, 0.0), False

    def _table(self, stream: str, columns: tuple[int, ...]) -> tuple[Times, F64, list[int]] | None:
        path = self._root / stream / "data.csv"
        if not path.is_file():
            return None
        table = read_numbers(path, columns, f"{stream} rows", self._findings)
        return table if len(table[0]) else None

    def _read_nav(self) -> tuple[Times, F64] | None:
        table = self._table("nav0", (23,))
        if table is None:
            if self.georeferenced:
                self._findings.say("nav0 has no usable row: there is no GPS/INS, so the flight has no place on a map")
            return None
        t, values, lines = table
        good = np.ones(len(t), dtype=bool)
        for i, why in self._bad_nav(values):
            good[i] = False
            self._findings.lose("nav0 rows", f"line {lines[i]}", why)
        return t[good], values[good]

    @staticmethod
    def _bad_nav(values: F64) -> Iterator[tuple[int, str]]:
        with np.errstate(invalid="ignore"):
            off = (np.abs(values[:, 0]) > 90) | (np.abs(values[:, 1]) > 360)
            norm = np.linalg.norm(values[:, 3:7], axis=1)
            bent = np.abs(norm - 1) > 0.05
            negative = (values[:, 13:22] < 0).any(axis=1)
        for bad, why in (
            (off, "latitude or longitude is no place on Earth"),
            (bent, "the quaternion is not of unit length"),
            (negative, "a sigma is negative"),
        ):
            yield from ((int(i), why) for i in np.flatnonzero(bad))

    def _read_imu(self) -> tuple[Times, F64] | None:
        table = self._table("imu0", (7,))
        path = self._root / "imu0" / "sensor.yaml"
        self._body_from_imu = body_from_sensor(load_yaml(path), path) if path.is_file() else Pose()
        if table is None:
            return None
        t, values, lines = table
        bad = ~np.isfinite(values).all(axis=1)
        for i in np.flatnonzero(bad):
            self._findings.lose("imu0 rows", f"line {lines[i]}", "a field is empty")
        arm = float(np.linalg.norm(self._body_from_imu.translation))
        if arm > 0.02:
            self._findings.say(f"imu0 sits {arm:.2f} m from the body's origin: its accelerations are used as if there")
        values = np.concatenate(
            [values[~bad, :3] @ self._body_from_imu.rotation.T, values[~bad, 3:] @ self._body_from_imu.rotation.T], 1
        )
        return t[~bad], values

    def _read_rig(self, settings: Settings) -> Rig:
        folders = sorted((p for p in self._root.glob("cam[0-9]*") if p.is_dir()), key=lambda p: (len(p.name), p.name))
        if not folders or folders[0].name != "cam0":
            raise InputError(
                f"{self._root}: there is no cam0; a flight log needs cam0/sensor.yaml, cam0/data.csv, cam0/data/"
            )
        rig = Rig(tuple(rig_camera(f) for f in folders))
        if settings.sources.calibration:
            path = Path(settings.sources.calibration).expanduser()
            self.notes["calibration"] = f"Kalibr {path.name}"
            return read_camchain(path, rig, self._body_from_imu)
        return rig

    def _read_exposures(self) -> list[Exposure]:
        streams = [self._images(c.name) for c in self.rig.cameras]
        if not streams[0]:
            raise InputError(f"{self._root / 'cam0'}: no image of data.csv is there; put the images into cam0/data/")
        exposures, apart = group_exposures(streams)
        if apart:
            self._findings.say(
                f"the cameras do not expose together: paired images are up to {apart / 1e6:.1f} ms apart"
            )
        return exposures

    def _images(self, cam: str) -> list[tuple[int, str]]:
        """The images of a camera that exist; what an excerpt leaves out at its ends is no loss."""
        table, group = self._root / cam / "data.csv", f"{cam} images"
        if not table.is_file():
            raise InputError(f"{table}: missing; write lines of 'timestamp [ns],filename'")
        rows = read_names(table, group, self._findings)
        there = [(self._root / cam / "data" / name).is_file() for _, name in rows]
        if any(there):
            first, last = there.index(True), len(there) - there[::-1].index(True)
            if last - first < len(rows):
                self.notes[f"{cam} excerpt"] = f"rows {first + 1} to {last} of {len(rows)} have images"
                self._findings.expect(group, self._findings.counts[group] - len(rows) + last - first)
            for (_, name), here in zip(rows[first:last], there[first:last], strict=True):
                if not here:
                    self._findings.lose(group, name, "the file is missing")
        found = [row for row, here in zip(rows, there, strict=True) if here]
        self._check_size(cam, found)
        return found

    def _check_size(self, cam: str, found: list[tuple[int, str]]) -> None:
        lens = next(c.camera for c in self.rig.cameras if c.name == cam)
        for _, name in found:
            try:
                size = image_size(self._root / cam / "data" / name)
            except UNREADABLE:
                continue
            if size != (lens.width, lens.height):
                raise InputError(
                    f"{self._root / cam / 'sensor.yaml'}: resolution is {lens.width}x{lens.height} but {name} is "
                    f"{size[0]}x{size[1]}; write the calibration of these images"
                )
            return

    def _read_truth(self) -> Trajectory | None:
        table = self._table("state_groundtruth_estimate0", (17, 8))
        if table is None:
            return None
        t, values, lines = table
        keep: list[int] = []
        poses: list[Pose] = []
        for i, row in enumerate(values[:, :7]):
            try:
                if not np.isfinite(row).all():
                    raise ValueError("a field is empty")
                poses.append(Pose.from_quaternion(row[3:], row[:3]))
                keep.append(i)
            except ValueError as e:
                self._findings.lose("state_groundtruth_estimate0 rows", f"line {lines[i]}", str(e))
        return (t[keep], poses) if poses else None

    def _note(self) -> None:
        lens = self.rig.cameras[0].camera
        self.notes |= {
            "cameras": [c.name for c in self.rig.cameras],
            "image_size": [lens.width, lens.height],
            "focal_px": [round(lens.fu, 2), round(lens.fv, 2)],
            "focal_from": self.notes.get("calibration", "sensor.yaml of cam0"),
            "nav": self._nav is not None,
            "imu": self._imu is not None,
        }

    # -- streaming

    def _nav_samples(self) -> Iterator[Event]:
        if self._nav is None:
            return
        t, v = self._nav
        position = self.local.to_enu(v[:, 0], v[:, 1], v[:, 2])
        for i in range(len(t)):
            q = _measured(v[i, 3:7])
            yield NavSample(
                int(t[i]),
                _measured(position[i]),
                None if q is None else matrix_from_quaternion(q),
                _measured(v[i, 7:10]),
                _measured(v[i, 10:13]),
                _sigma(v[i, 13:16]),
                _sigma(v[i, 16:19]),
                _sigma(v[i, 19:22]),
            )

    def _imu_samples(self) -> Iterator[Event]:
        if self._imu is None:
            return
        t, v = self._imu
        for i in range(len(t)):
            yield ImuSample(int(t[i]), v[i, :3].copy(), v[i, 3:].copy())

    def _frames(self) -> Iterator[Event]:
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


def _measured(values: F64) -> F64 | None:
    return values.copy() if np.isfinite(values).all() else None


def _sigma(values: F64) -> F64 | None:
    return values.copy() if np.isfinite(values).all() and (values > 0).all() else None
