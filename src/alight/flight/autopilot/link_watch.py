"""The watch over the link: the vehicle's heartbeat comes, and a thread listens for it."""

from __future__ import annotations

_HEARTBEAT_NS = 3_500_000_000  # without a heartbeat
_HEARTBEAT_PACE_NS = 1_900_000_000  # and of the autopilot's own time, in which a slow simulation sends one a second
_DEAF_NS = 1_200_000_000  # without a tick: longer than a TCP link takes to be opened again
_LOOKS = 5  # in that time: a program that was itself suspended has looked once only, and is not deaf


class LinkWatch:
    """Watch over the heartbeat (`tick`, of the listening thread) and over the ticks (`look`, of another thread)."""

    def __init__(self) -> None:
        self.alive = True
        self._heard_ns: int | None = None  # the newest heartbeat, our clock
        self._heard_pace_ns = 0
        self._ticked_ns: int | None = None
        self._looks = 0  # since the last tick

    def hear(self, now_ns: int, pace_ns: int) -> bool:
        """Take a heartbeat; True: the vehicle is heard again."""
        self._heard_ns, self._heard_pace_ns = now_ns, pace_ns
        back, self.alive = not self.alive, True
        return back

    def tick(self, now_ns: int, pace_ns: int) -> str:
        """Let time pass; return the reason if the vehicle was lost just now, else an empty string."""
        self._ticked_ns, self._looks = now_ns, 0
        late = self._heard_ns is not None and now_ns - self._heard_ns > _HEARTBEAT_NS
        silent = late and pace_ns - self._heard_pace_ns > _HEARTBEAT_PACE_NS
        return self._lose("no heartbeat of the vehicle any more") if silent else ""

    def look(self, now_ns: int) -> str:
        """Test from another thread whether ticks come; return the reason if the vehicle was lost just now."""
        self._looks += 1
        return self._lose("nobody listens to the link") if self.is_deaf(now_ns) else ""

    def is_deaf(self, now_ns: int) -> bool:
        """True if ticks have stopped."""
        if self._ticked_ns is None or self._looks < _LOOKS:
            return False
        return now_ns - self._ticked_ns > _DEAF_NS

    def _lose(self, why: str) -> str:
        lost, self.alive = self.alive, False
        return why if lost else ""
