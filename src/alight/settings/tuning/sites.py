"""Tuning of the choice of sites (docs/lab/tuning-constants.md)."""

from __future__ import annotations

from pydantic import Field

from alight.settings.base import Fraction, FrozenModel, NonNegative, Positive


class SitesTuning(FrozenModel):
    """Choosing sites."""

    roomy: Positive = Field(5.0, description="Clearance beyond which more adds nothing to the score, m")
    room_weight: NonNegative = Field(1.0, description="Weight of the clearance against the quality Q")
    nearer: Fraction = Field(0.5, description="Height of the proposed next view over the present height above ground")
    lowest_look: Positive = Field(8.0, description="Least height of the proposed next view above the ground, m")
