"""Common part of both ways of mapping: search of the ground, and refusal of heights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar

import cv2
import numpy as np

from alight.arrays import F64, Mask
from alight.elevation import TiledElevation, TileStore
from alight.geometry import Grid
from alight.parallax.sparse_points import NO_POINTS, find_points, height_range, supported
from alight.pipeline.mapping.cell_size import first_cell
from alight.pipeline.mapping.view_geometry import looking_down
from alight.records import Datum, ElevationMap, Flag, Heights, View, is_trusted
from alight.settings import StageSettings
from alight.settings.tuning import MappingTuning

NO_PARALLAX = "no parallax: the aircraft did not move, or the ground has no texture, so no height can be measured"


def lone(given: Mask, tuning: MappingTuning) -> Mask:
    """True for heights given out, (R, C), with too few others about them."""
    window = (tuning.given_cells, tuning.given_cells)
    return np.asarray(given & (cv2.blur(given.astype(np.float32), window) < tuning.least_given))


@dataclass(frozen=True, eq=False)
class Surroundings:
    """A rectangle of a window, with the mask of heights given out in the window."""

    given: Mask  # (R, C) of the window
    where: tuple[slice, slice]

    def lone(self, given: Mask, tuning: MappingTuning) -> Mask:
        """True for lone heights of the rectangle; the window's mask adopts `given`."""
        self.given[self.where] = given
        reach = tuning.given_cells // 2
        r, c = (slice(max(0, s.start - reach), s.stop + reach) for s in self.where)
        rows, cols = (slice(s.start - w.start, s.stop - w.start) for s, w in zip(self.where, (r, c), strict=True))
        return lone(self.given[r, c], tuning)[rows, cols]


@dataclass(eq=False)
class GroundMap:
    """The map so far, and the points from which its ground was found."""

    by_quality: ClassVar[bool]  # as for `cell_size`

    settings: StageSettings
    tile_store: TileStore | None = None  # store of the tiles that the vehicle has left behind; None: memory
    elevation: TiledElevation | None = None
    ground: float | None = None  # metres above the origin, general ground height
    reason: str = ""  # why there is no map
    datum: Datum | None = None  # common error of all heights
    points: F64 = field(default_factory=lambda: NO_POINTS)

    def find_ground(self, views: Sequence[View], least: float = 0.0, points: F64 = NO_POINTS) -> bool:
        """Find the ground height and the cell size; False (see `reason`) when nothing can be measured.

        The points found replace those of an earlier search, whose views may have had other poses.

        Args:
            views: all views so far.
            least: baseline over height, at least; over a short one, errors of the poses decide.
            points: (N, 3) metres, of the scene, if its poses were found with points; else they are triangulated.
        """
        down = looking_down(views)
        if not down:
            self.reason = "no camera looks down: a site is sought below the aircraft, within 75 degrees of the vertical"
            return False
        if len(down) < 2:
            self.reason = NO_PARALLAX
            return False
        tuning = self.settings.parallax.points
        if len(points) < self.settings.mapping.enough_points:
            points = find_points(down, tuning)
        else:
            points = supported(points, float(np.median([v.centre[2] for v in down])), tuning)
        below = points[points[:, 2] < max(v.centre[2] for v in down)]
        if len(below) < self.settings.mapping.least_points:
            self.reason = NO_PARALLAX
            return False
        centres = np.array([v.centre for v in down])
        if np.linalg.norm(np.ptp(centres, axis=0)) < least * (centres[-1, 2] - np.median(below[:, 2])):
            self.reason = "the aircraft hardly moved for its height, so no height can be measured"
            return False
        self.points = below[:: -(-len(below) // self.settings.mapping.most_points)]
        self.ground = float(np.median(self.points[:, 2]))
        if self.elevation is None:
            cell = first_cell(down, self.ground, self.settings, self.by_quality)
            self.elevation = TiledElevation(
                cell, self.settings.elevation.tile, self.tile_store, self.settings.elevation
            )
        return True

    def searched_heights(
        self, grid: Grid, camera: float, known: ElevationMap | None = None, part: bool = False
    ) -> tuple[float, float]:
        """Heights to search: those of the map there, where it has enough, else of points near it.

        Both, where only a `part` of the map is known: that may miss a pit in the rest.
        """
        if self.settings.parallax.height_range:
            return self.settings.parallax.height_range
        wide, tall = grid.cell * grid.cols, grid.cell * grid.rows
        near = (grid.east + 0.5 * wide, grid.north - 0.5 * tall, 1.2 * max(wide, tall))
        low, high = height_range(self.points, camera, near)
        heights = np.empty(0) if known is None else known.height[known.trusted][::7].astype(np.float64)
        if len(heights) < self.settings.mapping.least_known:
            return low, high
        below, above = height_range(np.column_stack([heights, heights, heights]), camera)
        above = max(above, self._treetops(camera, float(np.median(heights))))
        return (min(low, below), max(high, above)) if part else (below, above)

    def _treetops(self, camera: float, ground: float) -> float:
        """Height up to which trees are sought on new ground: a map of fields has none, and crowns have no heights yet.

        At most half the camera's height above ground is searched.
        """
        return ground + min(self.settings.mapping.trees, 0.5 * (camera - ground))

    def _without_doubtful(self, heights: Heights, above: float, around: Surroundings | None = None) -> Heights:
        """Refuse lone heights, and those with too large a sigma for the camera's height `above` ground, metres."""
        limit = self.settings.elevation.max_sigma or self.settings.mapping.max_sigma * max(above, 1.0)
        vague = heights.sigma > limit
        given = is_trusted(heights.flags) & ~vague
        alone = lone(given, self.settings.mapping) if around is None else around.lone(given, self.settings.mapping)
        unsure = (vague | alone).astype(np.uint16) * np.uint16(Flag.UNSURE)
        return replace(heights, flags=heights.flags | unsure)

    def snapshot(self) -> ElevationMap | None:
        """The whole map so far, by value; None where nothing was seen."""
        found = self.elevation.snapshot(self.settings.elevation.most_cells) if self.elevation else None
        return None if found is None else replace(found, datum=self.datum)
