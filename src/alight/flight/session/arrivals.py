"""Exposures as they arrive, counted for the checks before a flight."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

from alight.flight.session.preflight import MOST_AGE, CameraFacts
from alight.records import Frame

WINDOW = 3.0  # s over which the rate of the cameras is counted


@dataclass
class Arrivals:
    """Number, times and delay of the exposures that have come."""

    times: deque[float] = field(default_factory=lambda: deque[float](maxlen=1000))  # s
    frames: int = 0
    delay: float = math.nan  # s from the stamp of the newest to its arrival
    begun: bool = False  # one has come that is of now

    def saw(self, frame: Frame, now_ns: int) -> bool:
        """Take an exposure that came at `now_ns` of our clock; False: it is of an earlier flight, as all before it.

        A folder that was filled before still has its pictures. They come all at once: a gap between them would look
        like a jump of the camera's clock.
        """
        self.frames += 1
        self.delay = (now_ns - frame.t_ns) * 1e-9
        self.times.append(now_ns * 1e-9)
        self.begun = self.begun or self.delay < MOST_AGE
        return self.begun

    def facts(self, now_ns: int, frozen: int) -> CameraFacts:
        """Facts about the cameras for the checks; `frozen`: number of the last pictures that are the same."""
        recent = sum(now_ns * 1e-9 - t < WINDOW for t in tuple(self.times))
        return CameraFacts(self.frames, recent / WINDOW, self.delay, frozen)
