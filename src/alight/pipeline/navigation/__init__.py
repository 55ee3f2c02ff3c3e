"""The navigation lane: events in, the motion of each exposure out, with the joint posterior of the keyframes.

There are two ways to find it behind one interface: the filter, and given poses. A caller may bring another: the bundle
adjustment of photos, whose motions all come at the end.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from alight.arrays import F64
from alight.geometry import Pose
from alight.pipeline.map_frame import MapFrame
from alight.pipeline.timing import Progress
from alight.records import Event, Frame, KeyframePosterior, Motion, MotionState, PhotoOutcome, Rig

TimedPoses = tuple[NDArray[np.int64], list[Pose]]  # world_from_body


@dataclass(frozen=True, eq=False)
class Navigation:
    """One exposure with all data on its motion for the other lanes, by value."""

    frame: Frame
    motion: Motion | None  # None: it comes at the end, with all others (`TrueTrajectory`)
    keyframes: Callable[[], KeyframePosterior] | None = None  # joint posterior after it, by value; None: exact poses
    attitude: bool = True  # one was measured by now, or the poses are given

    @cached_property
    def posterior(self) -> KeyframePosterior | None:
        """Joint posterior of the keyframes after this exposure; None: poses are exact.

        It is computed at first use, by the lane that uses it: only keyframes of the map need it.
        """
        return None if self.keyframes is None else self.keyframes()


@dataclass(frozen=True, eq=False)
class Trajectory:
    """The motions of a whole recording in the world, refined with all its data."""

    motions: tuple[Motion, ...]  # in order of time
    rig: Rig  # with the lens as estimated
    warnings: tuple[str, ...] = ()
    notes: Mapping[str, object] = field(default_factory=dict)
    joint: KeyframePosterior | None = None  # joint posterior of some or all of the poses; None: they are exact
    photos: tuple[PhotoOutcome, ...] = ()  # outcome of the tags of each photo
    attitude: bool = True  # one was measured, or the poses are given
    points: F64 = field(default_factory=lambda: np.empty((0, 3)))  # (N, 3) metres, points of the adjustment
    distrust: str = ""  # why no height above ground may be used; empty: they may

    @property
    def usable(self) -> dict[int, Motion]:
        """The motions that are not lost, by time."""
        return {m.t_ns: m for m in self.motions if m.state is not MotionState.LOST}

    @property
    def place(self) -> MapFrame:
        """The place of all motions in the world: no offset is left; the smallest covariance is their common one."""
        best = min(self.usable.values(), key=lambda m: float(np.trace(m.covariance[:3, :3])))
        return MapFrame(self.motions[-1].frame_id, np.zeros(3), best.covariance[:3, :3])

    @property
    def reason(self) -> str:
        """Reason why there is no motion at all."""
        otherwise = (
            "there is no GPS/INS position with height to start from (nav0), none with an attitude and no way over "
            "which the pictures show it, or no picture could be placed"
        )
        return "no motion: " + (self.warnings[-1] if self.warnings else otherwise)


def sparse(motions: Sequence[Motion]) -> tuple[Motion, ...]:
    """Evenly spaced motions, few enough to bound their joint covariance; between them errors are interpolated."""
    return tuple(motions[:: max(1, len(motions) // 240)])


class NavigationLane(Protocol):
    """One way to find the motion. Feed it events in the order of arrival, `finish` at the end."""

    def feed(self, event: Event) -> Navigation | None:
        """Take one event; an exposure that can be used gives a `Navigation`."""

    def finish(self, progress: Progress) -> Trajectory:
        """All motions, refined together where that is possible."""
