"""The steps of a flight in real time: the take-off, the landing, and the hold if one of them ends early."""

from __future__ import annotations

import time
from collections.abc import Callable

from alight.flight.autopilot import RemoteVehicle
from alight.flight.live.telemetry import TelemetryFeed
from alight.flight.session.order_taker import OrderTaker
from alight.flight.session.pilot import LandingPilot, PilotView
from alight.flight.session.take_off import TakeOff
from alight.records import FlightMode, Notice

STEP = 0.05  # s between two ticks
HOLDS = 6.0  # s that the autopilot gets to hold: a heartbeat before the order, one after it, and a lost packet
TAKEN = "somebody else flies now: nothing is sent to the vehicle any more"
UNCONFIRMED = "the vehicle was told to hold and has not confirmed it: take over"

Show = Callable[[str, PilotView | None], None]


class FlightLoop:
    """Takes off, lands and holds.

    Args:
        feed: the link.
        vehicle: the autopilot's reports.
        hand: takes the orders: the vehicle itself, or a `SpokenVehicle`.
        pilot: of the landing.
        show: called after every step with the phase, and in a landing with its view.
    """

    def __init__(
        self, feed: TelemetryFeed, vehicle: RemoteVehicle, hand: OrderTaker, pilot: LandingPilot, show: Show
    ) -> None:
        self._feed, self._vehicle, self._hand, self._pilot, self._show = feed, vehicle, hand, pilot, show

    @property
    def taken(self) -> bool:
        """True if we are not in control: not yet, or not any more."""
        return not self._hand.in_control

    def listen(self) -> list[Notice]:
        """Send waiting messages; pass new notices of the autopilot to the pilot, and return them."""
        self._feed.flush()
        with self._feed.lock:
            notices = self._feed.autopilot.notices()
            for notice in notices:
                self._pilot.noticed(notice)
        return notices

    def take_off(self, height: float, note: Callable[[str], None]) -> str:
        """Climb to a height, metres above the home; return the reason if it failed, else an empty string."""
        climb, told = TakeOff(self._vehicle, self._hand, height, time.monotonic_ns()), ""
        while not climb.done and not climb.failed:
            with self._feed.lock:
                climb.tick(time.monotonic_ns())
                hint = climb.hint
            if hint and hint != told:
                told = hint
                note(hint)
            self._feed.flush()
            self._show("take-off", None)
            time.sleep(STEP)
        return climb.failed

    def land(self, flying: bool, ended: Callable[[], bool]) -> None:
        """Land, until the pilot is done or `ended` is True; `flying`: we fly already, after our own take-off."""
        self._pilot.begin(time.monotonic_ns(), flying)
        due = time.monotonic()
        while not ended():
            with self._feed.lock:
                view = self._pilot.tick(time.monotonic_ns())
            self._feed.flush()
            self._show("landing", view)
            due = max(due + STEP, time.monotonic())
            time.sleep(max(due - time.monotonic(), 0.001))

    def hold(self) -> str:
        """Make the autopilot hold by itself, and give control away; return the vehicle's action in words.

        The order waits for a heartbeat and may be refused or lost: it is due on every turn until the mode is flown.
        Nothing is shown or written meanwhile, as the display or the disk may have failed.
        """
        if self._hand is not self._vehicle:
            return "nothing was sent to the vehicle"
        if self.taken:
            return TAKEN
        end = time.monotonic() + HOLDS
        while not (held := self._holds()) and not self.taken and time.monotonic() < end:
            time.sleep(STEP)
            self.listen()
        taken = self.taken
        with self._feed.lock:
            self._hand.release()
        if taken:
            return TAKEN
        return "the vehicle holds its place" if held else UNCONFIRMED

    def _holds(self) -> bool:
        """Order the hold if it is due; return whether it is flown."""
        with self._feed.lock:
            ordered = self._pilot.stop(time.monotonic_ns())
            return ordered and self._vehicle.alive and self._vehicle.telemetry.mode is FlightMode.HOLD
