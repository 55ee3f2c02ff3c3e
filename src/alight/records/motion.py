"""Poses with their covariance, and views."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np

from alight.arrays import F64
from alight.geometry import Camera, Pose
from alight.records.events import Pixels


class MotionState(IntEnum):
    """State of the motion estimate."""

    INITIALISING = 0
    GOOD = 1
    DEGRADED = 2
    LOST = 3


@dataclass(frozen=True, eq=False)
class Motion:
    """Poses and velocity of the vehicle and its cameras at one exposure, with covariance.

    `world_from_cams` holds any mounting correction that the estimator found, so it can differ from
    `world_from_body @ body_from_cam` of the rig.
    """

    t_ns: int
    world_from_body: Pose
    world_from_cams: tuple[Pose, ...]
    covariance: F64  # (6, 6) position in the world [m], then rotation vector in the world [rad]
    velocity_world: F64 | None = None  # (3,) m/s
    state: MotionState = MotionState.GOOD
    tracks: int = 0  # features that supported it
    offset_world: F64 | None = None  # (3,) m, map offset: positions plus this are their best estimate in the world
    why: str = ""  # reason why it is not GOOD
    frame_id: int = 0  # number of the map frame: a new one after the estimator had to start anew
    rolling: F64 | None = (
        None  # (9,) translation [m], linear and quadratic turn [rad] of the camera, in its axes, during the readout
    )
    gain: F64 | None = None  # (3,) factor of its picture's colours, so that all pictures show the ground alike


@dataclass(frozen=True, eq=False)
class KeyframePosterior:
    """Joint posterior of the poses of several exposures.

    In flight these are the last keyframes, in their map frame; of a recording, exposures from all of it, in the world.
    `lenses` holds the cameras once for each of L lens numbers estimated with the poses, that number off by one unit.
    """

    motions: tuple[Motion, ...]  # K, oldest first
    covariance: F64  # (6K + L, 6K + L): a pose of the rig is position [m], rotation vector in the world [rad]
    lenses: tuple[tuple[Camera, ...], ...] = ()  # L times the cameras of the rig


@dataclass(frozen=True, eq=False)
class RefinedMotions:
    """The motions of a whole recording, with the joint covariance of their errors."""

    motions: tuple[Motion, ...]
    joint: KeyframePosterior | None  # of some or all of them; None: the poses are exact, or their errors are not known


@dataclass(frozen=True, eq=False)
class View:
    """One image with its pose: the input of parallax."""

    t_ns: int
    cam: int  # index in the rig
    image: Pixels  # (H, W) grey or (H, W, 3) RGB
    camera: Camera
    world_from_cam: Pose  # when the middle row was exposed
    rolling: F64 | None = (
        None  # (9,) translation [m], linear and quadratic turn [rad] of the camera, in its axes, during the readout
    )
    gain: F64 | None = None  # (3,) factor of its colours, so that all views show the ground alike

    @property
    def centre(self) -> F64:
        """The camera centre C in the world, (3,) metres."""
        return np.asarray(self.world_from_cam.translation)

    @property
    def without_image(self) -> View:
        """The view without its picture, which takes most of its memory."""
        return replace(self, image=np.empty((0, 0), np.uint8))

    @property
    def key(self) -> tuple[int, int, bytes]:
        """Key of image and pose: equal for all views of one image from one pose."""
        rolling = b"" if self.rolling is None else self.rolling.tobytes()
        return self.t_ns, self.cam, self.world_from_cam.matrix.tobytes() + rolling
