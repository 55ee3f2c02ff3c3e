"""The mapping lane: exposures with their motion in, the map out.

There are two ways behind one interface: recursive (flight), and in one batch at the end (recordings, photos).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from alight.arrays import F64
from alight.pipeline.map_frame import MapFrame
from alight.pipeline.mapping.keyframes import looking_down
from alight.pipeline.navigation import Navigation, Trajectory
from alight.pipeline.remembered import NOWHERE, Remembered
from alight.pipeline.timing import Progress
from alight.records import NOTHING_MISSING, ElevationMap, MissingVeto, View

NO_HEIGHT = "no height could be measured: no place was seen by two views"


@dataclass(frozen=True, eq=False)
class MapSnapshot:
    """The map at one moment, by value, with its views; all in the map's frame."""

    elevation: ElevationMap
    views: tuple[View, ...]  # that look down on it
    position: F64  # (3,) metres, of the vehicle
    height_above_ground: float  # metres, of the vehicle
    frame: MapFrame
    attitude: bool = True  # one was measured, or the poses are given
    passed: Remembered = NOWHERE  # places that something moved across before
    came: Remembered = NOWHERE  # places where somebody came to stand a moment ago

    @property
    def missing(self) -> MissingVeto:
        """Vetoes that could refuse ground and are missing."""
        alone = MissingVeto.SECOND_CAMERA if len({v.cam for v in self.views}) < 2 else NOTHING_MISSING
        return alone if self.attitude else alone | MissingVeto.ATTITUDE


@dataclass(frozen=True, eq=False)
class FinishedMap:
    """The map of a whole recording, or why there is none."""

    snapshot: MapSnapshot | None = None
    reason: str = ""
    warnings: tuple[str, ...] = ()
    notes: Mapping[str, object] = field(default_factory=dict)


class MappingLane(Protocol):
    """One way to map: choice of keyframes, search of the ground, forgetting."""

    def feed(self, navigation: Navigation, effort: int = 0) -> int:
        """Take one exposure; return the number of keyframes that the map was improved with.

        `effort`: level of the effort in flight, from 0 (full) to 3 (least). It is the caller's decision and belongs
        in the schedule: the same exposures with the same efforts give the same bits.
        """

    def snapshot(self, about: F64 | None = None) -> MapSnapshot | None:
        """The map under the newest keyframe as it is now; None without one there.

        `about`: (2,) metres in the map's frame, a place that the map is to show too, even if it was seen long ago.
        """

    def finish(self, trajectory: Trajectory, progress: Progress) -> FinishedMap:
        """The map of the whole recording."""


def map_at_end(
    elevation: ElevationMap, views: Sequence[View], trajectory: Trajectory, ground: float | None, frame: MapFrame
) -> MapSnapshot:
    """The map at the end of a recording, with the vehicle's last place and its median height above ground."""
    ups = [m.world_from_body.translation[2] for m in trajectory.usable.values()]
    above = float(np.median(ups) - frame.offset_world[2] - (ground or 0))
    last = trajectory.motions[-1].world_from_body.translation - frame.offset_world
    return MapSnapshot(elevation, tuple(looking_down(views)), last, above, frame, trajectory.attitude)
