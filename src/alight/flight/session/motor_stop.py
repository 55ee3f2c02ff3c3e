"""The motors of a vehicle that stands after its landing: not every autopilot stops them by itself."""

from __future__ import annotations

from collections.abc import Callable

from alight.flight.session.order_taker import OrderTaker
from alight.records import FlightMode, Landed, Telemetry

STANDS_NS = 5_000_000_000  # it stands for so long, or longer since the last request
REQUESTS = 3  # after which a person is told


class MotorStop:
    """Asks for the motors to be stopped where they still turn seconds after a landing (PX4, COM_DISARM_LAND below 0).

    Args:
        hand: takes the request. An autopilot refuses it in the air.
        tell: called with words to a person.
    """

    def __init__(self, hand: OrderTaker, tell: Callable[[str], None]) -> None:
        self._hand, self._tell = hand, tell
        self._since_ns: int | None = None  # it stands, or was asked; None: it does not stand with its motors on
        self._requests = 0

    def tick(self, heard: Telemetry, now_ns: int) -> None:
        """Call it several times a second.

        Args:
            heard: of the vehicle.
            now_ns: our clock.
        """
        lands = self._hand.in_control and heard.mode in (FlightMode.LAND, FlightMode.RETURN)
        if not (lands and heard.armed and heard.landed is Landed.GROUND):
            self._since_ns, self._requests = None, 0
            return
        if self._since_ns is None:
            self._since_ns = now_ns
        if now_ns - self._since_ns < STANDS_NS or self._requests > REQUESTS:
            return
        self._since_ns, self._requests = now_ns, self._requests + 1
        if self._requests > REQUESTS:
            self._tell(f"it stands, and its motors were not stopped at {REQUESTS} requests: stop them by hand")
            return
        self._hand.disarm()
        self._tell("it stands, and its motors still turn: they are ordered to stop")
