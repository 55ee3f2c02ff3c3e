"""Geometric error of pictures: a plane, a sphere and a step against their exact projection, in pixels."""

from __future__ import annotations

import numpy as np

from alight.arrays import F64
from alight.geometry import Camera, Grid, Pose
from alight_sim.cameras import Eye
from alight_sim.kernels.raycast import cast_rays
from alight_sim.scene_world import SceneWorld, world_of

HEIGHT, BASELINE = 20.0, 0.5  # metres
PLANE = (0.15, -0.08, 1.0)  # slope east, slope north, height at the origin
RADIUS, RIM = 8.0, 5.0  # of the sphere about the origin, and the height at which it ends
TOP = 2.0  # of the step
LENSES = {
    "pinhole": Camera(320, 240, 240.6, 240.1, 161.5, 121.4),
    "radial-tangential": Camera(
        320, 240, 240.6, 240.1, 161.5, 121.4, "radial-tangential", (-0.0899, 0.0195, -0.00077, 0.00065)
    ),
    "equidistant": Camera(320, 240, 190.3, 190.1, 161.5, 121.4, "equidistant", (-0.01, 0.02, -0.01, 0.002)),
}


def errors(camera: Camera) -> dict[str, float]:
    """Largest error of plane, sphere and step seen through a lens, pixels.

    Plane and sphere: the point that a pixel hits against the closed form, projected into a second camera half a metre
    aside (so a wrong depth counts too), and into the first one. Step: its upper edge by bisection between pixels.
    """
    pose = _tilted()
    return {"plane": _plane(camera, pose), "sphere": _sphere(camera, pose), "step": _step(camera, pose)}


def _tilted() -> Pose:
    """A camera that looks down, askew in all three angles."""
    a, b, c = 0.05, -0.08, 0.3
    pitch = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    roll = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
    yaw = np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
    down = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    return Pose(yaw @ pitch @ roll @ down, np.array([0.43, -0.31, HEIGHT]))


def _ground(cell: float, side: float) -> tuple[Grid, F64, F64]:
    n = round(side / cell) + 1
    grid = Grid(-0.5 * side, 0.5 * side, cell, n, n)
    x, y = grid.xy()
    return grid, x[None, :], y[:, None]


def _apart(camera: Camera, pose: Pose, seen: F64, true: F64) -> float:
    """Largest distance of two sets of points (N, 3), pixels, in the camera and in one beside it."""
    beside = Pose(pose.rotation, pose.translation + pose.rotation @ [BASELINE, 0.0, 0.0])
    views = [np.linalg.norm(camera.project(p.inverse.apply(seen)) - camera.project(p.inverse.apply(true)), axis=-1)
             for p in (pose, beside)]  # fmt: skip
    return float(np.max(views))


def _look(world: SceneWorld, camera: Camera, pose: Pose) -> tuple[F64, F64]:
    """(N, 3) exact directions of all pixels in the world, and (N, 3) points that they hit, metres."""
    u, v = np.meshgrid(np.arange(float(camera.width)), np.arange(float(camera.height)))
    rays = camera.rays(np.stack([u, v], -1))
    eye = Eye(camera)
    seen = pose.apply(eye.rays[0].astype(np.float64) * eye.depth(world, pose)[..., None])
    return (rays @ pose.rotation.T).reshape(-1, 3), seen.reshape(-1, 3)


def _plane(camera: Camera, pose: Pose) -> float:
    grid, x, y = _ground(0.2, 90.0)
    e, n, h = PLANE
    rays, seen = _look(world_of(grid, (e * x + n * y + h).astype(np.float32)), camera, pose)
    o = pose.translation
    t = (e * o[0] + n * o[1] + h - o[2]) / (rays[:, 2] - e * rays[:, 0] - n * rays[:, 1])
    return _apart(camera, pose, seen, o + t[:, None] * rays)


def _sphere(camera: Camera, pose: Pose) -> float:
    grid, x, y = _ground(0.02, 26.0)
    cap = np.sqrt(np.maximum(RADIUS**2 - x**2 - y**2, RIM**2))
    rays, seen = _look(world_of(grid, cap.astype(np.float32)), camera, pose)
    o = pose.translation
    a, b, c = (rays * rays).sum(axis=1), rays @ o, o @ o - RADIUS**2
    with np.errstate(invalid="ignore"):
        true = o + ((-b - np.sqrt(b * b - a * c)) / a)[:, None] * rays
    on = true[:, 2] > RIM + 0.2
    return _apart(camera, pose, seen[on], true[on])


def _step(camera: Camera, pose: Pose) -> float:
    grid, x, y = _ground(0.1, 60.0)
    world = world_of(grid, np.where(x + 0.0 * y > 0.95, TOP, 0.0).astype(np.float32))
    brink = float(x[0, np.argmax(x[0] > 0.95)])
    north = np.linspace(-4.0, 4.0, 41)
    edge, inside = (
        camera.project(pose.inverse.apply(np.stack([np.full(41, e), north, np.full(41, TOP)], -1)))
        for e in (brink, brink + 0.1)
    )
    way = (inside - edge) / np.linalg.norm(inside - edge, axis=1, keepdims=True)
    low, high = np.full(41, -0.5), np.full(41, 0.5)  # pixels before and behind the edge
    for _ in range(20):
        middle = 0.5 * (low + high)
        on = _heights(world, camera, pose, edge + middle[:, None] * way) > TOP - 1e-5
        low, high = np.where(on, low, middle), np.where(on, middle, high)
    return float(np.abs(high).max())


def _heights(world: SceneWorld, camera: Camera, pose: Pose, pixels: F64) -> F64:
    """(N,) heights of the points that (N, 2) positions between the pixels hit, with rays rounded as an Eye's."""
    patch = world.patch((-20.0, -20.0, 20.0, 20.0))
    cell, rays = patch.grid.cell, camera.rays(pixels).astype(np.float32)
    o = pose.translation
    origin = np.array([[(o[0] - patch.place[0]) / cell, (patch.place[1] - o[1]) / cell, o[2]]])
    turn, out = (np.diag([1.0 / cell, -1.0 / cell, 1.0]) @ pose.rotation)[None], np.empty((1, len(pixels)))
    cast_rays(patch.height, *patch.pyramid, origin, rays[None], turn, patch.low, out)
    return np.asarray(pose.apply(rays.astype(np.float64) * out[0][:, None])[:, 2])
