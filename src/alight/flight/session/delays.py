"""Delays from an exposure to the orders that it led to, for the summary of a flight."""

from __future__ import annotations

from collections import deque

from alight.records import Motion

KEPT = 20_000  # delays that are kept


class OrderDelays:
    """Delays of the first orders after each verdict and each motion."""

    def __init__(self) -> None:
        self._verdict_ns = self._motion_ns = 0  # newest exposures that led to an order
        self.of_verdicts = deque[float](maxlen=KEPT)  # s, exposure to the first order of the verdict that holds it
        self.of_motions = deque[float](maxlen=KEPT)  # s, exposure to the first set-point relative to its motion

    def add_order(self, now_ns: int, verdict_ns: int, moved_by: Motion | None) -> None:
        """Take an order.

        Args:
            now_ns: our clock.
            verdict_ns: newest exposure of the newest verdict.
            moved_by: motion that its set-point is relative to; None: it has none.
        """
        if verdict_ns > self._verdict_ns:
            self._verdict_ns = verdict_ns
            self.of_verdicts.append((now_ns - verdict_ns) * 1e-9)
        if moved_by is not None and moved_by.t_ns > self._motion_ns:
            self._motion_ns = moved_by.t_ns
            self.of_motions.append((now_ns - moved_by.t_ns) * 1e-9)
