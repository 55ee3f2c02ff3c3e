"""Contact with the ground of a vehicle that is guided down."""

from __future__ import annotations

from alight.records import FlightMode, Landed, Telemetry

TOUCH, LOW = 1.0, 3.0  # m above the estimated height of the place
TOUCH_NS, STILL_NS = 800_000_000, 2_000_000_000  # without sinking: below TOUCH, and below LOW
SINKS = 0.4  # share of the ordered speed


class Contact:
    """Detects that it has stopped sinking: PX4 does not report GROUND in Offboard, and a place may lie higher."""

    def __init__(self) -> None:
        self._still_ns: int | None = None  # instant from which it has not sunk; None: it sinks

    def forget(self) -> None:
        """Begin anew, as it is not ordered down now."""
        self._still_ns = None

    def felt(self, height: float | None, sink: float, heard: Telemetry, now_ns: int) -> bool:
        """True if the vehicle stands. Call it at every tick while it is ordered down.

        Args:
            height: metres above the place, as estimated; None: unknown, but low.
            sink: m/s that are ordered.
            heard: of the vehicle; an unknown velocity is no contact.
            now_ns: our clock.
        """
        still = heard.mode is FlightMode.GUIDED and bool(heard.velocity_world[2] >= -SINKS * sink)
        if not still or (height is not None and height > LOW):
            self._still_ns = None
        elif self._still_ns is None:
            self._still_ns = now_ns
        least = TOUCH_NS if height is not None and height < TOUCH else STILL_NS
        stopped = self._still_ns is not None and now_ns - self._still_ns >= least
        return stopped or heard.landed is Landed.GROUND
