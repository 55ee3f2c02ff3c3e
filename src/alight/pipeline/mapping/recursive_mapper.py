"""Mapping in flight: the map is improved with every keyframe, and may be judged at any time."""

from __future__ import annotations

import logging
from collections.abc import Collection, Sequence

import numpy as np

from alight.arrays import F64
from alight.elevation import TileStore
from alight.pipeline.map_frame import MapFrame, Tie
from alight.pipeline.mapping import NO_HEIGHT, FinishedMap, MapSnapshot, VehiclePosition, vehicle_at_end
from alight.pipeline.mapping.keyframes import FrameStore, Keyframe, is_keyframe, views_of
from alight.pipeline.mapping.recursive_map import RecursiveMap
from alight.pipeline.mapping.view_geometry import looking_down
from alight.pipeline.navigation import Navigation, Trajectory
from alight.pipeline.timing import Progress, Timings
from alight.records import ElevationMap, KeyframePosterior, Motion, MotionState, Rig, View
from alight.settings import StageSettings

log = logging.getLogger(__name__)


class RecursiveMapper:
    """Recursive mapper: it finds the ground first; then every keyframe is a step of the map.

    Args:
        history: keep the data for the end of a recording.
        anew: stamps of the exposures before which it begins anew, as where it was lost in flight.
    """

    def __init__(
        self, rig: Rig, settings: StageSettings, tile_store: TileStore | None, timings: Timings, history: bool,
        anew: Collection[int] = (),
    ) -> None:  # fmt: skip
        self._rig, self._settings, self._tuning, self._timings = rig, settings, settings.mapping, timings
        self._tile_store, self._anew = tile_store, frozenset(anew)
        self._most = settings.mapping.kept_to_look if history else settings.mapping.kept_by_ring
        self._begin()

    def _begin(self) -> None:
        self._map = RecursiveMap(self._settings, self._tile_store)
        self.store, self._first_step = FrameStore(), self._tuning.first_step
        self._newest: Navigation | None = None  # keyframe
        self._frame: MapFrame | None = None  # of the map, by the newest exposure
        self._newest_ns = -(1 << 62)  # exposure
        self._warnings: list[str] = []

    def feed(self, navigation: Navigation, effort: int = 0) -> int:
        """Keep the exposure if it is a keyframe, and improve the map with it."""
        if navigation.frame.t_ns in self._anew:
            self._begin()
        motion = navigation.motion
        if motion is None or motion.state is MotionState.LOST:
            return 0
        if not self._follows(MapFrame.of(motion), motion.t_ns):
            return 0
        if not is_keyframe(motion, self.store.last, self._map.ground_height, self._first_step, self._settings):
            return 0
        self.store.keep(navigation.frame, motion)
        self._newest = navigation
        steps = self._grow(navigation, effort)
        self.store.drop_oldest(max(0, len(self.store) - self._most))
        while self.store.bytes > self._settings.parallax.store_mb * 1_000_000:
            self.store.drop_oldest(1)
        return steps

    def _follows(self, frame: MapFrame, t_ns: int) -> bool:
        """Adopt the frame of the newest exposure, and drop the map if that is another frame.

        False for an exposure that is out of sequence and belongs to another frame: it has no place in the map.
        """
        if self._frame is not None and frame.frame_id != self._frame.frame_id:
            if t_ns < self._newest_ns:
                return False
            self._drop_map(frame.frame_id, self._frame.tie(frame))
        self._frame, self._newest_ns = frame, max(t_ns, self._newest_ns)
        return True

    def _drop_map(self, frame_id: int, tie: Tie) -> None:
        self.store.clear()
        self._newest = None
        if self._map.begin_anew(tie.shift, tie.sigma_horizontal):
            warning = (
                f"map: the motion began anew (frame {frame_id}), and the map of before is dropped: its place in the "
                f"new frame is known to {tie.sigma_horizontal:.2f} m only"
            )
            log.warning(warning)
            self._warnings.append(warning)

    def _grow(self, navigation: Navigation, effort: int) -> int:
        """Find the ground, or take the newest keyframe into the map; return the number of steps."""
        due = self.store.taken % self._tuning.find_every == 0
        if self._map.ground is not None:
            steps = self._advance(self.store.keyframes[-1:], navigation, effort)
            if self._map.out_of_range and due:
                self._map.find_ground_again(self._views_now(), self._tuning.find_baseline)
            return steps
        if due and self._map.find_ground(self._views_now(), self._tuning.find_baseline):
            return self._advance(self.store.keyframes, navigation, effort)
        if len(self.store) >= self._tuning.kept_by_ring:  # the height is not known, nor is the needed baseline
            self.store.thin()
            self._first_step *= 2
        return 0

    def _advance(self, keyframes: Sequence[Keyframe], navigation: Navigation, effort: int) -> int:
        steps = 0
        for k in keyframes:
            assert k.motion is not None
            with self._timings.of("heights"):
                poses = _posterior_with(k.motion, navigation.posterior)
                steps += self._map.step(views_of([k], self._rig), poses, effort)
        return steps

    def _views_now(self, most: int | None = None) -> list[View]:
        """The newest keyframes as views, with the newest estimates of their poses."""
        known = self._newest.posterior if self._newest is not None else None
        newer = {m.t_ns: m for m in known.motions} if known is not None else None
        return views_of(self.store.keyframes[-(most or self._tuning.kept_by_ring) :], self._rig, newer)

    def snapshot(self, about: F64 | None = None) -> MapSnapshot | None:
        """The map under the newest keyframe, and about a place, as it is now; None without one there."""
        views = looking_down(self._views_now())
        elevation = self._map.under(views[-len(self._rig.cameras) :], about)
        if elevation is None or self._frame is None:
            return None
        centre = views[-1].centre
        vehicle = VehiclePosition(centre, float(centre[2] - (self._map.ground_height or 0.0)))
        return self._snapshot(elevation, views, vehicle, self._newest is None or self._newest.attitude)

    def _snapshot(
        self, elevation: ElevationMap, views: list[View], vehicle: VehiclePosition, attitude: bool
    ) -> MapSnapshot:
        assert self._frame is not None
        return MapSnapshot(elevation, tuple(views), vehicle, self._frame, attitude, self._map.passed, self._map.came)

    def finish(self, trajectory: Trajectory, progress: Progress) -> FinishedMap:
        """The map as the last keyframe left it; that of all keyframes where they end before the ground is found."""
        views = self._views_now(self._most)
        if self._map.elevation is None:
            with self._timings.of("ground"):
                found = self._map.find_ground(views)
            if not found or self._newest is None:
                return FinishedMap(None, self._map.reason, tuple(self._warnings))
            self._advance(self.store.keyframes, self._newest, 0)
        with self._timings.of("map"):
            elevation = self._map.snapshot()
        if elevation is None or self._frame is None:
            return FinishedMap(None, NO_HEIGHT, tuple(self._warnings))
        vehicle = vehicle_at_end(trajectory, self._map.ground, self._frame)
        seen = self._snapshot(elevation, looking_down(views), vehicle, trajectory.attitude)
        return FinishedMap(seen, warnings=tuple(self._warnings))


def _posterior_with(motion: Motion, posterior: KeyframePosterior | None) -> KeyframePosterior | None:
    """The posterior, or the motion by itself where it was a keyframe before the ground was found."""
    if posterior is None or motion.t_ns in {m.t_ns for m in posterior.motions}:
        return posterior
    return KeyframePosterior((motion,), np.asarray(motion.covariance))
