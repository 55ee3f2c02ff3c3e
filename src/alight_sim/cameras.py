"""Cameras of the simulator: rays through the distorted lens, cast at the time at which each row is exposed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from alight.arrays import F32, F64
from alight.geometry import Camera, Pose
from alight.records import InputError
from alight_sim.exposure import Imaging
from alight_sim.kernels.boxes import cast_boxes
from alight_sim.kernels.raycast import cast_rays
from alight_sim.kernels.shade import shade
from alight_sim.materials import tables
from alight_sim.movers import Moving, boxes_at
from alight_sim.patch import GroundPatch
from alight_sim.things.base import Box
from alight_sim.wires import CameraMoment, Lit, draw
from alight_sim.world import Poses

if TYPE_CHECKING:  # which draws its pictures with these cameras
    from alight_sim.scene_world import SceneWorld

COARSEST = 4  # largest number of halvings of the layers of looks
REACH = 12.0  # distance to which the ground is built, in heights above ground; it continues level beyond
FOUR = ((-0.125, -0.375), (0.375, -0.125), (-0.375, 0.125), (0.125, 0.375))


@dataclass(frozen=True)
class Shutter:
    """Exposure times of the rows. Row r is exposed around `time + (r - (H - 1) / 2) * line_time`."""

    exposure: float = 0.0  # s
    line_time: float = 0.0  # s from one row to the next: rolling shutter
    moments: int = 1  # instants over which the exposure is summed

    @classmethod
    def of(cls, imaging: Imaging) -> Shutter:
        """Return the shutter of the imaging settings."""
        return cls(imaging.exposure_time, imaging.line_time, imaging.moments)

    def opened(self, rows: int, moment: int) -> F64:
        """Return when each row records instant `moment` (an index) of the exposure, (rows,) s from its middle.

        (1,) if all rows record it together.
        """
        part = (moment + 0.5) / self.moments - 0.5
        lines = np.arange(rows) - 0.5 * (rows - 1) if self.line_time else np.zeros(1)
        return np.asarray(part * self.exposure + self.line_time * lines)


@dataclass(frozen=True, eq=False)
class Eye:
    """A camera with the undistorted rays of all its pixels, computed once."""

    camera: Camera
    samples: int = 1  # rays per pixel
    rays: tuple[F32, ...] = field(init=False)  # one (H, W, 3) array per sample, z = 1

    def __post_init__(self) -> None:
        u, v = np.meshgrid(np.arange(self.camera.width, dtype=float), np.arange(self.camera.height, dtype=float))
        rays = (
            self.camera.rays(np.stack([u + a, v + b], -1)).astype(np.float32) for a, b in rays_in_pixel(self.samples)
        )
        object.__setattr__(self, "rays", tuple(rays))

    def depth(self, world: SceneWorld, world_from_cam: Pose, sample: int = 0) -> F64:
        """Return the (H, W) ground depth on ray `sample` of each pixel, metres along the optical axis; -1: no hit.

        Raises:
            InputError: the camera is below the ground.
        """
        turns, places = world_from_cam.rotation[None], world_from_cam.translation[None]
        patch = world.patch(self.footprint(world, turns, places))
        return self._cast(world, patch, turns, places, sample)

    def radiance(
        self,
        world: SceneWorld,
        poses: Poses | Pose,
        time: float,
        shutter: Shutter | None = None,
        bodies: Sequence[Moving] = (),
    ) -> F32:
        """Return the linear light (H, W, 3) of one exposure.

        Args:
            poses: `world_from_cam` as a function of time (s); a Pose is a static camera.
            time: middle of the exposure, s.
            bodies: moving objects that are drawn in addition to those of the world.

        Raises:
            InputError: the camera is below the ground.
        """
        shutter = shutter or Shutter()
        out = np.zeros((self.camera.height, self.camera.width, 3), np.float32)
        moments = shutter.moments if shutter.exposure > 0 else 1
        count = self.samples * math.ceil(moments / self.samples)
        spans = Shutter(shutter.exposure, shutter.line_time, count)
        for k in range(count):
            seconds = time + spans.opened(self.camera.height, k)
            turns, places = still(poses, len(seconds)) if isinstance(poses, Pose) else poses(seconds)
            boxes = boxes_at((*world.movers, *bodies), seconds)
            self._add(world, turns, places, seconds, boxes, k % self.samples, 1.0 / count, out)
        return out

    def footprint(self, world: SceneWorld, turns: F64, places: F64) -> tuple[float, float, float, float]:
        """Return west, south, east, north (m) of the ground seen; `turns` (N, 3, 3), `places` (N, 3): camera poses."""
        edge = _border(self.rays[0])
        ends = [_reach(world, turns[k] @ edge.T, places[k]) for k in {0, len(turns) - 1}]
        spots = np.concatenate([*ends, places[:, :2]])
        west, south = spots.min(axis=0) - 1.0
        east, north = spots.max(axis=0) + 1.0
        return float(west), float(south), float(east), float(north)

    def _cast(self, world: SceneWorld, patch: GroundPatch, turns: F64, places: F64, sample: int) -> F64:
        for east, north, up in places[:: max(1, len(places) - 1)]:
            if up <= world.height_at(float(east), float(north)):
                raise InputError(f"the camera is below the ground at east {east:.1f}, north {north:.1f}; fly higher")
        cell = patch.grid.cell
        x, y = (places[:, 0] - patch.place[0]) / cell, (patch.place[1] - places[:, 1]) / cell
        to_grid = np.diag([1.0 / cell, -1.0 / cell, 1.0])
        out = np.empty((self.camera.height, self.camera.width))
        origins = np.ascontiguousarray(np.stack([x, y, places[:, 2]], axis=-1))
        cast_rays(patch.height, *patch.pyramid, origins, self.rays[sample], to_grid @ turns, patch.low, out)
        return out

    def _add(
        self, world: SceneWorld, turns: F64, places: F64, seconds: F64, boxes: F64, sample: int, weight: float, out: F32
    ) -> None:
        middle = float(seconds[len(seconds) // 2])
        pixel = 1.0 / math.sqrt(self.camera.fu * self.camera.fv)
        bounds = self.footprint(world, turns, places)
        patch = world.patch(bounds, middle, _level(world, bounds, float(places[:, 2].min()), pixel))
        depth, faces = self._cast(world, patch, turns, places, sample), np.zeros(out.shape[:2], np.int16)
        boxes = _near(boxes, patch)
        turns, places = np.ascontiguousarray(turns), np.ascontiguousarray(places)
        if boxes.shape[1]:
            cast_boxes(boxes, places, self.rays[sample], turns, depth, faces)
        height = np.zeros((0, 0), np.float32) if patch.level else patch.height
        level = float(np.concatenate([patch.height[[0, -1]].ravel(), patch.height[:, [0, -1]].ravel()]).mean())
        looks, _, wet = tables()
        hanging = world.hanging(patch, middle)
        light, share = (out, weight) if hanging is None else (np.zeros_like(out), 1.0)
        shade(
            height, patch.label, patch.cells, patch.skin, patch.skin_place, looks, wet, places, self.rays[sample],
            turns, depth, faces, boxes, pixel, level, world.light.numbers(middle), seconds, world.seed & 0xFFFF,
            share, light,
        )  # fmt: skip
        if hanging is not None:
            view = CameraMoment(self.camera, self.rays[sample], turns, places, depth)
            draw(hanging, view, patch, Lit(world.light.numbers(middle), middle, world.seed & 0xFFFF), light)
            out += np.float32(weight) * light


def _level(world: SceneWorld, bounds: Box, up: float, pixel: float) -> int:
    """Return the level of `SceneWorld.patch` with blocks at most a pixel wide.

    `bounds`: west, south, east, north, metres. `up`: height of the camera, metres. `pixel`: width of a pixel, rad.
    """
    cells = (up - world.usual_height(bounds)) * pixel / world.cell
    return min(max(math.floor(math.log2(max(cells, 1e-3))), 0), COARSEST)


def rays_in_pixel(samples: int) -> NDArray[np.float64]:
    """Return the (samples, 2) offsets of a pixel's rays from its centre, px."""
    if samples == 4:
        return np.array(FOUR)
    k = np.arange(samples)[:, None]
    offsets = np.mod(0.5 + k * [0.7548776662, 0.5698402910], 1.0) - 0.5
    return np.asarray(offsets - offsets.mean(axis=0))


def still(pose: Pose, count: int) -> tuple[F64, F64]:
    return np.repeat(pose.rotation[None], count, axis=0), np.repeat(pose.translation[None], count, axis=0)


def _border(rays: F32) -> F64:
    sides = (rays[0, ::16], rays[-1, ::16], rays[::16, 0], rays[::16, -1], rays[-1:, -1])
    return np.concatenate(sides).astype(np.float64)


def _reach(world: SceneWorld, rays: F64, place: F64) -> F64:
    """Return (N, 2) east, north where world rays (3, N) from `place` (3,) reach the lowest height, within a limit."""
    height = max(float(place[2]) - world.low, 1.0)
    flat = np.maximum(np.hypot(rays[0], rays[1]), 1e-9)
    away = np.minimum(np.where(rays[2] < 0, height * flat / np.maximum(-rays[2], 1e-9), np.inf), REACH * height)
    return np.asarray(place[:2] + (rays[:2] / flat * away).T)


def _near(boxes: F64, patch: GroundPatch) -> F64:
    """Return the boxes (T, M, 12) that are on the patch at some time, or whose shadow may fall on it."""
    x, y = patch.grid.xy()
    over = (boxes[..., 0] > x[0] - 30) & (boxes[..., 0] < x[-1] + 30) & (boxes[..., 1] > y[-1] - 30)
    over &= boxes[..., 1] < y[0] + 30
    return np.ascontiguousarray(boxes[:, over.any(axis=0)])
