"""Texts of the autopilot, joined from their pieces."""

from __future__ import annotations

from collections import deque
from typing import Any, NamedTuple

from alight.flight.autopilot.dialect import mavlink


class StatusText(NamedTuple):
    """A text of the autopilot; `ok` is False for errors, `warns` is True for warnings and errors."""

    text: str
    ok: bool
    warns: bool


class TextJoiner:
    """Joins the pieces of a long text, which carry the same number. Lost pieces are skipped."""

    def __init__(self) -> None:
        self._number = self._next = self._since_ns = 0  # number of the text that is joined, and of its next piece
        self._pieces: list[StatusText] = []
        self._warnings = deque[tuple[int, str]](maxlen=5)  # our clock, and the text

    def add(self, message: Any, now_ns: int) -> list[StatusText]:
        """Process a STATUSTEXT; return the texts that it completes: none, one or two.

        A piece of less than 50 characters is the last piece of its text.
        """
        over = self._joined(now_ns) if message.id != self._number else []
        if self._pieces and message.chunk_seq < self._next:
            return over  # it came twice
        self._number, self._next, self._since_ns = message.id, message.chunk_seq + 1, now_ns
        ok, warns = message.severity > mavlink.MAV_SEVERITY_ERROR, message.severity <= mavlink.MAV_SEVERITY_WARNING
        self._pieces.append(StatusText(str(message.text), ok, warns))
        return over + (self._joined(now_ns) if not message.id or len(message.text) < 50 else [])

    def overdue(self, now_ns: int) -> list[StatusText]:
        """Return the incomplete text whose next piece has not come within a second, else an empty list."""
        return self._joined(now_ns) if now_ns - self._since_ns > 1_000_000_000 else []

    def warnings(self, now_ns: int) -> list[str]:
        """Return the warnings and errors of the last two seconds."""
        return [text for t_ns, text in self._warnings if now_ns - t_ns < 2_000_000_000]

    def _joined(self, now_ns: int) -> list[StatusText]:
        pieces, self._pieces = self._pieces, []
        if not pieces:
            return []
        text = StatusText("".join(p.text for p in pieces), all(p.ok for p in pieces), pieces[0].warns)
        self._warnings += [(now_ns, text.text)] if text.warns else []
        return [text]
