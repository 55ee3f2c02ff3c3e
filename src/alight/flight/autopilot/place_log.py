"""The autopilot's positions of the last half minute: its position at an instant, and the age of its reports."""

from __future__ import annotations

import math
from bisect import bisect_left, insort
from collections import deque
from itertools import pairwise
from operator import attrgetter

from alight.flight.autopilot.clock import VehicleClock
from alight.flight.autopilot.place_watch import PlaceReport, PlaceWatch
from alight.records import Place

_REMEMBERED = 300  # positions
_CARRIED_NS = 1_500_000_000  # extrapolation of a report by its velocity, where reports are late or few
_BACK_NS = 400_000_000  # before a report
_WINDOW_NS = 5_000_000_000  # in which the greatest age is looked for
_stamp = attrgetter("boot_ns")


class PlaceLog:
    """Accepted reports in order of time."""

    def __init__(self) -> None:
        self._places: list[PlaceReport] = []
        self._arrivals: deque[tuple[int, int]] = deque(maxlen=_REMEMBERED)  # our clock, and the autopilot's stamp
        self._watch = PlaceWatch()

    @property
    def doubted(self) -> bool:
        """True if the newest reports contradict the accepted ones."""
        return self._watch.doubts

    def take(self, report: PlaceReport, now_ns: int) -> bool:
        """Take a report that came at `now_ns` of our clock; False: it is not accepted."""
        jumps = self._watch.jumps
        if not self._watch.believes(report):
            return False
        if self._watch.jumps != jumps:
            self._places.clear()  # they are of another estimate
        insort(self._places, report, key=_stamp)  # the link may reorder them
        del self._places[:-_REMEMBERED]
        self._arrivals.append((now_ns, report.boot_ns))
        return True

    def at(self, boot_ns: int) -> Place | None:
        """As `VehicleState.place_at`."""
        after = bisect_left(self._places, boot_ns, key=_stamp)
        beside = self._places[max(after - 1, 0) : after + 1]
        near = [r for r in beside if -_BACK_NS <= boot_ns - r.boot_ns <= _CARRIED_NS]
        if not near or self.doubted:
            return None
        return min(near, key=lambda report: abs(report.boot_ns - boot_ns)).at(boot_ns)

    def age(self, boot_ns: int) -> float:
        """Seconds from the newest report to an instant of the autopilot's clock; inf: there is none."""
        return (boot_ns - self._places[-1].boot_ns) * 1e-9 if self._places else math.inf

    def oldest(self, now_ns: int, clock: VehicleClock) -> float:
        """Greatest age of the newest report during the last five seconds, in seconds; inf: there is none.

        Args:
            now_ns: our clock.
            clock: the autopilot's, known.
        """
        recent = [a for a in self._arrivals if now_ns - a[0] <= _WINDOW_NS]
        ends = [*(later[0] for _, later in pairwise(recent)), now_ns]
        ages = [(end - clock.ours_ns(boot_ns)) * 1e-9 for end, (_, boot_ns) in zip(ends, recent, strict=False)]
        return max(ages, default=math.inf)
