"""Synthetic views for the tests of parallax: exact rays onto a surface, a band-limited texture, noise; NumPy alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from alight.geometry import Camera, Pose, so3_exp
from alight.records import View

LENS = Camera(160, 120, 150.0, 150.0, 79.5, 59.5)
UP = 20.0  # metres above the ground: 0.133 m a pixel
DOWN = np.diag([1.0, -1.0, -1.0])  # x right is east, the picture's top is north

F64 = NDArray[np.float64]
Surface = Callable[[F64, F64], F64]  # height at east, north
Paint = Callable[[F64, F64, int], F64]  # grey level at east, north in view k


class Texture:
    """Random waves no shorter than `finest` metres about grey level 128, with a sd of `contrast`."""

    def __init__(self, seed: int, finest: float = 0.55, contrast: float = 35.0, waves: int = 60) -> None:
        rng = np.random.default_rng(seed)
        length = finest * 4.0 ** rng.uniform(0, 1, waves)
        direction = rng.uniform(0, 2 * np.pi, waves)
        self._k = 2 * np.pi / length * np.array([np.cos(direction), np.sin(direction)])
        self._phase = rng.uniform(0, 2 * np.pi, waves)
        self._scale = contrast * np.sqrt(2 / waves)

    def __call__(self, east: F64, north: F64, k: int = 0) -> F64:
        """Grey level at every place, to a hundredth; in single precision, as most of the time of a view goes here."""
        x, y = east.astype(np.float32), north.astype(np.float32)
        out = np.zeros(east.shape, np.float32)
        for kx, ky, phase in np.column_stack([*self._k, self._phase]).astype(np.float32):
            out += np.cos(kx * x + ky * y + phase)
        return 128.0 + self._scale * out.astype(np.float64)


def plane(slope_east: float = 0.0, slope_north: float = 0.0, level: float = 0.0) -> Surface:
    """A level or slanted plane."""
    return lambda e, n: level + slope_east * e + slope_north * n


def box(height: float, half: float = 2.0) -> Surface:
    """Level ground with a square box about the origin."""
    return lambda e, n: np.where((np.abs(e) < half) & (np.abs(n) < half), height, 0.0)


def hit(surface: Surface, world_from_cam: Pose, rays_world: F64, top: float) -> F64:
    """Points where rays (..., 3) first hit the surface: a march from above in steps of 5 mm of height, then halving."""
    centre = world_from_cam.translation

    def at(depth: F64) -> F64:
        return np.asarray(centre + rays_world * depth[..., None])

    def above(depth: F64) -> NDArray[np.bool_]:
        p = at(depth)
        return np.asarray(p[..., 2] > surface(p[..., 0], p[..., 1]))

    near = (top - centre[2]) / rays_world[..., 2]
    step = 0.05 / -rays_world[..., 2]
    for _ in range(200):
        going = above(near + step)
        if not going.any():
            break
        near = np.where(going, near + step, near)
    far = near + step
    for _ in range(12):
        middle = 0.5 * (near + far)
        still = above(middle)
        near, far = np.where(still, middle, near), np.where(still, far, middle)
    return at(0.5 * (near + far))


@dataclass(frozen=True)
class Scene:
    """A surface and its paint, seen by `count` views along a slightly curved line."""

    surface: Surface = field(default_factory=plane)
    paint: Paint = field(default_factory=lambda: Texture(1))
    top: float = 0.3  # metres; nothing is higher
    noise: float = 1.0  # grey levels
    seed: int = 0
    spacing: float = 0.8  # metres between views
    camera: Camera = LENS

    def pose(self, k: int, count: int) -> Pose:
        """Pose of view k: along the east axis, swaying a little, nearly straight down."""
        tilt = 0.02 * np.array([np.sin(1.3 * k), np.cos(2.1 * k), np.sin(0.7 * k)])
        x = (k - 0.5 * (count - 1)) * self.spacing
        return Pose(so3_exp(tilt) @ DOWN, np.array([x, 0.5 * np.sin(2.0 * k), UP + 0.1 * np.cos(k)]))

    def picture(self, pose: Pose, k: int, gain: float = 1.0, offset: float = 0.0) -> NDArray[np.uint8]:
        """Picture of a camera: the mean over 2 x 2 rays a pixel."""
        c = self.camera
        u, v = np.meshgrid(np.arange(2 * c.width) / 2 - 0.25, np.arange(2 * c.height) / 2 - 0.25)
        rays = c.rays(np.stack([u, v], axis=-1)) @ pose.rotation.T
        p = hit(self.surface, pose, rays, self.top)
        grey = self.paint(p[..., 0], p[..., 1], k)
        grey = grey.reshape(c.height, 2, c.width, 2).mean(axis=(1, 3)) * gain + offset
        noise = np.random.default_rng([self.seed, k]).normal(0, self.noise, grey.shape) if self.noise else 0.0
        return np.clip(np.round(grey + noise), 0, 255).astype(np.uint8)

    def views(
        self, count: int = 6, gains: tuple[float, ...] = (1.0,), offsets: tuple[float, ...] = (0.0,)
    ) -> list[View]:
        """All views; gains and offsets are used in turn."""
        out = []
        for k in range(count):
            pose = self.pose(k, count)
            image = self.picture(pose, k, gains[k % len(gains)], offsets[k % len(offsets)])
            out.append(View(k * 100_000_000, 0, image, self.camera, pose))
        return out
