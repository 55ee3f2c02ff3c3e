"""Cameras of the simulator: one ray a pixel through the distorted lens, and what lens and sensor do to the light."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import cv2
import numpy as np

from alight.geometry import Camera, Pose
from alight.kernels.raycast import cast_rays
from alight.kernels.shade import shade
from alight.records import F32, F64, U8, InputError, Rig, RigCamera
from alight.simulate.materials import tables
from alight.simulate.world import World


@dataclass(frozen=True)
class Imaging:
    """What happens between the lens and the file."""

    samples: int = 1  # rays a pixel: 1 or 4
    gain: float = 1.25  # exposure: linear radiance times this is full scale at 1
    blur_px: float = 0.45  # standard deviation of lens and pixel together
    vignetting: float = 0.12  # light lost in the corners
    noise: float = 1.3  # grey levels, standard deviation
    gamma: float = 2.2

    def __post_init__(self) -> None:
        if self.samples not in (1, 4):
            raise ValueError(f"samples must be 1 or 4, not {self.samples}")


@dataclass(frozen=True, eq=False)
class Eye:
    """A camera ready to look: the rays of all its pixels, undistorted once."""

    camera: Camera
    imaging: Imaging
    rays: tuple[F32, ...] = field(init=False)  # one (H, W, 3) a sample, z = 1
    vignette: F32 = field(init=False)  # (H, W, 1)

    def __post_init__(self) -> None:
        offsets = (
            [(0.0, 0.0)] if self.imaging.samples == 1 else [(-0.12, -0.38), (0.38, -0.12), (-0.38, 0.12), (0.12, 0.38)]
        )
        u, v = np.meshgrid(np.arange(self.camera.width, dtype=float), np.arange(self.camera.height, dtype=float))
        rays = tuple(self.camera.rays(np.stack([u + a, v + b], -1)).astype(np.float32) for a, b in offsets)
        object.__setattr__(self, "rays", rays)
        r2 = (u - self.camera.cu) ** 2 + (v - self.camera.cv) ** 2
        vignette = 1.0 - self.imaging.vignetting * (r2 / r2.max())[..., None]
        object.__setattr__(self, "vignette", vignette.astype(np.float32))

    def depth(self, world: World, world_from_cam: Pose, sample: int = 0) -> F64:
        """(H, W) depth of what each pixel sees, metres along the optical axis; -1 where it sees none of the world.

        Raises:
            InputError: the camera is below the ground.
        """
        centre = world_from_cam.translation
        if centre[2] <= world.height_at(centre[0], centre[1]):
            raise InputError(
                f"the camera is below the ground at east {centre[0]:.1f}, north {centre[1]:.1f}; fly higher"
            )
        grid = world.grid
        row, col = grid.index(centre[0], centre[1])
        to_grid = np.diag([1.0 / grid.cell, -1.0 / grid.cell, 1.0])
        out = np.empty((self.camera.height, self.camera.width))
        origins = np.array([[float(col), float(row), centre[2]]])
        turns, low = (to_grid @ world_from_cam.rotation)[None], float(world.height.min())
        cast_rays(world.height, *world.pyramid, origins, self.rays[sample], turns, low, out)
        return out

    def radiance(self, world: World, world_from_cam: Pose, time: float) -> F32:
        """(H, W, 3) linear light at a time in seconds."""
        materials, amplitudes = tables()
        out = np.zeros((self.camera.height, self.camera.width, 3), np.float32)
        pixel = 1.0 / math.sqrt(self.camera.fu * self.camera.fv)
        for k, rays in enumerate(self.rays):
            shade(
                world.label, world.light, world.place, materials, amplitudes,
                world_from_cam.translation, rays, world_from_cam.rotation, self.depth(world, world_from_cam, k),
                pixel, world.level, world.sun.numbers, time, world.seed & 0xFFFF, 1.0 / len(self.rays), out,
            )  # fmt: skip
        return out

    def expose(self, radiance: F32, rng: np.random.Generator) -> U8:
        """(H, W, 3) RGB: lens blur, vignetting, exposure, gamma, sensor noise."""
        light = cv2.GaussianBlur(radiance, (0, 0), self.imaging.blur_px) if self.imaging.blur_px > 0 else radiance
        light = np.clip(light * (self.vignette * self.imaging.gain), 1e-6, 1.0)
        grey = cv2.pow(light, 1.0 / self.imaging.gamma) * 255.0
        noise = rng.standard_normal(grey.shape, dtype=np.float32)
        return np.asarray(np.clip(grey + self.imaging.noise * noise + 0.5, 0.0, 255.0).astype(np.uint8))


def default_rig() -> Rig:
    """A pair of 640x480 cameras looking down, 0.5 m apart across the body, mounted as exactly as people do."""
    left = Camera(640, 480, 481.2, 480.3, 323.0, 242.9, "radial-tangential", (-0.0899, 0.0195, -0.00077, 0.00065))
    right = Camera(640, 480, 480.2, 479.8, 322.6, 239.1, "radial-tangential", (-0.0895, 0.0187, -0.00063, 0.0005))
    return Rig(
        (
            RigCamera("cam0", left, Pose(_looking_down(0.0026, -0.0007, 0.0038), np.array([0.12, 0.25, -0.06]))),
            RigCamera("cam1", right, Pose(_looking_down(-0.0006, 0.0091, 0.0028), np.array([0.12, -0.25, -0.06]))),
        )
    )


def _looking_down(*small: float) -> F64:
    """Body from camera: image top is forward, image right is right, turned by a small rotation vector."""
    down = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    return np.asarray(cv2.Rodrigues(np.array(small))[0] @ down)
