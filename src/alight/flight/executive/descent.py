"""The descent onto a site, and reasons to abort it other than a refusal by a verdict."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from statistics import median

import numpy as np

from alight.flight.executive.places import Opinion, Standing
from alight.records import MovingBody, Site
from alight.records.executive import Order, Situation
from alight.settings import ExecutiveSettings, StageSettings


def is_too_low_to_abort(left: float, keys: ExecutiveSettings) -> bool:
    """Whether a landing that is `left` metres above its site is too low to be aborted."""
    return left < keys.abort_height


def is_near_ground(left: float, keys: ExecutiveSettings) -> bool:
    """Whether a landing, `left` metres above its site, goes on despite degraded motion and unusable pictures.

    At a height of 2 m, swaying grass fills the picture, and is treated as a moving object.
    """
    return left < keys.degraded_height


class Descent:
    """Orders of a landing: fly over the site, then descend slowly; return over the site if the vehicle drifts off."""

    def __init__(self, settings: StageSettings) -> None:
        self._keys, self._cruise = settings.executive, settings.route.cruise_speed
        self._room = settings.lander.reach + settings.hazards.traffic_margin  # metres, from a person or car
        self.begin(0.0)

    def begin(self, t: float) -> None:
        """Begin a landing at the time `t`, in seconds."""
        self._begun = t
        self._taken = deque(
            [t] * self._keys.refusals_to_abort, self._keys.refusals_to_abort
        )  # s, the newest exposure of each of the last verdicts
        self._flown, self._high = deque[tuple[float, float]](), 0.0  # (s, metres above the site); the greatest height
        self._low_at: float | None = None  # s, when it was first too low to abort
        self._over = False  # whether the vehicle is over the site and descends
        self._kept: float | None = None  # metres up, held until the vehicle is over the site
        self._unseen = 0  # consecutive verdicts that do not see the whole site
        self._p = deque[float](maxlen=self._keys.last_verdicts)  # P(safe) by the last verdicts that see it

    def judged(self, taken: float, found: Opinion, left: float) -> bool:
        """Add a new verdict; return whether the last verdicts together refuse the site.

        They refuse it if several consecutive verdicts see too little of it, or if the median of their P(safe) is low.
        Near the ground (`is_near_ground`) they never refuse it.

        Args:
            taken: time of the newest exposure in the map of the verdict, s.
            found: opinion of the verdict on the site.
            left: height of the vehicle above the site, metres.
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

    def too_long(self, t: float, left: float, verdict_time: float) -> str:
        """Return the reason if the landing takes too long or the newest verdict is too old, else an empty string.

        Args:
            t: present time, s.
            left: height above the site, metres; if it is too low to abort, the age of the verdict has no effect.
            verdict_time: see `AttemptLimits`.
        """
        waits = verdict_time * self._high / self._keys.unchecked  # s, over the site, for verdicts that keep up
        if t - self._begun > self._keys.hold + self._high / self._keys.landing_speed + waits:
            return f"it does not come down: {t - self._begun:.0f} s"
        silent = t - self._taken[-1]
        late = (
            silent > self._keys.unjudged + verdict_time
            and self._keys.look_again
            and not is_too_low_to_abort(left, self._keys)
        )
        return f"no verdict for {silent:.1f} s" if late else ""

    def must_stop(self, movers: Sequence[MovingBody], place: Site, left: float) -> bool:
        """Whether people or cars that move come too near to the site `place` before the vehicle stands on it.

        Their velocities are taken to stay. `left`: height above the site, metres; if it is too low, nothing stops it.
        """
        stops = self._keys.look_again and left >= self._keys.stop_height
        return stops and any(self._is_reached_by(m, place, left) for m in movers)

    def _is_reached_by(self, mover: MovingBody, place: Site, left: float) -> bool:
        way, speed = mover.place - [place.east, place.north], float(np.linalg.norm(mover.velocity))
        seconds = left / self._keys.landing_speed
        nearest = float(np.clip(-(way @ mover.velocity) / max(speed**2, 1e-9), 0.0, seconds))  # s from now
        return float(np.linalg.norm(way + nearest * mover.velocity)) < self._room + mover.reach

    def unfelt(self, t: float) -> str:
        """Return the reason if, at `t` s, no touchdown has been reported for too long on the last metres, else ""."""
        waited = 0.0 if self._low_at is None else t - self._low_at
        return f"for {waited:.0f} s on the last metres" if waited > self._keys.hold else ""

    def _is_checked(self, left: float) -> bool:
        """Whether the vehicle has descended less than `unchecked` metres during the last `refusals_to_abort` verdicts.

        `left`: present height above the site, metres. If true, an object that enters the site is seen in time for an
        abort, however slow the verdicts are.
        """
        first = self._taken[0]
        while len(self._flown) > 1 and self._flown[1][0] <= first:
            self._flown.popleft()
        return not self._keys.look_again or self._flown[0][1] - left < self._keys.unchecked

    def _has_enough_verdicts(self, left: float) -> bool:
        """Whether enough verdicts for an abort have come, or will come on the way from `left` metres above the site."""
        waits = left - self._keys.degraded_height < self._keys.unchecked and not is_near_ground(left, self._keys)
        return not (waits and self._keys.look_again) or len(self._p) == self._p.maxlen

    def order(self, now: Situation, place: Site, left: float, same_frame: bool) -> Order:
        """Return the order for the situation `now`, `left` metres above the site `place`.

        The vehicle waits over the site while verdicts do not keep up with the descent, and before the last metres until
        there are enough verdicts for an abort, but not if the autopilot cannot hold its position. It sinks straight
        down if its position is unknown, or is not in the map frame of the site (`same_frame`).
        """
        low, sink = is_too_low_to_abort(left, self._keys), self._keys.landing_speed
        self._flown.append((now.t, left))
        self._high = max(self._high, left)
        self._low_at = now.t if low and self._low_at is None else self._low_at
        speed = self._keys.aside_speed * (0.5 if low else 1.0)  # it must not drift on the last metres
        if now.position is None or not same_frame:
            return Order("land", None, speed, sink, down=True)
        beside = math.hypot(place.east - now.position[0], place.north - now.position[1])
        begin = self._keys.on_way if now.steers else self._keys.on_way / 2  # what is left then, straight down, stays
        within = self._keys.off_way if self._over else begin
        enough = self._over or self._has_enough_verdicts(left)
        waits = now.holds and not (enough and self._is_checked(left))
        self._over = low or (beside <= within and not waits)
        at = np.array([place.east, place.north, place.up])
        if self._over:
            self._kept = None
            return Order("land", at, speed, sink, down=True)
        up = float(now.position[2])
        self._kept = up if self._kept is None else min(self._kept, up + 0.3)  # a larger rise is an estimation error
        return Order("land", at, self._cruise, sink, down=False, height=self._kept)
