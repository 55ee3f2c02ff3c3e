"""The way down on a place, and reasons to break it off besides a verdict on the place."""

from __future__ import annotations

import math
from collections import deque
from statistics import median

import numpy as np

from alight.flight.executive.places import Opinion, Standing
from alight.records import Site
from alight.records.executive import Order, Situation
from alight.settings import ExecutiveSettings, StageSettings


def is_too_low_to_abort(left: float, keys: ExecutiveSettings) -> bool:
    """True if a landing is not broken off any more, `left` metres above its place."""
    return left < keys.abort_height


def is_near_ground(left: float, keys: ExecutiveSettings) -> bool:
    """True if a landing, `left` metres above its place, outlives degraded motion and pictures that show little.

    From 2 m above grass the whole picture sways, and counts as moving.
    """
    return left < keys.degraded_height


class Descent:
    """Orders of a landing: over the place first, then slowly down; back over it while it may still be broken off."""

    def __init__(self, settings: StageSettings) -> None:
        self._keys, self._cruise = settings.executive, settings.route.cruise_speed
        self.begin(0.0)

    def begin(self, t: float) -> None:
        """Begin a landing, at a time in seconds."""
        self._begun = t
        self._taken = deque(
            [t] * self._keys.refusals_to_abort, self._keys.refusals_to_abort
        )  # s, newest exposures of the last verdicts
        self._flown, self._high = deque[tuple[float, float]](), 0.0  # s, and metres above the place; the most of them
        self._low_at: float | None = None  # s, when it was first too low to break off
        self._over = False  # the vehicle is over the place, and comes down
        self._kept: float | None = None  # metres up, kept until it is over the place
        self._unseen = 0  # verdicts in a row that do not see the place whole
        self._p = deque[float](maxlen=self._keys.last_verdicts)  # P(safe) of the last ones that do

    def judged(self, taken: float, found: Opinion, left: float) -> bool:
        """Take a new verdict; True: the last ones together refuse the place.

        They do if several in a row see too little of it, or if it has come into doubt and stays there: one low
        P(safe) may come from swaying grass. Near the ground neither is a reason (`is_near_ground`).

        Args:
            taken: s, the newest exposure that the verdict holds.
        """
        self._taken.append(taken)
        if is_near_ground(left, self._keys):
            self._unseen = 0
            return False
        if found.standing is Standing.NOT_SEEN:
            self._unseen += 1
            return self._unseen >= self._keys.unseen
        self._unseen = 0
        self._p.append(found.p_safe)
        return len(self._p) == self._p.maxlen and median(self._p) < self._keys.abort_median

    def too_long(self, t: float, left: float) -> str:
        """Reason, in words, if the landing takes too long, or the newest verdict is too old; empty: neither."""
        if t - self._begun > self._keys.hold + self._high / self._keys.landing_speed:
            return f"it does not come down: {t - self._begun:.0f} s"
        silent = t - self._taken[-1]
        late = silent > self._keys.unjudged and self._keys.look_again and not is_too_low_to_abort(left, self._keys)
        return f"no verdict for {silent:.1f} s" if late else ""

    def unfelt(self, t: float) -> str:
        """Reason, in words, if no touchdown is reported for too long on the last metres; empty: it may still come."""
        waited = 0.0 if self._low_at is None else t - self._low_at
        return f"for {waited:.0f} s on the last metres" if waited > self._keys.hold else ""

    def _is_checked(self, left: float) -> bool:
        """Whether the last verdicts, as many as end a landing, saw the place from `unchecked` metres above or lower.

        So whoever comes to the place while the vehicle is more than that above `abort_height` is seen in time, however
        slow the verdicts are.
        """
        first = self._taken[0]
        while len(self._flown) > 1 and self._flown[1][0] <= first:
            self._flown.popleft()
        return not self._keys.look_again or self._flown[0][1] - left < self._keys.unchecked

    def _has_enough_verdicts(self, left: float) -> bool:
        """True if enough verdicts to break the landing off have come, or will come on the way down."""
        waits = left - self._keys.degraded_height < self._keys.unchecked and not is_near_ground(left, self._keys)
        return not (waits and self._keys.look_again) or len(self._p) == self._p.maxlen

    def order(self, now: Situation, place: Site, left: float, same_frame: bool) -> Order:
        """Return the order for now.

        It waits over the place where verdicts do not keep up with it, and from low down until there are enough of them
        to break the landing off. If the vehicle's position in the frame of the place is not known, it sinks straight
        down: it is too low to break off.
        """
        low, sink = is_too_low_to_abort(left, self._keys), self._keys.landing_speed
        self._flown.append((now.t, left))
        self._high = max(self._high, left)
        self._low_at = now.t if low and self._low_at is None else self._low_at
        speed = self._keys.aside_speed * (0.5 if low else 1.0)  # at last it must not drift
        if now.position is None or not same_frame:
            return Order("land", None, speed, sink, down=True)
        beside = math.hypot(place.east - now.position[0], place.north - now.position[1])
        within = self._keys.off_way if self._over else self._keys.on_way
        enough = self._over or self._has_enough_verdicts(left)
        self._over = low or (beside <= within and enough and self._is_checked(left))
        at = np.array([place.east, place.north, place.up])
        if self._over:
            self._kept = None
            return Order("land", at, speed, sink, down=True)
        up = float(now.position[2])
        self._kept = up if self._kept is None else min(self._kept, up + 0.3)  # more was an error of the estimate
        return Order("land", at, self._cruise, sink, down=False, height=self._kept)
