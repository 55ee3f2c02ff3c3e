"""What an autopilot says: whole texts from STATUSTEXT, of which long ones come in pieces."""

from __future__ import annotations

from typing import Any, NamedTuple

_PIECE = 50  # characters; a shorter piece is the last one


class SpokenText(NamedTuple):
    """A text, and whether it is no more than information."""

    text: str
    ok: bool


class TextJoiner:
    """Joins the pieces of one text, which bear one number. What is lost on the way is left out."""

    def __init__(self) -> None:
        self._number = 0  # of the text that is being joined; 0: none
        self._pieces: list[SpokenText] = []

    def take(self, message: Any) -> list[SpokenText]:
        """Take a STATUSTEXT; return the texts that are over with it: one, two, or none as more is to come."""
        over = []
        if self._pieces and message.id != self._number:
            over.append(self._joined())
        self._number = message.id
        self._pieces.append(SpokenText(str(message.text), message.severity > 3))
        if not message.id or len(message.text) < _PIECE:
            over.append(self._joined())
        return over

    def _joined(self) -> SpokenText:
        whole = SpokenText("".join(p.text for p in self._pieces), all(p.ok for p in self._pieces))
        self._pieces.clear()
        return whole
