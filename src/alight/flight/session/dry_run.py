"""A dry run: the receiver of a landing's commands in place of the vehicle, and a report of its parameters."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import numpy as np

from alight.arrays import F64
from alight.flight.autopilot import EstimateTie, ExternalPose, RemoteVehicle, Setpoint, metres_between
from alight.flight.live.telemetry import TelemetryFeed
from alight.flight.session import preflight
from alight.records import FlightMode, Place


class DryRunVehicle:
    """Replaces `RemoteVehicle` in a dry run: it prints the commands of a landing and sends nothing.

    Args:
        on_line: called with each command in words; for a set-point, whenever it has moved by half a metre.
    """

    def __init__(self, on_line: Callable[[str], None]) -> None:
        self._on_line, self._last = on_line, ""
        self._place: Place | None = None
        self._speed, self._resets = math.inf, 0
        self.in_control = False

    def set_mode(self, mode: FlightMode) -> int:
        """Print the mode; return 0 as the ticket."""
        self.in_control, self._place = True, None
        return self._print(f"mode: {mode.value}")

    def guide(self, setpoint: Setpoint, tie: EstimateTie | None = None) -> bool:
        """Print the set-point, and its speed if it changed by 0.1 m/s; return whether we are in control."""
        if setpoint.velocity_world is not None:
            self._place = None
            return self._print_new(f"straight down at {-setpoint.velocity_world[2]:.1f} m/s")
        assert tie is not None
        assert setpoint.position_world is not None
        if math.isfinite(setpoint.speed) and not abs(setpoint.speed - self._speed) < 0.1:
            self._speed = setpoint.speed
            self._print(f"speed: {setpoint.speed:.1f} m/s")
        place = tie.place_of(setpoint.position_world)
        if self._place is None or metres_between(place, self._place) > 0.5:
            self._place = place
            self._print(f"fly to {place_text(place)}")
        return self.in_control

    def land_on(self, t_ns: int, target_world: F64, world_from_body: F64) -> bool:
        """Print the landing target whenever it has moved by half a metre; return whether we are in control."""
        east, north, up = np.round(2 * target_world) / 2 + 0.0
        text = f"landing target {-up:.1f} m below, {east:+.1f} m east, {north:+.1f} m north of the vehicle"
        return self._print_new(text)

    def send_odometry(self, pose: ExternalPose) -> bool:
        """Print the odometry whenever it was reset; return whether the autopilot would get it."""
        if pose.resets != self._resets:
            self._resets = pose.resets
            east, north, up = pose.position
            at = f"{north:.1f} m north, {east:.1f} m east, {up:.1f} m up from the autopilot's origin"
            self._print(f"odometry, for each exposure from here on: {at}, quality {100 * pose.quality:.0f} %")
        return True

    def fly_by_sight(self, wanted: bool) -> None:
        """Print the choice of the autopilot's source of its position."""
        self._print(f"source of the position: {'odometry' if wanted else 'GPS'}")

    def disarm(self) -> int:
        """Print the command to stop the motors; return 0 as the ticket."""
        return self._print("disarm")

    def release(self) -> None:
        """Give control away, and print that it is given away."""
        if self.in_control:
            self._print("control is given away")
        self.in_control = False

    def _print_new(self, text: str) -> bool:
        if text != self._last:
            self._print(text)
        return self.in_control

    def _print(self, text: str) -> int:
        self._last = text
        self._on_line(text)
        return 0


VehicleCommands = RemoteVehicle | DryRunVehicle  # receiver of the commands of a landing


def place_text(place: Place) -> str:
    """Return a position as text: degrees, metres above sea level, and metres above home if known."""
    above = "" if math.isnan(place.above_home) else f", {place.above_home:.1f} m above home"
    return f"{place.latitude:.7f} {place.longitude:.7f}, {place.altitude_msl:.1f} m above the sea{above}"


def report_parameters(feed: TelemetryFeed, on_line: Callable[[str], None]) -> None:
    """Print the checks of the autopilot's parameters as soon as they are read; wait for them at most five seconds."""
    end = time.monotonic() + 5.0
    while time.monotonic() < end:
        with feed.lock:
            vehicle = feed.autopilot.vehicle
            found = [] if vehicle is None else preflight.judge_parameters(vehicle, feed.autopilot.odometry)
            read = vehicle is not None and vehicle.onboard.parameters_over
        if read:
            for check in found:
                on_line(check.line)
            return
        time.sleep(0.05)
