"""Receiver of a mission upload: it requests each item, repeats a request, and gives up after a while."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from alight_sim.autopilot.dialects import Dialect

_AGAIN, _GIVE_UP = 1.0, 8.0  # s
_ACCEPTED, _ERROR, _UNSUPPORTED, _NO_SPACE, _OUT_OF_TURN, _DENIED, _CANCELLED = 0, 1, 3, 4, 13, 14, 15
_MOST = 700


class MissionStore:
    """Messages of a mission: of the last accepted one, or all items that arrived where they are stored at once."""

    def __init__(self, dialect: Dialect, send: Callable[[Any], None]) -> None:
        self._dialect, self._send = dialect, send
        self._coming: list[Any] = []
        self._count = 0
        self._peer = (0, 0)
        self._asked_at = self._heard_at = 0.0
        self.items: list[Any] = []
        self.fresh = False  # items have changed since this was read

    @property
    def receiving(self) -> bool:
        """True if a transfer is under way."""
        return self._count > 0

    def announce(self, m: Any, sender: tuple[int, int], t: float) -> None:
        """Handle MISSION_COUNT: begin a transfer and request its first item, or refuse it."""
        if self._count and sender != self._peer:
            self._acknowledge(_DENIED, sender)
            return
        self._peer, self._coming = sender, []
        if m.count > _MOST:
            self._count = 0
            self._acknowledge(_NO_SPACE)
            return
        if self._dialect.stores_at_once:
            self.items, self.fresh = self.items[: m.count], True
        self._count, self._heard_at = m.count, t
        self._ask(t)

    def item(self, m: Any, sender: tuple[int, int], t: float) -> None:
        """Handle MISSION_ITEM_INT: take the item, then request the next one or acknowledge the mission."""
        if not self._count:
            self._peer = sender
            self._acknowledge(_ERROR)
            return
        if m.seq != len(self._coming):
            self._acknowledge(_OUT_OF_TURN)
            return
        if m.command not in self._dialect.mission_commands:
            self._count = 0
            self._acknowledge(_UNSUPPORTED)
            return
        self._coming.append(m)
        self._heard_at = t
        if self._dialect.stores_at_once:
            self.items, self.fresh = [*self._coming, *self.items[len(self._coming) :]], True
        if len(self._coming) < self._count:
            self._ask(t)
            return
        self.items, self._coming, self._count, self.fresh = self._coming, [], 0, True
        self._acknowledge(_ACCEPTED)

    def clear(self, sender: tuple[int, int]) -> None:
        """Handle MISSION_CLEAR_ALL: remove all items; an error during a transfer where items are stored at once."""
        if self._count and self._dialect.stores_at_once:
            self._acknowledge(_ERROR, sender)
            return
        self._peer, self._coming, self._count = sender, [], 0
        self.items, self.fresh = [], True
        self._acknowledge(_ACCEPTED)

    def step(self, t: float) -> None:
        """Repeat an old request, or cancel a transfer that has been silent too long."""
        if self._count and t - self._heard_at > _GIVE_UP:
            self._count = 0
            self._acknowledge(_CANCELLED)
        elif self._count and t - self._asked_at > _AGAIN:
            self._ask(t)

    def _ask(self, t: float) -> None:
        self._asked_at = t
        kind = mavlink.MAVLink_mission_request_int_message if self._dialect.asks_with_int else (
            mavlink.MAVLink_mission_request_message
        )  # fmt: skip
        self._send(kind(*self._peer, len(self._coming), 0))

    def _acknowledge(self, result: int, to: tuple[int, int] | None = None) -> None:
        self._send(mavlink.MAVLink_mission_ack_message(*(to or self._peer), result, 0))
