"""The calibration in a folder in the layout of a flight log (formats/flight-log.md)."""

from __future__ import annotations

import re
from dataclasses import fields
from pathlib import Path
from typing import Any, Literal

import numpy as np

from alight.geometry import LocalFrame, Pose
from alight.records import InputError, Rig
from alight.settings import ImuNoise, Settings
from alight.sources.sensors import body_from_sensor, load_yaml, numbers, origin, rig_camera
from alight.sources.source import Findings, RecordedSource, Trajectory

NOISE = (1e-9, 1e3)  # of an IMU, in the units of imu0/sensor.yaml
NO_NAV = "nav0 is missing: there is no GPS/INS, so heights and places are relative and nothing can be put on a map"


class CalibratedFolder(RecordedSource):
    """Calibration in a folder in the layout of a flight log: cameras, IMU, the origin of the world.

    Raises:
        InputError: no cam0, or an invalid calibration.
    """

    kind: Literal["flight"] = "flight"
    truth_trajectory: Trajectory | None = None

    def __init__(self, root: Path, settings: Settings) -> None:
        self._findings, self.length = Findings(), 0
        self._root = root / "mav0" if (root / "mav0").is_dir() else root
        self.name = self._root.parent.name if self._root.name == "mav0" else root.name
        self.notes: dict[str, Any] = {}
        self.imu_noise = ImuNoise()
        self.local, self.georeferenced = self._origin()
        self._body_from_imu = self._read_imu_pose()
        self.rig = self._read_rig(settings, self._body_from_imu)

    def locate(self, local: LocalFrame) -> None:
        """Set the world's origin from GPS/INS of another source."""
        self.local, self.georeferenced = local, True
        self.notes["nav"] = True

    @property
    def warnings(self) -> list[str]:
        """Items that could not be read, with the reasons."""
        return [*(() if self.georeferenced else [NO_NAV]), *self._findings.warnings]

    def _note(self, nav: bool, imu: bool) -> None:
        lens = self.rig.cameras[0].camera
        self.notes.setdefault("focal_from", "sensor.yaml of cam0")
        self.notes |= {
            "cameras": [c.name for c in self.rig.cameras],
            "image_size": [lens.width, lens.height],
            "focal_px": [round(lens.fu, 2), round(lens.fv, 2)],
            "nav": nav,
            "imu": imu,
        }

    def _origin(self) -> tuple[LocalFrame, bool]:
        if (self._root / "nav0").is_dir():
            return origin(self._root / "nav0" / "sensor.yaml"), True
        return LocalFrame(0.0, 0.0, 0.0), False

    def _read_imu_pose(self) -> Pose:
        if not (self._root / "imu0").is_dir():
            return Pose()
        path = self._root / "imu0" / "sensor.yaml"
        tree = load_yaml(path)
        stated = (f.name for f in fields(ImuNoise) if f.name in tree)
        self.imu_noise = ImuNoise(**{k: float(numbers(tree | {k: [tree[k]]}, k, (1,), path)[0]) for k in stated})
        for name in (f.name for f in fields(ImuNoise)):
            if name in tree and not NOISE[0] <= getattr(self.imu_noise, name) <= NOISE[1]:
                raise InputError(
                    f"{path}: {name} is {tree[name]!r:.40}; give a number from {NOISE[0]:g} to {NOISE[1]:g}"
                )
        self.notes["imu_noise"] = self.imu_noise.stated()
        pose = body_from_sensor(tree, path)
        if (arm := float(np.linalg.norm(pose.translation))) > 0.02:
            self._findings.say(f"imu0 sits {arm:.2f} m from the body's origin: its accelerations are taken as if there")
        return pose

    def _read_rig(self, settings: Settings, body_from_imu: Pose) -> Rig:
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
        from alight.sources.kalibr import read_camchain

        return read_camchain(path, rig, body_from_imu)
