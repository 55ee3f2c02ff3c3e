"""The map of a flight: improved with every keyframe."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from alight.arrays import F64, U16, Mask
from alight.elevation import TiledElevation, doublings_up_to
from alight.geometry import Grid
from alight.parallax.recursive import RecursiveParallax
from alight.pipeline.mapping.cell_size import BYTES_A_CELL, BYTES_A_STEP, cell_size, level_for, refuse_too_large
from alight.pipeline.mapping.ground_map import GroundMap, Surroundings
from alight.pipeline.mapping.view_geometry import bounds, looking_down
from alight.pipeline.remembered import NOWHERE, Remembered, what_moves, who_came
from alight.records import ElevationMap, Flag, Heights, KeyframePosterior, View, is_trusted

COARSE = 4  # cells: every n-th of them is used for the ground height


@dataclass(eq=False)
class RecursiveMap(GroundMap):
    """Recursive parallax over a window of keyframes."""

    by_quality: ClassVar[bool] = False

    ground_here: float | None = None  # metres above the origin, under the newest keyframe; None before the first step
    out_of_range: bool = False  # many of the newest heights are at an end of the searched range, or none is given out
    level: int = 0  # of the newest keyframe's cells
    passed: Remembered = NOWHERE  # places where something moved, in the frame of the poses
    came: Remembered = NOWHERE  # places where somebody came to stand, in the same frame
    estimator: RecursiveParallax | None = None

    @property
    def ground_height(self) -> float | None:
        """Ground height under the vehicle as far as known, metres above the origin."""
        return self.ground if self.ground_here is None else self.ground_here

    def find_ground_again(self, views: Sequence[View], least: float) -> None:
        """Find the ground if it lies beyond the searched heights; then the map begins anew, from the heights it has."""
        if self.find_ground(views, least):
            self.ground_here = self.ground
            if self.estimator is not None:
                self.estimator.reset_sweep()
        self.out_of_range = False

    def begin_anew(self, shift: F64, sigma: float = 0.0) -> bool:
        """Drop the heights: the poses to come have another frame, `shift` (3,) metres from that of the old ones.

        The ground height is kept, well enough for the search of heights. Places of traffic and of people are
        kept and grown, because they are known to `sigma` metres on the ground.

        Returns:
            True if there were any heights.
        """
        if self.elevation is None or self.ground is None:
            return False
        mapped = self.ground_here is not None
        for name in list(self.tile_store or ()):
            del self.tile_store[name]  # type: ignore[union-attr]
        self.elevation = TiledElevation(
            self.elevation.cell, self.settings.elevation.tile, self.tile_store, self.settings.elevation
        )
        self.ground, self.points = self.ground + float(shift[2]), self.points + shift
        self.ground_here = None if self.ground_here is None else self.ground_here + float(shift[2])
        self.estimator, self.datum, self.out_of_range = None, None, False
        self.passed, self.came = self.passed.moved(shift, sigma), self.came.moved(shift, sigma)
        return mapped

    def step(self, views: Sequence[View], poses: KeyframePosterior | None = None, effort: int = 0) -> bool:
        """Take a keyframe into the window and improve the map; False without a baseline yet.

        `poses`: joint posterior of the last keyframes; they are refined with the map. None: they are exact.
        `effort`: level of the effort, from 0 (full) to 3 (least).
        """
        down = looking_down(views)
        if self.elevation is None or self.ground is None or not down:
            return False
        newest = down[0]
        here = self.ground if self.ground_here is None else self.ground_here
        self.ground_here = min(here, float(newest.centre[2]) - self.settings.mapping.least_height)
        size = cell_size(newest, self.ground_here, self.settings, self.by_quality)
        self.level = level_for(size, self.elevation.cell, self.level, self.settings.mapping.level_slack)
        cell = self.elevation.cell_at(self.level)
        if self.estimator is None:
            self.estimator = RecursiveParallax(self.settings.parallax, cell, self.ground_here)
        self.estimator.work_at(cell, self.ground_here)
        self.estimator.push(down, poses)
        return self._improve(down, self.estimator, self.ground_here, effort)

    def _improve(self, down: list[View], estimator: RecursiveParallax, ground: float, effort: int) -> bool:
        assert self.elevation is not None
        low, high = bounds(down, ground)
        grid = _window(self.elevation, low, high, self.level, BYTES_A_STEP)
        known, up = self.elevation.start(grid), float(down[0].centre[2])
        parts = estimator.step(grid, known, *self.searched_heights(grid, up, known, estimator.beginning), effort)
        if estimator.alignment.plane.any():
            self.elevation.add_plane(estimator.alignment.plane, estimator.alignment.about)
            known = replace(known, height=known.height + estimator.alignment.plane_on(grid))
        if not parts:
            return False
        self.datum = parts[0].datum
        height, flags = known.height[::COARSE, ::COARSE].copy(), known.flags.copy()
        given, anew = is_trusted(known.flags), np.zeros(grid.shape, np.bool_)
        for part in parts:
            where = box_in(grid, part.grid)
            found = self._without_doubtful(part, up - ground, Surroundings(given, where))
            rows, cols = (slice(-s.start % COARSE, None, COARSE) for s in where)
            at = tuple(slice(-(-s.start // COARSE), -(-s.stop // COARSE)) for s in where)
            height[at] = found.height[rows, cols]
            flags[where], anew[where] = found.flags, True
            self.elevation.add(changed(found, known, where), replace_all=True)
        self._note_traffic(grid, flags, anew, down[0].t_ns, up - ground)
        self._note_who_came(estimator, down[0].t_ns)
        at_an_end = ((flags[::COARSE, ::COARSE] & np.uint16(Flag.RANGE)) != 0).mean()
        self.out_of_range = bool(at_an_end > self.settings.mapping.beyond or not is_trusted(flags).any())
        heights = height[np.isfinite(height)]
        if len(heights) >= self.settings.mapping.least_known // 4:
            self.ground_here = float(np.median(heights))
        self.elevation.roll((down[0].centre[0], down[0].centre[1]), float(np.linalg.norm(high - low)))
        return True

    def _note_traffic(self, grid: Grid, flags: U16, anew: Mask, t_ns: int, height: float) -> None:
        """Remember moving places, seen from a `height` above ground (metres) that shows enough of them (G6b).

        `flags`, `anew`: (R, C), as in `what_moves`.
        """
        keys = self.settings.hazards
        self.passed = self.passed.since(t_ns - round(keys.traffic_memory * 1e9))
        if height >= keys.traffic_height and keys.traffic_memory > 0:
            self.passed = self.passed.with_seen(what_moves(grid, flags, anew), t_ns)

    def _note_who_came(self, estimator: RecursiveParallax, t_ns: int) -> None:
        """Remember the places where somebody came to stand (G6c)."""
        self.came = self.came.since(t_ns - round(self.settings.hazards.came_memory * 1e9))
        for grid, came in estimator.came:
            self.came = self.came.with_seen(who_came(grid, came), t_ns)

    def under(self, views: Sequence[View], about: F64 | None = None) -> ElevationMap | None:
        """The map of the ground in the views, and of that about a place, (2,) metres; None where nothing was seen.

        On the newest keyframe's cells, or on coarser ones where these are finer than the lander needs.

        Raises:
            SettingsError: the map would be too large for any memory, as when the ground is lost.
        """
        if self.elevation is None or self.ground_here is None or not views:
            return None
        low, high = bounds(views, self.ground_here)
        if about is not None:
            reach = self.settings.mapping.judged_about
            low, high = np.minimum(low, about - reach), np.maximum(high, about + reach)
        here = self.elevation.cell_at(self.level)
        level = self.level + doublings_up_to(here, self.settings.lander.judging_cell)
        found = self.elevation.read(_window(self.elevation, low, high, level, BYTES_A_CELL))
        return replace(found, datum=self.datum) if found.trusted.any() else None


def _window(elevation: TiledElevation, low: F64, high: F64, level: int, each: float) -> Grid:
    """The cells between two corners (2,), `each` of which takes so many bytes; refused where no memory holds them."""
    refuse_too_large((low[0], low[1]), (high[0], high[1]), elevation.cell_at(level), each)
    return elevation.layer(level).window((low[0], high[0]), (low[1], high[1]))


def box_in(grid: Grid, part: Grid) -> tuple[slice, slice]:
    """Rows and columns of a grid that `part`, another grid on its cells, covers."""
    row, col = (round(float(v)) for v in grid.index(np.array(part.east), np.array(part.north)))
    return slice(row, row + part.rows), slice(col, col + part.cols)


def changed(found: Heights, known: ElevationMap, where: tuple[slice, slice]) -> Heights:
    """Changes of a step in a part of the map; unchanged cells are UNSEEN, not to count at this cell size."""
    height, sigma, flags, rgb = (getattr(known, k)[where] for k in ("height", "sigma", "flags", "rgb"))
    same = (found.height == height) & (found.sigma == sigma) & (found.flags == flags)
    same &= (found.rgb == rgb).all(axis=2)
    return replace(found, flags=np.where(same, np.uint16(Flag.UNSEEN), found.flags).astype(np.uint16))
