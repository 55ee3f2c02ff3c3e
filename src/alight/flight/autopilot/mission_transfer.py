"""Mission upload: the autopilot requests each item; lost messages are sent again, a stalled transfer begins again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from alight.flight.autopilot.mission_item import MissionItem
from alight.flight.autopilot.part_removal import ACCEPTED, PartRemoval
from alight.flight.autopilot.pymavlink_dialect import message

_AGAIN_NS = 1_000_000_000  # without a request, until the last message is sent again
_TRIES = 8  # of one message
_STARTS = 10  # of the whole transfer, longer than ArduPilot waits for an item: until then it refuses a deletion
_OUT_OF_TURN, _CANCELLED = 13, 15  # MAV_MISSION_RESULT
_INTERRUPTED = {1, _CANCELLED}  # 1 is ERROR: the answer to a copy of an item, or to a transfer that timed out
REFUSALS = {
    1: "it reports an error",
    2: "the frame of an item is not supported",
    3: "an item's command is not supported",
    4: "there is no space for so many items",
    5: "an item is invalid",
    **{6 + i: f"parameter {i + 1} of an item is invalid" for i in range(4)},
    10: "the latitude of an item is invalid",
    11: "the longitude of an item is invalid",
    12: "the altitude of an item is invalid",
    14: "it takes no missions from us",
    15: "the transfer was cancelled",
}


@dataclass(frozen=True)
class TransferResult:
    """The end of an upload or a deletion."""

    ok: bool
    text: str
    items: int
    late: bool = False  # nobody waits for it: the rest of an upload whose failure was reported before


class MissionTransfer:
    """One upload (or, without items, one deletion) at a time.

    After an upload that has failed, the part that the autopilot may hold is deleted; its result follows then.
    """

    def __init__(self, send: Callable[[Any], None]) -> None:
        self._send = send
        self._items: tuple[MissionItem, ...] = ()
        self.target = (0, 0)
        self.active = False
        self.torn = False  # the newest upload failed: the autopilot holds no whole mission
        self._removal = PartRemoval(self._clear)
        self._last: Callable[[], None] = self._announce
        self._asked: set[int] = set()  # since the newest announcement
        self._begun, self._most = False, 0  # since `start`: it takes items; most items requested
        self._interrupted: int | None = None  # a result after which the transfer may or may not go on
        self._deadline_ns = self._tries = self._starts = 0

    @property
    def holds_part(self) -> bool:
        """True if the autopilot may hold a part of a mission, until a deletion or a whole mission is confirmed."""
        return self._removal.pending or (self.active and self._begun)

    def start(self, items: tuple[MissionItem, ...], t_ns: int) -> None:
        """Begin to upload the items; a transfer that is under way is given up."""
        if self.active and self._begun:
            self._removal.pending = True  # of the one that is given up
        self._items, self.active, self._starts = items, True, 1
        self._begun, self._most = False, 0
        self._begin(t_ns)

    def rebooted(self, t_ns: int) -> None:
        """Begin a transfer that is under way anew: the vehicle has forgotten it."""
        if self.active:
            self._begin(t_ns)

    def request(self, sequence: int, t_ns: int) -> None:
        """Answer MISSION_REQUEST or MISSION_REQUEST_INT: send that item, however often it is requested."""
        if not self.active or not 0 <= sequence < len(self._items):
            return
        if sequence not in self._asked:
            self._tries, self._interrupted = 0, None
        self._asked.add(sequence)
        self._begun, self._most = True, max(self._most, len(self._asked))
        self._last = lambda: self._send(self._items[sequence].message(sequence, *self.target))
        self._transmit(t_ns)

    def acknowledge(self, result: int, t_ns: int) -> TransferResult | None:
        """Take a MISSION_ACK.

        Args:
            result: MAV_MISSION_RESULT.
            t_ns: now.

        Returns:
            The end of the transfer; None: it goes on, and lost messages are sent again.
        """
        if not self.active:
            told = self._removal.acknowledge(result)
            return None if told is None else TransferResult(told[0], told[1], 0, late=told[0])
        if result == _OUT_OF_TURN:  # an item came twice; the request for the next will come
            return None
        if result == ACCEPTED:
            if self._items and len(self._asked) < len(self._items):
                return None  # of an earlier transfer
            self.active = self.torn = False
            self._removal.done()
            return TransferResult(True, f"mission of {len(self._items)} items accepted", len(self._items))
        if result in _INTERRUPTED:  # its acceptance or its next request may still be on the way
            self._interrupted = result
            self._begun |= bool(self._items) and result == _CANCELLED  # it had begun to take them
            return None
        return self._refused(result, t_ns)

    def tick(self, t_ns: int, flown: bool = False) -> TransferResult | None:
        """Send an unanswered message again; return the end of a transfer that nobody answers, else None.

        Args:
            t_ns: now.
            flown: the autopilot flies a mission.
        """
        if not self.active:
            told = self._removal.tick(t_ns, flown)
            return TransferResult(False, told, 0) if told else None
        if t_ns < self._deadline_ns:
            return None
        if self._interrupted is None and self._tries < _TRIES:
            self._transmit(t_ns)
            return None
        if (self._asked or self._interrupted is not None) and self._starts < _STARTS:
            self._starts += 1
            self._begin(t_ns)
            return None
        if self._interrupted is not None:
            return self._refused(self._interrupted, t_ns)
        return self._fail(f"mission not accepted: no answer after {self._most} of {len(self._items)} items", t_ns)

    def _refused(self, result: int, t_ns: int) -> TransferResult | None:
        where = f" (after item {max(self._asked)})" if self._asked else ""
        return self._fail(f"mission refused: {REFUSALS.get(result, f'result {result}')}{where}", t_ns)

    def _fail(self, text: str, t_ns: int) -> TransferResult | None:
        """End the transfer; if a part of it or of an older one may be left, the result waits for the deletion."""
        self.active, self.torn = False, True
        if not (self._begun or self._removal.pending):
            return TransferResult(False, text, len(self._items))
        self._removal.begin(text, t_ns)
        return None

    def _begin(self, t_ns: int) -> None:
        self._asked, self._tries, self._last, self._interrupted = set(), 0, self._announce, None
        self._transmit(t_ns)

    def _transmit(self, t_ns: int) -> None:
        self._tries += 1
        self._deadline_ns = t_ns + _AGAIN_NS
        self._last()

    def _announce(self) -> None:
        system, component = self.target
        if self._items:
            self._send(
                message("MISSION_COUNT", target_system=system, target_component=component, count=len(self._items),
                        mission_type=0)
            )  # fmt: skip
        else:
            self._clear()

    def _clear(self) -> None:
        system, component = self.target
        self._send(message("MISSION_CLEAR_ALL", target_system=system, target_component=component, mission_type=0))
