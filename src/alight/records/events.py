"""Output of the sources: cameras, frames, GPS/INS and inertial samples, the schedule; and feature tracks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import DTypeLike, NDArray

from alight.arrays import F64, U8
from alight.geometry import Camera, Pose


class StoredPixels(Protocol):
    """A picture that is not held in memory: `np.asarray` reads it."""

    nbytes: int  # bytes of memory that it always holds

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> U8:
        """The pixels, (H, W) grey or (H, W, 3) RGB."""

    def let_go(self) -> None:
        """Keep no copy of the pixels in memory: they are not needed soon."""


Pixels = U8 | StoredPixels


@dataclass(frozen=True, eq=False)
class RigCamera:
    """One camera of a rig: its lens and its mounting."""

    name: str
    camera: Camera
    body_from_cam: Pose
    readout: float | None = None  # s, from the exposure of the first row to that of the last; None: unknown


@dataclass(frozen=True, eq=False)
class Rig:
    """The cameras that expose together; index 0 is the left or only one."""

    cameras: tuple[RigCamera, ...]


@dataclass(frozen=True, eq=False)
class Frame:
    """One exposure of the whole rig. An image that was dropped or unreadable is None."""

    t_ns: int
    images: tuple[Pixels | None, ...]  # one a camera, (H, W) grey or (H, W, 3) RGB
    name: str = ""


@dataclass(frozen=True, eq=False)
class NavSample:
    """One row of the GPS/INS navigation solution; None is 'not measured'."""

    t_ns: int
    position_world: F64 | None  # (3,) metres
    world_from_body: F64 | None  # (3, 3) rotation
    velocity_world: F64 | None = None  # (3,) m/s
    angular_velocity_body: F64 | None = None  # (3,) rad/s
    sigma_position: F64 | None = None  # (3,) metres, east north up
    sigma_attitude: F64 | None = None  # (3,) rad, roll pitch yaw
    sigma_velocity: F64 | None = None  # (3,) m/s, east north up


@dataclass(frozen=True, eq=False)
class ImuSample:
    """One raw inertial measurement, body frame."""

    t_ns: int
    angular_velocity_body: F64  # (3,) rad/s
    specific_force_body: F64  # (3,) m/s^2


Event = Frame | NavSample | ImuSample


@dataclass(frozen=True, eq=False)
class Tracks:
    """Tracked features of one exposure. Row i of every array is the feature `ids[i]`."""

    t_ns: int
    ids: NDArray[np.int64]  # (N,) one number a feature, never used again
    pixels: F64  # (N, cameras, 2) pixels as the image has them; NaN = not seen by that camera
    normalised: F64  # (N, cameras, 2) x/z, y/z with the lens taken out; NaN = not seen by that camera
    texture: F64 | None = None  # (N,) Shi-Tomasi response a pixel over the SSD window, grey range 1; None: unknown


@dataclass(frozen=True, eq=False)
class Prediction:
    """Predicted camera poses of an exposure, with covariance.

    The motion of features depends on the change of the pose, which is known far better than the pose. Both poses are
    of one estimate; the covariance is that of one pose relative to the other.
    """

    world_from_cams: tuple[Pose, ...]
    earlier: tuple[Pose, ...] | None = None  # world_from_cam at the exposure before; None: no longer known
    covariance: F64 | None = None  # (6, 6) of earlier points in camera 0 now: turned by [rad], then moved by [m]

    @property
    def is_finite(self) -> bool:
        """True if all its numbers are finite."""
        known = [p.matrix for p in (*self.world_from_cams, *(self.earlier or ()))]
        return all(np.isfinite(a).all() for a in (*known, *(() if self.covariance is None else (self.covariance,))))


Spot = tuple[float, float]  # east, north, metres in the map's frame


@dataclass(frozen=True)
class Schedule:
    """Exposures of a flight that each lane used, by their stamps in ns; it left out the others because it was busy.

    A lane that was lost begins anew with an exposure: its state is gone, in a replay too.
    """

    tracked: tuple[int, ...] = ()  # exposures that the navigation lane took
    mapped: tuple[int, ...] = ()  # exposures that the mapping lane took
    effort: tuple[int, ...] = ()  # of the mapping lane for each of them: 0 full, higher numbers less
    judged: tuple[int, ...] = ()  # exposures whose map was judged
    about: tuple[Spot | None, ...] = ()  # the place that each of these maps showed too; None: none
    navigation_anew: tuple[int, ...] = ()  # exposures before which the navigation lane began anew
    mapping_anew: tuple[int, ...] = ()  # exposures before which the mapping lane began anew
