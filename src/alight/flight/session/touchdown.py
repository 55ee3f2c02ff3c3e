"""The end of a landing: contact with the ground, and motors that must stop."""

from __future__ import annotations

from collections.abc import Callable

from alight.flight.session.dry_run import VehicleCommands
from alight.records import FlightMode, Landed, Telemetry

TOUCH, LOW = 1.0, 3.0  # m above the estimated height of the place
TOUCH_NS, STILL_NS = 800_000_000, 2_000_000_000  # without sinking: below TOUCH, and below LOW
STANDS_NS = 5_000_000_000  # from the touchdown to the first request to stop the motors, and between two of them
REQUESTS = 3  # after which a person is warned


class Contact:
    """Detects that it has stopped sinking: PX4 does not report GROUND in Offboard, and a place may lie higher."""

    def __init__(self) -> None:
        self._still_ns: int | None = None  # instant from which it has not sunk; None: it sinks

    def forget(self) -> None:
        """Begin anew, as it is not ordered down now."""
        self._still_ns = None

    def is_felt(self, height: float | None, sink: float, reports: Telemetry, now_ns: int) -> bool:
        """True if the vehicle stands. Call it at every tick while it is ordered down.

        Args:
            height: metres above the place, as estimated; None: unknown, but low.
            reports: of the vehicle; an unknown velocity is no contact.
        """
        still = reports.mode is FlightMode.GUIDED and bool(reports.velocity_world[2] >= -0.4 * sink)
        if not still or (height is not None and height > LOW):
            self._still_ns = None
        elif self._still_ns is None:
            self._still_ns = now_ns
        least = TOUCH_NS if height is not None and height < TOUCH else STILL_NS
        stopped = self._still_ns is not None and now_ns - self._still_ns >= least
        return stopped or reports.landed is Landed.GROUND


class MotorStop:
    """Requests that motors stop where they still turn seconds after a landing (PX4, COM_DISARM_LAND below 0).

    Args:
        commands: takes the request. An autopilot refuses it in the air.
    """

    def __init__(self, commands: VehicleCommands, warn: Callable[[str], None]) -> None:
        self._commands, self._warn = commands, warn
        self._since_ns: int | None = None  # of the touchdown or the newest request; None: motors off, or in the air
        self._requests = 0

    def tick(self, reports: Telemetry, now_ns: int) -> None:
        """Call it several times a second, with the reports of the vehicle."""
        lands = self._commands.in_control and reports.mode in (FlightMode.LAND, FlightMode.RETURN)
        if not (lands and reports.armed and reports.landed is Landed.GROUND):
            self._since_ns, self._requests = None, 0
            return
        if self._since_ns is None:
            self._since_ns = now_ns
        if now_ns - self._since_ns < STANDS_NS or self._requests > REQUESTS:
            return
        self._since_ns, self._requests = now_ns, self._requests + 1
        if self._requests > REQUESTS:
            self._warn(f"it stands, and its motors were not stopped at {REQUESTS} requests: stop them by hand")
            return
        self._commands.disarm()
        self._warn("it stands, and its motors still turn: they are ordered to stop")
