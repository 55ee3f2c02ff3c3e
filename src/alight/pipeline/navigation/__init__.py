"""The navigation lane: events in, the motion of each exposure out, with the joint posterior of the keyframes.

There are three ways to find it behind one interface: the filter, given poses, bundle adjustment of photos.
"""

from __future__ import annotations

from alight.jobs import Jobs
from alight.photos.lane import BundleLane
from alight.pipeline.navigation.filter_lane import FilterLane, FrameBatch, Handover, TrackedFrame
from alight.pipeline.navigation.given import GivenLane
from alight.pipeline.navigation.lane import MotionSource, Navigation, NavigationLane, TimedPoses, Trajectory
from alight.records import Rig
from alight.settings import StageSettings

__all__ = [
    "FilterLane", "FrameBatch", "GivenLane", "Handover", "MotionSource", "Navigation", "NavigationLane", "TimedPoses",
    "TrackedFrame", "Trajectory", "all_at_end", "navigation_lane",
]  # fmt: skip


def all_at_end(kind: str, settings: StageSettings, poses: TimedPoses | None) -> bool:
    """True if the motions of a recording come all at once, at its end."""
    method = settings.motion.method
    return poses is None and (method == "bundle" or (method == "auto" and kind == "photos"))


def navigation_lane(
    rig: Rig, kind: str, settings: StageSettings, poses: TimedPoses | None, history: bool, jobs: Jobs
) -> NavigationLane:
    """Choose the way to find the motion.

    Args:
        kind: `flight` (continuous) or `photos` (far apart).
        poses: body poses that replace the estimated ones.
        history: keep the data for the end of a recording.
        jobs: finds features and matches pairs of photos.
    """
    if poses is not None:
        return GivenLane(rig, poses, settings.motion, history)
    if all_at_end(kind, settings, poses):
        return BundleLane(rig, settings.motion.bundle, jobs)
    return FilterLane(rig, settings, history, photos=kind == "photos")
