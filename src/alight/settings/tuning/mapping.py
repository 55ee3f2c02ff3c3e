"""Tuning of the mapping lane and of the elevation map."""

from __future__ import annotations

from pydantic import Field

from alight.settings.base import Fraction, FrozenModel, NonNegative, Positive


class MappingTuning(FrozenModel):
    """Constants for keyframes, the search for the ground, the cell size, and limits of published heights."""

    first_step: Positive = Field(0.25, description="Distance of keyframes before the height above ground is known, m")
    find_every: int = Field(8, ge=1, description="Keyframes from one search for the ground to the next")
    find_baseline: Positive = Field(0.08, description="Baseline over height that this search needs in flight")
    kept_by_ring: int = Field(16, ge=3, description="Keyframes kept to find the ground in flight")
    kept_to_look: int = Field(64, ge=3, description="Keyframes whose images are kept for pixels finer than the heights")
    least_points: int = Field(20, ge=1, description="Least number of triangulated points that show the ground")
    least_known: int = Field(
        400,
        ge=1,
        description="Heights, or points of the bundle adjustment, from which they give the range that is searched",
    )
    trees: NonNegative = Field(15.0, description="Height of the trees that may stand on ground not mapped yet, m")
    beyond: Fraction = Field(
        0.3, description="Share of cells at an end of the searched range from which another range is sought"
    )
    cell_over_pixel: Positive = Field(1.8, description="Size of a cell over the ground sampling distance")
    level_slack: NonNegative = Field(0.15, description="Hysteresis before the size of the cells is changed, octaves")
    max_sigma: Positive = Field(
        0.0065, description="Largest sigma of a height that is given out over the height above ground"
    )
    least_given: Fraction = Field(0.25, description="Least share of neighbours given out with a height; below: UNSURE")
    given_cells: int = Field(41, ge=1, description="Window of these neighbours, cells")
    judged_about: Positive = Field(8.0, description="Ground about a place in question that is judged with it, m")
    least_height: Positive = Field(1.0, description="Least height of the camera above the mapped ground, m")


class ElevationTuning(FrozenModel):
    """Constants of the elevation map."""

    tile: int = Field(128, ge=64, description="Side of a tile, cells; each tile chooses its own views")
    less_sure: Positive = Field(
        1.5, description="Sigma of a cell that was only seen with coarser cells over the sigma of these"
    )
    least_share: Fraction = Field(
        0.05, description="Least share of the map seen with cells as fine as those of the written rasters"
    )
