"""The limits of wind, battery and time."""

from __future__ import annotations

from alight.records.executive import FlightEvent, Situation
from alight.settings import ExecutiveSettings


def exceeded(now: Situation, begun: float | None, keys: ExecutiveSettings) -> tuple[FlightEvent, str] | None:
    """The limit that is exceeded, with its numbers in words; None: none is.

    Args:
        now: wind and battery.
        begun: s, when the landing was; None: not yet.
        keys: the limits.
    """
    if now.wind_speed > keys.most_wind:
        return FlightEvent.WIND, f"{now.wind_speed:.1f} m/s, limit {keys.most_wind:.1f}"
    if now.battery < keys.least_battery:
        return FlightEvent.BATTERY, f"{100 * now.battery:.0f} %, limit {100 * keys.least_battery:.0f}"
    if begun is not None and now.t - begun > keys.time_budget:
        return FlightEvent.TIME, f"{keys.time_budget:.0f} s"
    return None
