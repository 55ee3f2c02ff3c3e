"""Tuning of the choice of sites (docs/lab/tuning-constants.md)."""

from __future__ import annotations

from pydantic import Field

from alight.settings.base import Fraction, FrozenModel, NonNegative, Positive


class SitesTuning(FrozenModel):
    """Choice of sites."""

    roomy: Positive = Field(5.0, description="Clearance beyond which more adds nothing to the score, m")
    room_weight: NonNegative = Field(1.0, description="Weight of the clearance against the quality Q")
    doubt_weight: NonNegative = Field(20.0, description="Weight of 1 - P(safe) against the quality Q")
    chance_step: Positive = Field(0.02, description="Candidates whose P(safe) is in one step of it are ranked by Q")
    look_base: Fraction = Field(
        0.12, description="Distance of a next view by one camera from the place, over its height"
    )
    lowest_look: Positive = Field(8.0, description="Least height of a next view above the ground, m")
