"""A take-off: guided mode, arming, climb to a height."""

from __future__ import annotations

from collections import deque

from alight.flight.autopilot import RemoteVehicle
from alight.records import FlightMode, Landed, Notice, NoticeKind, Telemetry

AGAIN_NS = 3_000_000_000  # until a refused command is repeated, or given up
TEXTS = 3  # of the autopilot that give the reason of a refusal
LONGEST_NS = 120_000_000_000


class TakeOff:
    """A take-off. Call `tick` until `done` is true or `failed` holds the reason in words; pass all notices on.

    Args:
        height: metres above home.
        begin_ns: present time of our clock.
    """

    def __init__(self, vehicle: RemoteVehicle, height: float, begin_ns: int) -> None:
        self._vehicle, self._height, self._begin_ns = vehicle, height, begin_ns
        self._step, self._ordered_ns = "", begin_ns
        self._ticket, self._accepted = -1, False  # of the newest command
        self._refusal = ""  # to arm, in words
        self._texts = deque[str](maxlen=TEXTS)  # of the autopilot, since that command
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

    def on_notice(self, notice: Notice) -> None:
        """Process a notice of the autopilot. A refusal to arm ends the take-off: motors start at a person's word only.

        The other commands are repeated if they are refused.
        """
        if notice.kind is NoticeKind.TEXT:
            self._texts.append(notice.text)
        elif notice.kind is NoticeKind.COMMAND and notice.ticket == self._ticket:
            self._accepted = notice.ok
            self._refusal = notice.text if self._step == "arm" and not notice.ok else ""

    def tick(self, now_ns: int) -> None:
        """Send the next command that is due."""
        if self.done or self.failed:
            return
        if not self._vehicle.alive:
            self.failed = "no heartbeat of the vehicle any more"
        elif self._took and not self._vehicle.in_control:
            self.failed = "somebody else flies now"
        elif now_ns - self._begin_ns > LONGEST_NS:
            self.failed = f"{self._step or 'the start'}: no effect within {LONGEST_NS * 1e-9:.0f} s"
        elif self._refusal:
            if now_ns - self._ordered_ns > AGAIN_NS:  # its texts have come
                self.failed = "; ".join([self._refusal, *self._texts])
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
        if step == self._step and (self._accepted or now_ns - self._ordered_ns < AGAIN_NS):
            return
        self._step, self._ordered_ns, self._took, self._accepted = step, now_ns, True, False
        self._texts.clear()
        if step == "guided mode":
            self._ticket = self._vehicle.set_mode(FlightMode.GUIDED)
        elif step == "arm":
            self._ticket = self._vehicle.arm()
        else:
            self._ticket = self._vehicle.take_off(self._height)
