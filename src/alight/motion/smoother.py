from __future__ import annotations
from dataclasses import dataclass, field
from alight.records import F64, ImuSample, Motion, NavSample, Rig, Tracks
from alight.settings import Filter


@dataclass(eq=False)
class Recording:
    rig: Rig
    settings: Filter
    imu: list[ImuSample] = field(default_factory=list)
    nav: list[NavSample] = field(default_factory=list)
    exposures: list[tuple[Motion, Tracks, F64]] = field(default_factory=list)


def smooth(recording: Recording) -> list[Motion]:
    return [m for m, _, _ in recording.exposures]
