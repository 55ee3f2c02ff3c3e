"""Text messages of an autopilot: whole texts from STATUSTEXT, which sends long ones in pieces."""

from __future__ import annotations

from typing import Any, NamedTuple

_PIECE = 50  # characters; a shorter piece is the last one
_PATIENCE_NS = 1_000_000_000  # for the next piece


class SpokenText(NamedTuple):
    """A text, and whether it is mere information (severity above 3)."""

    text: str
    ok: bool


class TextJoiner:
    """Joins the pieces of one text, which carry one number. Lost pieces are left out."""

    def __init__(self) -> None:
        self._number = self._next = self._since_ns = 0  # of the text that is being joined, of its next piece
        self._pieces: list[SpokenText] = []

    def take(self, message: Any, now_ns: int) -> list[SpokenText]:
        """Take a STATUSTEXT; return the texts that it completes: one, two, or none if a piece is to come."""
        over = self._joined() if message.id != self._number else []
        if self._pieces and message.chunk_seq < self._next:
            return over  # it came twice
        self._number, self._next, self._since_ns = message.id, message.chunk_seq + 1, now_ns
        self._pieces.append(SpokenText(str(message.text), message.severity > 3))
        return over + (self._joined() if not message.id or len(message.text) < _PIECE else [])

    def overdue(self, now_ns: int) -> list[SpokenText]:
        """Return the text whose next piece does not come in time, as far as it came."""
        return self._joined() if now_ns - self._since_ns > _PATIENCE_NS else []

    def _joined(self) -> list[SpokenText]:
        pieces, self._pieces = self._pieces, []
        return [SpokenText("".join(p.text for p in pieces), all(p.ok for p in pieces))] if pieces else []
