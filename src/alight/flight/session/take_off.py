"""A take-off: guided mode, arming, climb to a height."""

from __future__ import annotations

from alight.flight.autopilot import RemoteVehicle
from alight.records import FlightMode, Landed, Telemetry

AGAIN_NS = 3_000_000_000  # until a command without effect is repeated
LONGEST_NS = 120_000_000_000


class TakeOff:
    """A take-off. Call `tick` until `done` is true or `failed` holds the reason in words.

    Args:
        height: metres above home.
        begin_ns: present time of our clock.
    """

    def __init__(self, vehicle: RemoteVehicle, height: float, begin_ns: int) -> None:
        self._vehicle, self._height, self._begin_ns = vehicle, height, begin_ns
        self._step, self._ordered_ns = "", begin_ns
        self._took = self._armed = False
        self.done, self.failed = False, ""

    @property
    def hint(self) -> str:
        """Action that a person must take now, in words; empty: no action."""
        if self._step != "take off" or self.done:
            return ""
        if self._vehicle.helicopter and not self._lifted:
            return "switch on the motor interlock now: a helicopter that is armed without it is disarmed after 10 s"
        return "put the throttle stick in the middle now" if self._vehicle.throttle_low else ""

    @property
    def _above(self) -> float:
        place = self._vehicle.telemetry.place
        return 0.0 if place is None else place.above_home

    @property
    def _lifted(self) -> bool:
        """Whether the vehicle has lifted off, by its landed state; if that is unknown, by a height above 1 m."""
        landed = self._vehicle.telemetry.landed
        return self._above > 1.0 if landed is Landed.UNKNOWN else landed is not Landed.GROUND

    def tick(self, now_ns: int) -> None:
        """Send the next command that is due."""
        if self.done or self.failed:
            return
        if self._took and not self._vehicle.in_control:
            self.failed = "somebody else flies now"
        elif not self._vehicle.alive:
            self.failed = "no heartbeat of the vehicle any more"
        elif now_ns - self._begin_ns > LONGEST_NS:
            self.failed = f"{self._step or 'the start'}: no effect within {LONGEST_NS * 1e-9:.0f} s"
        else:
            self._go_on(self._vehicle.telemetry, now_ns)

    def _go_on(self, reports: Telemetry, now_ns: int) -> None:
        self.done = reports.armed and self._above > 0.95 * self._height
        if self.done:
            return
        if self._armed and not reports.armed:  # somebody stopped the motors on purpose
            self.failed = "the motors were stopped again"
            return
        self._armed = reports.armed
        step = "take off" if reports.armed else "arm" if reports.mode is FlightMode.GUIDED else "guided mode"
        if step == "take off" and self._step == step and self._lifted:
            return  # it climbs
        if step == self._step and now_ns - self._ordered_ns < AGAIN_NS:
            return
        self._step, self._ordered_ns, self._took = step, now_ns, True
        if step == "guided mode":
            self._vehicle.set_mode(FlightMode.GUIDED)
        elif step == "arm":
            self._vehicle.arm()
        else:
            self._vehicle.take_off(self._height)
