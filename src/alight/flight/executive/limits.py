"""The limits of wind, battery and time, of waiting, and of degraded motion."""

from __future__ import annotations

import math

from alight.flight.executive.descent import is_near_ground
from alight.records import MotionState
from alight.records.executive import FlightEvent, FlightState, Situation
from alight.settings import ExecutiveSettings

NEAR_A_PLACE = (FlightState.LOOK, FlightState.DESCEND, FlightState.COMMIT)


class AttemptLimits:
    """What ends an attempt or a wait. Call `observe` at every tick."""

    def __init__(self, keys: ExecutiveSettings) -> None:
        self._keys = keys
        self._begun: float | None = None  # s, start of the landing
        self._since: dict[FlightEvent, float] = {}  # s, when each was first beyond its limit
        self._sound_at = -math.inf  # s, when the motion was last not degraded
        self.missing_at = -math.inf  # s, when motion or pictures were last missing

    def observe(self, now: Situation) -> None:
        """Note the start of the landing, and the time when the motion was last not degraded."""
        self._begun = now.t if self._begun is None else self._begun
        if now.state is not MotionState.DEGRADED:
            self._sound_at = now.t

    def exceeded(self, now: Situation) -> tuple[FlightEvent, str] | None:
        """The limit that is exceeded, with its numbers in words; None: none is. Call it at every tick.

        Wind and battery count after some time beyond their limits: a gust and a short dip of the voltage do not.
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
        """Seconds to wait for lost motion or pictures: longer if the vehicle keeps its place and does not drift."""
        return self._keys.hold if now.holds else self._keys.wait

    def is_too_weak(self, now: Situation, state: FlightState, left: float) -> bool:
        """True if the motion has been degraded for too long for a state (before HOLD, if it holds).

        Near the ground it does not end a landing, as long as the autopilot holds its place; `left`: m above that.
        """
        if state is FlightState.COMMIT and now.holds and is_near_ground(left, self._keys):
            return False
        return state in NEAR_A_PLACE and now.t - self._sound_at >= self._keys.degraded
