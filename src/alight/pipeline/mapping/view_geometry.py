"""Geometry of views and ground: views that look down, their footprints, and the ground in them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from alight.arrays import F64
from alight.geometry import Camera
from alight.parallax.views import radius2_limit
from alight.records import View

STEEPEST = np.cos(np.radians(75.0))  # views flatter than this to the ground are not used
ENOUGH = 40  # points or cells, least to estimate a height from


def looking_down(views: Sequence[View]) -> list[View]:
    """The views whose optical axis is at most 75 degrees from straight down."""
    return [v for v in views if -v.world_from_cam.rotation[2, 2] > STEEPEST]


@lru_cache(maxsize=1024)
def _border(camera: Camera) -> F64:
    """Rays through corners and middles of the sides of its picture, (8, 3), in the optical frame."""
    w, h = camera.width - 1.0, camera.height - 1.0
    return camera.rays(np.array([[0, 0], [w / 2, 0], [w, 0], [w, h / 2], [w, h], [w / 2, h], [0, h], [0, h / 2]]))


def footprint(view: View, height: float) -> F64:
    """Footprint of the image's border on level ground at `height`, (N, 2) metres; rays end at 75 degrees from down."""
    rays = _border(view.camera) @ view.world_from_cam.rotation.T
    down = np.maximum(-rays[:, 2], np.linalg.norm(rays, axis=1) * STEEPEST)
    return np.asarray(view.centre[:2] + rays[:, :2] * ((view.centre[2] - height) / down)[:, None])


def bounds(views: Sequence[View], height: float | F64) -> tuple[F64, F64]:
    """The rectangle about all footprints of the views on level ground: south-west and north-east corner, (2,) metres.

    `height`: metres, of the ground; one for all views, or (N,) of each.
    """
    corners = np.concatenate([footprint(v, h) for v, h in zip(views, np.broadcast_to(height, len(views)), strict=True)])
    return corners.min(axis=0), corners.max(axis=0)


def ground_in(view: View, points: F64, otherwise: float) -> float:
    """Median height of the points (N, 3) in the picture of a view, metres; `otherwise` where there are too few."""
    place = view.world_from_cam.inverse.apply(points)
    ahead = place[:, 2] > 0
    points, place = points[ahead], place[ahead]
    uv = view.camera.project(place)
    inside = ((uv >= 0) & (uv <= [view.camera.width - 1, view.camera.height - 1])).all(axis=1)
    inside &= ((place[:, :2] / place[:, 2:]) ** 2).sum(axis=1) < radius2_limit(view.camera)
    return float(np.median(points[inside, 2])) if inside.sum() >= ENOUGH else otherwise
