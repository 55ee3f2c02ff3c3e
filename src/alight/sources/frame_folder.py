"""A folder with frames of one camera and its calibration, as exported from a bag or a film."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from alight.geometry import Camera, Pose
from alight.records import InputError, Rig, RigCamera
from alight.settings import Settings
from alight.sources.calibration import load_yaml, read_camchain, rig_camera
from alight.sources.flight_log import FlightLog
from alight.sources.frame_times import frame_times
from alight.sources.image_formats import PLAIN

FRAMES = (*PLAIN, ".bmp")


def frames_in(root: Path) -> list[Path]:
    """Return the sorted pictures of a folder or, if it has none, of its first sub-folder with pictures."""
    for folder in (root, *sorted(p for p in root.iterdir() if p.is_dir())):
        if found := sorted(p for p in folder.iterdir() if p.suffix.lower() in FRAMES and not p.name.startswith(".")):
            return found
    return []


class FrameFolder(FlightLog):
    """Frames of one camera.

    The calibration is the `sensor.yaml` of a flight log's camera, or Kalibr's camchain with `T_cam_imu`. It lies next
    to the frames or is given as `sources.calibration`.

    Raises:
        InputError: the frames have no calibration with a mounting, or no times.
    """

    def __init__(self, root: Path, settings: Settings) -> None:
        self._files = {p.name: p for p in frames_in(root)}
        self._rate = settings.sources.rate
        super().__init__(root, settings)

    def _image_path(self, cam: str, name: str) -> Path:
        return self._files[name]

    def _images(self, cam: str) -> list[tuple[int, str]]:
        folder = next(iter(self._files.values())).parent
        found = frame_times(folder, list(self._files), self._rate)
        self.findings.expect(f"{cam} images", len(self._files))
        for name in sorted(self._files.keys() - {name for _, name in found.rows}):
            self.findings.lose(f"{cam} images", name, f"it has no time in {found.source}")
        self.notes["frame_times"] = found.source
        return found.rows

    def _read_rig(self, settings: Settings) -> Rig:
        sizes = (size for name in self._files if (size := self._size_of("cam0", name)) is not None)
        width, height = next(sizes, (0, 0))
        if not width:
            raise InputError(f"{self._root}: not one frame can be read; copy them again")
        if (self._root / "sensor.yaml").is_file():
            rig = Rig((replace(rig_camera(self._root), name="cam0"),))
            self.notes["focal_from"] = "sensor.yaml"
        else:
            rig = Rig((RigCamera("cam0", Camera(width, height, width, width, width / 2, height / 2), Pose()),))
        given = settings.sources.calibration
        path = Path(given).expanduser() if given else self._camchain()
        if path is None and "focal_from" in self.notes:
            return rig
        if path is None:
            raise InputError(
                f"{self._root}: the frames have no calibration; put Kalibr's camchain.yaml with T_cam_imu, or the "
                "sensor.yaml of a flight log's camera, beside them"
            )
        if "focal_from" not in self.notes and "T_cam_imu" not in dict(load_yaml(path).get("cam0") or {}):
            raise InputError(f"{path}: cam0.T_cam_imu is missing; write the mounting of the camera in the vehicle")
        self.notes["focal_from"] = f"Kalibr {path.name}"
        return read_camchain(path, rig, Pose())

    def _camchain(self) -> Path | None:
        """Return the first YAML file next to the frames that holds a camera in Kalibr's form; None if there is none."""
        for path in sorted(p for s in ("*.yaml", "*.yml") for p in self._root.glob(s)):
            with suppress(InputError):  # a file of another kind
                if isinstance(load_yaml(path).get("cam0"), dict):
                    return path
        return None
