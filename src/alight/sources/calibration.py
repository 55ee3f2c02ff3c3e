"""Read calibrations (`sensor.yaml`, Kalibr's `camchain.yaml`) and check every number; an error names file and key.

`where` is the beginning of such an error: the file, and what the keys belong to.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from alight.arrays import F64
from alight.documents import LONGEST, DocumentError, parse_yaml, read_bytes
from alight.geometry import Camera, LocalFrame, Pose
from alight.records import InputError, Rig, RigCamera
from alight.sources.source import LARGEST

MODELS = {  # common name of a model: its name in Alight
    "radial-tangential": "radial-tangential", "radtan": "radial-tangential", "plumb_bob": "radial-tangential",
    "equidistant": "equidistant", "none": "none", "None": "none",
}  # fmt: skip
MATRIX_HINT = "write {cols: 4, rows: 4, data: [16 numbers, row by row]} of a rotation and a translation in metres"
KALIBR_HINT = "write four rows of four numbers, as Kalibr does"


def why_no_lens(camera: Camera) -> str | None:
    """Return why a lens is impossible, for example by a typing error or damaged tags; None if it is possible."""
    wide = max(camera.width, camera.height)
    for f in (camera.fu, camera.fv):
        if not 0.05 * wide <= f <= 100 * wide:
            return f"a focal length of {f:g} pixels for images {camera.width} pixels wide"
    for c in (camera.cu, camera.cv):
        if not -wide <= c <= 2 * wide:
            return f"a principal point at {c:g} pixels in images {camera.width} pixels wide"
    worst = max(camera.distortion, key=abs, default=0.0)
    return f"a distortion of {worst:g}" if abs(worst) > 1e4 else None


def load_yaml(path: Path) -> dict[str, Any]:
    """Read a mapping from a YAML file, also in OpenCV's dialect.

    Raises:
        InputError: the file does not exist, is not YAML, or holds no mapping.
    """
    try:
        text = read_bytes(path, LONGEST).decode("utf-8-sig", errors="replace")
        lines = [line for line in text.splitlines() if not line.startswith("%")]  # %YAML:1.0 is OpenCV's, not YAML's
        tree = parse_yaml("\n".join(lines).replace("!!opencv-matrix", ""))
    except OSError as e:
        raise InputError(f"{path}: cannot be read ({e.strerror}); this calibration file is needed") from e
    except DocumentError as e:
        raise InputError(f"{path}: {e}") from e
    if not isinstance(tree, dict):
        raise InputError(f"{path}: needs a mapping of keys such as 'intrinsics: [fu, fv, cu, cv]'")
    return tree


def numbers(tree: Mapping[str, Any], key: str, counts: Sequence[int], where: str) -> F64:
    """Return the list of finite numbers that a mapping holds at `key`; error messages begin with `where`.

    Raises:
        InputError: the key is missing, or its value is not a list of finite numbers whose length is among `counts`.
    """
    want = f"write {key}: [" + " or ".join(str(c) for c in counts) + " numbers]"
    if key not in tree:
        raise InputError(f"{where}{key} is missing; {want}")
    try:
        values = np.array([float(v) for v in tree[key]], dtype=np.float64)
    except (TypeError, ValueError) as e:
        raise InputError(f"{where}{key} is no list of numbers; {want}") from e
    if len(values) not in counts:
        raise InputError(f"{where}{key} has {len(values)} numbers; {want}")
    if not np.isfinite(values).all():
        raise InputError(f"{where}{key} has a number that is not finite; {want}")
    return values


def rigid(tree: Mapping[str, Any], key: str, where: str, hint: str) -> Pose:
    """Build a pose from the 4x4 matrix at `key`, given as rows, as 16 numbers, or as EuRoC's `{rows, cols, data}`.

    Raises:
        InputError: the matrix is missing, or not a rigid motion; the message begins with `where` and ends with `hint`.
    """
    if key not in tree:
        raise InputError(f"{where}{key} is missing; {hint}")
    data = tree[key].get("data") if isinstance(tree[key], Mapping) else tree[key]
    try:
        values = np.array(data, dtype=np.float64)
    except (TypeError, ValueError) as e:
        raise InputError(f"{where}{key} is no matrix of numbers; {hint}") from e
    if values.size != 16:
        raise InputError(f"{where}{key} has {values.size} numbers instead of 16; {hint}")
    try:
        pose = Pose.from_matrix(values.reshape(4, 4))
    except ValueError as e:
        raise InputError(f"{where}{key} is {e}; {hint}") from e
    if (np.abs(pose.translation) > LARGEST["lever arm"]).any():
        raise InputError(f"{where}{key} is farther than {LARGEST['lever arm']:g} m from the body; {hint}")
    return pose


def body_from_sensor(tree: Mapping[str, Any], path: Path) -> Pose:
    """Read `T_BS`, the pose of a sensor in the body; see `rigid` for errors."""
    return rigid(tree, "T_BS", f"{path}: ", MATRIX_HINT)


def _camera(tree: Mapping[str, Any], coefficients_key: str, where: str) -> Camera:
    """Read a lens: `resolution`, `intrinsics`, `distortion_model`, coefficients. Error messages begin with `where`."""
    if (kind := str(tree.get("camera_model", "pinhole"))) != "pinhole":
        raise InputError(f"{where}camera_model {kind!r} is not supported; calibrate it as 'pinhole'")
    if (given := str(tree.get("distortion_model", "none"))) not in MODELS:
        raise InputError(f"{where}distortion_model {given!r} is unknown; use radial-tangential, equidistant or none")
    model = MODELS[given]
    counts = {"radial-tangential": (4, 5), "equidistant": (4,)}.get(model)
    distortion = numbers(tree, coefficients_key, counts, where).tolist() if counts else []
    width, height = numbers(tree, "resolution", (2,), where).tolist()
    fu, fv, cu, cv = numbers(tree, "intrinsics", (4,), where).tolist()
    if not all(1 <= n <= 100_000 for n in (width, height)):
        raise InputError(f"{where}resolution is {width:g}x{height:g}; write the width and height of the images")
    try:
        lens = Camera(int(width), int(height), fu, fv, cu, cv, model, tuple(distortion))
    except ValueError as e:
        raise InputError(f"{where}intrinsics or resolution: {e}") from e
    if (why := why_no_lens(lens)) is not None:
        raise InputError(f"{where}intrinsics or {coefficients_key}: {why}; write the calibration of these images")
    return lens


def rig_camera(folder: Path) -> RigCamera:
    """Read one camera with its mounting from `folder/sensor.yaml`."""
    path = folder / "sensor.yaml"
    tree = load_yaml(path)
    return RigCamera(folder.name, _camera(tree, "distortion_coefficients", f"{path}: "), body_from_sensor(tree, path))


def origin(path: Path) -> LocalFrame:
    """Read the world's origin from `nav0/sensor.yaml`.

    Raises:
        InputError: `origin` is missing or not a position on Earth.
    """
    want = "write origin: {latitude: degrees, longitude: degrees, height: metres above the WGS84 ellipsoid}"
    given = load_yaml(path).get("origin")
    try:
        place = [float(given[k]) for k in ("latitude", "longitude", "height")]  # type: ignore[index]
        if not (abs(place[0]) < 90 and abs(place[1]) <= 360 and abs(place[2]) <= LARGEST["height"]):
            raise ValueError("no place near the ground of the Earth; at a pole there is no east")
        return LocalFrame(*place)
    except KeyError as e:
        raise InputError(f"{path}: origin has no {e.args[0]}; {want}") from e
    except (TypeError, ValueError) as e:
        raise InputError(f"{path}: origin is missing or malformed ({given!r}); {want}") from e


def read_time_shifts(path: Path, cameras: int) -> dict[int, float]:
    """Read the `timeshift_cam_imu` (s, added to stamps for IMU time) of the cameras that have one in Kalibr's file.

    Raises:
        InputError: a time shift is not a finite number.
    """
    key, tree, shifts = "timeshift_cam_imu", load_yaml(path), dict[int, float]()
    for n in range(cameras):
        if (given := (tree.get(f"cam{n}") or {}).get(key)) is not None:
            shifts[n] = float(numbers({key: [given]}, key, (1,), f"{path}: cam{n}.")[0])
    return shifts


def read_camchain(path: Path, rig: Rig, body_from_imu: Pose) -> Rig:
    """Return a rig with the lenses of Kalibr's file, and with the mountings that the file gives.

    `T_cam_imu` gives the mounting in the body (through `body_from_imu`). Without it, camera 0 keeps its mounting, and
    `T_cn_cnm1` gives each further camera's pose relative to the previous one. Lenses are scaled to resized images.

    Raises:
        InputError: the file lacks a camera of the rig, or is malformed; the message names file and key.
    """
    tree = load_yaml(path)
    cameras: list[RigCamera] = []
    for n, old in enumerate(rig.cameras):
        entry, where = tree.get(f"cam{n}"), f"{path}: cam{n}."
        if not isinstance(entry, dict):
            raise InputError(f"{path}: cam{n} is missing; the recording has {len(rig.cameras)} camera(s)")
        lens = _camera(entry, "distortion_coeffs", where)
        if "T_cam_imu" in entry:
            mounting = body_from_imu @ rigid(entry, "T_cam_imu", where, KALIBR_HINT).inverse
        elif n == 0:
            mounting = old.body_from_cam
        elif "T_cn_cnm1" in entry:
            mounting = cameras[-1].body_from_cam @ rigid(entry, "T_cn_cnm1", where, KALIBR_HINT).inverse
        else:
            raise InputError(f"{path}: cam{n} has neither T_cn_cnm1 nor T_cam_imu; {KALIBR_HINT}")
        size = old.camera.width, old.camera.height
        if (lens.width, lens.height) != size:
            lens, given = lens.scaled(size[0] / lens.width), f"{lens.width}x{lens.height}"
            if (lens.width, lens.height) != size:
                raise InputError(
                    f"{where}resolution is {given}, the images are {size[0]}x{size[1]}; calibrate with images of the "
                    "same shape"
                )
        cameras.append(replace(old, camera=lens, body_from_cam=mounting))
    return Rig(tuple(cameras))
