"""Tuning of the selection of sites and of the route."""

from __future__ import annotations

from pydantic import Field

from alight.settings.base import Fraction, FrozenModel, NonNegative, Positive


class SitesTuning(FrozenModel):
    """Constants for the selection of sites."""

    third_party: bool = Field(
        True, description="Roads that the map shows are avoided, standing cars, people and buildings kept out of"
    )
    roomy: Positive = Field(
        5.0, description="Clearance that adds 1 to the score, and beyond which more adds nothing, m"
    )
    doubt_weight: NonNegative = Field(20.0, description="Weight of 1 - P(safe) against the quality Q")
    chance_step: Positive = Field(0.02, description="Candidates whose P(safe) is in one step of it are ranked by Q")
    look_base: Fraction = Field(
        0.12, description="Distance of a next view by one camera from the place, over its height"
    )
    lowest_look: Positive = Field(
        8.0, description="Least height of a next view, and ground about a place in question that is judged with it, m"
    )


class RouteTuning(FrozenModel):
    """Constants of the route to the best site."""

    look_share: Fraction = Field(
        0.5, description="Height of a look over that of the last; of the last inspection over the approach height"
    )
    air_speed: Positive = Field(
        12.0, description="Most speed through the air, m/s; against the wind it flies slower over the ground"
    )
    calm: Positive = Field(2.0, description="Wind up to which its direction does not count, m/s")
