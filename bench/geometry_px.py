"""Where the simulator draws a plane, a sphere and a height step, against where projection puts them, in pixels."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from alight.geometry import Camera, Grid, Pose
from alight.records import F64, Terrain
from alight.simulate import World, world_of
from alight.simulate.cameras import Eye

LENSES = {
    "none": Camera(640, 480, 480.0, 479.0, 321.3, 240.1),
    "radial-tangential": Camera(
        640, 480, 481.2, 480.3, 323.0, 242.9, "radial-tangential", (-0.0899, 0.0195, -0.0008, 0.0007)
    ),
    "equidistant": Camera(640, 480, 400.0, 400.0, 321.3, 240.1, "equidistant", (-0.01, 0.02, -0.01, 0.002)),
}
UP, STEP, RADIUS = 20.0, 2.0, 5.0  # metres
SIDE, CELL = 110.0, 0.05
Surface = Callable[[F64, F64], F64]


def _world(surface: Surface) -> World:
    n = round(SIDE / CELL) + 1
    grid = Grid(-SIDE / 2, SIDE / 2, CELL, n, n)
    height = surface(*np.meshgrid(*grid.xy())).astype(np.float32)
    return world_of(grid, height, np.full(grid.shape, Terrain.BARE, np.uint8))


def _pose(east: float = 0.4) -> Pose:
    a, b = 0.05, -0.08
    pitch = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    roll = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
    down = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    return Pose(pitch @ roll @ down, np.array([east, -0.3, UP]))


def _hits(world: World, lens: Camera, pose: Pose, pixels: F64) -> F64:
    """What rays through (N, 2) pixels, fractions too, meet: (N, 3) world."""
    eye = Eye(lens)
    rays = lens.rays(pixels)[None].astype(np.float32)
    object.__setattr__(eye, "rays", (rays,))
    object.__setattr__(eye, "camera", Camera(len(pixels), 1, lens.fu, lens.fv, lens.cu, lens.cv))
    depth = eye.depth(world, pose)
    return pose.apply(rays[0].astype(np.float64) * depth[0][:, None])


def _inside(lens: Camera, count: int = 4000) -> F64:
    return np.random.default_rng(0).uniform((0, 0), (lens.width - 1, lens.height - 1), (count, 2))


def _seen_beside(lens: Camera, points: F64, truth: F64) -> float:
    """Largest distance in the picture of a camera 0.5 m beside, which sees depth as the place in the picture."""
    beside = _pose(0.9).inverse
    return float(np.abs(lens.project(beside.apply(points)) - lens.project(beside.apply(truth))).max())


def _plane(lens: Camera) -> float:
    """Hits and the plane's own equation along the same rays."""
    pose, pixels = _pose(), _inside(lens)
    rays = lens.rays(pixels) @ pose.rotation.T
    c = pose.translation
    t = (0.15 * c[0] - 0.08 * c[1] + 1.0 - c[2]) / (rays[:, 2] - 0.15 * rays[:, 0] + 0.08 * rays[:, 1])
    world = _world(lambda x, y: 0.15 * x - 0.08 * y + 1.0)
    return _seen_beside(lens, _hits(world, lens, pose, pixels), c + rays * t[:, None])


def _sphere(lens: Camera) -> float:
    """The upper cap of a sphere, and the nearer root of the quadratic."""
    pose, pixels = _pose(), _inside(lens)
    rays = lens.rays(pixels) @ pose.rotation.T
    c = pose.translation
    a, b = (rays**2).sum(1), rays @ c
    root = b * b - a * (c @ c - RADIUS**2)
    with np.errstate(invalid="ignore"):
        truth = c + rays * ((-b - np.sqrt(root)) / a)[:, None]
        on = (root > 0) & (np.hypot(truth[:, 0], truth[:, 1]) < 3.9)
    world = _world(lambda x, y: np.sqrt(np.maximum(RADIUS**2 - x * x - y * y, 9.0)))
    return _seen_beside(lens, _hits(world, lens, pose, pixels[on]), truth[on])


def _step(lens: Camera) -> float:
    """The brink of a step: bisection over the picture for where the rays begin to pass it."""
    pose = _pose()
    world = _world(lambda x, y: np.where(x > 3.93, STEP, 0.0))
    truth = world.truth()
    brink = truth.grid.xy()[0][np.argmax(truth.height[0] > 0.5 * STEP)]
    line = np.stack([np.full(41, brink), np.linspace(-6, 6, 41), np.full(41, STEP)], -1)
    edge = lens.project(pose.inverse.apply(line))
    way = lens.project(pose.inverse.apply(line + np.array([0.1, 0, 0]))) - edge
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    low, high = np.full(41, -0.5), np.full(41, 0.5)  # pixels: past it, and on it
    for _ in range(16):
        middle = 0.5 * (low + high)
        on = np.abs(_hits(world, lens, pose, edge + middle[:, None] * way)[:, 2] - STEP) < 1e-4
        low, high = np.where(on, low, middle), np.where(on, middle, high)
    return float(np.abs(0.5 * (low + high)).max())


def errors() -> dict[str, dict[str, float]]:
    """The largest error in pixels by lens model, of a plane, a sphere and a height step."""
    return {
        name: {"plane": _plane(lens), "sphere": _sphere(lens), "step": _step(lens)} for name, lens in LENSES.items()
    }
