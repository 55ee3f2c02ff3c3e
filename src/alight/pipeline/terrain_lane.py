"""The terrain lane: views -> heights, tile by tile or keyframe by keyframe -> one map."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from alight.elevation import FIELDS, TiledElevation, TileStore
from alight.geometry import Grid
from alight.parallax import Images, RecursiveParallax, find_points, ground_sampling, height_range, match_tile
from alight.records import F64, Datum, ElevationMap, Flag, Heights, KeyframePosterior, View, is_trusted
from alight.settings import Settings

MAX_SIGMA = 0.0065  # of the height: of those with this sigma one in thirteen is off by more than a hundredth
MARGIN = 24  # cells about a tile that are matched with it and thrown away: no seams
STEEPEST = np.cos(np.radians(75.0))  # views flatter than this to the ground are not used
LEAST_POINTS = 20
NEAR_TILES = 3  # tiles about the one being matched that stay unpacked
CELL_OVER_PIXEL = 1.8
SLACK = 0.15  # octaves that the cell may be off beyond the half before it changes: a level is not left by a gust
MOST_POINTS = 20_000  # that say where the ground is
LEAST_HEIGHT = 1.0  # metres above the ground: nearer, the map is not what is needed
BEYOND = 0.3  # share of a step's cells at an end of the range that asks for another
LEAST_KNOWN = 400  # heights of the map that say it better
# a height is given out among others that are: of those that are left where most are refused one in five is wrong
LEAST_GIVEN = 0.25  # of the cells about it
ABOUT = 41  # cells
NICE = np.array([1.0, 1.5, 2.0, 3.0, 5.0, 7.0])

Progress = Callable[[float], None]


def nice_cell(sampling: float) -> float:
    """The round cell size nearest to 1.8 ground sampling distances, metres."""
    target = CELL_OVER_PIXEL * sampling
    decade = 10.0 ** np.floor(np.log10(target))
    sizes = np.concatenate([NICE * decade, [10.0 * decade]])
    return float(np.round(sizes[np.argmin(np.abs(np.log(sizes / target)))], 6))


def level_for(sampling: float, cell: float, now: int) -> int:
    """The level whose cells, `cell * 2**level` metres, suit a ground sampling distance: `now` while it will do."""
    exact = math.log2(CELL_OVER_PIXEL * sampling / cell)
    return now if abs(exact - now) <= 0.5 + SLACK else round(exact)


def looking_down(views: Sequence[View]) -> list[View]:
    """The views whose optical axis is at most 75 degrees from straight down."""
    return [v for v in views if -v.world_from_cam.rotation[2, 2] > STEEPEST]


def core(heights: Heights, margin: int) -> Heights:
    """The heights without their margin."""
    inner = slice(margin, -margin)
    grid = heights.grid.window(margin, margin, heights.grid.rows - 2 * margin, heights.grid.cols - 2 * margin)
    return replace(heights, grid=grid, **{f: np.ascontiguousarray(getattr(heights, f)[inner, inner]) for f in FIELDS})  # type: ignore[arg-type]


def footprint(view: View, height: float) -> NDArray[np.float64]:
    """Where the image's border meets level ground at `height`, (N, 2) metres; rays end at 75 degrees from down."""
    w, h = view.camera.width - 1.0, view.camera.height - 1.0
    border = np.array([[0, 0], [w / 2, 0], [w, 0], [w, h / 2], [w, h], [w / 2, h], [0, h], [0, h / 2]])
    rays = view.camera.rays(border)
    rays = rays @ view.world_from_cam.rotation.T
    down = np.maximum(-rays[:, 2], np.linalg.norm(rays, axis=1) * STEEPEST)
    return np.asarray(view.centre[:2] + rays[:, :2] * ((view.centre[2] - height) / down)[:, None])


def lone(given: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which of the heights that are given out, (R, C), have too few about them that are."""
    return np.asarray(given & (cv2.blur(given.astype(np.float32), (ABOUT, ABOUT)) < LEAST_GIVEN))


@dataclass(eq=False)
class TerrainLane:
    """Matches every tile that at least two views see, or steps the map with every keyframe."""

    settings: Settings
    far: TileStore | None = None  # where tiles go that the vehicle has left behind; None: memory
    elevation: TiledElevation | None = None
    ground: float | None = None  # metres above the origin, the ground in general
    below: float | None = None  # the same under the newest keyframe
    beyond: bool = False  # most of the newest step's heights lie at an end of the searched range
    reason: str = ""  # why there is no map
    gauge: Datum | None = None  # what all heights under the newest keyframe share
    _ring: RecursiveParallax | None = None
    _level: int = 0  # of the newest keyframe's cells
    _map: int | None = None  # the number of the poses that the ring holds
    _points: F64 = field(default_factory=lambda: np.empty((0, 3)))

    def learn(self, views: Sequence[View], least: float = 0.0) -> bool:
        """Find where the ground is and how fine the map shall be; False (see `reason`) when nothing can be measured.

        `least`: baseline over height that it takes; over a short one, poses that are not quite right yet decide.
        """
        down = looking_down(views)
        if len(down) < 2:
            self.reason = "no camera looks down: a site is sought below the aircraft, within 75 degrees of the vertical"
            return False
        points = find_points(down)
        below = points[points[:, 2] < min(v.centre[2] for v in down)]
        if len(below) < LEAST_POINTS:
            self.reason = (
                "no parallax: the aircraft did not move, or the ground has no texture, so no height can be measured"
            )
            return False
        centres = np.array([v.centre for v in down])
        if np.linalg.norm(np.ptp(centres, axis=0)) < least * (centres[-1, 2] - np.median(below[:, 2])):
            self.reason = "the aircraft hardly moved for its height, so no height can be measured"
            return False
        self._points = np.concatenate([self._points, below])
        self._points = self._points[:: -(-len(self._points) // MOST_POINTS)]
        self.ground = float(np.median(self._points[:, 2]))
        if self.elevation is None:
            sampling = float(np.median([ground_sampling(v, self.ground) for v in down]))
            cell = self.settings.parallax.cell or nice_cell(sampling)
            self.elevation = TiledElevation(cell, self.settings.elevation.tile, self.far)
        return True

    def learn_anew(self, views: Sequence[View], least: float) -> None:
        """Find the ground again where it lies beyond what was searched; what was found there is looked at anew."""
        known, self._points = self._points, np.empty((0, 3))
        if not self.learn(views, least):
            self._points = known
        elif self._ring is not None:
            self._ring.look_anew()
        self.beyond = False

    def _range(self, grid: Grid, camera: float, known: ElevationMap | None = None) -> tuple[float, float]:
        """Heights to search: what the map knows there already counts as points, beside those near it."""
        if self.settings.parallax.height_range:
            return self.settings.parallax.height_range
        wide, tall = grid.cell * grid.cols, grid.cell * grid.rows
        near = (grid.east + 0.5 * wide, grid.north - 0.5 * tall, 1.2 * max(wide, tall))
        low, high = height_range(self._points, camera, near)
        heights = np.empty(0) if known is None else known.height[known.trusted][::7].astype(np.float64)
        if len(heights) < LEAST_KNOWN:
            return low, high
        return height_range(np.column_stack([heights, heights, heights]), camera)

    def _levels(self, views: Sequence[View], ground: float) -> Iterator[tuple[int, list[View], list[View]]]:
        """Coarse to fine: a level, the views that ask for it, and with them those of the levels beside it."""
        assert self.elevation is not None
        level, of = 0, []
        for v in views:
            if self.settings.parallax.cell is None:
                level = level_for(ground_sampling(v, ground), self.elevation.cell, level)
            of.append(level)
        for k in sorted(set(of), reverse=True):
            asking = [v for v, its in zip(views, of, strict=True) if its == k]
            yield k, asking, [v for v, its in zip(views, of, strict=True) if abs(its - k) <= 1]

    def build(self, views: Sequence[View], progress: Progress, only: Callable[[Grid], bool] = lambda _: True) -> int:
        """Match all tiles under `views` for which `only` holds, at the cells that they ask for; return how many."""
        views = looking_down(views)
        if self.elevation is None or self.ground is None or not views:
            return 0
        levels = list(self._levels(views, self.ground))
        done = 0
        for n, (level, asking, beside) in enumerate(levels):
            done += self._match(level, asking, beside, only, lambda f, n=n: progress((n + f) / len(levels)))  # type: ignore[misc]
        return done

    def _match(
        self, level: int, asking: list[View], views: list[View], only: Callable[[Grid], bool], progress: Progress
    ) -> int:
        assert self.elevation is not None
        assert self.ground is not None
        images = Images(views, self.elevation.cell_at(level), self.ground)
        corners = np.concatenate([footprint(v, self.ground) for v in asking])
        (west, south), (east, north) = corners.min(axis=0), corners.max(axis=0)
        camera = float(np.median([v.centre[2] for v in asking]))
        keys = list(self.elevation.cover((west, east), (south, north), level))
        done = 0
        for n, key in enumerate(keys):
            grid = self.elevation.tile_grid(key, MARGIN, level)
            if only(grid):
                heights = match_tile(images, grid, *self._range(grid, camera), self.settings.parallax)
                if heights is not None:
                    self.elevation.add(core(self._without_doubtful(heights, camera), MARGIN))
                    self.elevation.roll((grid.east, grid.north), NEAR_TILES * grid.cell * grid.cols)
                    done += 1
            progress((n + 1) / len(keys))
        return done

    def step(self, views: Sequence[View], of_map: int = 0, poses: KeyframePosterior | None = None) -> bool:
        """Recursive parallax: take a keyframe into the ring and improve the map; False without a baseline yet.

        `of_map` is the number of the motion's map: poses of another one do not belong with those that the ring holds.
        `poses`: what is known of the last keyframes' poses; they are refined with the map. None: they are exact.
        """
        down = looking_down(views)
        if self.elevation is None or self.ground is None or not down:
            return False
        newest = down[0]
        self.below = min(self.ground if self.below is None else self.below, float(newest.centre[2]) - LEAST_HEIGHT)
        if self.settings.parallax.cell is None:
            self._level = level_for(ground_sampling(newest, self.below), self.elevation.cell, self._level)
        cell = self.elevation.cell_at(self._level)
        if self._ring is None:
            self._ring = RecursiveParallax(self.settings.parallax, cell, self.below)
        if self._map is not None and of_map != self._map:
            self._ring.restart()
        self._map = of_map
        self._ring.work_at(cell, self.below)
        self._ring.push(down, poses)
        return self._improve(down)

    def _improve(self, down: list[View]) -> bool:
        assert self.elevation is not None
        assert self._ring is not None
        assert self.below is not None
        corners = np.concatenate([footprint(v, self.below) for v in down])
        low, high = corners.min(axis=0), corners.max(axis=0)
        grid = self.elevation.window((low[0], high[0]), (low[1], high[1]), self._level)
        known, up = self.elevation.start(grid), float(down[0].centre[2])
        found = self._ring.step(grid, known, *self._range(grid, up, known))
        if self._ring.plane.any():
            self.elevation.add_plane(self._ring.plane, self._ring.about)
            known = replace(known, height=known.height + self._ring.plane_on(grid))
        if found is None:
            return False
        self.gauge = found.gauge
        found = self._without_doubtful(found, up)
        self.beyond = bool(((found.flags & np.uint16(Flag.RANGE)) != 0).mean() > BEYOND)
        heights = found.height[::4, ::4][np.isfinite(found.height[::4, ::4])]
        if len(heights) >= LEAST_KNOWN // 4:
            self.below = float(np.median(heights))
        self.elevation.add(changed(found, known), replace_all=True)
        self.elevation.roll((down[0].centre[0], down[0].centre[1]), float(np.linalg.norm(high - low)))
        return True

    def _without_doubtful(self, heights: Heights, camera: float) -> Heights:
        """Refuse heights of too large a sigma, which goes with the camera's height above the ground, and lone ones."""
        ground = self.ground if self.below is None else self.below
        limit = self.settings.elevation.max_sigma or MAX_SIGMA * max(camera - (ground or 0.0), 1.0)
        vague = heights.sigma > limit
        unsure = np.where(vague | lone(is_trusted(heights.flags) & ~vague), np.uint16(Flag.UNSURE), np.uint16(0))
        return replace(heights, flags=heights.flags | unsure)

    def map_under(self, views: Sequence[View]) -> ElevationMap | None:
        """The map of what the views look at, on the newest keyframe's cells; None where nothing was seen yet."""
        if self.elevation is None or self.below is None or not views:
            return None
        corners = np.concatenate([footprint(v, self.below) for v in views])
        (west, south), (east, north) = corners.min(axis=0), corners.max(axis=0)
        found = self.elevation.read(self.elevation.window((west, east), (south, north), self._level))
        return replace(found, gauge=self.gauge) if found.trusted.any() else None

    def map(self) -> ElevationMap | None:
        """The map so far."""
        found = self.elevation.snapshot(self.settings.elevation.most_cells) if self.elevation else None
        return None if found is None else replace(found, gauge=self.gauge)


def changed(found: Heights, known: ElevationMap) -> Heights:
    """What a step changed; what it left as it was need not be written, and is not taken for seen at this cell size."""
    same = (found.height == known.height) & (found.sigma == known.sigma) & (found.flags == known.flags)
    same &= (found.rgb == known.rgb).all(axis=2)
    return replace(found, flags=np.where(same, np.uint16(Flag.UNSEEN), found.flags).astype(np.uint16))
