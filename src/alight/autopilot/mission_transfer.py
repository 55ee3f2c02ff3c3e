"""Mission upload: the autopilot asks for each item; what is lost is sent again, what stalls is begun again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from alight.autopilot.mission_item import MissionItem
from alight.autopilot.pymavlink_dialect import message

_AGAIN_NS = 1_000_000_000  # without a request, until the last message is sent again
_TRIES = 8  # of one message
_STARTS = 10  # of the whole transfer, longer than ArduPilot waits for an item: until then it refuses a deletion
_ACCEPTED, _OUT_OF_TURN = 0, 13  # MAV_MISSION_RESULT
_INTERRUPTED = {1, 15}  # ERROR and OPERATION_CANCELLED: what a copy of an item or a transfer that timed out brings
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
    begun: bool = False  # items were asked for: an autopilot that stores them as they come may hold a part


class MissionTransfer:
    """One upload (or, without items, one deletion) at a time."""

    def __init__(self, send: Callable[[Any], None]) -> None:
        self._send = send
        self._items: tuple[MissionItem, ...] = ()
        self.target = (0, 0)
        self.active = False
        self._last: Callable[[], None] = self._announce
        self._asked: set[int] = set()
        self._interrupted: int | None = None  # a result after which the transfer may or may not go on
        self._deadline_ns = self._tries = self._starts = 0

    def start(self, items: tuple[MissionItem, ...], t_ns: int) -> None:
        """Begin to upload the items; a transfer that is under way is given up."""
        self._items, self.active, self._starts = items, True, 1
        self._begin(t_ns)

    def rebooted(self, t_ns: int) -> None:
        """Begin a transfer that is under way anew: the vehicle has forgotten it."""
        if self.active:
            self._begin(t_ns)

    def delete_part(self) -> None:
        """Delete what a failed upload may have left; nobody waits for the answer."""
        system, component = self.target
        self._send(message("MISSION_CLEAR_ALL", target_system=system, target_component=component, mission_type=0))

    def stop(self) -> None:
        """Give up the transfer that is under way, without a result."""
        self.active = False

    def request(self, sequence: int, t_ns: int) -> None:
        """MISSION_REQUEST or MISSION_REQUEST_INT: send that item, however often it is asked for."""
        if not self.active or not 0 <= sequence < len(self._items):
            return
        if sequence not in self._asked:
            self._tries, self._interrupted = 0, None
        self._asked.add(sequence)
        self._last = lambda: self._send(self._items[sequence].message(sequence, *self.target))
        self._transmit(t_ns)

    def acknowledge(self, result: int, t_ns: int) -> TransferResult | None:
        """Take a MISSION_ACK.

        Args:
            result: MAV_MISSION_RESULT.
            t_ns: now.

        Returns:
            The end of the transfer; None: it goes on, and what was lost is sent again.
        """
        if not self.active or result == _OUT_OF_TURN:  # an item came twice; the request for the next will come
            return None
        if result == _ACCEPTED:
            if self._items and len(self._asked) < len(self._items):
                return None  # of an earlier transfer
            return self._end(True, f"mission of {len(self._items)} items accepted")
        if result in _INTERRUPTED:  # its acceptance or its next request may still be on the way
            self._interrupted = result
            return None
        return self._refused(result)

    def tick(self, t_ns: int) -> TransferResult | None:
        """Send again what was not answered in time; return the end of a transfer that nobody answers, else None."""
        if not self.active or t_ns < self._deadline_ns:
            return None
        if self._interrupted is None and self._tries < _TRIES:
            self._transmit(t_ns)
            return None
        if (self._asked or self._interrupted is not None) and self._starts < _STARTS:
            self._starts += 1
            self._begin(t_ns)
            return None
        if self._interrupted is not None:
            return self._refused(self._interrupted)
        return self._end(False, f"mission not accepted: no answer after {len(self._asked)} of {len(self._items)} items")

    def _refused(self, result: int) -> TransferResult:
        where = f" (after item {max(self._asked)})" if self._asked else ""
        return self._end(False, f"mission refused: {REFUSALS.get(result, f'result {result}')}{where}")

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
            self.delete_part()

    def _end(self, ok: bool, text: str) -> TransferResult:
        self.active = False
        return TransferResult(ok, text, len(self._items), bool(self._asked))
