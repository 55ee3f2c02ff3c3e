"""Text messages of an autopilot: whole texts from STATUSTEXT, which sends long ones in pieces."""

from __future__ import annotations

from typing import Any, NamedTuple

from alight.flight.autopilot.dialect import mavlink


class StatusText(NamedTuple):
    """A text, and whether it is mere information."""

    text: str
    ok: bool


class TextJoiner:
    """Joins the pieces of one text, which carry one number. Lost pieces are left out."""

    def __init__(self) -> None:
        self._number = self._next = self._since_ns = 0  # of the text that is being joined, of its next piece
        self._pieces: list[StatusText] = []

    def add(self, message: Any, now_ns: int) -> list[StatusText]:
        """Take a STATUSTEXT; return the texts that it completes: one, two, or none if a piece is to come.

        A piece of less than 50 characters is the last one.
        """
        over = self._joined() if message.id != self._number else []
        if self._pieces and message.chunk_seq < self._next:
            return over  # it came twice
        self._number, self._next, self._since_ns = message.id, message.chunk_seq + 1, now_ns
        self._pieces.append(StatusText(str(message.text), message.severity > mavlink.MAV_SEVERITY_ERROR))
        return over + (self._joined() if not message.id or len(message.text) < 50 else [])

    def overdue(self, now_ns: int) -> list[StatusText]:
        """Return the text whose next piece does not come within a second, as far as it came."""
        return self._joined() if now_ns - self._since_ns > 1_000_000_000 else []

    def _joined(self) -> list[StatusText]:
        pieces, self._pieces = self._pieces, []
        return [StatusText("".join(p.text for p in pieces), all(p.ok for p in pieces))] if pieces else []
