"""Tuning of the hazard judgement (docs/lab/tuning-constants.md)."""

from __future__ import annotations

from pydantic import Field

from alight.settings.base import Fraction, FrozenModel, NonNegative


class HazardsTuning(FrozenModel):
    """Judging the ground."""

    unknown_share: Fraction = Field(0.02, description="Largest share of the footprint that was never seen")
    doubtful_share: Fraction = Field(
        0.35, description="Largest share of the footprint without a height that can be trusted"
    )
    bridge: NonNegative = Field(
        0.15, description="Half the width of gaps across which doubtful heights count if they agree with the rim, m"
    )
    bridge_plain: NonNegative = Field(0.75, description="The same where the image is plain (little texture, glare), m")
    min_landable: Fraction = Field(
        0.2, description="Least probability of landable ground; below it the cell is refused, above it P weighs it"
    )
    tilt_sigma: NonNegative = Field(
        0.008, description="Least 1-sigma of the common tilt of the map, rad, where the poses do not give a larger one"
    )
    noise_length: NonNegative = Field(0.6, description="Distance over which neighbouring heights share their noise, m")
    smoothed: bool = Field(
        True, description="The heights come from matched images, which flatten small obstacles: P is lowered for it"
    )
    hidden_hazard: Fraction = Field(0.25, description="Probability that a footprint that was never seen hides a hazard")
