"""The limits of wind, battery and time, of waiting, and of degraded motion."""

from __future__ import annotations

import math
from collections.abc import Iterator

from alight.flight.executive.descent import is_near_ground
from alight.records.executive import FlightEvent, FlightState, Situation
from alight.settings import ExecutiveSettings


class AttemptLimits:
    """The limits of wind, battery and time; wind and battery count after some time beyond their limits."""

    def __init__(self, keys: ExecutiveSettings) -> None:
        self._keys = keys
        self._since: dict[FlightEvent, float] = {}  # s, when each was first beyond its limit

    def exceeded(self, now: Situation, begun: float | None) -> tuple[FlightEvent, str] | None:
        """The limit that is exceeded, with its numbers in words; None: none is. Call it at every tick.

        Args:
            now: wind and battery; a gust and a short dip of the voltage do not count.
            begun: s, start of the landing; None: not yet.
        """
        beyond = dict(_beyond(now, begun, self._keys))
        self._since = {event: self._since.get(event, now.t) for event in beyond}
        for event, words in beyond.items():
            if event is FlightEvent.TIME or now.t - self._since[event] >= self._keys.lasting:
                return event, words
        return None


def _beyond(now: Situation, begun: float | None, keys: ExecutiveSettings) -> Iterator[tuple[FlightEvent, str]]:
    """The limits that are exceeded at this moment, with their numbers in words.

    Args:
        now: wind and battery.
        begun: s, start of the landing; None: not yet.
        keys: the limits.
    """
    if now.wind_speed > keys.most_wind:
        yield FlightEvent.WIND, f"{now.wind_speed:.1f} m/s, limit {keys.most_wind:.1f}"
    if math.isnan(now.battery):
        yield FlightEvent.BATTERY, "it is not reported any more"
    if now.battery < keys.least_battery:
        yield FlightEvent.BATTERY, f"{100 * now.battery:.0f} %, limit {100 * keys.least_battery:.0f}"
    if begun is not None and now.t - begun > keys.time_budget:
        yield FlightEvent.TIME, f"{keys.time_budget:.0f} s"


class Recovery:
    """Time for which motion and pictures have been there again: a hold does not end at a flicker of them."""

    def __init__(self, keys: ExecutiveSettings) -> None:
        self._keys, self._missing_at = keys, -math.inf

    def missing(self, t: float) -> None:
        """Note that something is missing, at a time in seconds."""
        self._missing_at = t

    def over(self, t: float) -> bool:
        """True if nothing has been missing for `executive.recovered` seconds."""
        return t - self._missing_at >= self._keys.recovered


def patience(now: Situation, keys: ExecutiveSettings) -> float:
    """Seconds to wait for lost motion or pictures: longer if the vehicle keeps its place and does not drift."""
    return keys.hold if now.holds else keys.wait


def held_enough(
    now: Situation, since: float, over: tuple[FlightEvent, str] | None, keys: ExecutiveSettings
) -> tuple[FlightEvent, str] | None:
    """Event and reason if a vehicle that holds is to wait no longer; None: it is to wait on.

    Args:
        now: `holds`: the autopilot keeps its place.
        since: s, start of HOLD.
        over: the limit that is exceeded.
        keys: the limits.
    """
    waited = now.t - since
    if waited > patience(now, keys):
        return FlightEvent.WAITED, f"for {waited:.0f} s"
    return over if now.holds else None


def is_too_weak(now: Situation, state: FlightState, degraded: float, left: float, keys: ExecutiveSettings) -> bool:
    """True if the motion has been degraded for too long for the present state.

    Near the ground it does not end a landing, as long as the autopilot holds its place.

    Args:
        now: `holds`: the autopilot holds its place.
        state: the present state, or that before HOLD.
        degraded: s, time for which the motion has been degraded.
        left: metres above the place.
        keys: the limits.
    """
    if state is FlightState.COMMIT and now.holds and is_near_ground(left, keys):
        return False
    near_a_place = (FlightState.LOOK, FlightState.DESCEND, FlightState.COMMIT)
    return state in near_a_place and degraded >= keys.degraded
