"""The navigation lane: events in, the motion of each exposure out, with the joint posterior of the keyframes.

There are two ways to find it behind one interface: the filter, and given poses. A caller may bring another: the bundle
adjustment of photos, whose motions all come at the end.
"""

from __future__ import annotations

from alight.pipeline.navigation.filter_lane import FilterLane, FrameBatch, Handover, TrackedFrame
from alight.pipeline.navigation.lane import MotionSource, Navigation, NavigationLane, TimedPoses, Trajectory
from alight.records import Rig, SettingsError
from alight.settings import StageSettings

__all__ = [
    "FilterLane", "FrameBatch", "Handover", "MotionSource", "Navigation", "NavigationLane", "TimedPoses",
    "TrackedFrame", "Trajectory", "navigation_lane",
]  # fmt: skip


def navigation_lane(
    rig: Rig, kind: str, settings: StageSettings, poses: TimedPoses | None, history: bool
) -> NavigationLane:
    """Choose the way to find the motion.

    Args:
        kind: `flight` (continuous) or `photos` (far apart).
        poses: body poses that replace the estimated ones.
        history: keep the data for the end of a recording.

    Raises:
        SettingsError: the settings ask for bundle adjustment, whose lane is the caller's.
    """
    if poses is not None:
        from alight.pipeline.navigation.given import GivenLane

        return GivenLane(rig, poses, settings.motion, history)
    if settings.motion.bundles(kind):
        raise SettingsError("motion.method: give the lane of the bundle adjustment as `navigation`, or use filter")
    return FilterLane(rig, settings, history, photos=kind == "photos")
