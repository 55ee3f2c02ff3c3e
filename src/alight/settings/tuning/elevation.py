"""Tuning of the elevation map (docs/lab/tuning-constants.md)."""

from __future__ import annotations

from pydantic import Field

from alight.settings.base import FrozenModel


class ElevationTuning(FrozenModel):
    """The elevation map."""

    tile: int = Field(128, ge=64, description="Side of a tile, cells; each tile chooses its own views")
