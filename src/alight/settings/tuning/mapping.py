"""Tuning of the mapping lane and of the elevation map."""

from __future__ import annotations

from pydantic import Field

from alight.settings.base import Fraction, FrozenModel, NonNegative, Positive


class MappingTuning(FrozenModel):
    """Constants for keyframes, the search for the ground, the cell size, and limits of published heights."""

    first_step: Positive = Field(0.25, description="Distance of keyframes before the height above ground is known, m")
    find_every: int = Field(
        8,
        ge=2,
        description="Keyframes from one search for the ground to the next; the first in flight takes as many, to twice "
        "as many",
    )
    kept_to_look: int = Field(64, ge=3, description="Keyframes whose images are kept for pixels finer than the heights")
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


class ElevationTuning(FrozenModel):
    """Constants of the elevation map."""

    tile: int = Field(128, ge=64, description="Side of a tile, cells; each tile chooses its own views")
    less_sure: Positive = Field(
        1.5, description="Sigma of a cell that was only seen with coarser cells over the sigma of these"
    )
    least_share: Fraction = Field(
        0.05, description="Least share of the map seen with cells as fine as those of the written rasters"
    )
