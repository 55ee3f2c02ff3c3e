"""A small survey in a drone's format: photos of a textured relief, drawn by casting each pixel's ray."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import damage as d
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from alight.geometry import Camera, LocalFrame, enu_from_flu
from alight.photos.reading.photo_pose import BODY_FROM_CAM

F64 = NDArray[np.float64]
CAMERA = Camera(400, 320, 430.0, 430.0, 199.5, 159.5)
UP = 40.0  # metres above the ground
PLACE = LocalFrame(45.0, 7.6, 310.0)
TEXTURE_CELL = 0.1  # m
# cells and tiles that make a run of seconds out of a survey, with a dozen tiles
SMALL = [
    word
    for key in (
        "parallax.cell=0.3", "tuning.elevation.tile=64", "tuning.bundle.features=900", "motion.bundle.lens=held",
        "terrain.model=null",
    )
    for word in ("--set", key)
]  # fmt: skip


def relief(x: F64, y: F64) -> F64:
    """Height in metres of a relief of 2 m, flat enough for a landing at the top."""
    return np.sin(x / 9.0) * np.cos(y / 7.0)


def texture(seed: int) -> NDArray[np.uint8]:
    """Grey texture of blobs of several sizes over 120 m."""
    rng = np.random.default_rng(seed)
    total = sum(cv2.GaussianBlur(rng.normal(size=(1200, 1200)), (0, 0), s) * s for s in (1.5, 3.0, 6.0))
    return np.asarray(np.clip(128 + 45 * total / np.std(total), 0, 255), dtype=np.uint8)


def look(ground: NDArray[np.uint8], centre: F64, world_from_cam: F64, camera: Camera = CAMERA) -> NDArray[np.uint8]:
    """Picture of the relief from a place, (H, W, 3)."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width].astype(np.float64)
    ray = camera.rays(np.stack([u, v], axis=-1)) @ world_from_cam.T
    h = np.zeros(u.shape)
    for _ in range(8):
        xyz = centre + ray * ((h - centre[2]) / ray[..., 2])[..., None]
        h = relief(xyz[..., 0], xyz[..., 1])
    at = ((xyz[..., :2] + 60.0) / TEXTURE_CELL).astype(np.float32)
    grey = cv2.remap(ground, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    return np.repeat(grey[:, :, None], 3, axis=2)


def draw_photos(folder: Path, lines: int = 2, per_line: int = 4, zooms: tuple[float, ...] = (1.0,)) -> Path:
    """Draw lines of photos 10 m apart, 14 m from line to line, with RTK, gimbal and lens; zooms change by line."""
    ground = texture(3)
    rng = np.random.default_rng(9)
    for k in range(lines * per_line):
        line, step = divmod(k, per_line)
        zoom = zooms[line % len(zooms)]
        camera = replace(CAMERA, fu=zoom * CAMERA.fu, fv=zoom * CAMERA.fv)
        along = step if line % 2 == 0 else per_line - 1 - step
        centre = np.array([10.0 * along, 14.0 * line, UP]) - [15.0, 7.0, 0.0] + rng.normal(0, 0.3, 3)
        yaw = 90.0 if line % 2 == 0 else -90.0
        world_from_cam = enu_from_flu(np.radians(yaw), np.radians(-90.0), 0.0) @ BODY_FROM_CAM.rotation
        latitude, longitude, height = (float(v) for v in PLACE.to_geodetic(centre))
        tags = d.dji_tags(
            AbsoluteAltitude=f"{height:.4f}", RelativeAltitude=f"{centre[2]:.2f}", GimbalYawDegree=f"{yaw:.2f}",
            CalibratedFocalLength=f"{camera.fu}", CalibratedOpticalCenterX="200.0", CalibratedOpticalCenterY="160.0",
            DewarpData="",
        )  # fmt: skip
        minutes, seconds = divmod(3 * k, 60)
        d.write_photo(
            folder / f"DJI_{k:04d}.JPG", second=f"{seconds:02d}", xmp=d.xmp_packet(tags), size=(400, 320),
            place=(latitude, longitude, height), image=Image.fromarray(look(ground, centre, world_from_cam, camera)),
            photo={36867: f"2026:01:26 13:{minutes:02d}:{seconds:02d}", 37386: 8.0 * zoom},
        )  # fmt: skip
    return folder
