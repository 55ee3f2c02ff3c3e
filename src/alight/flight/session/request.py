"""What a flown landing is asked for, and its status for a display."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from alight.checks.result import CheckResult
from alight.flight.session.pilot import PilotView
from alight.outputs.reading import EarlierSite
from alight.records import Home, InputError, Telemetry, Zones
from alight.settings import Settings


@dataclass(frozen=True)
class FlightRequest:
    """Options of one flown landing."""

    link: str  # udp:127.0.0.1:14550
    camera: str  # cameras, or a folder that is being filled
    out: Path
    settings: Settings
    rig: Path | None = None  # calibration of cameras
    dry_run: bool = False  # whether orders are only written in words
    home: Home | None = None  # for route.plan; None: the autopilot's. A missing separation is the receiver's
    separation: float | None = None  # metres, ellipsoidal height minus altitude above the sea; None: the receiver's
    take_off: float | None = None  # metres above home; None: the vehicle flies already
    imu_rate: float = 100.0  # Hz requested of the autopilot; 0: no IMU
    signing_key: Path | None = None  # file with the passphrase of the link's signatures
    record: bool = True
    overwrite: bool = False
    goals: tuple[EarlierSite, ...] = ()  # places to look at before the search, in this order
    zones: Zones | None = None  # of the user
    odometry: bool = False  # whether the motion is sent as odometry, to fly by it where GPS fails

    def validate(self) -> None:
        """Raise InputError, with the remedy, if no landing can be flown with these options."""
        executive = self.settings.executive
        if self.dry_run and self.take_off is not None:
            raise InputError("--take-off: a dry run sends nothing; leave it out, or leave out --dry-run")
        if self.take_off is not None and self.take_off < executive.search_height:
            raise InputError(
                f"--take-off {self.take_off:g}: the search begins where the climb ends, before a map shows what stands "
                f"there; give at least executive.search_height, {executive.search_height:g} m, or lower that"
            )
        if self.settings.too_low:
            raise InputError(self.settings.too_low)
        if not executive.look_again:
            raise InputError("executive.look_again=false lands without looking: it is for campaigns; leave it out")


@dataclass(frozen=True, eq=False)
class FlightStatus:
    """A flight at one moment, for a display; a field is None until its part exists."""

    phase: str  # checks, take-off, landing
    checks: Sequence[CheckResult] = ()
    view: PilotView | None = None
    telemetry: Telemetry | None = None
    health: str | None = None  # state of the lanes, in one line


OnStatus = Callable[[FlightStatus], None]
OnLine = Callable[[str], None]
