"""Kalibr's `camchain.yaml`: a rig calibration that replaces the recording's own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from alight.geometry import Camera, Pose
from alight.records import InputError, Rig, RigCamera
from alight.sources.sensors import camera, load_yaml, rigid

HINT = "write four rows of four numbers, as Kalibr does"


def read_camchain(path: Path, rig: Rig, body_from_imu: Pose) -> Rig:
    """Replace a rig's lenses, and the mountings that the file holds.

    `T_cam_imu` gives the mounting in the body (through `body_from_imu`). Without it camera 0 keeps the mounting it had
    and `T_cn_cnm1` places each next camera behind the one before.

    Raises:
        InputError: the file lacks a camera of the rig, or is malformed; the message names file and key.
    """
    tree = load_yaml(path)
    cameras: list[RigCamera] = []
    for n, old in enumerate(rig.cameras):
        entry = tree.get(f"cam{n}")
        if not isinstance(entry, dict):
            raise InputError(f"{path}: cam{n} is missing; the recording has {len(rig.cameras)} camera(s)")
        lens = _lens(entry, n, path)
        if "T_cam_imu" in entry:
            mounting = body_from_imu @ rigid(entry["T_cam_imu"], f"cam{n}.T_cam_imu", path, HINT).inverse
        elif n == 0:
            mounting = old.body_from_cam
        elif "T_cn_cnm1" in entry:
            step = rigid(entry["T_cn_cnm1"], f"cam{n}.T_cn_cnm1", path, HINT)
            mounting = cameras[-1].body_from_cam @ step.inverse
        else:
            raise InputError(f"{path}: cam{n} has neither T_cn_cnm1 nor T_cam_imu; {HINT}")
        cameras.append(replace(old, camera=_fitted(lens, old.camera, n, path), body_from_cam=mounting))
    return Rig(tuple(cameras))


def _lens(entry: dict[str, object], n: int, path: Path) -> Camera:
    try:
        return camera(entry, "distortion_coeffs", path)
    except InputError as e:
        raise InputError(str(e).replace(f"{path}: ", f"{path}: cam{n}.", 1)) from e


def _fitted(lens: Camera, old: Camera, n: int, path: Path) -> Camera:
    """The calibration at the size of the recording's images, which may have been resized."""
    if (lens.width, lens.height) == (old.width, old.height):
        return lens
    scaled = lens.scaled(old.width / lens.width)
    if (scaled.width, scaled.height) != (old.width, old.height):
        raise InputError(
            f"{path}: cam{n}.resolution is {lens.width}x{lens.height}, the images are {old.width}x{old.height}; "
            "calibrate with images of the same shape"
        )
    return scaled
