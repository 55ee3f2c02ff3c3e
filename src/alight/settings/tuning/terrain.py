"""Tuning of the land cover (docs/lab/tuning-constants.md)."""

from __future__ import annotations

from pydantic import Field

from alight.settings.base import Fraction, FrozenModel, NonNegative, Positive


class TerrainTuning(FrozenModel):
    """What covers the ground."""

    appearance: Fraction = Field(
        0.5, description="Weight of the model of appearance: neighbouring pixels are not independent"
    )
    block: Positive = Field(0.5, description="Side of the blocks on which the shape of the ground is judged, m")
    ground_window: Positive = Field(10.0, description="Width below which what is raised stands on the ground, m")
    bulge: NonNegative = Field(0.04, description="Height that a hilltop may have per metre of its width, m/m")
    raised: Positive = Field(0.5, description="Height above the ground from which something counts as an object, m")
    overhang: NonNegative = Field(
        0.5, description="Safety distance around tall objects per metre of their height (capped at 6 m), m/m"
    )
    basin_depth: Positive = Field(
        0.2, description="Depth of standing water that a closed basin must hold to be taken for a pond, m"
    )
    basin_odds: Positive = Field(4.0, description="Log odds given to standing water that the shape alone shows")
    leafy: Positive = Field(0.09, description="Excess green from which a surface is plants")
    tall: Positive = Field(1.5, description="Height above the ground from which plants are a tree, m")
    beside_tall: Fraction = Field(
        0.27, description="Largest probability of landable ground within the safety distance around tall objects"
    )
    pond_share: Fraction = Field(
        0.2, description="Least share of a patch that looks like water and is water on its own evidence"
    )
