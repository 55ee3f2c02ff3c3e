"""The terrain lane of a recording: views -> heights tile by tile -> one map."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from alight.elevation import FIELDS, Elevation
from alight.geometry import Grid
from alight.parallax import Images, Ring, find_points, ground_sampling, height_range, match
from alight.records import F64, ElevationMap, Flag, Heights, View
from alight.settings import Settings

MARGIN = 24  # cells about a tile that are matched with it and thrown away: no seams
STEEPEST = np.cos(np.radians(75.0))  # views flatter than this to the ground are not used
LEAST_POINTS = 20
NEAR_TILES = 3  # tiles about the one being matched that stay unpacked
CELL_OVER_PIXEL = 1.8
NICE = np.array([1.0, 1.5, 2.0, 3.0, 5.0, 7.0])

Progress = Callable[[float], None]


def nice_cell(sampling: float) -> float:
    """The round cell size nearest to 1.8 ground sampling distances, metres."""
    target = CELL_OVER_PIXEL * sampling
    decade = 10.0 ** np.floor(np.log10(target))
    sizes = np.concatenate([NICE * decade, [10.0 * decade]])
    return float(np.round(sizes[np.argmin(np.abs(np.log(sizes / target)))], 6))


def looking_down(views: Sequence[View]) -> list[View]:
    """The views whose optical axis is at most 75 degrees from straight down."""
    return [v for v in views if -v.world_from_cam.rotation[2, 2] > STEEPEST]


def core(heights: Heights, margin: int) -> Heights:
    """The heights without their margin."""
    inner = slice(margin, -margin)
    grid = heights.grid.window(margin, margin, heights.grid.rows - 2 * margin, heights.grid.cols - 2 * margin)
    return replace(heights, grid=grid, **{f: np.ascontiguousarray(getattr(heights, f)[inner, inner]) for f in FIELDS})


def footprint(view: View, height: float) -> NDArray[np.float64]:
    """Where the image's border meets level ground at `height`, (N, 2) metres; rays end at 75 degrees from down."""
    w, h = view.camera.width - 1.0, view.camera.height - 1.0
    border = np.array([[0, 0], [w / 2, 0], [w, 0], [w, h / 2], [w, h], [w / 2, h], [0, h], [0, h / 2]])
    rays = view.camera.rays(border)
    rays = rays @ view.world_from_cam.rotation.T
    down = np.maximum(-rays[:, 2], np.linalg.norm(rays, axis=1) * STEEPEST)
    return np.asarray(view.centre[:2] + rays[:, :2] * ((view.centre[2] - height) / down)[:, None])


@dataclass(eq=False)
class TerrainLane:
    """Matches every tile that at least two views see."""

    settings: Settings
    elevation: Elevation | None = None
    ground: float | None = None  # metres above the origin, the ground in general
    reason: str = ""  # why there is no map
    _ring: Ring | None = None
    _points: F64 = field(default_factory=lambda: np.empty((0, 3)))

    def learn(self, views: Sequence[View]) -> bool:
        """Find where the ground is and how fine the map shall be; False (see `reason`) when nothing can be measured."""
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
        self._points = np.concatenate([self._points, below])
        self.ground = float(np.median(self._points[:, 2]))
        if self.elevation is None:
            sampling = float(np.median([ground_sampling(v, self.ground) for v in down]))
            self.elevation = Elevation(self.settings.parallax.cell or nice_cell(sampling), self.settings.elevation.tile)
        return True

    def _range(self, grid: Grid, camera: float) -> tuple[float, float]:
        if self.settings.parallax.height_range:
            return self.settings.parallax.height_range
        wide, tall = grid.cell * grid.cols, grid.cell * grid.rows
        near = (grid.east + 0.5 * wide, grid.north - 0.5 * tall, 1.2 * max(wide, tall))
        return height_range(self._points, camera, near)

    def build(self, views: Sequence[View], progress: Progress, only: Callable[[Grid], bool] = lambda _: True) -> int:
        """Match all tiles under `views` for which `only` holds; return how many."""
        views = looking_down(views)
        if self.elevation is None or self.ground is None or not views:
            return 0
        images = Images(views, self.elevation.cell, self.ground)
        corners = np.concatenate([footprint(v, self.ground) for v in views])
        camera = float(np.median([v.centre[2] for v in views]))
        keys = list(
            self.elevation.cover((corners[:, 0].min(), corners[:, 0].max()), (corners[:, 1].min(), corners[:, 1].max()))
        )
        done = 0
        for n, key in enumerate(keys):
            grid = self.elevation.tile_grid(key, MARGIN)
            if only(grid):
                heights = match(images, grid, *self._range(grid, camera), self.settings.parallax)
                if heights is not None:
                    self.elevation.add(core(heights, MARGIN))
                    self.elevation.roll((grid.east, grid.north), NEAR_TILES * grid.cell * grid.cols)
                    done += 1
            progress((n + 1) / len(keys))
        return done

    def step(self, views: Sequence[View]) -> bool:
        """Recursive parallax: take a keyframe into the ring and improve the map; False without a baseline yet."""
        if self.elevation is None or self.ground is None:
            return False
        if self._ring is None:
            self._ring = Ring(self.settings.parallax, self.elevation.cell, self.ground)
        down = looking_down(views)
        if not down:
            return False
        self._ring.push(down)
        corners = np.concatenate([footprint(v, self.ground) for v in down])
        low, high = corners.min(axis=0), corners.max(axis=0)
        grid = self.elevation.window((low[0], high[0]), (low[1], high[1]))
        known = self.elevation.read(grid)
        found = self._ring.step(grid, known, *self._range(grid, float(down[0].centre[2])))
        if found is None:
            return False
        self.elevation.add(found, replace_all=True)
        self.elevation.roll((down[0].centre[0], down[0].centre[1]), float(np.linalg.norm(high - low)))
        return True

    def map(self, height_above_ground: float) -> ElevationMap | None:
        """The map so far, with heights of too large a sigma refused."""
        found = self.elevation.snapshot() if self.elevation else None
        if found is None:
            return None
        limit = self.settings.elevation.max_sigma or 0.01 * height_above_ground
        vague = found.sigma > limit
        return replace(
            found, flags=np.where(vague, found.flags | np.uint16(Flag.UNSURE), found.flags).astype(np.uint16)
        )
