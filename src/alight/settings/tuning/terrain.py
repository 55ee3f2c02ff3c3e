"""Tuning of the land cover."""

from __future__ import annotations

from pydantic import Field

from alight.settings.base import Fraction, FrozenModel, NonNegative, Positive


class TerrainTuning(FrozenModel):
    """Constants of the land cover."""

    appearance: Fraction = Field(
        0.5, description="Weight of the model of appearance: neighbouring pixels are not independent"
    )
    block: Positive = Field(0.5, description="Side of the blocks on which the shape of the ground is judged, m")
    cell: Positive = Field(0.2, description="Cells up to which finer ones are joined before they are classified, m")
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
    tall: Positive = Field(
        1.5, description="Height above the ground from which plants are a tree, and a roof is one, m"
    )
    beside_tall: Fraction = Field(
        0.27, description="Largest probability of landable ground within the safety distance around tall objects"
    )
    pond_share: Fraction = Field(
        0.2, description="Least share of a patch that looks like water and is water on its own evidence"
    )
    water_slope: Positive = Field(0.04, description="Steepest slope over 1.5 m that the surface of water seems to have")
    water_area: Positive = Field(
        10.0, description="Least area of a level surface that may be water, and of its rim that is seen, m^2"
    )
    water_bank: Positive = Field(0.12, description="Height above a level surface from which its rim is a bank, m")
    rim: tuple[float, float] = Field(
        (0.5, 0.8),
        description="Shares of the rim that are bank, or lower, at which a surface is not and is water, or a roof",
    )
    roof_area: tuple[float, float] = Field((6.0, 2000.0), description="Least and largest area of a flat roof, m^2")
    water_level: tuple[float, float] = Field(
        (0.006, 0.015),
        description="Slopes of a whole surface, beyond the tilt of the map, at which it is and is not level",
    )
    water_even: tuple[float, float] = Field(
        (0.04, 0.10), description="Deviations from its plane at which a surface is and is not even, m"
    )
    road_widths: tuple[float, ...] = Field(
        (2.5, 3.5, 5.0, 7.0, 10.0), description="Widths of strips that may be a road: a path to three lanes, m"
    )
    road_length: Positive = Field(
        20.0, description="Length over which a strip must go on; a road is half as long again, m"
    )
    road_tints: tuple[float, float, float] = Field(
        (0.06, 0.012, 0.012), description="Noise of log brightness, coolness and greenness of ground, 1-sigma"
    )
    road_unlike: tuple[float, float] = Field(
        (0.28, 0.48),
        description="Shares of the variance between a strip and its sides at which it may be and is a road",
    )
    car_height: tuple[float, float] = Field((0.8, 2.5), description="Least and largest height of a standing car, m")
    car_sides: tuple[tuple[float, float], tuple[float, float]] = Field(
        ((1.3, 3.0), (3.0, 7.0)), description="Least and largest width of a standing car, and the same of its length, m"
    )
