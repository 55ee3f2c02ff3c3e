"""Tuning of the route (docs/lab/tuning-constants.md)."""

from __future__ import annotations

from pydantic import Field

from alight.settings.base import Fraction, FrozenModel, Positive


class RouteTuning(FrozenModel):
    """Way-points to the best site."""

    look_share: Fraction = Field(
        0.5, description="Height of a look over that of the last; of the last inspection over the approach height"
    )
    air_speed: Positive = Field(
        12.0, description="Most speed through the air, m/s; against the wind it flies slower over the ground"
    )
    calm: Positive = Field(2.0, description="Wind up to which its direction does not count, m/s")
