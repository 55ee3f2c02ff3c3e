"""Output of the sources: cameras, frames, GPS/INS and inertial samples; also feature tracks and the schedule."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import DTypeLike, NDArray

from alight.arrays import F64, U8
from alight.geometry import Camera, Pose


class StoredPixels(Protocol):
    """Picture on disk; `np.asarray` reads it into memory."""

    nbytes: int  # bytes of memory that it occupies even when not loaded

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> U8:
        """Return the pixels, (H, W) grey or (H, W, 3) RGB."""

    def let_go(self) -> None:
        """Release the copy of the pixels in memory, as they are not needed soon."""


Pixels = U8 | StoredPixels


@dataclass(frozen=True, eq=False)
class RigCamera:
    """One camera of a rig: intrinsics and mounting."""

    name: str
    camera: Camera
    body_from_cam: Pose
    readout: float | None = None  # s, time between the exposures of the first and the last row; None: unknown


@dataclass(frozen=True, eq=False)
class Rig:
    """Cameras that expose together; index 0 is the left or only camera."""

    cameras: tuple[RigCamera, ...]


@dataclass(frozen=True, eq=False)
class Frame:
    """One exposure of the whole rig; a dropped or unreadable image is None."""

    t_ns: int
    images: tuple[Pixels | None, ...]  # one per camera, (H, W) grey or (H, W, 3) RGB
    name: str = ""


@dataclass(frozen=True, eq=False)
class NavSample:
    """One row of the GPS/INS navigation solution; None: not measured."""

    t_ns: int
    position_world: F64 | None  # (3,) metres
    world_from_body: F64 | None  # (3, 3) rotation
    velocity_world: F64 | None = None  # (3,) m/s
    angular_velocity_body: F64 | None = None  # (3,) rad/s
    sigma_position: F64 | None = None  # (3,) metres, east north up
    sigma_attitude: F64 | None = None  # (3,) rad, roll pitch yaw
    sigma_velocity: F64 | None = None  # (3,) m/s, east north up
    height_world: float | None = None  # metres above the world's origin, of a row without position: the barometer's


@dataclass(frozen=True, eq=False)
class ImuSample:
    """One raw inertial measurement, body frame."""

    t_ns: int
    angular_velocity_body: F64  # (3,) rad/s
    specific_force_body: F64  # (3,) m/s^2


Event = Frame | NavSample | ImuSample


@dataclass(frozen=True, eq=False)
class Tracks:
    """Tracked features of one exposure; row i of every array belongs to the feature `ids[i]`."""

    t_ns: int
    ids: NDArray[np.int64]  # (N,) unique number of each feature, never reused
    pixels: F64  # (N, cameras, 2) distorted pixels; NaN = not seen by that camera
    normalised: F64  # (N, cameras, 2) undistorted x/z, y/z; NaN = not seen by that camera
    texture: F64 | None = None  # (N,) Shi-Tomasi response per pixel of the SSD window, grey range 1; None: unknown


@dataclass(frozen=True, eq=False)
class Prediction:
    """Predicted camera poses of an exposure, with covariance.

    The image motion of features depends on the change of the pose, which is known far better than the pose itself. Both
    poses come from one estimate. The covariance describes the later pose relative to the earlier one.
    """

    world_from_cams: tuple[Pose, ...]
    earlier: tuple[Pose, ...] | None = None  # world_from_cam at the previous exposure; None: unknown
    covariance: F64 | None = None  # (6, 6) of the motion of points in camera 0: rotation [rad], translation [m]

    @property
    def is_finite(self) -> bool:
        """Whether all numbers of the prediction are finite."""
        known = [p.matrix for p in (*self.world_from_cams, *(self.earlier or ()))]
        return all(np.isfinite(a).all() for a in (*known, *(() if self.covariance is None else (self.covariance,))))


Spot = tuple[float, float]  # east and north in the map frame, metres


@dataclass(frozen=True)
class Schedule:
    """Exposures of a flight that each lane used, by their time stamps in ns; a busy lane skips exposures.

    A lost lane restarts at an exposure without its earlier state, in a replay too.
    """

    tracked: tuple[int, ...] = ()  # exposures that the navigation lane used
    mapped: tuple[int, ...] = ()  # exposures that the mapping lane used
    effort: tuple[int, ...] = ()  # effort of the mapping lane per mapped exposure: 0 is full, higher is less
    judged: tuple[int, ...] = ()  # exposures whose map was judged
    about: tuple[Spot | None, ...] = ()  # position that each judged map also had to show; None: no position
    navigation_anew: tuple[int, ...] = ()  # exposures before which the navigation lane was restarted
    mapping_anew: tuple[int, ...] = ()  # exposures before which the mapping lane was restarted
