"""What goes between the stages: frozen records, and the errors a user can mend.

World ENU, body FLU, camera optical; SI, radians, `int` nanoseconds; unknown is NaN, reasons are flag bits.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum, IntFlag

import numpy as np
from numpy.typing import NDArray

from alight.arrays import F16, F32, F64, U8, U16
from alight.geometry import Camera, Grid, LocalFrame, Pose
from alight.settings import Settings


class AlightError(Exception):
    """Something a user can mend; the message names the bad thing and says how."""


class InputError(AlightError):
    """The input cannot be used: a folder without images, a malformed calibration, a missing stream."""


class SettingsError(AlightError):
    """A setting is unknown or out of range."""


class OutputError(AlightError):
    """The result cannot be written: disk full, no permission, folder taken."""


class MissingExtraError(AlightError):
    """An optional package is not installed."""

    def __init__(self, package: str, extra: str) -> None:
        super().__init__(f"{package} is not installed; mend it with: pip install 'alight[{extra}]'")


@dataclass(frozen=True, eq=False)
class RigCamera:
    """One camera of a rig: its lens and where it sits."""

    name: str
    camera: Camera
    body_from_cam: Pose


@dataclass(frozen=True, eq=False)
class Rig:
    """The cameras that expose together; index 0 is the left or only one."""

    cameras: tuple[RigCamera, ...]


@dataclass(frozen=True, eq=False)
class Frame:
    """One exposure of the whole rig. An image that was dropped or unreadable is None."""

    t_ns: int
    images: tuple[U8 | None, ...]  # one a camera, (H, W) grey or (H, W, 3) RGB
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
    """Where the tracked features are in one exposure. Row i of every array is the feature `ids[i]`."""

    t_ns: int
    ids: NDArray[np.int64]  # (N,) one number a feature, never used again
    pixels: F64  # (N, cameras, 2) pixels as the image has them; NaN = not seen by that camera
    normalised: F64  # (N, cameras, 2) x/z, y/z with the lens taken out; NaN = not seen by that camera
    texture: F64 | None = None  # (N,) Shi-Tomasi response a pixel over the SSD window, grey range 1; None: unknown


@dataclass(frozen=True, eq=False)
class Prediction:
    """Where the cameras will be at an exposure as the motion lets expect it, and how well that is known.

    What tells how features move is the change of the pose, and that is known far better than the pose: both poses are
    of one estimate, with the covariance of the one as seen from the other.
    """

    world_from_cams: tuple[Pose, ...]
    earlier: tuple[Pose, ...] | None = None  # world_from_cam at the exposure before; None: no longer known
    covariance: F64 | None = None  # (6, 6) of earlier points in camera 0 now: turned by [rad], then moved by [m]


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


@dataclass(frozen=True, eq=False)
class KeyframePosterior:
    """Exposures from one posterior: poses that agree with each other, and how far they may be off together.

    In flight the last keyframes, in their map; of a recording exposures of the whole of it, in the world. `lenses`
    holds the camera once for each of L lens numbers that were estimated with the poses, that number off by one unit.
    """

    motions: tuple[Motion, ...]  # K, oldest first
    covariance: F64  # (6K + L, 6K + L): a pose of the rig is position [m], rotation vector in the world [rad]
    lenses: tuple[Camera, ...] = ()  # L


@dataclass(frozen=True, eq=False)
class RefinedMotions:
    """The motions of a whole recording, and how their errors go together."""

    motions: tuple[Motion, ...]
    joint: KeyframePosterior | None  # of some or all of them; None: the poses are exact, or their errors are not known


@dataclass(frozen=True, eq=False)
class Datum:
    """What all heights of a map share: how far its plane may be off, beside the sigma of each cell."""

    east: float  # metres, of the centre about which it tilts
    north: float
    covariance: F64  # (3, 3): offset up [m], rise per metre towards east and towards north [rad]

    @property
    def offset_sigma(self) -> float:
        """Of the height of the centre, metres."""
        return float(np.sqrt(self.covariance[0, 0]))

    @property
    def tilt_sigma(self) -> float:
        """Of the tilt towards where it is known worst, rad."""
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance[1:, 1:])[-1]))


@dataclass(frozen=True, eq=False)
class View:
    """One image with its pose: what parallax works on."""

    t_ns: int
    cam: int  # index in the rig
    image: U8  # (H, W) grey or (H, W, 3) RGB
    camera: Camera
    world_from_cam: Pose

    @property
    def centre(self) -> F64:
        """The camera centre C in the world, (3,) metres."""
        return np.asarray(self.world_from_cam.translation)


class Flag(IntFlag):
    """Why a height is missing or doubtful; bits of flags.tif."""

    UNSEEN = 1  # fewer than two views see the cell
    TEXTURE = 2  # too little texture to match
    AMBIGUOUS = 4  # a second height fits nearly as well
    SATURATED = 8  # the pixels are at an end of their range
    MOVING = 16  # the views disagree although the geometry fits: water, swaying plants, moving shadow
    STEP = 32  # within a window of a height step: the height may be that of the neighbour
    INCONSISTENT = 64  # fewer than two of the views that see the cell agree on what is there
    RANGE = 128  # the height is at an end of the searched range
    UNSURE = 256  # the evidence together makes a wrong match likely
    FEW = 512  # seen by two views only: a note, not a reason
    WATER = 1024  # water: what was matched is the bed, below the surface


# a height that carries one of these is not given out (NaN in dem.tif)
REFUSED = (
    Flag.UNSEEN
    | Flag.TEXTURE
    | Flag.AMBIGUOUS
    | Flag.SATURATED
    | Flag.MOVING
    | Flag.INCONSISTENT
    | Flag.RANGE
    | Flag.UNSURE
    | Flag.WATER
)


def is_trusted(flags: U16) -> NDArray[np.bool_]:
    """Where no flag refuses the height."""
    return np.asarray((flags & np.uint16(REFUSED)) == 0)


class Terrain(IntEnum):
    """Class codes of terrain.tif and of a flight's truth."""

    UNKNOWN = 0
    BARE = 1
    SHORT_GRASS = 2
    TALL_VEGETATION = 3
    TREE = 4
    WATER = 5
    ROCK = 6
    PAVED = 7
    STRUCTURE = 8


LANDABLE = (Terrain.BARE, Terrain.SHORT_GRASS, Terrain.PAVED)  # kinds of ground that may be landed on


@dataclass(frozen=True, eq=False)
class Heights:
    """What one parallax step found on one grid."""

    grid: Grid
    height: F32  # (R, C) metres above the origin (world up); NaN = unseen
    sigma: F32  # (R, C) metres, 1-sigma relative to the map
    flags: U16  # (R, C) bits of Flag
    views: U8  # (R, C) views that saw the cell
    rgb: U8  # (R, C, 3) what the cameras saw
    residual: F32  # (R, C) normalised matching residual, 0 (perfect) to 1 (nothing in common)
    gauge: Datum | None = None  # None: not known, as for poses that came without covariance


@dataclass(frozen=True, eq=False)
class ElevationMap:
    """One map of the ground, fused from many steps. Fields as in `Heights`."""

    grid: Grid
    height: F32
    sigma: F32
    flags: U16
    views: U8
    rgb: U8
    residual: F32
    gauge: Datum | None = None
    warp: F32 | None = None  # (R, C) metres, 1-sigma of a height from what the poses bend and turn beside the gauge
    fine: U8 | None = None  # (f R, f C, 3) the ground on finer pixels, the mean of several views; None: not known
    frame_id: int = 0  # of the poses that it was made with (`Motion.frame_id`)
    position_covariance: F64 | None = None  # (3, 3) m^2, of the whole map's place on Earth; None: not known

    @property
    def finest(self) -> tuple[U8, int]:
        """The finest picture of the ground that there is, (f R, f C, 3), and its pixels a cell, f."""
        picture = self.rgb if self.fine is None else self.fine
        return picture, picture.shape[0] // self.grid.rows

    @property
    def relative_sigma(self) -> F32:
        """(R, C) metres, 1-sigma of a height relative to the map's plane: of the match, and of what the poses bend."""
        return self.sigma if self.warp is None else np.hypot(self.sigma, self.warp)

    @property
    def trusted(self) -> NDArray[np.bool_]:
        """(R, C): cells whose height may be given out."""
        trusted: NDArray[np.bool_] = np.isfinite(self.height) & is_trusted(self.flags)
        return trusted


@dataclass(frozen=True, eq=False)
class TerrainMap:
    """What covers the ground."""

    grid: Grid
    label: U8  # (R, C) Terrain codes
    landable: F32  # (R, C) probability that this kind of ground may be landed on; NaN = no evidence
    probability: F16 | None = None  # (R, C, 8) of codes 1 to 8; NaN = nothing seen


class Hazard(IntFlag):
    """Why a touchdown centred on a cell is refused."""

    UNKNOWN = 1  # part of the footprint was not seen or not trusted
    SLOPE = 2
    ROUGHNESS = 4
    STEP = 8
    CLEARANCE = 16  # something stands in the rotor's or belly's way
    TERRAIN = 32  # water, plants, structure
    EDGE = 64  # the footprint leaves the map
    DOUBT = 128  # every limit is met, but not surely enough (p_safe below the least wanted)


@dataclass(frozen=True, eq=False)
class HazardMap:
    """What a touchdown centred on each cell would meet. NaN where it cannot be judged."""

    grid: Grid
    slope: F32  # (R, C) rad, of the footprint's plane
    roughness: F32  # (R, C) metres, largest deviation from that plane
    step: F32  # (R, C) metres, largest rise between neighbouring cells in the footprint
    clearance: F32  # (R, C) metres to the nearest cell where a touchdown is refused
    p_safe: F32  # (R, C) probability that a touchdown here meets every limit
    quality: F32  # (R, C) Q of the paper, eq. 5: 0 is best, more negative is worse
    reasons: NDArray[np.uint8]  # (R, C) bits of Hazard; 0 = safe


@dataclass(frozen=True)
class Site:
    """One candidate landing site, properties as in sites.geojson."""

    rank: int
    east: float
    north: float
    up: float
    p_safe: float
    quality: float
    slope: float  # rad
    roughness: float  # metres
    clearance: float  # metres
    radius: float  # metres, of the largest safe disc about it
    terrain: Terrain
    heading: float  # rad, clockwise from north, of the suggested touchdown
    height_sigma: float  # metres


@dataclass(frozen=True)
class Sites:
    """The answer: ranked sites, or the reason why there is none."""

    sites: tuple[Site, ...]
    reason: str = ""  # why `sites` is empty
    frame_id: int = 0  # of the map that they were found on


@dataclass(frozen=True, eq=False)
class NextView:
    """A view that would reduce the doubt about the most promising place: a proposal to the executive."""

    position_world: F64  # (3,) metres, of the cameras
    place_world: F64  # (3,) metres, what to look at
    p_safe: float  # of that place by now
    height: float  # metres above it


@dataclass(frozen=True, eq=False)
class Waypoint:
    """A point of the route."""

    name: str
    position_world: F64  # (3,) metres
    heading: float  # rad, clockwise from north
    speed: float  # m/s towards it
    t: float  # s from the start of the route
    look: bool = False  # judge the ground again from here


@dataclass(frozen=True)
class Route:
    """The way-points to the best site."""

    waypoints: tuple[Waypoint, ...]
    warnings: tuple[str, ...] = field(default=())
    frame_id: int = 0  # of the map that it was planned on


@dataclass(frozen=True, eq=False)
class RunResult:
    """Everything one run found out: what the output folder and the report are made of.

    Whatever a run could not make is None or empty; `not_written` then says why, by file name.
    """

    source_name: str  # the folder or file, as a person would call it
    source_kind: str  # photos | flight log | ...
    local: LocalFrame
    georeferenced: bool  # False: `local` is a stand-in and the world has no place on Earth
    settings: Settings
    sites: Sites
    elevation: ElevationMap | None = None
    terrain: TerrainMap | None = None
    hazards: HazardMap | None = None
    route: Route | None = None
    motions: Sequence[Motion] = ()
    height_above_ground: float | None = None  # metres, median over the exposures
    counts: Mapping[str, int] = field(default_factory=dict)  # "frames read": 32, "frames dropped, cut off": 1
    notes: Mapping[str, object] = field(default_factory=dict)  # words, numbers, lists: "focal": "held", "points": 19472
    warnings: Sequence[str] = ()
    timings: Mapping[str, Sequence[float]] = field(default_factory=dict)  # seconds of every step, by stage
    not_written: Mapping[str, str] = field(default_factory=dict)  # file name: why
