"""Detection of a takeover: changes of mode that we did not order, and a pilot's sticks."""

from __future__ import annotations

from collections.abc import Set

from alight.flight.autopilot.firmware import Firmware
from alight.records import FlightMode

_REMEMBERED_NS = 6_000_000_000  # after our request, in which a change of mode counts as its effect
_UNDER_WAY_NS = 400_000_000  # after a request, in which a heartbeat may have left before it, and copies may still come
_GRACE_NS = 2_000_000_000  # from the answer to an order until heartbeats must show its mode
_ENDS = (FlightMode.LAND, FlightMode.RETURN)
_MOVED = 150  # microseconds of a stick's 1000, from its position when we took control


class ControlWatch:
    """Distinguishes our changes of mode from somebody else's. We are in control from our first order to a takeover."""

    def __init__(self, firmware: Firmware) -> None:
        self._firmware = firmware
        self._asked: dict[FlightMode, int] = {}
        self._newest: FlightMode | None = None  # ordered mode
        self._accepted_ns: int | None = None  # when the autopilot accepted it
        self._mode: tuple[FlightMode, str] | None = None
        self._neutral: tuple[int, ...] | None = None
        self._flown: FlightMode | None = None  # of the newest heartbeat with motors armed, since our newest order
        self.in_control = False

    @property
    def mode_name(self) -> str:
        """The autopilot's name for its mode; empty: not heard yet."""
        return "" if self._mode is None else self._mode[1]

    def ordered(self, mode: FlightMode, t_ns: int) -> None:
        """Take control and note that a mode was ordered: a change to it within six seconds is ours, once."""
        if not self.in_control:
            self._neutral = None
        self.in_control, self._flown = True, None
        self._asked[mode] = t_ns
        self._newest, self._accepted_ns = mode, None

    def accepted(self, mode: FlightMode, t_ns: int) -> None:
        """Note that an order was accepted only now: its effect counts from here, unless it was seen already."""
        if mode in self._asked:
            self._asked[mode] = t_ns
        if mode is self._newest:
            self._accepted_ns = t_ns

    def released(self) -> None:
        """Give control away; ordered modes are forgotten."""
        self.in_control, self._newest = False, None
        self._asked.clear()

    def rebooted(self) -> None:
        """Give control away, and forget the mode and the neutral sticks."""
        self.released()
        self._mode = self._neutral = self._flown = None

    def mode(
        self, mode: FlightMode, name: str, t_ns: int, unanswered: Set[FlightMode] = frozenset(),
        on_ground: bool = False, armed: bool = True,
    ) -> str | None:  # fmt: skip
        """Take a heartbeat's mode.

        Args:
            mode: of the heartbeat.
            name: the autopilot's name for it.
            t_ns: now.
            unanswered: modes whose orders are still being sent; each try may bring the mode again.
            on_ground: the vehicle stands.
            armed: the motors run. PX4 leaves the landing mode as it stops them, for a mode in which it can be armed.

        Returns:
            The sign that somebody else has taken over, in words; None: there is none.
        """
        before, self._mode = self._mode, (mode, name)
        self._flown = mode if armed else self._flown
        if before is None or not self.in_control:
            return None
        if armed and self._is_not_obeyed(mode, t_ns, on_ground):
            return f"{name} is flown, and {self._newest.value if self._newest else ''} was ordered"
        ours = self._is_ours(mode, t_ns) or mode in unanswered
        natural = self._is_natural(before[0], mode, on_ground)
        natural |= not armed and (self._flown in _ENDS or before[0] in _ENDS)
        if before == self._mode or ours or natural:
            return None
        return f"the mode went from {before[1]} to {name}, which we did not ask for"

    def _is_natural(self, before: FlightMode, after: FlightMode, on_ground: bool) -> bool:
        """True if the autopilot makes this change by itself at the end of a task."""
        change = before, after
        return change in self._firmware.natural and (on_ground or change not in self._firmware.natural_on_ground)

    def _is_not_obeyed(self, mode: FlightMode, t_ns: int, on_ground: bool) -> bool:
        """True if another mode is flown than the one that was accepted a while ago.

        A change within seconds of our own order looks like its effect: this distinguishes them later.
        """
        newest, accepted_ns = self._newest, self._accepted_ns
        if newest in (None, FlightMode.TAKE_OFF, mode) or accepted_ns is None or t_ns < accepted_ns + _GRACE_NS:
            return False
        assert newest is not None
        return not self._is_natural(newest, mode, on_ground)

    def _is_ours(self, mode: FlightMode, t_ns: int) -> bool:
        """True if we have ordered this mode; once it is seen, this order and all earlier ones are used up."""
        asked_ns = self._asked.get(mode, -_REMEMBERED_NS)
        if t_ns - asked_ns >= _REMEMBERED_NS:
            return False
        if t_ns - asked_ns >= _UNDER_WAY_NS:
            self._asked = {m: t for m, t in self._asked.items() if t > asked_ns}
        return True

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
