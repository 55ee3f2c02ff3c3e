"""A world that is not the simulator's: a textured plane with boxes on it, ray-cast with NumPy."""

from collections.abc import Sequence
from functools import cache

import cv2
import numpy as np

from alight.arrays import F32
from alight.geometry import Camera, Grid
from alight.records import Terrain
from alight_sim.movers import Moving, boxes_at
from alight_sim.things.base import Box
from alight_sim.truth import SceneTruth
from alight_sim.world import Poses, World

SIDE = 512  # cells of the texture, which repeats


class PlaneWorld(World):
    """Level ground at height 0 with three boxes. The seed changes texture and boxes."""

    name, start = "plane", (0.0, 0.0, 5.0)

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.texture = rng.uniform(0.03, 0.3, (SIDE, SIDE)).astype(np.float32)
        self.boxes = np.zeros((3, 12))  # their numbers are those of things that move; these stand along the axes
        self.boxes[:, :2] = np.array([[4.0, 3.0], [-4.0, 2.0], [1.0, -5.0]]) + rng.uniform(-0.5, 0.5, (3, 2))
        self.boxes[:, 3], self.boxes[:, 5:8], self.boxes[:, 8:11] = 1.0, rng.uniform(0.3, 0.8, (3, 3)), 1.5

    def truth(self, bounds: Box) -> SceneTruth:
        west, south, east, north = (round(b / self.cell) for b in bounds)
        grid = Grid(west * self.cell, north * self.cell, self.cell, north - south + 1, east - west + 1)
        x, y = grid.xy()
        height, label = np.zeros(grid.shape, np.float32), np.full(grid.shape, Terrain.BARE, np.uint8)
        for box in self.boxes:
            on = np.ix_(np.abs(y - box[1]) <= box[6], np.abs(x - box[0]) <= box[5])
            height[on], label[on] = box[7], Terrain.STRUCTURE
        return SceneTruth(grid, height, label)

    def radiance(self, camera: Camera, world_from_cam: Poses, seconds: float, bodies: Sequence[Moving]) -> F32:
        now = np.array([seconds])
        (turn,), (place,) = (a.astype(np.float32) for a in world_from_cam(now))
        boxes = np.concatenate([self.boxes, boxes_at(bodies, now)[0]]).astype(np.float32)
        rays, shade = rays_of(camera) @ turn.T, np.ones((camera.height, camera.width, 3), np.float32)
        depth = -place[2] / np.minimum(rays[..., 2], -0.05)
        for box in boxes:
            c, s = box[3:5]
            axes = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]], np.float32)
            start, inverse = axes @ (place - box[:3]), 1.0 / (rays @ axes.T)
            a, b = (np.array([-box[5], -box[6], 0.0], np.float32) - start) * inverse, (box[5:8] - start) * inverse
            near, far = np.minimum(a, b).max(axis=-1), np.maximum(a, b).min(axis=-1)
            hit = (near > 0.0) & (near <= far) & (near < depth)
            depth[hit], shade[hit] = near[hit], box[8:11]
        spots = place + depth[..., None] * rays
        spots = spots[..., :2] + spots[..., 2:]  # the texture goes on up the sides of the boxes
        layers = [cv2.remap(self.texture, spots / size % SIDE, None, cv2.INTER_LINEAR) for size in (0.05, 0.2, 0.8)]
        return np.mean(layers, axis=0)[..., None] * shade


@cache
def rays_of(camera: Camera) -> F32:
    """(H, W, 3) rays of all pixels, z = 1."""
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)
    return np.asarray(camera.rays(np.stack([u, v], -1)), np.float32)
