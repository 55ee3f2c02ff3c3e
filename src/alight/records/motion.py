"""Poses with covariance, and posed images."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum, StrEnum

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


class GpsState(StrEnum):
    """How the filter treats the positions of GPS/INS."""

    USED = "used"
    VAGUE = "vague"  # used, but they claim to be far less certain than the estimate
    LOST = "lost"  # none comes
    JUMPED = "jumped"  # they are outside their gate; neither they nor velocities are used
    DRIFTS = "drifts"  # they drift against the pictures; likewise
    RETURNING = "returning"  # they are back within their gate, and not used yet; likewise


@dataclass(frozen=True, eq=False)
class Odometry:
    """Facts about a motion for an autopilot that navigates by it.

    The pose in the map frame has no jumps while `resets` is constant: positions that come back, or that jumped, move
    only the offset of the map.
    """

    covariance: F64  # (9, 9) position [m], rotation vector in the world [rad], velocity [m/s], in the map frame (M29)
    angular_velocity_body: F64  # (3,) rad/s, without the gyro bias
    quality: float  # 0 to 1: share of the landmarks that the filter can hold, and of the features that pass; 0: none
    resets: int = 0  # number of events at which the pose may have jumped
    gps: GpsState = GpsState.USED
    gps_why: str = ""  # reason why positions are not USED
    unaided: float = 0.0  # s since the last position that was used


@dataclass(frozen=True, eq=False)
class MovingBody:
    """A person or car that moves on the ground, as one exposure shows it."""

    place: F64  # (2,) metres east and north, in the map frame
    velocity: F64  # (2,) m/s
    reach: float  # metres from `place` to its edge, roughly


@dataclass(frozen=True, eq=False)
class Motion:
    """Poses and velocity of the vehicle and its cameras at one exposure, with covariance.

    `world_from_cams` includes any mounting correction that the estimator found. It can therefore differ from
    `world_from_body @ body_from_cam` of the rig.
    """

    t_ns: int
    world_from_body: Pose
    world_from_cams: tuple[Pose, ...]
    covariance: F64  # (6, 6) position in the world [m], then rotation vector in the world [rad]
    velocity_world: F64 | None = None  # (3,) m/s
    state: MotionState = MotionState.GOOD
    tracks: int = 0  # number of features used
    offset_world: F64 | None = None  # (3,) m, map offset: add it to positions for the best world positions
    why: str = ""  # reason why the state is not GOOD
    frame_id: int = 0  # map number: changes when the estimator is reinitialised
    rolling: F64 | None = (
        None  # (9,) translation [m], linear and quadratic turn [rad] of the camera, in its axes, during the readout
    )
    gain: F64 | None = None  # (3,) factor of the picture's colours that equalises all pictures
    odometry: Odometry | None = None  # None: not from the filter
    movers: tuple[MovingBody, ...] = ()  # people and cars that move in its pictures


@dataclass(frozen=True, eq=False)
class KeyframePosterior:
    """Joint posterior of the poses of several exposures.

    In flight the exposures are the last keyframes, in their map frame. For a recording they are spread over all of it,
    in the world frame. L lens parameters are estimated with the poses: `lenses[k]` holds the cameras with parameter k
    increased by one unit.
    """

    motions: tuple[Motion, ...]  # K motions, oldest first
    covariance: F64  # (6K + L, 6K + L); pose of the rig: position [m], rotation vector in the world [rad]
    lenses: tuple[tuple[Camera, ...], ...] = ()  # L tuples of the rig's cameras


@dataclass(frozen=True, eq=False)
class RefinedMotions:
    """Motions of a whole recording, with the joint covariance of their errors."""

    motions: tuple[Motion, ...]
    joint: KeyframePosterior | None  # posterior of some or all motions; None: poses exact, or errors unknown


@dataclass(frozen=True, eq=False)
class View:
    """One image with its pose: the input of parallax."""

    t_ns: int
    cam: int  # index in the rig
    image: Pixels  # (H, W) grey or (H, W, 3) RGB
    camera: Camera
    world_from_cam: Pose  # at the exposure of the middle row
    rolling: F64 | None = (
        None  # (9,) translation [m], linear and quadratic turn [rad] of the camera, in its axes, during the readout
    )
    gain: F64 | None = None  # (3,) factor of the colours that equalises all views

    @property
    def centre(self) -> F64:
        """Camera centre C in the world, (3,) metres."""
        return np.asarray(self.world_from_cam.translation)

    @property
    def without_image(self) -> View:
        """The view with an empty image, which saves most of its memory."""
        return replace(self, image=np.empty((0, 0), np.uint8))

    @property
    def key(self) -> tuple[int, int, bytes]:
        """Key of image and pose: equal for all views of one image from one pose."""
        rolling = b"" if self.rolling is None else self.rolling.tobytes()
        return self.t_ns, self.cam, self.world_from_cam.matrix.tobytes() + rolling
