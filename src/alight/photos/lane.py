"""Bundle adjustment of all photos at the end."""

from __future__ import annotations

from typing import cast

from alight.jobs import Jobs, Task
from alight.photos.bundle.adjust import adjust
from alight.photos.bundle.features import colmap
from alight.pipeline.navigation import Navigation, Trajectory
from alight.pipeline.timing import Progress
from alight.records import Event, Frame, NavSample, Rig
from alight.settings import BundleSettings


class BundleLane:
    """Lane that keeps the photos; their motions come all at once.

    Args:
        jobs: finds features and matches pairs.
    """

    def __init__(self, rig: Rig, settings: BundleSettings, jobs: Jobs) -> None:
        colmap()  # if it is missing, fail before the photos are read
        self._rig, self._settings, self._jobs = rig, settings, jobs
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
        of = " ".join(str(f.t_ns) for f in self._frames)
        arguments = self._frames, self._nav, self._rig, self._settings, progress, self._jobs
        (found,) = self._jobs.run([Task("motion", adjust, arguments, of, here=True)])
        return cast(Trajectory, found)
