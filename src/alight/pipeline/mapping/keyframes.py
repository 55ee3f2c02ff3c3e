"""Keyframes: their selection, their pixels as long as needed, and the ground that they show."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from alight.arrays import F64
from alight.geometry import Camera
from alight.parallax.plane_sweep import ENOUGH
from alight.parallax.views import STEEPEST, inside_picture, on_level, radius2_limit
from alight.records import Frame, Motion, Rig, View
from alight.settings import StageSettings


def is_keyframe(
    motion: Motion, last: Motion | None, ground: float | None, first_step: float, settings: StageSettings
) -> bool:
    """Whether an exposure is a keyframe of the map: its camera moved far enough since the last keyframe.

    Args:
        motion: motion of the exposure.
        last: motion of the last keyframe; None: there is no keyframe yet.
        ground: ground height above the origin, metres; None: unknown, and `first_step` metres are far enough.
    """
    if last is None:
        return True
    step = first_step
    if ground is not None:
        above = motion.world_from_body.translation[2] - ground
        step = settings.parallax.points.least_angle * max(above, 1.0)
    moved = motion.world_from_cams[0].translation - last.world_from_cams[0].translation
    return bool(np.linalg.norm(moved) >= step)


class Keyframe(NamedTuple):
    """Exposure that is kept, with its motion as estimated on arrival."""

    frame: Frame
    motion: Motion | None  # None: it is estimated only at the end of the recording, as of photos


class FrameStore:
    """Frames that are kept, oldest first."""

    def __init__(self) -> None:
        self.keyframes: list[Keyframe] = []
        self.taken = 0  # number of frames ever kept
        self.last: Motion | None = None  # motion of the newest frame that has a motion; None: no frame has one

    @property
    def bytes(self) -> int:
        """Size of the pixels of all frames, bytes."""
        return sum(i.nbytes for k in self.keyframes for i in k.frame.images if i is not None)

    def keep(self, frame: Frame, motion: Motion | None = None) -> None:
        """Add a frame, with its motion if known."""
        self.keyframes.append(Keyframe(frame, motion))
        self.taken += 1
        self.last = motion or self.last

    def thin(self) -> None:
        """Drop every second frame, but keep the newest."""
        self.keyframes = self.keyframes[::-2][::-1]


def views_of(keyframes: Iterable[Keyframe], rig: Rig, newer: Mapping[int, Motion] | None = None) -> list[View]:
    """Return the images of keyframes with a motion as posed views; motions in `newer`, by time, take precedence."""
    out = []
    for k in keyframes:
        motion = k.motion if newer is None else newer.get(k.frame.t_ns, k.motion)
        for i, image in enumerate(k.frame.images):
            if motion is not None and image is not None:
                at = motion.world_from_cams[i]
                out.append(View(k.frame.t_ns, i, image, rig.cameras[i].camera, at, motion.rolling, motion.gain))
    return out


def looking_down(views: Sequence[View]) -> list[View]:
    """Return the views whose optical axis is less than 75 degrees from straight down."""
    return [v for v in views if -v.world_from_cam.rotation[2, 2] > STEEPEST]


@lru_cache(maxsize=1024)
def _border(camera: Camera) -> F64:
    """Return the rays through corners and side centres of the picture, (8, 3), in the optical frame."""
    w, h = camera.width - 1.0, camera.height - 1.0
    return camera.rays(np.array([[0, 0], [w / 2, 0], [w, 0], [w, h / 2], [w, h], [w / 2, h], [0, h], [0, h / 2]]))


def footprint(view: View, height: float) -> F64:
    """Project the picture's border onto level ground at `height`, (N, 2) metres; rays end at 75 degrees from down."""
    return on_level(_border(view.camera) @ view.world_from_cam.rotation.T, view.centre, height)


def bounds(views: Sequence[View], height: float | F64) -> tuple[F64, F64]:
    """Return the rectangle around the views' footprints on level ground: south-west and north-east corner, (2,) metres.

    `height`: ground height, metres; one value for all views, or (N,) one per view.
    """
    corners = np.concatenate([footprint(v, h) for v, h in zip(views, np.broadcast_to(height, len(views)), strict=True)])
    return corners.min(axis=0), corners.max(axis=0)


def ground_in(view: View, points: F64, otherwise: float) -> float:
    """Return the median height of the points (N, 3) in a view's picture, metres; `otherwise` if they are too few."""
    place = view.world_from_cam.inverse.apply(points)
    ahead = place[:, 2] > 0
    points, place = points[ahead], place[ahead]
    inside = inside_picture(view.camera, place)
    inside &= ((place[:, :2] / place[:, 2:]) ** 2).sum(axis=1) < radius2_limit(view.camera)
    return float(np.median(points[inside, 2])) if inside.sum() >= ENOUGH else otherwise
