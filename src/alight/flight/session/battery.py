"""The battery as the executive is to know it: silence about it is no full battery."""

from __future__ import annotations

import math

from alight.records import Telemetry

SILENT = 20.0  # s without a report, after which a battery that was reported counts as not known


class BatteryWatch:
    """The last reported share of the battery."""

    def __init__(self) -> None:
        self._share, self._at = math.nan, math.inf  # and s, when it was reported

    def share(self, heard: Telemetry, now: float) -> float:
        """Return the share, 0 to 1; 1: it was never reported; NaN: it was, and is not any more.

        Args:
            heard: the newest telemetry.
            now: s of a steady clock.
        """
        age = heard.ages.get("SYS_STATUS", math.inf)
        if not math.isnan(heard.battery.share) and age < SILENT:
            self._share, self._at = heard.battery.share, now - age
        if math.isnan(self._share):
            return 1.0
        return self._share if now - self._at < SILENT else math.nan
