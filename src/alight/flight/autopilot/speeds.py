"""Speeds of guided flight as commands, sent again and again, as ArduPilot forgets them."""

from __future__ import annotations

import math

from alight.flight.autopilot.commands import CommandQueue

DO_CHANGE_SPEED = 178  # MAV_CMD
_OVER_GROUND, _DOWNWARDS = 1.0, 3.0  # SPEED_TYPE
_AGAIN_NS = 2_000_000_000
_SAME = 0.1  # m/s, below which a change is not worth a command


class SpeedKeeper:
    """Keeps the speeds of the set-points in force.

    ArduPilot goes back to its own speeds whenever it starts its guided controller anew (a change of mode, the end of a
    take-off, a position after a velocity), and does not report it.
    """

    def __init__(self, commands: CommandQueue) -> None:
        self._commands = commands
        self._given, self._given_ns = (math.inf, math.inf), -_AGAIN_NS
        self._tickets: set[int] = set()
        self._refused = False

    def forget(self) -> None:
        """Send the speeds again with the next set-point, as the controller was started anew."""
        self._given_ns = -_AGAIN_NS

    def keep(self, speed: float, sink: float, t_ns: int) -> None:
        """Send the speeds of a set-point that was just sent, if they are new or were sent a while ago.

        Args:
            speed: m/s over the ground; inf: the autopilot's own.
            sink: m/s downwards; inf: the autopilot's own.
            t_ns: now.
        """
        same = all(math.isclose(a, b, abs_tol=_SAME) for a, b in zip((speed, sink), self._given, strict=True))
        if (same and t_ns - self._given_ns < _AGAIN_NS) or self._commands.waiting(DO_CHANGE_SPEED):
            return
        self._given, self._given_ns = (speed, sink), t_ns
        for kind, value in ((_OVER_GROUND, speed), (_DOWNWARDS, sink)):
            if math.isfinite(value):
                parameters = (kind, value, -1.0)
                self._tickets.add(self._commands.submit("speed", DO_CHANGE_SPEED, parameters, t_ns))

    def is_quiet(self, ticket: int, ok: bool) -> bool:
        """Take an answer; True: it is one of ours and not the first refusal, so that it need not be reported."""
        if ticket not in self._tickets:
            return False
        self._tickets.discard(ticket)
        told, self._refused = self._refused, not ok
        return ok or told
