"""Deletion of the rest of a failed upload, ordered again until the autopilot confirms it."""

from __future__ import annotations

from collections.abc import Callable

_AGAIN_NS, _LATER_NS = 1_000_000_000, 5_000_000_000  # between two tries, before and after the failure is reported
_TRIES = 12  # until it is reported; longer than ArduPilot waits for an item: until then it refuses a deletion
ACCEPTED = 0  # MAV_MISSION_RESULT


class PartRemoval:
    """Deletes the part of a mission that may be left on an autopilot, which stores items as they come.

    It goes on until the deletion is confirmed: the link may come back much later.

    Args:
        send: sends the order to delete the mission.
    """

    def __init__(self, send: Callable[[], None]) -> None:
        self._send = send
        self.pending = False  # a part may be there
        self._told = True
        self._failure = ""  # of the upload, in words
        self._deadline_ns = self._tries = 0

    def begin(self, failure: str, t_ns: int) -> None:
        """Begin after an upload has failed; `failure` is the reason in words."""
        self._failure, self._tries = failure, 0
        self.pending, self._told = True, False
        self._transmit(t_ns)

    def done(self) -> None:
        """Forget it: a whole mission has taken its place, or it was deleted otherwise."""
        self.pending, self._told = False, True

    def acknowledge(self, result: int) -> tuple[bool, str] | None:
        """Take a MISSION_ACK; a denial does not end the removal.

        Returns:
            Whether the failure was reported before, and the text to report now; None: nothing to report.
        """
        if not self.pending or result != ACCEPTED:
            return None
        told = self._told
        self.done()
        text = "the part of a mission that may have been left is deleted"
        return told, text if told else f"{self._failure}; the part that it held is deleted"

    def tick(self, t_ns: int, flown: bool) -> str:
        """Send the order again if it was not confirmed in time.

        Args:
            t_ns: now.
            flown: a mission is flown. Once the failure was reported, that may be another mission: it is not deleted.

        Returns:
            The text to report now; empty: nothing.
        """
        if not self.pending or t_ns < self._deadline_ns or (flown and self._told):
            return ""
        if self._tries < _TRIES or self._told:
            self._transmit(t_ns)
            return ""
        self._told = True
        return f"{self._failure}; it may hold a part, whose deletion is not confirmed: do not fly its mission"

    def _transmit(self, t_ns: int) -> None:
        self._tries += 1
        self._deadline_ns = t_ns + (_LATER_NS if self._told else _AGAIN_NS)
        self._send()
