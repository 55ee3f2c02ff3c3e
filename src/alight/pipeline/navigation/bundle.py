"""Bundle adjustment of all photos at the end."""

from __future__ import annotations

from alight.motion.bundle.adjust import adjust
from alight.motion.bundle.matching import colmap
from alight.pipeline.navigation.lane import Navigation, Progress, Trajectory
from alight.records import Event, Frame, NavSample, Rig
from alight.settings import BundleSettings


class BundleLane:
    """Keeps the photos; their motions come all at once."""

    def __init__(self, rig: Rig, settings: BundleSettings) -> None:
        colmap()  # missing? say so before the photos are read
        self._rig, self._settings = rig, settings
        self._frames: list[Frame] = []
        self._nav: list[NavSample | None] = []
        self._last: NavSample | None = None

    def feed(self, event: Event) -> Navigation | None:
        """Keep the photo and the navigation sample of its time; the motion comes at the end."""
        if isinstance(event, NavSample):
            self._last = event
        elif isinstance(event, Frame):
            self._frames.append(event)
            self._nav.append(self._last if self._last is not None and self._last.t_ns == event.t_ns else None)
            return Navigation(event, None)
        return None

    def finish(self, progress: Progress) -> Trajectory:
        """Adjust; the photos that could not be registered are in the warnings."""
        found = adjust(self._frames, self._nav, self._rig, self._settings, progress)
        attitude = any(n is not None and n.world_from_body is not None for n in self._nav)
        motions = tuple(m for m in found.motions if m is not None)
        return Trajectory(
            motions, found.rig, tuple(found.warnings), dict(found.notes), found.joint, attitude, found.points_world
        )
