"""Rigs of a scene file: built-in rigs by name, or cameras with the keys of a flight log's sensor.yaml."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated, Any, Literal

import cv2
import numpy as np
from pydantic import Field, model_validator

from alight.arrays import F64
from alight.geometry import Camera, Pose
from alight.records import Rig, RigCamera
from alight_sim.section import Section

RigName = Literal["pair", "single", "wide", "oblique"]
Lens = Literal["none", "radial-tangential", "equidistant"]


class Transform(Section):
    """A rigid transformation in the format of sensor.yaml."""

    cols: Literal[4] = Field(4, description="always 4")
    rows: Literal[4] = Field(4, description="always 4")
    data: tuple[float, ...] = Field(min_length=16, max_length=16, description="16 numbers, row by row")

    @model_validator(mode="after")
    def _rigid(self) -> Transform:
        Pose.from_matrix(np.reshape(self.data, (4, 4)))
        return self

    @property
    def pose(self) -> Pose:
        """The pose; a rotation that is exact to rounding is kept bit for bit."""
        M = np.reshape(self.data, (4, 4))
        R = M[:3, :3]
        return Pose(R, M[:3, 3]) if np.abs(R @ R.T - np.eye(3)).max() < 1e-12 else Pose.from_matrix(M)


Pixels = Annotated[int, Field(ge=1, le=12_000)]


class CameraModel(Section):
    """One camera: the contents of a sensor.yaml, or its position, tilt and field of view."""

    sensor_type: Literal["camera"] = Field("camera", description="as in sensor.yaml")
    comment: str = Field("", description="for people")
    rate_hz: float | None = Field(None, description="as in sensor.yaml; imaging.rate_hz is what counts")
    resolution: tuple[Pixels, Pixels] = Field((640, 480), description="[width, height] pixels")
    camera_model: Literal["pinhole"] = Field("pinhole", description="as in sensor.yaml")
    intrinsics: tuple[float, float, float, float] | None = Field(None, description="[fu, fv, cu, cv] pixels")
    field_deg: float = Field(67.0, gt=1, lt=170, description="degrees across the image, where intrinsics are not given")
    distortion_model: Lens = Field("none", description="of the lens")
    distortion_coefficients: tuple[float, ...] = Field(
        (), description="k1, k2, p1, p2 [, k3] or k1..k4; zeros without it"
    )
    T_BS: Transform | None = Field(None, description="camera to body")
    place: tuple[float, float, float] = Field(
        (0.0, 0.0, 0.0), description="metres forward, left, up in the body, where T_BS is not given"
    )
    tilt_deg: float = Field(90.0, ge=-90, le=90, description="degrees that it looks below the horizon ahead, likewise")

    @model_validator(mode="after")
    def _is_camera(self) -> CameraModel:
        _ = self.camera
        return self

    @property
    def camera(self) -> Camera:
        """Image size, intrinsics and distortion."""
        (width, height), numbers = self.resolution, self.intrinsics
        if numbers is None:
            half = math.radians(0.5 * self.field_deg)
            focal = 0.5 * width / (half if self.distortion_model == "equidistant" else math.tan(half))
            numbers = focal, focal, 0.5 * (width - 1), 0.5 * (height - 1)
        distortion = self.distortion_coefficients
        if self.distortion_model != "none" and not distortion:
            distortion = (0.0, 0.0, 0.0, 0.0)
        return Camera(width, height, *numbers, self.distortion_model, distortion)

    @property
    def body_from_cam(self) -> Pose:
        """Pose of the camera in the body; the top of its picture points forward or up."""
        return self.T_BS.pose if self.T_BS else Pose(looking(math.radians(self.tilt_deg)), np.array(self.place))


class RigModel(Section):
    """A rig by name, `rig: pair`, or by its cameras, `rig: {cameras: [...]}`."""

    name: RigName = Field("pair", description="a built-in rig, where no cameras are given")
    cameras: tuple[CameraModel, ...] = Field((), max_length=8, description="cameras of your own, the left one first")

    @model_validator(mode="before")
    @classmethod
    def _by_name(cls, given: Any) -> Any:
        return {"name": given} if isinstance(given, str) else given

    @property
    def rig(self) -> Rig:
        """The rig; cameras of your own are named cam0, cam1 and so on."""
        if not self.cameras:
            return BUILT_IN[self.name]()
        return Rig(tuple(RigCamera(f"cam{k}", c.camera, c.body_from_cam) for k, c in enumerate(self.cameras)))

    @classmethod
    def of(cls, rig: Rig) -> RigModel:
        """Return the model that reproduces a rig, bit for bit."""
        return cls.model_validate({"cameras": [_described(c) for c in rig.cameras]})


def looking(tilt: float) -> F64:
    """Return the (3, 3) rotation `body_from_cam` of a camera that points `tilt` radians below the forward direction."""
    c, s = math.cos(tilt), math.sin(tilt)
    return np.array([[0.0, -s, c], [-1.0, 0.0, 0.0], [0.0, -c, -s]])


def _described(cam: RigCamera) -> dict[str, Any]:
    lens = cam.camera
    return {
        "resolution": (lens.width, lens.height),
        "intrinsics": (lens.fu, lens.fv, lens.cu, lens.cv),
        "distortion_model": lens.model,
        "distortion_coefficients": lens.distortion,
        "T_BS": {"data": tuple(cam.body_from_cam.matrix.ravel().tolist())},
    }


def default_rig() -> Rig:
    """Return a pair of 640x480 cameras that point down, 0.5 m apart across the body, with small mounting errors."""
    left = Camera(640, 480, 481.2, 480.3, 323.0, 242.9, "radial-tangential", (-0.0899, 0.0195, -0.00077, 0.00065))
    right = Camera(640, 480, 480.2, 479.8, 322.6, 239.1, "radial-tangential", (-0.0895, 0.0187, -0.00063, 0.0005))
    return Rig(
        (
            RigCamera("cam0", left, Pose(_looking_down(0.0026, -0.0007, 0.0038), np.array([0.12, 0.25, -0.06]))),
            RigCamera("cam1", right, Pose(_looking_down(-0.0006, 0.0091, 0.0028), np.array([0.12, -0.25, -0.06]))),
        )
    )


def _looking_down(*small: float) -> F64:
    """Return `body_from_cam` (3, 3) of a camera that points down, top forward; `small`: error, rotation vector, rad."""
    down = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    return np.asarray(cv2.Rodrigues(np.array(small))[0] @ down)


def _single() -> Rig:
    return Rig(default_rig().cameras[:1])


def _wide() -> Rig:
    lens = Camera(640, 480, 306.0, 306.0, 319.5, 239.5, "equidistant", (-0.01, 0.02, -0.01, 0.002))
    return Rig(tuple(RigCamera(c.name, lens, c.body_from_cam) for c in default_rig().cameras))


def _oblique() -> Rig:
    pose = looking(math.radians(50.0))
    return Rig(
        tuple(RigCamera(c.name, c.camera, Pose(pose, c.body_from_cam.translation)) for c in default_rig().cameras)
    )


BUILT_IN: dict[str, Callable[[], Rig]] = {"pair": default_rig, "single": _single, "wide": _wide, "oblique": _oblique}
