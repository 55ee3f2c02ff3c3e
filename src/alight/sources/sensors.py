"""`sensor.yaml` of a flight log: calibrations are checked number by number; an error names file and key."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alight.documents import LONGEST, DocumentError, parse_yaml, read_bytes
from alight.geometry import Camera, LocalFrame, Pose
from alight.records import InputError, RigCamera
from alight.sources.lens_bounds import why_no_lens

MODELS = {  # common names of the models -> our names
    "radial-tangential": "radial-tangential",
    "radtan": "radial-tangential",
    "plumb_bob": "radial-tangential",
    "equidistant": "equidistant",
    "none": "none",
    "None": "none",
}
WIDEST = 100_000  # pixels
HIGHEST = 100_000.0  # m
FARTHEST = 1_000.0  # m, of a sensor from the body's origin
MATRIX_HINT = "write {cols: 4, rows: 4, data: [16 numbers, row by row]} of a rotation and a translation in metres"


def load_yaml(path: Path) -> dict[str, Any]:
    """Read a mapping from a YAML file, OpenCV's dialect included.

    Raises:
        InputError: no such file, not YAML, or no mapping.
    """
    try:
        text = read_bytes(path, LONGEST).decode("utf-8-sig", errors="replace")
    except OSError as e:
        raise InputError(f"{path}: cannot be read ({e.strerror}); this calibration file is needed") from e
    except DocumentError as e:
        raise InputError(f"{path}: {e}") from e
    lines = [line for line in text.splitlines() if not line.startswith("%")]  # %YAML:1.0 is OpenCV's, not YAML's
    try:
        tree = parse_yaml("\n".join(lines).replace("!!opencv-matrix", ""))
    except DocumentError as e:
        raise InputError(f"{path}: {e}") from e
    if not isinstance(tree, dict):
        raise InputError(f"{path}: needs a mapping of keys such as 'intrinsics: [fu, fv, cu, cv]'")
    return tree


def numbers(tree: Mapping[str, Any], key: str, counts: Sequence[int], path: Path) -> NDArray[np.float64]:
    """Take a list of finite numbers out of a mapping.

    Raises:
        InputError: the key is missing, or its value is no list of so many finite numbers.
    """
    want = f"write {key}: [" + " or ".join(str(c) for c in counts) + " numbers]"
    if key not in tree:
        raise InputError(f"{path}: {key} is missing; {want}")
    try:
        values = np.array([float(v) for v in tree[key]], dtype=np.float64)
    except (TypeError, ValueError) as e:
        raise InputError(f"{path}: {key} is no list of numbers; {want}") from e
    if len(values) not in counts:
        raise InputError(f"{path}: {key} has {len(values)} numbers; {want}")
    if not np.isfinite(values).all():
        raise InputError(f"{path}: {key} has a number that is not finite; {want}")
    return values


def rigid(matrix: Any, key: str, path: Path, hint: str = MATRIX_HINT) -> Pose:
    """Make a pose from a 4x4 matrix given as rows, as 16 numbers, or as EuRoC's `{rows, cols, data}`.

    Raises:
        InputError: it is no rigid motion; the message names file and key.
    """
    data = matrix.get("data") if isinstance(matrix, Mapping) else matrix
    try:
        values = np.array(data, dtype=np.float64)
    except (TypeError, ValueError) as e:
        raise InputError(f"{path}: {key} is no matrix of numbers; {hint}") from e
    if values.size != 16:
        raise InputError(f"{path}: {key} has {values.size} numbers instead of 16; {hint}")
    try:
        pose = Pose.from_matrix(values.reshape(4, 4))
    except ValueError as e:
        raise InputError(f"{path}: {key} is {e}; {hint}") from e
    if (np.abs(pose.translation) > FARTHEST).any():
        raise InputError(f"{path}: {key} is farther than {FARTHEST:g} m from the body; {hint}")
    return pose


def body_from_sensor(tree: Mapping[str, Any], path: Path) -> Pose:
    """`T_BS`, sensor to body.

    Raises:
        InputError: missing or malformed.
    """
    if "T_BS" not in tree:
        raise InputError(f"{path}: T_BS is missing; {MATRIX_HINT}")
    return rigid(tree["T_BS"], "T_BS", path)


def camera(tree: Mapping[str, Any], coefficients_key: str, path: Path) -> Camera:
    """The lens: `resolution`, `intrinsics`, `distortion_model` and its coefficients.

    Raises:
        InputError: a key is missing or malformed.
    """
    if (kind := str(tree.get("camera_model", "pinhole"))) != "pinhole":
        raise InputError(f"{path}: camera_model {kind!r} is not supported; calibrate it as 'pinhole'")
    given = str(tree.get("distortion_model", "none"))
    if given not in MODELS:
        raise InputError(f"{path}: distortion_model {given!r} is unknown; use radial-tangential, equidistant or none")
    model = MODELS[given]
    counts = {"radial-tangential": (4, 5), "equidistant": (4,)}.get(model)
    distortion = numbers(tree, coefficients_key, counts, path).tolist() if counts else []
    width, height = numbers(tree, "resolution", (2,), path).tolist()
    fu, fv, cu, cv = numbers(tree, "intrinsics", (4,), path).tolist()
    if not all(1 <= n <= WIDEST for n in (width, height)):
        raise InputError(f"{path}: resolution is {width:g}x{height:g}; write the width and height of the images")
    try:
        lens = Camera(int(width), int(height), fu, fv, cu, cv, model, tuple(distortion))
    except ValueError as e:
        raise InputError(f"{path}: intrinsics or resolution: {e}") from e
    if (why := why_no_lens(lens)) is not None:
        raise InputError(f"{path}: intrinsics or {coefficients_key}: {why}; write the calibration of these images")
    return lens


def rig_camera(folder: Path) -> RigCamera:
    """One camera of the log with its mounting, from `folder/sensor.yaml`."""
    path = folder / "sensor.yaml"
    tree = load_yaml(path)
    return RigCamera(folder.name, camera(tree, "distortion_coefficients", path), body_from_sensor(tree, path))


def origin(path: Path) -> LocalFrame:
    """The world's origin from `nav0/sensor.yaml`.

    Raises:
        InputError: `origin` is missing or no place on Earth.
    """
    want = "write origin: {latitude: degrees, longitude: degrees, height: metres above the WGS84 ellipsoid}"
    given = load_yaml(path).get("origin")
    try:
        place = [float(given[k]) for k in ("latitude", "longitude", "height")]  # type: ignore[index]
        if not (abs(place[0]) < 90 and abs(place[1]) <= 360 and abs(place[2]) <= HIGHEST):
            raise ValueError("no place near the ground of the Earth; at a pole there is no east")
        return LocalFrame(*place)
    except KeyError as e:
        raise InputError(f"{path}: origin has no {e.args[0]}; {want}") from e
    except (TypeError, ValueError) as e:
        raise InputError(f"{path}: origin is missing or malformed ({given!r}); {want}") from e
