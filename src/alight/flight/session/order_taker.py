"""Receivers of orders: an autopilot, or a writer of their words."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Protocol

import numpy as np

from alight.arrays import F64
from alight.flight.autopilot import EstimateTie, Setpoint, metres_between
from alight.records import FlightMode, Place

SAID_AGAIN = 0.5  # m by which a set-point has to move until its words are given again
SAID_SPEED = 0.1  # m/s, the same of its speed


class OrderTaker(Protocol):
    """Takes orders: a `RemoteVehicle`, or a `SpokenVehicle`. An order returns the ticket of its answer."""

    @property
    def in_control(self) -> bool:
        """True if we fly: from our first order to a takeover."""

    def set_mode(self, mode: FlightMode) -> int:
        """Fly in this mode from now on; takes control."""

    def guide(self, setpoint: Setpoint, tie: EstimateTie | None = None) -> bool:
        """Fly to a set-point, tied to the autopilot's estimate where it has a position; False: not sent."""

    def land_on(self, t_ns: int, target_world: F64, world_from_body: F64) -> bool:
        """Report the target of a landing.

        Args:
            t_ns: instant at which this held, our clock.
            target_world: (3,) metres from the vehicle to the target, world axes.
            world_from_body: (3, 3) attitude of that instant.

        Returns:
            False: not sent.
        """

    def arm(self) -> int:
        """Start the motors."""

    def disarm(self) -> int:
        """Stop the motors; refused in the air."""

    def take_off(self, height: float) -> int:
        """Climb to a height in metres above the home; takes control."""

    def release(self) -> None:
        """Give control away: no message that moves the vehicle is sent any more."""


class SpokenVehicle:
    """Takes orders and gives them in words; nothing is sent.

    Args:
        say: called with each order in words; with a set-point again when it has moved by half a metre.
    """

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say, self._last = say, ""
        self._place: Place | None = None
        self._speed = math.inf
        self.in_control = False

    def set_mode(self, mode: FlightMode) -> int:
        """Say the mode."""
        self.in_control, self._place = True, None
        return self._spoken(f"mode: {mode.value}")

    def guide(self, setpoint: Setpoint, tie: EstimateTie | None = None) -> bool:
        """Say the set-point, and its speed where it is a new one."""
        if setpoint.position_world is None:
            return self._sink(setpoint)
        assert tie is not None
        if math.isfinite(setpoint.speed) and not abs(setpoint.speed - self._speed) < SAID_SPEED:
            self._speed = setpoint.speed
            self._spoken(f"speed: {setpoint.speed:.1f} m/s")
        place = tie.place_of(setpoint.position_world)
        if self._place is None or metres_between(place, self._place) > SAID_AGAIN:
            self._place = place
            self._spoken(f"fly to {words_of(place)}")
        return self.in_control

    def _sink(self, setpoint: Setpoint) -> bool:
        """Say the speed downwards, once."""
        assert setpoint.velocity_world is not None
        words = f"straight down at {-setpoint.velocity_world[2]:.1f} m/s"
        if words != self._last:
            self._spoken(words)
        self._place = None
        return self.in_control

    def land_on(self, t_ns: int, target_world: F64, world_from_body: F64) -> bool:
        """Say the position of the target, whenever it has changed by half a metre."""
        east, north, up = np.round(2 * target_world) / 2 + 0.0
        words = f"landing target {-up:.1f} m below, {east:+.1f} m east, {north:+.1f} m north of the vehicle"
        if words != self._last:
            self._spoken(words)
        return self.in_control

    def arm(self) -> int:
        """Say the order to arm."""
        return self._spoken("arm")

    def disarm(self) -> int:
        """Say the order to stop the motors."""
        return self._spoken("disarm")

    def take_off(self, height: float) -> int:
        """Say the height."""
        return self._spoken(f"take off to {height:.0f} m above home")

    def release(self) -> None:
        """Say that control is given away."""
        if self.in_control:
            self._spoken("control is given away")
        self.in_control = False

    def _spoken(self, words: str) -> int:
        self._last = words
        self._say(words)
        return 0


def words_of(place: Place) -> str:
    """Return a place in words: degrees, metres above the sea, and above home if known."""
    above = "" if math.isnan(place.above_home) else f", {place.above_home:.1f} m above home"
    return f"{place.latitude:.7f} {place.longitude:.7f}, {place.altitude_msl:.1f} m above the sea{above}"
