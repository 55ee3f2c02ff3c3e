"""Mapping of recordings and photos: keyframes are stored and matched together at the end."""

from __future__ import annotations

import logging

from alight.arrays import F64
from alight.elevation import TileStore
from alight.geometry import Grid
from alight.jobs import Jobs
from alight.pipeline.mapping import NO_HEIGHT, FinishedMap, MapSnapshot, vehicle_at_end
from alight.pipeline.mapping.batch_map import BatchMap
from alight.pipeline.mapping.keyframes import FrameStore, in_world, is_keyframe, views_of, with_motions
from alight.pipeline.mapping.view_geometry import bounds, looking_down
from alight.pipeline.navigation import Navigation, Trajectory
from alight.pipeline.timing import Progress, Timings
from alight.records import MotionState, PriorHeights, Rig
from alight.settings import StageSettings

log = logging.getLogger(__name__)


class BatchMapper:
    """Batch mapper: it keeps keyframes by their baseline and maps at the end; a full store is mapped in part before."""

    def __init__(
        self,
        rig: Rig,
        settings: StageSettings,
        tile_store: TileStore | None,
        timings: Timings,
        jobs: Jobs,
        prior: PriorHeights | None = None,
    ) -> None:
        self._rig, self._settings, self._timings = rig, settings, timings
        self._map = BatchMap(settings, tile_store, jobs=jobs, prior=prior)
        self.store = FrameStore()

    def feed(self, navigation: Navigation, effort: int = 0) -> int:
        """Keep the exposure if it is a keyframe; the map comes at the end, with all effort."""
        motion = navigation.motion
        if motion is None or motion.state is MotionState.LOST:
            return 0
        ground, tuning = self._map.ground, self._settings.mapping
        if is_keyframe(motion, self.store.last, ground, tuning.first_step, self._settings):
            self.store.keep(navigation.frame, motion)
            if ground is None and self.store.taken % tuning.find_every == 0:
                self._map.find_ground(views_of(self.store.keyframes, self._rig))
        if self.store.bytes > self._settings.parallax.store_mb * 1_000_000:
            self._make_room()
        return 0

    def snapshot(self, about: F64 | None = None) -> MapSnapshot | None:
        """None: there is a map at the end only."""
        return None

    def _make_room(self) -> None:
        """Match every tile that the older half of the store sees, then forget that half: memory is bounded.

        Tiles that the newer half sees as well are matched again later, and the better height of each cell stays.
        Before the ground is found, every second keyframe is forgotten instead.
        """
        keyframes, half = in_world(self.store.keyframes), len(self.store) // 2  # as at the end: the map is one
        views, older = views_of(keyframes, self._rig), looking_down(views_of(keyframes[:half], self._rig))
        if not self._map.find_ground(views) and self._map.ground is None:
            self.store.thin()
            log.warning("frame store full: %s; every second keyframe is forgotten", self._map.reason)
            return
        if older:
            low, high = bounds(older, self._map.ground_under(older))

            def leaving(grid: Grid) -> bool:
                e, n = grid.xy()
                return bool(e[-1] >= low[0] and e[0] <= high[0] and n[0] >= low[1] and n[-1] <= high[1])

            self._map.match_tiles(views, lambda _: None, leaving)
        self.store.drop_oldest(half)
        log.info("frame store full: the older half was mapped and forgotten")

    def finish(self, trajectory: Trajectory, progress: Progress) -> FinishedMap:
        """Match all tiles with the poses of the whole recording."""
        views = views_of(with_motions(self.store.keyframes, trajectory.usable), trajectory.rig)
        with self._timings.of("ground"):
            found = self._map.find_ground(views, points=trajectory.points)
        if not found and self._map.elevation is None:
            return FinishedMap(reason=self._map.reason)
        with self._timings.of("heights"):
            self._map.match_tiles(views, progress)
        with self._timings.of("map"):
            elevation = self._map.snapshot(trajectory.joint)
        if elevation is None:
            return FinishedMap(reason=NO_HEIGHT)
        frame = trajectory.place
        vehicle = vehicle_at_end(trajectory, self._map.ground, frame)
        seen = MapSnapshot(elevation, tuple(looking_down(views)), vehicle, frame, trajectory.attitude)
        compared = self._map.against_prior()
        return FinishedMap(seen, notes={"prior_dem": compared.line} if compared else {})


class PhotoMapper(BatchMapper):
    """Batch mapper of photos, whose motions all come at the end: every photo is kept."""

    def feed(self, navigation: Navigation, effort: int = 0) -> int:
        """Keep the photo."""
        self.store.keep(navigation.frame)
        return 0
