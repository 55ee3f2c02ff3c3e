"""How far the motion can be trusted, told from what passes its gate, and when to doubt the state itself (M24)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from alight.motion.ekf.state import ATT, VEL, FilterState
from alight.records import MotionState

_SUPPORT = 8  # features inside their gates below which the cameras do not hold the motion
_BLINK = 0.5  # s without such an exposure that are a dropped frame and no more
_SLOW = 2.5  # exposures apart: photos come every few seconds
_SETTLED = 3  # exposures until the start is over
_ODDS = 5  # exposures in a row in which most features contradict the state, after which the state is doubted
_AT_ODDS = 3  # GPS positions in a row outside their gate that are more than chance
_NOISE = 3.0  # mean squared innovation over its variance above which the pictures are worse than they claim
_TILT, _SPEED = 0.2, 20.0  # rad, m/s: 1-sigma above which nothing is known


@dataclass(frozen=True)
class Votes:
    """What the features of one exposure said of the state."""

    inside: int = 0  # of those held or used up now: within their gates
    outside: int = 0
    innovation: float = 0.0  # mean squared distance over the rows of those inside, 1 expected; 0: none

    def __add__(self, other: Votes) -> Votes:
        n = max(self.inside + other.inside, 1)
        mean = (self.innovation * self.inside + other.innovation * other.inside) / n
        return Votes(self.inside + other.inside, self.outside + other.outside, mean)


class Health:
    """Fed with what passed and what did not; judges every exposure."""

    def __init__(self, coast: float) -> None:
        """Take the time [s] without any support after which all is lost."""
        self._coast = coast
        self._seen_ns = self._nav_ns = self._place_ns = self._last_ns = -(1 << 62)
        self._settled = self._odd = 0
        self._innovation = 1.0
        self._outside = 0  # GPS positions in a row outside their gate, and ns of the first of them
        self._outside_since = 0

    def restart(self, t_ns: int) -> None:
        """A new start from GPS/INS."""
        self._nav_ns = self._place_ns = t_ns
        self._settled = self._odd = self._outside = 0

    def hear(self, t_ns: int, place: bool | None, other: bool) -> float:
        """Take one row of GPS/INS: was the position inside its gate (None: not measured), was anything else?

        Returns:
            s for which positions have now been outside without a break.
        """
        if place or other:
            self._nav_ns = t_ns
        if place is not None:
            self._place_ns = t_ns if place else self._place_ns
            self._outside_since = t_ns if place or not self._outside else self._outside_since
            self._outside = 0 if place else self._outside + 1
        return (t_ns - self._outside_since) * 1e-9 if self._outside else 0.0

    def look(self, t_ns: int, votes: Votes) -> bool:
        """Take one exposure; True: the pictures have contradicted the state for so long that it is to be doubted."""
        self._pause = max((t_ns - self._last_ns) * 1e-9, 0.0)
        self._last_ns = t_ns
        if votes.inside >= _SUPPORT and votes.inside >= votes.outside:
            self._seen_ns, self._settled = t_ns, self._settled + 1
            self._innovation += 0.2 * (votes.innovation - self._innovation)
        odd = votes.outside >= _SUPPORT and votes.outside > 2 * votes.inside
        self._odd = self._odd + 1 if odd else 0
        if self._odd >= _ODDS:
            self._odd = 0
            return True
        return False

    def judge(self, state: FilterState) -> tuple[MotionState, str]:
        """The state at the last exposure, and why it is not GOOD."""
        t = self._last_ns
        seen = (t - self._seen_ns) * 1e-9 <= max(_BLINK, _SLOW * self._pause)
        coast = max(self._coast, _SLOW * self._pause)
        place, nav = (t - self._place_ns) * 1e-9 <= coast, (t - self._nav_ns) * 1e-9 <= coast
        if not nav and (t - self._seen_ns) * 1e-9 > coast:
            return MotionState.LOST, "neither the pictures nor GPS/INS hold the motion"
        if is_diverged(state):
            return MotionState.LOST, "attitude or velocity are not known any more"
        if self._settled < _SETTLED and nav:
            return MotionState.INITIALISING, "the first features are being learned"
        if not seen:
            return MotionState.DEGRADED, "GPS/INS only: too few features, or they contradict the motion"
        if self._outside >= _AT_ODDS:
            return MotionState.DEGRADED, "vision only: GPS is at odds with it"
        if not place:
            return MotionState.DEGRADED, "vision only: GPS is silent"
        if self._innovation > _NOISE:
            return MotionState.DEGRADED, "features scatter by more than they claim"
        return MotionState.GOOD, ""


def is_diverged(state: FilterState) -> bool:
    """Whether the covariance says that nothing is known."""
    spread = np.diag(state.P)
    return bool(np.sqrt(spread[ATT][:2].max()) > _TILT or np.sqrt(spread[VEL].max()) > _SPEED)
