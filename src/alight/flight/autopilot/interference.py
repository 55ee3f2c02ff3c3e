"""Messages on the link that are not the vehicle's: what they may cost, and the lines that report them."""

from __future__ import annotations

from collections import Counter, deque

from alight.flight.autopilot.dialect import mavlink

_SECOND_NS = 1_000_000_000
_SELDOM_NS = 60 * _SECOND_NS  # between two reports
Kind = tuple[int, int]  # MAV_AUTOPILOT and MAV_TYPE


class Allowance:
    """Admits events at a limited rate, and after a pause those of a second at once."""

    def __init__(self, per_second: float) -> None:
        self._rate = self._left = per_second
        self._at_ns = 0

    def admits(self, now_ns: int) -> bool:
        """Whether an event at `now_ns` is within the rate."""
        self._left = min(self._left + self._rate * max(now_ns - self._at_ns, 0) * 1e-9, self._rate)
        self._at_ns = max(now_ns, self._at_ns)
        admitted = self._left >= 1.0
        self._left -= admitted
        return admitted


class Interference:
    """Detects a second sender with the vehicle's identity, and reports it and the dropped messages at long intervals.

    One sender does not use a sequence number for two messages within a fraction of a second; two senders do, again and
    again. A gap of many lost messages causes it only for a moment, which has no effect.

    Args:
        kind: kind of the vehicle in its first heartbeat.
    """

    def __init__(self, kind: Kind) -> None:
        self._kind = kind
        self._clashes = deque[int](maxlen=3)  # ns, at least a second apart
        self._has_second, self._second_ns = False, -_SELDOM_NS
        self._reported, self._quiet_ns, self._wait_ns = Counter[str](), 0, _SECOND_NS

    def on_clash(self, now_ns: int) -> None:
        """Process two messages of the vehicle's identity with one sequence number."""
        if not self._clashes or now_ns - self._clashes[-1] >= _SECOND_NS:
            self._clashes.append(now_ns)
            self._has_second |= len(self._clashes) == 3 and now_ns - self._clashes[0] < 10 * _SECOND_NS

    def is_of_vehicle(self, heartbeat: mavlink.MAVLink_heartbeat_message) -> bool:
        """Whether a heartbeat with the vehicle's identity is of its kind; another is that of a second sender."""
        same = (heartbeat.autopilot, heartbeat.type) == self._kind
        self._has_second |= not same
        return same

    def reports(self, dropped: Counter[str], now_ns: int) -> list[str]:
        """Return the lines that are due.

        `dropped`: number of messages dropped so far, by reason.
        """
        out, new = [], dropped - self._reported
        if self._has_second and now_ns - self._second_ns >= _SELDOM_NS:
            out.append("a second sender has the vehicle's identity: end it, or sign the link (--signing-key)")
            self._second_ns = now_ns
        self._has_second = False
        if not new:
            self._quiet_ns = max(now_ns, self._quiet_ns)
        elif now_ns - self._quiet_ns >= self._wait_ns:
            out.append("dropped messages: " + counts_text(new))
            self._reported, self._quiet_ns, self._wait_ns = dropped.copy(), now_ns, _SELDOM_NS
        return out


def counts_text(dropped: Counter[str]) -> str:
    """Return numbers of dropped messages as text, by reason; empty: none was dropped."""
    return ", ".join(f"{number} {why}" for why, number in sorted(dropped.items()) if number)
