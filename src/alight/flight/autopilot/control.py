"""Detection of a takeover: by changes of mode that we did not order, and by a pilot's sticks."""

from __future__ import annotations

from collections.abc import Set

from alight.flight.autopilot.firmware import Firmware
from alight.records import FlightMode

_REMEMBERED_NS = 6_000_000_000  # after our request, in which a change of mode is treated as its effect
_UNDER_WAY_NS = 400_000_000  # after a request, in which heartbeats from before it, and copies, may still come
_GRACE_NS = 2_000_000_000  # from the answer to an order until heartbeats must show its mode
_MOVED = 150  # microseconds of a stick's range of 1000, from its position when we took control
_ENDS = (FlightMode.LAND, FlightMode.RETURN)


class ControlWatch:
    """Detects takeovers by changes of mode and by sticks. We are in control from our first order to a takeover."""

    def __init__(self, firmware: Firmware) -> None:
        self._firmware = firmware
        self._ordered_ns: dict[FlightMode, int] = {}
        self._newest: FlightMode | None = None  # ordered mode
        self._accepted_ns: int | None = None  # when the autopilot accepted it
        self._mode: tuple[FlightMode, str] | None = None
        self._neutral: tuple[int, ...] | None = None
        self._flown: FlightMode | None = None  # mode of the newest heartbeat with armed motors since our newest order
        self.in_control = False

    @property
    def mode_name(self) -> str:
        """The autopilot's name for its present mode; empty: no heartbeat yet."""
        return "" if self._mode is None else self._mode[1]

    def ordered(self, mode: FlightMode, t_ns: int) -> None:
        """Take control and note an ordered mode; the first change to it within six seconds is treated as ours."""
        if not self.in_control:
            self._neutral = None
        self.in_control, self._flown = True, None
        self._ordered_ns[mode] = t_ns
        self._newest, self._accepted_ns = mode, None

    def accepted(self, mode: FlightMode, t_ns: int) -> None:
        """Note that an ordered mode was accepted at `t_ns`; if it is still unseen, its six seconds begin again."""
        if mode in self._ordered_ns:
            self._ordered_ns[mode] = t_ns
        if mode is self._newest:
            self._accepted_ns = t_ns

    def released(self) -> None:
        """Give control away, and forget the ordered modes."""
        self.in_control, self._newest = False, None
        self._ordered_ns.clear()

    def rebooted(self) -> None:
        """Give control away, and forget the mode and the neutral position of the sticks."""
        self.released()
        self._mode = self._neutral = self._flown = None

    def mode(
        self, mode: FlightMode, name: str, t_ns: int, unanswered: Set[FlightMode] = frozenset(),
        on_ground: bool = False, armed: bool = True,
    ) -> str:  # fmt: skip
        """Process the mode of a heartbeat; return the evidence of a takeover in words, or an empty string.

        Args:
            name: the autopilot's name for the mode.
            unanswered: modes whose orders are still being sent; each attempt may cause the mode again.
            on_ground: whether the vehicle is on the ground.
            armed: whether the motors run. PX4 leaves the landing mode when it stops them.
        """
        before, self._mode = self._mode, (mode, name)
        self._flown = mode if armed else self._flown
        if before is None or not self.in_control:
            return ""
        if armed and self._is_not_obeyed(mode, t_ns, on_ground):
            return f"{name} is flown, and {self._newest.value if self._newest else ''} was ordered"
        ours = self._is_ours(mode, t_ns) or mode in unanswered
        natural = self._firmware.is_natural(before[0], mode, on_ground)
        natural |= not armed and (self._flown in _ENDS or before[0] in _ENDS)
        if before == self._mode or ours or natural:
            return ""
        return f"the mode went from {before[1]} to {name}, which we did not order"

    def _is_not_obeyed(self, mode: FlightMode, t_ns: int, on_ground: bool) -> bool:
        """Whether `mode` is flown although our newest order, another mode, was accepted two seconds ago or earlier.

        Changes that the autopilot makes by itself (some only `on_ground`) are allowed. The method also finds a takeover
        that `_is_ours` accepts: a pilot's change to a mode that we ordered seconds before.
        """
        newest, accepted_ns = self._newest, self._accepted_ns
        if newest is None or accepted_ns is None or t_ns < accepted_ns + _GRACE_NS:
            return False
        return newest not in (FlightMode.TAKE_OFF, mode) and not self._firmware.is_natural(newest, mode, on_ground)

    def _is_ours(self, mode: FlightMode, t_ns: int) -> bool:
        """Whether we have ordered this mode within six seconds; if so, forget that order and all earlier orders."""
        ordered_ns = self._ordered_ns.get(mode, -_REMEMBERED_NS)
        if t_ns - ordered_ns >= _REMEMBERED_NS:
            return False
        if t_ns - ordered_ns >= _UNDER_WAY_NS:
            self._ordered_ns = {m: t for m, t in self._ordered_ns.items() if t > ordered_ns}
        return True

    def sticks(self, positions: tuple[int, ...]) -> str:
        """Return which stick a pilot has moved since we took control, in words, or an empty string.

        The throttle may move during a take-off: ArduPilot arms with it down, and a later takeover needs its middle.

        `positions`: positions of the four sticks, microseconds, as in RC_CHANNELS.
        """
        if not self.in_control:
            return ""
        if self._neutral is None:
            self._neutral = positions
        elif self._newest is FlightMode.TAKE_OFF:
            self._neutral = (*self._neutral[:2], positions[2], self._neutral[3])
        moved = [abs(a - b) for a, b in zip(positions, self._neutral, strict=True)]
        return f"stick {moved.index(max(moved)) + 1} moved" if max(moved) > _MOVED else ""
