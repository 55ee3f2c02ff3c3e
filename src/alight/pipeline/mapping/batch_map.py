"""The map of a recording or of photos, built at the end: every tile is matched with all views that see it."""

from __future__ import annotations

import logging
from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from hashlib import blake2b
from typing import ClassVar

import numpy as np

from alight.arrays import F64
from alight.elevation.tiles import TileStore, bytes_a_cell
from alight.geometry import Grid
from alight.jobs import InTurn, Jobs, KeptHere, Sent, Task
from alight.parallax.batch import Images, MatchedBlock, match_tile
from alight.parallax.datum import Matched, with_datum
from alight.parallax.plane_sweep import ENOUGH
from alight.parallax.sparse_points import NO_POINTS, height_range
from alight.parallax.views import choose_views, ground_sampling, may_see
from alight.pipeline.mapping import NO_HEIGHT, FinishedMap, MapSnapshot, map_at_end
from alight.pipeline.mapping.ground_map import GroundMap, refuse_too_large
from alight.pipeline.mapping.keyframes import FrameStore, bounds, ground_in, is_keyframe, looking_down, views_of
from alight.pipeline.navigation import Navigation, Trajectory
from alight.pipeline.timing import Progress, Timings
from alight.records import (
    ElevationMap,
    KeyframePosterior,
    MotionState,
    Pixels,
    PriorComparison,
    PriorHeights,
    Rig,
    View,
)
from alight.records.map_frame import in_world
from alight.settings import ParallaxSettings, StageSettings
from alight.spread import nmad

log = logging.getLogger(__name__)

MARGIN = 24  # cells around a tile that are matched and discarded, to avoid seams
BLOCK = 2  # side of a block, tiles: a larger block has a smaller share of margin
SHARE = 0.5  # largest side of a block over the shorter side of the pictures
PRIOR_EVERY, PRIOR_SIGMAS = 8, 3.0  # stride in cells; sigmas of the prior's error that the search allows for


@dataclass(frozen=True, eq=False)
class TileBlock:
    """Grid that is matched at once, with its views."""

    grid: Grid
    searched: tuple[float, float]  # lowest and highest height searched, metres
    views: list[View]
    grounds: F64  # (N,) metres, ground height in each view
    above: float  # metres, median height above ground of the views


def match_block(
    images: Images,
    views: Sequence[View],
    pixels: Sequence[Pixels],
    grounds: F64,
    grid: Grid,
    searched: tuple[float, float],
    settings: ParallaxSettings,
) -> MatchedBlock | None:
    """Match one grid with views whose pixels are passed separately; None if fewer than two views see it.

    `images`: store of prepared views. `pixels`: one picture per view. `grounds`: (N,) ground height per view, metres.
    `searched`: lowest and highest height, metres.
    """
    whole = [replace(v, image=p) for v, p in zip(views, pixels, strict=True)]
    return match_tile(images.of(whole, grounds), grid, *searched, settings)


def _near_before_far(tile: tuple[int, int]) -> list[tuple[int, int]]:
    """Return the sort key of a tile (row, column) on a Z-order curve (Morton 1966), which keeps shared views close."""
    return [(tile[0] >> k, tile[1] >> k) for k in range(16, -1, -1)]


@dataclass(eq=False)
class BatchMap(GroundMap):
    """Batch parallax, tile by tile, coarse cells before fine ones."""

    by_quality: ClassVar[bool] = True

    jobs: Jobs = field(default_factory=InTurn)
    prior: PriorHeights | None = None  # external DEM that narrows the height search
    _matched: list[Matched] = field(default_factory=list)  # matched tiles with their views
    _grounds: dict[Hashable, float] = field(default_factory=dict)  # ground height by the key of a view, metres
    _step: int = 0  # number of matching rounds

    def match_tiles(
        self, views: Sequence[View], progress: Progress, only: Callable[[Grid], bool] = lambda _: True
    ) -> int:
        """Match all tiles under `views` that `only` accepts, level by level; return the number of matched tiles."""
        views = looking_down(views)
        if self.elevation is None or self.ground is None or not views:
            return 0
        levels = list(self.levels(views))
        return sum(
            self._match(level, asking, beside, only, lambda f, n=n: progress((n + f) / len(levels)))  # type: ignore[misc]
            for n, (level, asking, beside) in enumerate(levels)
        )

    def find_ground(self, views: Sequence[View], least: float = 0.0, points: F64 = NO_POINTS) -> bool:
        """Find the ground (see `GroundMap`); ground heights in views are then computed from the new points."""
        self._grounds.clear()
        return super().find_ground(views, least, points)

    def ground_under(self, views: Sequence[View]) -> F64:
        """Return the ground height in each view, (N,) metres, from the points in its picture, or from all points."""
        assert self.ground is not None
        points = self.points[:: -(-len(self.points) // 2000) or 1]  # at most 2000 points
        for v in views:
            if v.key not in self._grounds:
                self._grounds[v.key] = ground_in(v, points, self.ground)
        return np.array([self._grounds[v.key] for v in views])

    def levels(self, views: Sequence[View]) -> Iterator[tuple[int, list[View], list[View]]]:
        """Yield the levels, coarse to fine: number, views of the level, and views of it and its neighbours."""
        level, of = 0, []
        for v, ground in zip(views, self.ground_under(views).tolist(), strict=True):
            level = self.level_of(v, ground, level)
            of.append(level)
        for k in sorted(set(of), reverse=True):
            asking = [v for v, its in zip(views, of, strict=True) if its == k]
            yield k, asking, [v for v, its in zip(views, of, strict=True) if abs(its - k) <= 1]

    def _match(
        self, level: int, asking: list[View], views: list[View], only: Callable[[Grid], bool], progress: Progress
    ) -> int:
        assert self.elevation is not None
        assert self.ground is not None
        low, high = bounds(asking, self.ground_under(asking))
        refuse_too_large(low, high, self.elevation.cell_at(level), bytes_a_cell())
        grids = [g for g in self.tile_grids(asking, low, high, level) if only(g)]
        self._step += 1
        images = KeptHere(f"images-{self._step}", partial(Images, [], self.elevation.cell_at(level), self.ground))
        seen = [self.block_of(grid, asking, views) for grid in grids]
        done = 0
        matched = self.jobs.run((self._task(images, b) for b in seen), at_once=True)
        for n, (block, found) in enumerate(zip(seen, matched, strict=True)):
            if found is not None:
                rows, cols = (slice(MARGIN, n - MARGIN) for n in block.grid.shape)
                heights = self._without_doubtful(found.heights, block.above).part((rows, cols))
                self.elevation.add(heights)
                self._matched.append(Matched.of(heights.grid, [block.views[k] for k in found.chosen.tolist()]))
                self.elevation.roll((block.grid.east, block.grid.north), 3 * heights.grid.cell * block.grid.cols)
                done += 1
            progress((n + 1) / len(seen))
        return done

    def searched_heights(
        self, grid: Grid, camera: float, known: ElevationMap | None = None, part: bool = False
    ) -> tuple[float, float]:
        """Return the lowest and highest height to search; see `GroundMap`. The heights of a prior are used as well."""
        low, high = super().searched_heights(grid, camera, known, part)
        if self.prior is None or self.settings.parallax.height_range:
            return low, high
        heights = self.prior.over(grid.coarser(PRIOR_EVERY))
        heights = heights[np.isfinite(heights)]
        offset, spread = self._above_prior()
        if not len(heights) or not np.isfinite(offset):
            return low, high
        heights += offset
        below, above = height_range(np.column_stack([heights, heights, heights]), camera)
        below, above = below - PRIOR_SIGMAS * spread, above + PRIOR_SIGMAS * spread
        if not self._enough_points(grid):
            return below, above
        return min(low, below), max(high, above)

    def _enough_points(self, grid: Grid) -> bool:
        wide, tall = grid.cell * grid.cols, grid.cell * grid.rows
        away = np.hypot(self.points[:, 0] - grid.east - 0.5 * wide, self.points[:, 1] - grid.north + 0.5 * tall)
        return int((away < 0.5 * max(wide, tall)).sum()) >= ENOUGH

    def _above_prior(self) -> tuple[float, float]:
        """Return median and NMAD of the points' heights above the prior, metres; NaN if there are too few points."""
        assert self.prior is not None
        off = self.points[:, 2] - self.prior.at(self.points[:, 0], self.points[:, 1])
        off = off[np.isfinite(off)]
        return (float(np.median(off)), nmad(off)) if len(off) >= ENOUGH else (np.nan, np.nan)

    def against_prior(self) -> PriorComparison | None:
        """Compare the trusted heights of the map with the prior; None if they do not overlap enough."""
        if self.prior is None or (found := self.snapshot()) is None:
            return None
        off = (found.height - self.prior.over(found.grid))[found.trusted]
        off = off[np.isfinite(off)]
        if len(off) < ENOUGH:
            return None
        return PriorComparison(self.prior.name, float(np.median(off)), nmad(off), len(off) * found.grid.cell**2)

    def block_of(self, grid: Grid, asking: list[View], views: Sequence[View]) -> TileBlock:
        """Return the block of a grid with the `views` chosen for it, and all other `views` of the same exposures.

        `asking`: the views whose level has the grid's cell size.
        """
        camera, above = self._over(grid, asking)
        searched, s = self.searched_heights(grid, camera), self.settings.parallax
        middle = 0.5 * (searched[0] + searched[1])
        near = [views[k] for k in may_see(views, grid, middle, middle)]
        at = {near[k].t_ns for k in choose_views(near, grid, middle, s.views, s.sweep.max_tangent)}
        seen = [v for v in views if v.t_ns in at]
        return TileBlock(grid, searched, seen, self.ground_under(seen), above)

    def _over(self, grid: Grid, views: list[View]) -> tuple[float, float]:
        """Return median camera height and median height above ground, metres, of those `views` that may see a grid."""
        up, ground = np.array([v.centre[2] for v in views]), self.ground_under(views)
        here = may_see(views, grid, *super().searched_heights(grid, float(np.median(up)))) or slice(None)
        return float(np.median(up[here])), float(np.median((up - ground)[here]))

    def _task(self, images: KeptHere, block: TileBlock) -> Task:
        """Build the task to match a block with the store `images`; pixels are sent apart, for neighbours to share."""
        place = f"{round(block.grid.north / block.grid.cell)}_{round(block.grid.east / block.grid.cell)}"
        pixels = tuple(Sent(f"photo-{v.t_ns}-{v.cam}", v.image) for v in block.views)
        views = tuple(v.without_image for v in block.views)
        about = blake2b(repr((block.grid, block.searched, block.grounds.tolist())).encode())
        for v in views:
            about.update(repr(v.key).encode())
        arguments = images, views, pixels, block.grounds, block.grid, block.searched, self.settings.parallax
        return Task(f"tile-{self._step}-{place}", match_block, arguments, about.hexdigest())

    def tile_grids(self, asking: list[View], low: F64, high: F64, level: int) -> list[Grid]:
        """Return grids of `level` to match, with margins: blocks of tiles, or single tiles for small pictures.

        `asking`: views of that level. `low`, `high`: (2,) metres, south-west and north-east corner.
        """
        assert self.elevation is not None
        layer = self.elevation.layer(level)
        keys = list(layer.cover((low[0], high[0]), (low[1], high[1])))
        tile = layer.tile_grid(keys[0])
        pixels = map(ground_sampling, asking, self.ground_under(asking).tolist())
        side = np.median([min(v.camera.width, v.camera.height) * p for v, p in zip(asking, pixels, strict=True)])
        block = BLOCK if BLOCK * tile.rows * tile.cell <= SHARE * side else 1
        size = block * tile.rows + 2 * MARGIN
        out = []
        for row, col in sorted({(block * (r // block), block * (c // block)) for r, c in keys}, key=_near_before_far):
            corner = layer.tile_grid((row + block - 1, col), MARGIN)
            out.append(corner.window(0, 0, size, size))
        return out

    def snapshot(self, joint: KeyframePosterior | None = None) -> ElevationMap | None:
        """Return the whole map so far, with its datum from the joint posterior of the poses; None: exact poses."""
        found = super().snapshot()
        return found if found is None or joint is None else with_datum(found, self._matched, joint)


class BatchMapper:
    """Mapping lane that keeps keyframes and maps them at the end; if its store fills up earlier, half of them then."""

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
        """Keep the exposure if it is a keyframe, as every photo is; return 0, as the map is built at the end."""
        motion = navigation.motion
        if motion is None:  # photos: motions come at the end
            self.store.keep(navigation.frame)
            return 0
        if motion.state is MotionState.LOST:
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
        """Return None: there is a map only at the end."""
        return None

    def _make_room(self) -> None:
        """Match every tile that the older half of the store sees, then drop that half, so that memory is bounded.

        Tiles that the newer half sees as well are matched again later, and each cell keeps its better height. Before
        the ground is found, every second keyframe is dropped instead.
        """
        keyframes, half = self.store.keyframes, len(self.store.keyframes) // 2
        motions = {m.t_ns: m for m in in_world(k.motion for k in keyframes if k.motion is not None)}  # as at the end
        views, older = (views_of(some, self._rig, motions) for some in (keyframes, keyframes[:half]))
        older = looking_down(older)
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
        del self.store.keyframes[:half]
        log.info("frame store full: the older half was mapped and forgotten")

    def finish(self, trajectory: Trajectory, progress: Progress) -> FinishedMap:
        """Match all tiles with the poses of the whole recording; return the map."""
        motions = trajectory.usable
        views = views_of((k for k in self.store.keyframes if k.frame.t_ns in motions), trajectory.rig, motions)
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
        seen = map_at_end(elevation, views, trajectory, self._map.ground, trajectory.place)
        compared = self._map.against_prior()
        return FinishedMap(seen, notes={"prior_dem": compared.line} if compared else {})
