"""Limits of wind, battery and time, of waiting, and of degraded motion."""

from __future__ import annotations

import math
from collections import deque

from alight.flight.executive.descent import is_near_ground
from alight.flight.executive.table import Event
from alight.records import MotionState
from alight.records.executive import FlightEvent, FlightState, Situation
from alight.settings import ExecutiveSettings

NEAR_A_PLACE = (FlightState.LOOK, FlightState.DESCEND, FlightState.COMMIT)


class AttemptLimits:
    """Limits that end an attempt or a wait. Call `observe` at every tick."""

    def __init__(self, keys: ExecutiveSettings) -> None:
        self._keys = keys
        self._begun: float | None = None  # s, start of the landing
        self._since: dict[FlightEvent, float] = {}  # s, since when each quantity exceeds its limit
        self._sound_at = -math.inf  # s, when the motion was last not degraded
        self.missing_at = -math.inf  # s, when motion, pictures or the autopilot's position were last missing
        self._judged = 0  # number of the newest verdict
        self._ages = deque[float]([0.0], keys.last_verdicts)  # s, of the newest exposures of the last verdicts

    def observe(self, now: Situation) -> None:
        """Note the start of the landing, what was last missing or degraded, and the age of a verdict."""
        self._begun = now.t if self._begun is None else self._begun
        self.missing_at = self.missing_at if now.holds else now.t
        if now.state is not MotionState.DEGRADED if now.sight is None else now.sight.sees:
            self._sound_at = now.t
        if now.seen is not None and now.seen.number > self._judged:
            self._judged = now.seen.number
            self._ages.append(now.t - now.seen.t)

    @property
    def verdict_time(self) -> float:
        """Longest time, s, from a request for a verdict to the verdict: each of the last took half of it.

        A request waits until the verdict before it is done. Slow verdicts lengthen every wait for one by this.
        """
        return 2.0 * max(self._ages)

    def is_overdue(self, t: float, since: float) -> bool:
        """Whether at `t` a verdict on what was seen at `since` is overdue, both in seconds."""
        return t - since > self._keys.wait + self.verdict_time

    def exceeded(self, now: Situation) -> Event | None:
        """Return the event of an exceeded limit and its values in words; None: no limit is exceeded.

        Call it at every tick. Wind and battery must exceed their limits for some time: a gust or a short dip of the
        voltage has no effect.
        """
        k, beyond = self._keys, dict[FlightEvent, str]()
        if now.wind_speed > k.most_wind:
            beyond[FlightEvent.WIND] = f"{now.wind_speed:.1f} m/s, limit {k.most_wind:.1f}"
        if math.isnan(now.battery):
            beyond[FlightEvent.BATTERY] = "it is not reported any more"
        if now.battery < k.least_battery:
            beyond[FlightEvent.BATTERY] = f"{100 * now.battery:.0f} %, limit {100 * k.least_battery:.0f}"
        if self._begun is not None and now.t - self._begun > k.time_budget:
            beyond[FlightEvent.TIME] = f"{k.time_budget:.0f} s"
        self._since = {event: self._since.get(event, now.t) for event in beyond}
        for event, words in beyond.items():
            if event is FlightEvent.TIME or now.t - self._since[event] >= k.lasting:
                return event, words
        return None

    def patience(self, now: Situation) -> float:
        """Return the seconds to wait for lost motion or pictures: more if the autopilot can hold its position."""
        return self._keys.hold if now.holds else self._keys.wait

    def is_too_weak(self, now: Situation, state: FlightState, left: float) -> bool:
        """Whether the motion has been degraded for too long at a location or, by sight, is not shown by the pictures.

        Args:
            state: present state; during HOLD, the state before it.
            left: height above the site, metres. Near the ground, a landing continues with degraded motion.
        """
        if state is FlightState.COMMIT and is_near_ground(left, self._keys):
            return False
        matters = state in NEAR_A_PLACE or now.sight is not None
        return matters and now.t - self._sound_at >= self._keys.degraded
