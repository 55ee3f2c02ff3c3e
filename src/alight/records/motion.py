"""Poses with their covariance, and views."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from alight.arrays import F64
from alight.geometry import Camera, Pose
from alight.records.events import Pixels


class MotionState(IntEnum):
    """How far the motion estimate can be trusted."""

    INITIALISING = 0
    GOOD = 1
    DEGRADED = 2
    LOST = 3


@dataclass(frozen=True, eq=False)
class Motion:
    """Where the vehicle and its cameras were at one exposure, with covariance.

    `world_from_cams` is what the pictures say: it holds any mounting correction that the estimator found, so it can
    differ from `world_from_body @ body_from_cam` of the rig.
    """

    t_ns: int
    world_from_body: Pose
    world_from_cams: tuple[Pose, ...]
    covariance: F64  # (6, 6) position in the world [m], then rotation vector in the world [rad]
    velocity_world: F64 | None = None  # (3,) m/s
    state: MotionState = MotionState.GOOD
    tracks: int = 0  # features that supported it
    offset_world: F64 | None = None  # (3,) m to add to the positions for the best guess of where the world has them
    why: str = ""  # it is not GOOD
    frame_id: int = 0  # poses of one number belong together; a new one after the estimator had to start anew
    rolling: F64 | None = (
        None  # (9,) way [m], even and bent turn [rad] of the camera, in its axes, while it is read out
    )
    gain: F64 | None = None  # (3,) factor of its picture's colours, with which all show the ground alike


@dataclass(frozen=True, eq=False)
class KeyframePosterior:
    """Exposures from one posterior: poses that agree with each other, and how far they may be off together.

    In flight the last keyframes, in their map; of a recording exposures of the whole of it, in the world. `lenses`
    holds the cameras once for each of L lens numbers that were estimated with the poses, that number off by one unit.
    """

    motions: tuple[Motion, ...]  # K, oldest first
    covariance: F64  # (6K + L, 6K + L): a pose of the rig is position [m], rotation vector in the world [rad]
    lenses: tuple[tuple[Camera, ...], ...] = ()  # L times the cameras of the rig


@dataclass(frozen=True, eq=False)
class RefinedMotions:
    """The motions of a whole recording, and how their errors go together."""

    motions: tuple[Motion, ...]
    joint: KeyframePosterior | None  # of some or all of them; None: the poses are exact, or their errors are not known


@dataclass(frozen=True, eq=False)
class View:
    """One image with its pose: what parallax works on."""

    t_ns: int
    cam: int  # index in the rig
    image: Pixels  # (H, W) grey or (H, W, 3) RGB
    camera: Camera
    world_from_cam: Pose  # when the middle row was exposed
    rolling: F64 | None = (
        None  # (9,) way [m], even and bent turn [rad] of the camera, in its axes, while it is read out
    )
    gain: F64 | None = None  # (3,) factor of its colours, with which all views show the ground alike

    @property
    def centre(self) -> F64:
        """The camera centre C in the world, (3,) metres."""
        return np.asarray(self.world_from_cam.translation)

    @property
    def key(self) -> tuple[int, int, bytes]:
        """The same of all views of one image from one pose."""
        rolling = b"" if self.rolling is None else self.rolling.tobytes()
        return self.t_ns, self.cam, self.world_from_cam.matrix.tobytes() + rolling
