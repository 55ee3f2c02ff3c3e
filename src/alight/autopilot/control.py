"""Who flies: changes of mode that nobody of us asked for, and a pilot's sticks."""

from __future__ import annotations

from alight.autopilot.firmware import Firmware
from alight.records import FlightMode

_REMEMBERED_NS = 6_000_000_000  # how long after our request a change of mode counts as its effect
_MOVED = 150  # microseconds of a stick's 1000, from where it was when we took over


class ControlWatch:
    """Tells our own changes of mode from somebody else's. We are in control from our first order to a takeover."""

    def __init__(self, firmware: Firmware) -> None:
        self._firmware = firmware
        self._asked: dict[FlightMode, int] = {}
        self._mode: tuple[FlightMode, str] | None = None
        self._neutral: tuple[int, ...] | None = None
        self.in_control = False

    @property
    def mode_name(self) -> str:
        """The autopilot's word for its mode; empty: not heard yet."""
        return "" if self._mode is None else self._mode[1]

    def ordered(self, mode: FlightMode, t_ns: int) -> None:
        """Take control and note that a mode was asked for: a change to it within six seconds is ours."""
        if not self.in_control:
            self._neutral = None
        self.in_control = True
        self._asked[mode] = t_ns

    def released(self) -> None:
        """Give control away; modes that were asked for are forgotten."""
        self.in_control = False
        self._asked.clear()

    def rebooted(self) -> None:
        """Give control away, and forget the mode and the neutral sticks."""
        self.released()
        self._mode = self._neutral = None

    def mode(self, mode: FlightMode, name: str, t_ns: int) -> str | None:
        """Take a heartbeat's mode; return in words how it shows that somebody else has taken over, or None."""
        before, self._mode = self._mode, (mode, name)
        if before is None or before == self._mode or not self.in_control:
            return None
        if t_ns - self._asked.get(mode, -_REMEMBERED_NS) < _REMEMBERED_NS:
            return None
        if (before[0], mode) in self._firmware.natural:
            return None
        return f"the mode went from {before[1]} to {name}, which we did not ask for"

    def sticks(self, positions: tuple[int, ...]) -> str | None:
        """Take the positions of the sticks.

        Args:
            positions: microseconds of each channel.

        Returns:
            The reason in words if a pilot moved one since we took over, else None.
        """
        if not self.in_control:
            return None
        if self._neutral is None:
            self._neutral = positions
        moved = [abs(a - b) for a, b in zip(positions, self._neutral, strict=True)]
        return f"stick {moved.index(max(moved)) + 1} moved" if max(moved) > _MOVED else None
