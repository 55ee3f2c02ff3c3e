"""Tuning of the elevation map (docs/lab/tuning-constants.md)."""

from __future__ import annotations

from pydantic import Field

from alight.settings.base import Fraction, FrozenModel, Positive


class ElevationTuning(FrozenModel):
    """The elevation map."""

    tile: int = Field(128, ge=64, description="Side of a tile, cells; each tile chooses its own views")
    less_sure: Positive = Field(
        1.5, description="Sigma of a cell that was only seen with coarser cells over the sigma of these"
    )
    least_share: Fraction = Field(
        0.05, description="Least share of the map seen with cells as fine as those of the written rasters"
    )
