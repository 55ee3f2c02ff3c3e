"""Reports of an autopilot: state and notices. ENU, FLU, SI units; altitudes above mean sea level are named `msl`."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from enum import Enum, IntFlag
from typing import Literal

import numpy as np

from alight.arrays import F64
from alight.records.errors import InputError

FirmwareName = Literal["ardupilot", "px4"]
_NAN = float("nan")
PRE_ARM = 0x10000000  # MAV_SYS_STATUS_PREARM_CHECK
FIX_3D = 3
FARTHEST_FROM_SEA = 120.0  # metres, largest distance of the geoid from the ellipsoid
HIGHEST = 12_000.0  # metres; no ground lies as far above or below the sea or the ellipsoid


class FlightMode(Enum):
    """Mode of the autopilot, with the same names for all firmwares."""

    GUIDED = "guided"  # follows our set-points (ArduPilot GUIDED, PX4 Offboard)
    MISSION = "mission"
    TAKE_OFF = "take-off"  # PX4 only; ArduPilot takes off within GUIDED
    LAND = "land"
    HOLD = "hold"  # keeps its position (BRAKE, Hold)
    RETURN = "return"
    PILOT = "pilot"  # any mode in which a person flies with the sticks
    OTHER = "other"


class Landed(Enum):
    """Landed state of the vehicle, numbered as in MAV_LANDED_STATE."""

    UNKNOWN = 0
    GROUND = 1
    AIR = 2
    TAKING_OFF = 3
    LANDING = 4


@dataclass(frozen=True)
class Place:
    """Position from the autopilot; both altitudes are those of one instant."""

    latitude: float  # degrees
    longitude: float  # degrees
    altitude_msl: float  # metres above mean sea level
    above_home: float = _NAN  # metres above the autopilot's own home position


@dataclass(frozen=True)
class Home:
    """Position where the vehicle is armed: the zero of its relative altitudes."""

    latitude: float  # degrees
    longitude: float  # degrees
    altitude_msl: float  # metres above mean sea level
    separation: float = _NAN  # metres, height of the geoid above the ellipsoid there; NaN: unknown

    @property
    def height(self) -> float:
        """Height above the WGS84 ellipsoid, metres; NaN without a separation."""
        return self.altitude_msl + self.separation

    @classmethod
    def parse(cls, text: str) -> Home:
        """Parse `LAT,LON,ALT_MSL` with an optional `,SEPARATION`.

        Raises:
            InputError: a number is missing, malformed or out of range.
        """
        want = "write LAT,LON,ALT_MSL: degrees, and metres above the sea; a fourth number is the SEPARATION there"
        try:
            numbers = [float(part) for part in text.split(",")]
        except ValueError as e:
            raise InputError(f"home {text!r}: {want}") from e
        if not 3 <= len(numbers) <= 4 or not np.isfinite(numbers).all():
            raise InputError(f"home {text!r}: {want}")
        if abs(numbers[0]) > 90 or abs(numbers[1]) > 360 or abs(numbers[2]) > HIGHEST:
            raise InputError(f"home {text!r}: is nowhere on Earth; {want}")
        if len(numbers) == 4 and abs(numbers[3]) > FARTHEST_FROM_SEA:
            raise InputError(f"home {text!r}: the separation is at most {FARTHEST_FROM_SEA:.0f} m; {want}")
        return cls(*numbers)

    def with_separation(self, separation: float) -> Home:
        """Return this home with `separation` (metres, geoid above ellipsoid); a finite separation is not replaced."""
        return self if math.isfinite(self.separation) else replace(self, separation=separation)


@dataclass(frozen=True)
class GpsQuality:
    """Accuracy of the receiver's position, 1-sigma; NaN: not reported."""

    fix: int = 0  # GPS_FIX_TYPE: 3 is 3D, 5 and 6 are RTK
    satellites: int = 0
    horizontal: float = _NAN  # metres
    vertical: float = _NAN  # metres
    speed: float = _NAN  # m/s
    separation: float = _NAN  # metres, geoid above ellipsoid, if the receiver reports both heights


@dataclass(frozen=True)
class Battery:
    """Remaining charge and voltage of the battery; NaN: not reported."""

    share: float = _NAN  # 0 to 1
    voltage: float = _NAN  # V


class EstimatorFlag(IntFlag):
    """Status bits of EKF_STATUS_REPORT and ESTIMATOR_STATUS."""

    ABSOLUTE = 16
    CONSTANT = 128
    AIDED = 512  # by a receiver's positions
    UNINITIALISED = 1024
    GPS_GLITCH = 32768


def is_absolute(estimator_flags: int) -> bool:
    """Whether the estimator's flags report an absolute position without a sign of failure.

    Since 1.16, PX4 sets CONSTANT for every vehicle at rest, also while it uses positions of its receiver.
    """
    doubtful = EstimatorFlag.UNINITIALISED | EstimatorFlag.GPS_GLITCH
    if not estimator_flags & EstimatorFlag.AIDED:
        doubtful |= EstimatorFlag.CONSTANT
    return bool(estimator_flags & EstimatorFlag.ABSOLUTE) and not estimator_flags & doubtful


def _unknown() -> F64:
    return np.full(3, np.nan)


@dataclass(frozen=True, eq=False)
class Telemetry:
    """Snapshot of the vehicle's state. None and NaN: not received yet."""

    firmware: str  # "ArduPilot" or "PX4"
    boot_ns: int = 0  # newest time of the autopilot's clock, since its boot
    armed: bool = False
    mode: FlightMode = FlightMode.OTHER
    failsafe: bool = False  # whether it reports a critical state, as when a failsafe of its own flies
    mode_name: str = ""  # the autopilot's own name of the mode
    landed: Landed = Landed.UNKNOWN
    grounded: float = 0.0  # s from the first to the newest of the last consecutive reports of GROUND
    place: Place | None = None
    velocity_world: F64 = field(default_factory=_unknown)  # (3,) m/s
    world_from_body: F64 | None = None  # (3, 3) rotation
    angular_velocity_body: F64 = field(default_factory=_unknown)  # (3,) rad/s
    gps: GpsQuality = GpsQuality()
    sensors_healthy: int | None = None  # bits of MAV_SYS_STATUS_SENSOR
    checks_off: bool = False  # whether the user has disabled the autopilot's pre-arm checks
    estimator_flags: int | None = None  # EKF_STATUS_REPORT or ESTIMATOR_STATUS
    home: Place | None = None
    wind_world: F64 = field(default_factory=_unknown)  # (3,) m/s, velocity of the air
    battery: Battery = Battery()
    by_sight: bool = False  # whether it was ordered to fly by our odometry, not by GPS
    ages: dict[str, float] = field(default_factory=dict)  # s since the last message of each type

    @property
    def has_position(self) -> bool:
        """Whether the estimator reported a valid absolute position (`is_absolute`) in the last 10 s."""
        recent = self._is_recent("EKF_STATUS_REPORT", "ESTIMATOR_STATUS")
        return self.estimator_flags is not None and recent and is_absolute(self.estimator_flags)

    @property
    def can_hold(self) -> bool:
        """Whether the vehicle can hold its place: it has a position, by our odometry or by a fix in the last 10 s.

        After the loss of GPS, an estimator reports its position for 5 to 8 s more, but cannot keep it.
        """
        return self.has_position and (self.by_sight or self.has_fix)

    @property
    def has_fix(self) -> bool:
        """Whether the receiver of GPS reported a fix in the last 10 s."""
        return self.gps.fix >= FIX_3D and self._is_recent("GPS_RAW_INT")

    def _is_recent(self, *messages: str) -> bool:
        return min((self.ages[name] for name in messages if name in self.ages), default=0.0) < 10.0

    @property
    def ready(self) -> bool:
        """Whether the vehicle may be armed: pre-arm checks passed or disabled, and a valid absolute position."""
        return self.has_position and (self.checks_off or bool((self.sensors_healthy or 0) & PRE_ARM))

    @property
    def has_contact(self) -> bool:
        """Whether the ground was reported for half a second, with motors on or off; one false report has no effect."""
        return self.grounded >= 0.5

    @property
    def is_down(self) -> bool:
        """Whether a landing is complete: disarmed and on the ground."""
        return not self.armed and self.landed is Landed.GROUND


class NoticeKind(Enum):
    """Subject of a notice."""

    FOUND = "found"  # the vehicle's first message
    LINK_LOST = "link lost"
    LINK_BACK = "link back"
    REBOOT = "reboot"
    TAKEOVER = "takeover"  # someone else flies: nothing is sent until the user orders it
    MODE = "mode"  # a change of mode that Alight requested, or its consequence
    COMMAND = "command"  # a command was accepted, refused or not answered
    TEXT = "text"  # a text message of the autopilot
    INTERFERENCE = "interference"  # messages were dropped, or a second sender has the vehicle's identity


@dataclass(frozen=True)
class Notice:
    """One event on the vehicle, or the answer to a request of Alight."""

    t_ns: int  # clock of this computer
    kind: NoticeKind
    text: str
    ok: bool = True
    mode: FlightMode | None = None
    ticket: int | None = None  # for COMMAND: the number that the request returned
