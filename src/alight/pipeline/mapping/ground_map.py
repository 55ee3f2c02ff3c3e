"""Common part of both mapping lanes: search of the ground, cell size, and refusal of heights."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar

import cv2
import numpy as np

from alight.arrays import F64, Mask
from alight.elevation import TiledElevation, TileStore
from alight.geometry import Box, Grid
from alight.parallax.plane_sweep import ENOUGH
from alight.parallax.sparse_points import NO_POINTS, Features, find_points, height_range, is_within, supported
from alight.parallax.views import ground_sampling
from alight.pipeline.mapping.keyframes import looking_down
from alight.records import Datum, ElevationMap, Flag, Heights, SettingsError, View, is_trusted
from alight.settings import StageSettings
from alight.settings.tuning import MappingTuning

NO_PARALLAX = "no parallax: the aircraft did not move, or the ground has no texture, so no height can be measured"
HARDLY_MOVED = "the aircraft hardly moved for its height, so no height can be measured"
# by `parallax.quality`: cell size over 1.8 pixels, and least cell size over the cell size on which the lander is
# judged
QUALITY = {"fast": (2.0, 1.0), "normal": (1.0, 0.5), "fine": (1.0, 0.0)}


def cell_size(view: View, ground: float, settings: StageSettings, by_quality: bool) -> float:
    """Return the cell size, metres, for a view of ground at height `ground`.

    It is `parallax.cell` if that is set, otherwise 1.8 pixels. `by_quality`: whether `parallax.quality` may enlarge it,
    as for whole recordings.
    """
    if settings.parallax.cell is not None:
        return settings.parallax.cell
    pixels, least = QUALITY[settings.parallax.quality if by_quality else "fine"]
    size = settings.mapping.cell_over_pixel * (pixels * ground_sampling(view, ground))
    return max(size, least * settings.lander.judging_cell)


def nice_cell(size: float) -> float:
    """Return the round cell size (1, 1.5, 2, 3, 5 or 7 times a power of ten) nearest to `size`, metres."""
    decade = 10.0 ** np.floor(np.log10(size))
    sizes: F64 = np.array([1.0, 1.5, 2.0, 3.0, 5.0, 7.0, 10.0]) * decade
    return float(np.round(sizes[np.argmin(np.abs(np.log(sizes / size)))], 6))


def level_for(size: float, first: float, now: int, slack: float) -> int:
    """Return the level for a cell size (eq. 16a).

    Args:
        size: wanted cell size, metres.
        first: cell size of level 0, metres; it doubles from level to level.
        now: present level, which is kept while its cell size differs from `size` by at most 1/2 + `slack` octaves.
        slack: tolerance, octaves.
    """
    exact = math.log2(size / first)
    return now if abs(exact - now) <= 0.5 + slack else round(exact)


def refuse_too_large(low: F64, high: F64, cell: float, each: float) -> None:
    """Refuse a map that would need more than 25 GB.

    Args:
        low, high: (2,) south-west and north-east corners, metres.
        cell: cell size, metres.
        each: bytes per cell.

    Raises:
        SettingsError: the map is too large; the message gives its size and the cell that would need 1 GB.
    """
    width, length = (float(v) for v in high - low)
    needed = each * (width / cell) * (length / cell)
    if needed <= 25e9:
        return
    better = float(f"{math.sqrt(each * width * length / 1e9):.1g}")
    raise SettingsError(
        f"cells of {cell:g} m: a map of {width:,.0f} x {length:,.0f} m needs about {needed / 1e9:,.0f} GB; "
        f"parallax.cell={better:g} would need {each * (width / better) * (length / better) / 1e9:.1f} GB"
    )


def lone(given: Mask, where: Box, tuning: MappingTuning) -> Mask:
    """Return the mask, over the box `where`, of trusted cells (`given`, (R, C)) with too few trusted neighbours."""
    reach, window = tuning.given_cells // 2, (tuning.given_cells, tuning.given_cells)
    r, c = (slice(max(0, s.start - reach), s.stop + reach) for s in where)
    about = given[r, c]
    alone = about & (cv2.blur(about.astype(np.float32), window) < tuning.least_given)
    rows, cols = (slice(s.start - w.start, s.stop - w.start) for s, w in zip(where, (r, c), strict=True))
    return np.asarray(alone[rows, cols])


@dataclass(eq=False)
class GroundMap:
    """The map so far, and the points from which its ground was found."""

    by_quality: ClassVar[bool]  # whether `parallax.quality` applies; see `cell_size`

    settings: StageSettings
    tile_store: TileStore | None = None  # store of far tiles; None: memory
    elevation: TiledElevation | None = None
    ground: float | None = None  # metres above the origin, median ground height
    reason: str = ""  # why there is no map
    datum: Datum | None = None  # common error of all heights
    points: F64 = field(default_factory=lambda: NO_POINTS)
    features: Features = field(init=False)  # of the views of a search, for the next one

    def __post_init__(self) -> None:
        """Begin without features."""
        self.features = Features(self.settings.parallax.points)

    def find_ground(self, views: Sequence[View], least: float = 0.0, points: F64 = NO_POINTS) -> bool:
        """Find the ground height and the cell size; return False, with `reason` set, if nothing can be measured.

        The points found replace the points of earlier searches, whose views may have had other poses.

        Args:
            views: all views so far.
            least: least baseline over height; over a shorter baseline, errors of the poses dominate.
            points: (N, 3) scene points in metres from the estimation of the poses; too few: points are triangulated.
        """
        down = looking_down(views)
        if not down:
            self.reason = "no camera looks down: a site is sought below the aircraft, within 75 degrees of the vertical"
            return False
        if len(down) < 2:
            self.reason = NO_PARALLAX
            return False
        tuning = self.settings.parallax.points
        centres = np.array([v.centre for v in down])
        moved = float(np.linalg.norm(np.ptp(centres, axis=0)))
        if least and not is_within(down, moved / least, tuning, self.features):
            self.reason = HARDLY_MOVED
            return False
        if len(points) < self.settings.mapping.least_known:
            points = find_points(down, tuning, self.features)
        else:
            points = supported(points, float(np.median([v.centre[2] for v in down])), tuning)
        below = points[points[:, 2] < max(v.centre[2] for v in down)]
        if len(below) < ENOUGH:
            self.reason = NO_PARALLAX
            return False
        if moved < least * (centres[-1, 2] - np.median(below[:, 2])):
            self.reason = HARDLY_MOVED
            return False
        self.points, self.ground = below, float(np.median(below[:, 2]))
        self.features = Features(tuning)
        if self.elevation is None:
            size = float(np.median([cell_size(v, self.ground, self.settings, self.by_quality) for v in down]))
            self.elevation = self._empty(self.settings.parallax.cell or nice_cell(size))
        return True

    def _empty(self, cell: float) -> TiledElevation:
        tuning = self.settings.elevation
        return TiledElevation(cell, tuning.tile, self.tile_store, tuning)

    def level_of(self, view: View, ground: float, now: int) -> int:
        """Return the level for a view of ground at height `ground`, metres; `now`: the present level."""
        assert self.elevation is not None
        size = cell_size(view, ground, self.settings, self.by_quality)
        return level_for(size, self.elevation.cell, now, self.settings.mapping.level_slack)

    def searched_heights(
        self, grid: Grid, camera: float, known: ElevationMap | None = None, part: bool = False
    ) -> tuple[float, float]:
        """Return the lowest and highest height to search, metres, from the map `known`, or from points if it has few.

        `camera`: height of the camera, metres. `part`: whether `known` may lack a part of the grid, and with it a pit;
        then points are used as well.
        """
        if self.settings.parallax.height_range:
            return self.settings.parallax.height_range
        wide, tall = grid.cell * grid.cols, grid.cell * grid.rows
        near = (grid.east + 0.5 * wide, grid.north - 0.5 * tall, 1.2 * max(wide, tall))
        low, high = height_range(self.points, camera, near)
        heights = np.empty(0) if known is None else known.height[known.trusted][::7].astype(np.float64)
        if len(heights) < self.settings.mapping.least_known:
            return low, high
        middle = float(np.median(heights))
        # a map of fields has no trees, and the crowns of new ground have no heights yet
        treetops = middle + min(self.settings.mapping.trees, 0.5 * (camera - middle))
        below, above = height_range(np.column_stack([heights, heights, heights]), camera)
        above = max(above, treetops)
        return (min(low, below), max(high, above)) if part else (below, above)

    def _without_doubtful(
        self, heights: Heights, above: float, given: Mask | None = None, where: Box | None = None
    ) -> Heights:
        """Refuse isolated heights, and heights whose sigma is too large for a camera `above` metres above ground.

        Args:
            heights: all cells, or the cells in the box `where` of a window.
            given: (R, C) mask of the window's trusted heights, updated in the box; None: `heights` is the whole window.
        """
        limit = self.settings.elevation.max_sigma or self.settings.mapping.max_sigma * max(above, 1.0)
        vague = heights.sigma > limit
        own = is_trusted(heights.flags) & ~vague
        if given is None or where is None:
            given, where = own, (slice(0, heights.grid.rows), slice(0, heights.grid.cols))
        given[where] = own
        unsure = (vague | lone(given, where, self.settings.mapping)).astype(np.uint16) * np.uint16(Flag.UNSURE)
        return replace(heights, flags=heights.flags | unsure)

    def snapshot(self) -> ElevationMap | None:
        """Return a copy of the whole map so far; None if nothing was seen."""
        found = self.elevation.snapshot(self.settings.elevation.most_cells) if self.elevation else None
        return None if found is None else replace(found, datum=self.datum)
