"""The way down on a place, and reasons to break it off besides a verdict on the place."""

from __future__ import annotations

import math
from collections import deque
from statistics import median

import numpy as np

from alight.landing.executive.opinion import Opinion, Standing
from alight.records import Site
from alight.records.executive import Order, Situation
from alight.settings import StageSettings

HEARD = 2.0  # m of descent in which enough verdicts come: nearer than this to the height of the last verdicts it waits
LAST = 0.5  # of the sideways speed, once a landing is not broken off any more: it must not drift as it touches down


class Descent:
    """Orders of a landing: over the place first, then slowly down; back over it while it may still be broken off.

    Args:
        settings: of all stages; `executive` and `route` are used.
    """

    def __init__(self, settings: StageSettings) -> None:
        self._keys, self._cruise = settings.executive, settings.route.cruise_speed
        self.begin(0.0)

    def begin(self, t: float) -> None:
        """Begin a landing, at a time in seconds."""
        self._begun = self._judged = t
        self._over = False  # the vehicle is over the place, and comes down
        self._kept: float | None = None  # metres up, kept until it is over the place
        self._unseen = 0  # verdicts in a row that do not see the place whole
        self._p = deque[float](maxlen=self._keys.last_verdicts)  # P(safe) of the last ones that do

    def judged(self, t: float, said: Opinion, left: float) -> bool:
        """Take a new verdict; True: the last ones together refuse the place.

        They do if several in a row see too little of it, or if it has come into doubt and stays there: one low
        P(safe) may come from swaying grass. Near the ground neither is a reason: from 2 m above grass the whole
        picture sways, and counts as moving.

        Args:
            t: s.
            said: opinion on the place.
            left: metres above it.
        """
        self._judged = t
        if left < self._keys.degraded_height:
            self._unseen = 0
            return False
        if said.standing is Standing.NOT_SEEN:
            self._unseen += 1
            return self._unseen >= self._keys.unseen
        self._unseen = 0
        self._p.append(said.p_safe)
        return len(self._p) == self._p.maxlen and median(self._p) < self._keys.doubted

    def too_long(self, t: float, left: float) -> str:
        """Reason, in words, if the landing takes too long, or no verdict has come for too long; empty: neither."""
        if t - self._begun > self._keys.hold:
            return f"it does not come down: {t - self._begun:.0f} s"
        silent = t - self._judged
        late = silent > self._keys.unjudged and left >= self._keys.degraded_height and self._keys.look_again
        return f"no verdict for {silent:.1f} s" if late else ""

    def _has_heard(self, left: float) -> bool:
        """True if enough verdicts to break the landing off have come, or will come on the way down."""
        above = left - self._keys.degraded_height
        return not 0.0 <= above < HEARD or not self._keys.look_again or len(self._p) == self._p.maxlen

    def order(self, now: Situation, place: Site, left: float, same_frame: bool) -> Order:
        """Return the order for now.

        From low down it waits over the place until there are enough verdicts to break the landing off. If the
        vehicle's position in the frame of the place is not known, it sinks straight down: it is too low to break off.
        """
        low, sink = left < self._keys.abort_height, self._keys.landing_speed
        speed = self._keys.aside_speed * (LAST if low else 1.0)
        if now.position is None or not same_frame:
            return Order("land", None, speed, sink, down=True)
        beside = math.hypot(place.east - now.position[0], place.north - now.position[1])
        within = self._keys.off_site if self._over else self._keys.over_site
        heard = self._over or self._has_heard(left)
        self._over = low or (beside <= within and heard)
        at = np.array([place.east, place.north, place.up])
        if self._over:
            self._kept = None
            return Order("land", at, speed, sink, down=True)
        self._kept = float(now.position[2]) if self._kept is None else self._kept
        return Order("land", at, self._cruise, sink, down=False, height=self._kept)
