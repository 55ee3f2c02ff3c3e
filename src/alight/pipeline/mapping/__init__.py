"""Mapping lane: exposures with their motion in, the map out.

The package has two lanes behind one interface: recursive (in flight), and batch at the end (recordings, photos).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from alight.arrays import F64
from alight.pipeline.mapping.keyframes import looking_down
from alight.pipeline.navigation import Navigation, Trajectory
from alight.pipeline.remembered import NOWHERE, Remembered
from alight.pipeline.timing import Progress
from alight.records import NOTHING_MISSING, ElevationMap, MissingVeto, View
from alight.records.map_frame import MapFrame

NO_HEIGHT = "no height could be measured: no place was seen by two views"


@dataclass(frozen=True, eq=False)
class MapSnapshot:
    """The map at one time with its views, immutable; all in the map frame."""

    elevation: ElevationMap
    views: tuple[View, ...]  # views that look down
    position: F64  # (3,) metres, position of the vehicle
    height_above_ground: float  # metres, height of the vehicle above ground
    frame: MapFrame
    attitude: bool = True  # whether an attitude was measured, or the poses are given
    passed: Remembered = NOWHERE  # cells that moving objects crossed
    came: Remembered = NOWHERE  # cells where a person or object recently came to stand
    whole: bool = False  # whether it is the map of a whole run

    @property
    def missing(self) -> MissingVeto:
        """Vetoes that could not be applied for want of data."""
        alone = MissingVeto.SECOND_CAMERA if len({v.cam for v in self.views}) < 2 else NOTHING_MISSING
        return alone if self.attitude else alone | MissingVeto.ATTITUDE


@dataclass(frozen=True, eq=False)
class FinishedMap:
    """The map of a whole recording, or the reason why there is none."""

    snapshot: MapSnapshot | None = None
    reason: str = ""
    warnings: tuple[str, ...] = ()
    notes: Mapping[str, object] = field(default_factory=dict)


class MappingLane(Protocol):
    """Interface to map the ground: keyframe selection, search of the ground, bounded memory."""

    def feed(self, navigation: Navigation, effort: int = 0) -> int:
        """Use one exposure; return the number of keyframes that the map was improved with.

        `effort` is the effort in flight, from 0 (full) to 3 (least). The caller decides it and records it in the
        schedule: the same exposures with the same efforts give the same bits.
        """

    def snapshot(self, about: F64 | None = None) -> MapSnapshot | None:
        """Return the present map under the newest keyframe; None if there is no map.

        `about`: (2,) metres in the map frame, a position that the map must also show, even if it was seen long ago.
        """

    def finish(self, trajectory: Trajectory, progress: Progress) -> FinishedMap:
        """Return the map of the whole recording."""


def map_at_end(
    elevation: ElevationMap, views: Sequence[View], trajectory: Trajectory, ground: float | None, frame: MapFrame
) -> MapSnapshot:
    """Build the snapshot at the end of a recording, with the vehicle's last position and median height above ground."""
    ups = [m.world_from_body.translation[2] for m in trajectory.usable.values()]
    above = float(np.median(ups) - frame.offset_world[2] - (ground or 0))
    last = trajectory.motions[-1].world_from_body.translation - frame.offset_world
    return MapSnapshot(elevation, tuple(looking_down(views)), last, above, frame, trajectory.attitude, whole=True)
