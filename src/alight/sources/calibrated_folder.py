"""Calibration in a folder in the layout of a flight log (formats/flight-log.md)."""

from __future__ import annotations

import re
from contextlib import suppress
from dataclasses import fields
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from alight.arrays import F64, U8
from alight.geometry import LocalFrame, Pose
from alight.records import InputError, Rig
from alight.settings import ImuNoise, Settings
from alight.sources.calibration import (
    body_from_sensor,
    load_yaml,
    numbers,
    origin,
    read_camchain,
    read_time_shifts,
    rig_camera,
)
from alight.sources.image_formats import Levels, levels_of
from alight.sources.images import UNREADABLE, read_header, read_image
from alight.sources.source import Source

IMU_NOISE = (1e-9, 1e3)  # lower and upper limit, in the units of imu0/sensor.yaml


class CalibratedFolder(Source):
    """Calibration in a folder in the layout of a flight log: cameras, IMU, and the origin of the world.

    Raises:
        InputError: cam0 is missing, or the calibration is invalid.
    """

    no_place = (
        "nav0 is missing: there is no GPS/INS, so heights and places are relative and nothing can be put on a map"
    )

    def __init__(self, root: Path, settings: Settings) -> None:
        super().__init__()
        self._root = root / "mav0" if (root / "mav0").is_dir() else root
        self.name = self._root.parent.name if self._root.name == "mav0" else root.name
        stated = self._read_origin()
        self.georeferenced, self.local = stated is not None, stated or LocalFrame(0.0, 0.0, 0.0)
        self._body_from_imu = self._read_imu_pose()
        self._levels: dict[str, Levels | None] = {}
        self.rig = self._read_rig(settings)
        self._ahead_ns = self._read_time_shifts(settings)  # ns per camera, stamps ahead of the IMU's clock

    def locate(self, local: LocalFrame) -> None:
        """Set the world's origin, which the GPS/INS of another source gives."""
        self.local, self.georeferenced = local, True
        self.notes["nav"] = True

    @property
    def warnings(self) -> list[str]:
        """What could not be read, with reasons, one sentence each."""
        return [*(() if self.georeferenced else [self.no_place]), *self.findings.warnings]

    def _note(self, nav: bool, imu: bool) -> None:
        lens = self.rig.cameras[0].camera
        self.notes.setdefault("focal_from", "sensor.yaml of cam0")
        self.notes |= {
            "cameras": [c.name for c in self.rig.cameras], "image_size": [lens.width, lens.height],
            "focal_px": [round(lens.fu, 2), round(lens.fv, 2)], "nav": nav, "imu": imu,
        }  # fmt: skip

    def _image_path(self, cam: str, name: str) -> Path:
        return self._root / cam / "data" / name

    def _image(self, index: int, name: str | None, unfinished: bool = False) -> U8 | None:
        """Decode the image `name` of the camera with the index `index`; None if `name` is None.

        An image that cannot be read gives None as well, and is recorded as lost.

        Raises:
            ValueError: the image cannot be read, and `unfinished` is set because it may still be written.
        """
        if name is None:
            return None
        cam = self.rig.cameras[index]
        path = self._image_path(cam.name, name)
        try:
            return read_image(path, (cam.camera.width, cam.camera.height), self._levels_of(cam.name, path))
        except ValueError as e:
            if unfinished:
                raise
            self.findings.lose(f"{cam.name} images", name, str(e))
            return None

    def _levels_of(self, cam: str, path: Path) -> Levels | None:
        """Return the levels of camera `cam` for images like `path`; None if they have eight bits or cannot be read.

        Levels come from a sample of the images in the folder of `path`. Sensors of 10 or 12 bits are stored in 16, of
        which the upper eight would be nearly black.
        """
        if cam in self._levels:
            return self._levels[cam]
        with suppress(*UNREADABLE):
            deep = read_header(path).bits > 8
            found = levels_of(sorted(path.parent.glob(f"*{path.suffix}"))) if deep else None
            if found or not deep:
                self._levels[cam] = found
            if found:
                self.notes.setdefault("levels", {})[cam] = f"{found.low:g} to {found.high:g} become 0 to 255"
            return found
        return None

    def _read_origin(self) -> LocalFrame | None:
        """Return the origin of the world; None: the recording has no place on Earth."""
        return origin(self._root / "nav0/sensor.yaml") if (self._root / "nav0").is_dir() else None

    def _read_imu_pose(self) -> Pose:
        path = self._root / "imu0" / "sensor.yaml"
        if not path.parent.is_dir():
            return Pose()
        tree = load_yaml(path)
        stated = [f.name for f in fields(ImuNoise) if f.name in tree]
        self.imu_noise = ImuNoise(**{k: float(numbers({k: [tree[k]]}, k, (1,), f"{path}: ")[0]) for k in stated})
        least, most = IMU_NOISE
        for name in stated:
            if not least <= getattr(self.imu_noise, name) <= most:
                raise InputError(f"{path}: {name} is {tree[name]!r:.40}; give a number from {least:g} to {most:g}")
        self.notes["imu_noise"] = self.imu_noise.stated()
        pose = body_from_sensor(tree, path)
        if (arm := float(np.linalg.norm(pose.translation))) > 0.02:
            self.findings.warn(f"imu0 sits {arm:.2f} m from the body's origin: its accelerations are taken as if there")
        return pose

    def _read_time_shifts(self, settings: Settings) -> list[int]:
        """Return the ns by which each camera's stamps are ahead of the IMU's clock, by Kalibr and the settings.

        A camera without a shift gets the first given shift, or 0 if the exposures of the two then coincide better.
        """
        cameras, given = len(self.rig.cameras), settings.motion.filter.time_offset
        path = settings.sources.calibration
        shifts = read_time_shifts(Path(path).expanduser(), cameras) if path else {}
        if not shifts:
            return [0] * cameras
        first, shift = next(iter(shifts.items()))
        for k in (k for k in range(cameras) if k not in shifts):
            shifts[k] = shift if self._apart(k, first, 0.0) <= self._apart(k, first, shift) else 0.0
            self.findings.warn(
                f"timeshift_cam_imu is missing for cam{k}: {shifts[k]:+.4f} s is used, with which its exposures meet "
                f"those of cam{first}"
            )
        ahead = [-shifts[k] for k in range(cameras)]
        if given:
            self.findings.warn(
                f"motion.filter.time_offset={given:g} is used instead of timeshift_cam_imu, by which cam0 is "
                f"{ahead[0]:+.4f} s ahead; set it to 0 to use the calibration's"
            )
            ahead = [a - ahead[0] for a in ahead]
        else:
            self.notes["timeshift_cam_imu"] = [-a for a in ahead]
        return [round(1e9 * a) for a in ahead]

    def _apart(self, camera: int, other: int, shift: float) -> float:
        """Return the median time in ns from each stamp of `camera` to the nearest stamp of `other`, two camera indices.

        The stamps of `other` are first moved by `shift` seconds. 0 if a camera has too few stamps.
        """
        own, others = (self._stamps(self.rig.cameras[k].name)[:, None] for k in (camera, other))
        if not len(own) or len(others) < 2:
            return 0.0
        return float(np.median(cKDTree(others + 1e9 * shift).query(own)[0]))

    def _stamps(self, cam: str) -> F64:
        """Return the stamps of a camera, (N,) ns."""
        table = self._root / cam / "data.csv"
        lines = table.read_text("utf-8", "replace").splitlines() if table.is_file() else []
        return np.array([float(text) for line in lines if (text := line.partition(",")[0].strip()).isdecimal()])

    def _read_rig(self, settings: Settings) -> Rig:
        numbered = (p for p in self._root.glob("cam*") if re.fullmatch("cam[0-9]+", p.name))
        folders = sorted((p for p in numbered if p.is_dir()), key=lambda p: (len(p.name), p.name))
        if not folders or folders[0].name != "cam0":
            raise InputError(
                f"{self._root}: there is no cam0; a flight log needs cam0/sensor.yaml, cam0/data.csv and cam0/data/"
            )
        rig = Rig(tuple(rig_camera(f) for f in folders))
        if settings.sources.calibration is None:
            return rig
        path = Path(settings.sources.calibration).expanduser()
        self.notes["focal_from"] = f"Kalibr {path.name}"
        return read_camchain(path, rig, self._body_from_imu)
