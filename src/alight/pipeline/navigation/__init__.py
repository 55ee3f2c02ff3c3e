"""Navigation lane: events in, the motion of each exposure out, with the joint posterior of the keyframes.

The package has two lanes behind one interface: the filter and given poses. A caller may pass another lane, such as the
bundle adjustment of photos, whose motions all come at the end.
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
from alight.pipeline.timing import Progress
from alight.records import Event, Frame, KeyframePosterior, Motion, MotionState, PhotoOutcome, Rig
from alight.records.map_frame import MapFrame

TimedPoses = tuple[NDArray[np.int64], list[Pose]]  # world_from_body


@dataclass(frozen=True, eq=False)
class Navigation:
    """One exposure with its motion, for the other lanes; immutable."""

    frame: Frame
    motion: Motion | None  # None: it comes at the end, with all motions (`Trajectory`)
    keyframes: Callable[[], KeyframePosterior] | None = None  # joint posterior after it; None: exact poses
    attitude: bool = True  # whether an attitude was measured so far, or the poses are given

    @cached_property
    def posterior(self) -> KeyframePosterior | None:
        """Joint posterior of the keyframes after this exposure; None: poses are exact.

        The mapping lane computes it at first use, as only keyframes of the map need it.
        """
        return None if self.keyframes is None else self.keyframes()


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Motions of a whole recording in the world, refined with all its data."""

    motions: tuple[Motion, ...]  # in order of time
    rig: Rig  # with the estimated lenses
    warnings: tuple[str, ...] = ()
    notes: Mapping[str, object] = field(default_factory=dict)
    joint: KeyframePosterior | None = None  # joint posterior of some or all poses; None: exact poses
    photos: tuple[PhotoOutcome, ...] = ()  # outcome of the tags of each photo
    attitude: bool = True  # whether an attitude was measured, or the poses are given
    points: F64 = field(default_factory=lambda: np.empty((0, 3)))  # (N, 3) metres, points of the bundle adjustment
    distrust: str = ""  # why all heights must be refused; empty: they are usable

    @property
    def usable(self) -> dict[int, Motion]:
        """Motions that are not lost, by time."""
        return {m.t_ns: m for m in self.motions if m.state is not MotionState.LOST}

    @property
    def place(self) -> MapFrame:
        """Common map frame of all motions, without offset; its covariance is their smallest position covariance."""
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
    """Return evenly spaced motions, a few hundred at most, to bound their joint covariance."""
    return tuple(motions[:: max(1, len(motions) // 240)])


class NavigationLane(Protocol):
    """Interface to estimate the motion: call `feed` with each event in the order of arrival, then `finish`."""

    def feed(self, event: Event) -> Navigation | None:
        """Process one event; return the `Navigation` of a usable exposure, else None."""

    def finish(self, progress: Progress) -> Trajectory:
        """Return all motions, refined together if possible."""
