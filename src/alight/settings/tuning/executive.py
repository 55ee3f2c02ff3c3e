"""Tuning of the executive."""

from __future__ import annotations

from pydantic import Field

from alight.settings.base import Fraction, FrozenModel, NonNegative, Positive


class ExecutiveTuning(FrozenModel):
    """Constants of the executive: search, looks and landing."""

    lane: Positive = Field(0.7, description="Distance of two lanes of the search, over the height")
    look_base: Positive = Field(
        0.15, description="Half the length of a look leg beside a place, over the height; at least the lander's radius"
    )
    probable: Fraction = Field(
        0.8,
        description="P(safe) of a candidate for which the search is broken off; a verdict below it on a landing under "
        "way refuses its place",
    )
    tries_at_once: int = Field(
        4, ge=0, description="Places refused from near by after which the search is broken off for sites only"
    )
    clearly: Fraction = Field(
        0.2, description="P(safe) by which another place must be better for one in doubt to be left for it"
    )
    hopeless: Fraction = Field(0.3, description="P(safe) below which a place in doubt is dropped without a lower look")
    beside: Positive = Field(0.4, description="Better places so near are taken instead at a look, over its height")
    same_place: Positive = Field(2.0, description="Distance within which a listed place is the one looked at, m")
    same_spot: Positive = Field(
        0.5, description="The same once the landing has begun: it comes down without a swerve, m"
    )
    abort_median: Fraction = Field(
        0.9, description="Median P(safe) of the last verdicts on a landing under way, below which they refuse its place"
    )
    last_verdicts: int = Field(5, ge=1, description="So many of them")
    plain: Fraction = Field(
        0.1, description="P(safe) that bare and paved ground counts more when the next place is chosen"
    )
    nearest: Positive = Field(
        4.0, description="Height of one more look at a place that is in doubt from the height to commit from, m"
    )
    refusals_to_abort: int = Field(
        2,
        ge=1,
        description="Verdicts in a row that refuse a place, or leave it in doubt from the lowest look, before it is "
        "given up",
    )
    visits: int = Field(
        8, ge=1, description="Places refused from near by after which candidates are visited no more, sites only"
    )
    wait: Positive = Field(12.0, description="Time without a verdict, or without any position, before giving up, s")
    hold: Positive = Field(
        60.0, description="Time without navigation or pictures that the autopilot is let hold its place, s"
    )
    lasting: NonNegative = Field(3.0, description="Time beyond the limit of wind or battery before it counts, s")
    degraded: Positive = Field(
        1.0,
        description="Time of degraded motion that ends a look, a descent or a landing; time with motion and pictures "
        "after which a hold ends, s",
    )
    degraded_height: NonNegative = Field(
        3.0, description="Height above the site below which it does not end a landing, where the autopilot holds, m"
    )
    unseen: int = Field(
        3, ge=1, description="Verdicts in a row that do not see the place whole and end a landing above that height"
    )
    unjudged: Positive = Field(5.0, description="Age of what the newest verdict saw that breaks a landing off, s")
    unchecked: Positive = Field(
        2.0,
        description="Way down at most below the height from which so many verdicts saw the place, m",
    )
    stale: Positive = Field(1.5, description="Age of the newest picture above which the camera counts as lost, s")
    landing_speed: Positive = Field(0.5, description="Speed of the touchdown, m/s")
    on_way: Positive = Field(0.4, description="Distance from its way, or its site, within which it comes down, m")
    off_way: Positive = Field(0.7, description="Distance from it beyond which it keeps its height again, m")
    aside_speed: Positive = Field(
        0.4,
        description="Speed sideways while it comes down, m/s, half of it at last: a jump of GPS must not rush it. "
        "An autopilot that lands by itself has its own",
    )
    abort_height: Positive = Field(
        1.5, description="Height above the site below which a landing is broken off only for people and cars, m"
    )
    stop_height: Positive = Field(1.0, description="Height above the site below which it is not broken off at all, m")
    unmapped: Fraction = Field(
        0.05, description="Share of the ground that may be unmapped below a way longer than the approach height"
    )
    rise: Positive = Field(
        3.0, description="Height above the ground about it from which what is in doubt may be a tree, m"
    )
    risen: NonNegative = Field(1.0, description="Area of this below a way that may be flown low, m^2")
    fence_margin: NonNegative = Field(
        2.0, description="Least distance between the vehicle's disc and the autopilot's fence, m; half of it on the way"
    )
    arrived: Positive = Field(1.0, description="Distance within which a way-point is reached, m")
