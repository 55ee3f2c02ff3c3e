"""What the autopilot stores: parameters, the fence and the rally points, read before a flight and never written."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

from alight.flight.autopilot.dialect import mavlink
from alight.flight.autopilot.firmware import Firmware

_TRIES = 4
_ANSWER_NS = 700_000_000  # until an unanswered request is repeated
_MOST_ITEMS = 1000  # of one list; autopilots store fewer


class StoredItem(NamedTuple):
    """One item of the fence or the rally points."""

    command: int  # MAV_CMD
    parameter: float  # of a corner: number of corners of its polygon; of a circle: radius, m
    latitude: float  # degrees
    longitude: float  # degrees


class StoredList:
    """Downloads one list by the mission protocol: count, items one by one, acknowledgement.

    Args:
        kind: MAV_MISSION_TYPE.
        send: called with each message to send.
        address: system and component of the vehicle.
    """

    def __init__(self, kind: int, send: Callable[[Any], None], address: tuple[int, int]) -> None:
        self._kind, self._send, self._address = kind, send, address
        self._received: list[StoredItem] = []
        self.count: int | None = None  # announced items; None: none yet
        self._tries, self._due_ns = 0, 0
        self.failed = ""  # reason why the list cannot be had

    @property
    def items(self) -> tuple[StoredItem, ...] | None:
        """The whole list; None: it was not downloaded, or not yet."""
        return tuple(self._received) if self.count is not None and len(self._received) >= self.count else None

    @property
    def over(self) -> bool:
        """Whether the download has ended, with the list or without."""
        return bool(self.failed) or self.items is not None

    def tick(self, t_ns: int) -> None:
        """Send or repeat the request that is due at `t_ns` of the `TimeoutClock`."""
        if self.over or t_ns < self._due_ns:
            return
        if self._tries == _TRIES:
            self.failed = f"no answer to {_TRIES} requests"
            return
        self._tries, self._due_ns = self._tries + 1, t_ns + _ANSWER_NS
        if self.count is None:
            self._send(mavlink.MAVLink_mission_request_list_message(*self._address, self._kind))
        else:
            self._send(mavlink.MAVLink_mission_request_int_message(*self._address, len(self._received), self._kind))

    def on_message(self, m: Any, t_ns: int) -> None:
        """Process a message of the mission protocol; those of another list, or out of turn, have no effect."""
        name = m.get_type()
        if self.over or not self._tries or getattr(m, "mission_type", 0) != self._kind:
            return
        if name == "MISSION_ACK":
            kinds = mavlink.enums["MAV_MISSION_RESULT"]
            self.failed = f"the autopilot answers {kinds[m.type].name if m.type in kinds else m.type}"
            return
        if name == "MISSION_COUNT" and self.count is None:
            self.count = m.count
            if m.count > _MOST_ITEMS:
                self.failed = f"{_MOST_ITEMS} items are read at most"
                return
        elif name == "MISSION_ITEM_INT" and self.count is not None and m.seq == len(self._received):
            self._received.append(StoredItem(m.command, m.param1, m.x * 1e-7, m.y * 1e-7))
        else:
            return
        self._tries, self._due_ns = 0, t_ns
        self.tick(t_ns)
        if self.over:
            accepted = mavlink.MAV_MISSION_ACCEPTED
            self._send(mavlink.MAVLink_mission_ack_message(*self._address, accepted, self._kind))


class OnboardData:
    """Reads named parameters, the fence and the rally points of an autopilot; `begin` starts the reading.

    Args:
        us: our system and component; answers to others have no effect.
    """

    def __init__(
        self, firmware: Firmware, address: tuple[int, int], us: tuple[int, int], send: Callable[[Any], None]
    ) -> None:
        self._firmware, self._address, self._us, self._send = firmware, address, us, send
        self._wanted: dict[str, tuple[int, int]] = {}  # requests so far, and when the next is due
        self.begun = False
        self._forget()

    def _forget(self) -> None:
        self.parameters: dict[str, float] = {}
        self._wanted = {name: (0, 0) for name in self._wanted}
        kinds = mavlink.MAV_MISSION_TYPE_FENCE, mavlink.MAV_MISSION_TYPE_RALLY
        self.fence, self.rally = (StoredList(kind, self._send, self._address) for kind in kinds)

    @property
    def over(self) -> bool:
        """Whether everything is read, or was not answered."""
        return self.begun and self.parameters_over and self.fence.over and self.rally.over

    @property
    def parameters_over(self) -> bool:
        """Whether each parameter was read, or was not answered."""
        return self.begun and all(n in self.parameters or tries > _TRIES for n, (tries, _) in self._wanted.items())

    @property
    def unanswered(self) -> list[str]:
        """Names of the parameters that were not read: not answered yet, or not of this release."""
        return [name for name in self._wanted if name not in self.parameters]

    def begin(self, names: Iterable[str]) -> None:
        """Begin to read the parameters `names`, the fence and the rally points; further calls have no effect."""
        if not self.begun:
            self.begun, self._wanted = True, dict.fromkeys(names, (0, 0))

    def rebooted(self) -> None:
        """Read everything again."""
        self._forget()

    def tick(self, t_ns: int) -> None:
        """Send the requests that are due at `t_ns` of the `TimeoutClock`."""
        if not self.begun:
            return
        for name, (tries, due_ns) in self._wanted.items():
            if name not in self.parameters and tries <= _TRIES and t_ns >= due_ns:
                self._wanted[name] = tries + 1, t_ns + _ANSWER_NS
                if tries < _TRIES:
                    self._send(mavlink.MAVLink_param_request_read_message(*self._address, name.encode(), -1))
        (self.rally if self.fence.over else self.fence).tick(t_ns)  # an autopilot sends one list at a time

    def on_message(self, m: Any, t_ns: int) -> bool:
        """Process a message; return whether it is one of parameters or lists."""
        name = m.get_type()
        if name == "PARAM_VALUE":
            value = self._firmware.parameter_value(m.param_value, m.param_type)
            if m.param_id in self._wanted and math.isfinite(value):
                self.parameters[m.param_id] = value
        elif name in ("MISSION_COUNT", "MISSION_ITEM_INT", "MISSION_ACK"):
            if all(to in (0, us) for to, us in zip((m.target_system, m.target_component), self._us, strict=True)):
                self.fence.on_message(m, t_ns)
                self.rally.on_message(m, t_ns)
        else:
            return False
        return True
