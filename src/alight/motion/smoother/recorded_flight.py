"""What the smoother takes: a recorded flight, as the filter saw it."""

from __future__ import annotations

from dataclasses import dataclass, field

from alight.arrays import F64
from alight.records import ImuSample, Motion, NavSample, Rig, Tracks
from alight.settings import FilterSettings

LEAST_EXPOSURES = 3  # of a flight that is smoothed


@dataclass(eq=False)
class RecordedFlight:
    """Input of the filter during a flight, and its motions."""

    rig: Rig
    settings: FilterSettings
    imu: list[ImuSample] = field(default_factory=list)
    nav: list[NavSample] = field(default_factory=list)
    exposures: list[tuple[Motion, Tracks, F64]] = field(default_factory=list)  # motion, tracks, core of the state
