"""The steps of a flight in real time: the take-off, the landing, and the hold if one of them ends early."""

from __future__ import annotations

import time
from collections.abc import Callable

from alight.flight.autopilot import RemoteVehicle
from alight.flight.live.telemetry import TelemetryFeed
from alight.flight.session.pilot import LandingPilot, PilotView
from alight.flight.session.take_off import TakeOff
from alight.records import FlightMode, Notice
from alight.records.executive import FlightState

STEP = 0.05  # s between two ticks
TAKEN = "somebody else flies now: nothing is sent to the vehicle any more"
UNCONFIRMED = "the vehicle was ordered to hold and has not confirmed it: take over"

OnStep = Callable[[str, PilotView | None], None]  # called after every step with the phase, and in a landing its view


class FlightLoop:
    """Takes off, lands and holds."""

    def __init__(self, feed: TelemetryFeed, vehicle: RemoteVehicle, pilot: LandingPilot, dry_run: bool) -> None:
        self.feed, self.vehicle, self.pilot, self.dry_run = feed, vehicle, pilot, dry_run

    @property
    def taken(self) -> bool:
        """True if we are not in control: not yet, or not any more."""
        return not self.pilot.in_control

    def listen(self) -> list[Notice]:
        """Send waiting messages; pass new notices of the autopilot to the pilot, and return them."""
        self.feed.flush()
        with self.feed.lock:
            notices = self.feed.autopilot.notices()
            for notice in notices:
                self.pilot.on_notice(notice)
        return notices

    def take_off(self, height: float, on_step: OnStep, on_hint: Callable[[str], None]) -> str:
        """Climb to a height, metres above the home; return the reason if it failed, else an empty string."""
        climb, shown = TakeOff(self.vehicle, height, time.monotonic_ns()), ""
        while not climb.done and not climb.failed:
            with self.feed.lock:
                climb.tick(time.monotonic_ns())
                hint = climb.hint
            if hint and hint != shown:
                shown = hint
                on_hint(hint)
            self.feed.flush()
            on_step("take-off", None)
            time.sleep(STEP)
        return climb.failed

    def land(self, flying: bool, on_step: OnStep) -> None:
        """Land, until the pilot is done or a dry run would return; `flying`: we fly already, after our own take-off."""
        self.pilot.begin(time.monotonic_ns(), flying)
        due = time.monotonic()
        while not self.pilot.over and not (self.dry_run and self.pilot.state is FlightState.RETURN):
            with self.feed.lock:
                view = self.pilot.tick(time.monotonic_ns())
            self.feed.flush()
            on_step("landing", view)
            due = max(due + STEP, time.monotonic())
            time.sleep(max(due - time.monotonic(), 0.001))

    def hold(self) -> str:
        """Make the autopilot hold by itself, and give control away; return the vehicle's action in words.

        The order waits for a heartbeat and may be refused or lost: it is due on every turn until the mode is flown.
        Nothing is shown or written meanwhile, as the display or the disk may have failed.
        """
        if self.dry_run:
            return "nothing was sent to the vehicle"
        if self.taken:
            return TAKEN
        end = time.monotonic() + 6.0  # a heartbeat before the order, one after it, and a lost packet
        while not (held := self._holds()) and not self.taken and time.monotonic() < end:
            time.sleep(STEP)
            self.listen()
        taken = self.taken
        with self.feed.lock:
            self.vehicle.release()
        if taken:
            return TAKEN
        return "the vehicle holds its place" if held else UNCONFIRMED

    def _holds(self) -> bool:
        """Order the hold if it is due; return whether it is flown."""
        with self.feed.lock:
            ordered = self.pilot.stop(time.monotonic_ns())
            return ordered and self.vehicle.alive and self.vehicle.telemetry.mode is FlightMode.HOLD
