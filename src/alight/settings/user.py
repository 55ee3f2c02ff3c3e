"""Settings for users: few keys, each with a description and a unit. No run needs any of them to be set."""

from __future__ import annotations

import math
from itertools import combinations
from typing import Literal

from pydantic import Field, model_validator

from alight.settings.base import (
    Finite,
    Fraction,
    FrozenModel,
    Incline,
    NonNegative,
    Offset,
    Part,
    Positive,
    Seconds,
    Vehicle,
)


class SourcesKeys(FrozenModel):
    """Settings for reading the recording."""

    calibration: str | None = Field(
        None,
        coerce_numbers_to_str=True,
        description="Kalibr camchain.yaml that replaces the calibration of the recording, or the focal length of its "
        "photos, pixels; null: none",
    )
    skip: int = Field(0, ge=0, le=10**9, description="Number of exposures left out at the start")
    every: int = Field(1, ge=1, le=10**9, description="Use every n-th exposure")
    rate: Positive | None = Field(None, description="Frames a second, where frames have no times; null: they have")
    time_offset: float | None = Field(
        None,
        allow_inf_nan=False,
        description="Time by which the stamps of frames are ahead of the autopilot's log, or of a film's "
        "telemetry, s; null: found from the pictures",
    )
    separation: float | None = Field(
        None,
        ge=-120.0,  # no geoid is farther from the ellipsoid
        le=120.0,
        description="Ellipsoid above sea level, for the heights of an autopilot's log, m; null: the receiver's",
    )


class FilterKeys(FrozenModel):
    """Settings for the clock and mounting of the cameras, used for flights."""

    mounting_sigma: NonNegative | None = Field(
        None,
        description="1-sigma of the rotation between cameras and GPS/INS that the calibration leaves open, rad; "
        "0: exactly as calibrated; null: 0.03 for photos, 0 for flights",
    )
    time_offset: Finite = Field(
        0.0, description="Known time by which the camera stamps are ahead of the GPS/INS and IMU clock, s"
    )
    time_offset_sigma: Seconds = Field(0.0, description="1-sigma of that time, s; 0: it is known exactly")


class BundleKeys(FrozenModel):
    """Settings for the calibration of the camera, used for photos."""

    focal: Literal["held", "trusted", "free"] = Field(
        "held",
        description="Focal length: held at the calibration, trusted (held, although heights above take-off contradict "
        "it), or free (estimated; needs photos from several heights)",
    )
    lens: Literal["held", "free"] = Field(
        "free", description="Principal point and distortion: held at the calibration, or free (estimated)"
    )


class MotionKeys(FrozenModel):
    """Settings for the estimation of the camera poses."""

    method: Literal["auto", "filter", "bundle"] = Field(
        "auto",
        description="filter: exposure by exposure, for flights; bundle: all photos together; "
        "auto: the one that suits the recording",
    )
    given_position_sigma: NonNegative = Field(
        0.0,
        description="1-sigma of the position of poses given with --poses, m; above 0, recursive refines them",
    )
    given_attitude_sigma: NonNegative = Field(
        0.0, description="1-sigma of the attitude of poses given with --poses, rad"
    )
    filter: FilterKeys = FilterKeys()
    bundle: BundleKeys = BundleKeys()

    def bundles(self, kind: str) -> bool:
        """Whether all poses of a recording (`kind`: flight or photos) are adjusted together, at its end."""
        return self.method == "bundle" or (self.method == "auto" and kind == "photos")


class ParallaxKeys(FrozenModel):
    """Settings for the measurement of heights."""

    method: Literal["batch", "recursive"] = Field(
        "batch",
        description="batch: from all exposures at the end; recursive: step by step with every keyframe, as in flight",
    )
    quality: Literal["fast", "normal", "fine"] = Field(
        "normal",
        description="Cells of a map from all exposures at the end; fine: 1.8 pixels on the ground; normal: the same, "
        "no smaller than half of what the lander is judged on; fast: twice as large, no smaller than that",
    )
    cell: Positive | None = Field(None, description="Size of a cell of the map, m; null: by quality")
    height_range: tuple[Finite, Finite] | None = Field(
        None, description="Lowest and highest ground that is searched, m above the origin; null: found by itself"
    )
    store_mb: int = Field(
        1500,
        ge=64,
        le=10**6,
        description="Memory for the images of keyframes, MB; a long recording is mapped part by part",
    )

    @model_validator(mode="after")
    def _sound(self) -> ParallaxKeys:
        if self.height_range is not None and not self.height_range[0] < self.height_range[1]:
            raise ValueError("height_range: the lowest ground must lie below the highest")
        return self


class ElevationKeys(FrozenModel):
    """Settings of the height map."""

    max_sigma: Positive | None = Field(
        None, description="Heights with a larger 1-sigma are left out, m; null: 0.65 % of the height above ground"
    )
    most_cells: int = Field(
        16_000_000,
        ge=10_000,
        le=10**9,
        description="Most cells of the written rasters; a larger map is written with coarser cells",
    )


class TerrainKeys(FrozenModel):
    """Settings of the land cover."""

    enabled: bool = Field(True, description="Classify the ground and refuse water, plants, trees and structures")
    model: str | None = Field(
        "default",
        description="Model of what ground looks like: default, a file written by 'alight terrain train', "
        "or null (shape and colour of the map alone)",
    )


class Lander(FrozenModel):
    """The vehicle that lands: its size, its gear and its limits."""

    radius: Vehicle = Field(1.5, description="Radius of the footprint, m")
    max_slope: Incline = Field(math.radians(10.0), description="Steepest slope of the ground, rad")
    max_roughness: Vehicle = Field(0.15, description="Largest deviation of the ground from the footprint's plane, m")
    belly_clearance: Vehicle | None = Field(
        None,
        description="Clearance between the contact plane of feet or skids and the belly, m; null, or without gear: "
        "not judged",
    )
    feet: tuple[tuple[Offset, Offset], ...] | None = Field(
        None, description="Position (forward, left) of each foot from the centre, m; null: no feet"
    )
    foot_radius: Part = Field(0.0, description="Radius of a foot, m")
    foot_contact: Literal["highest", "mean"] = Field(
        "highest", description="A foot stands on the highest ground under it, or sinks in to the mean"
    )
    support: Literal["resting", "any"] = Field(
        "resting", description="Planes judged: those on which the lander can rest or rock, or any three feet (stricter)"
    )
    skids: tuple[Offset, Offset] | None = Field(
        None, description="Length of the skids and distance between them, m; null: no skids"
    )
    max_step: Vehicle | None = Field(
        None, description="Largest step between neighbouring cells, m; null: only the roughness counts"
    )
    rotor_radius: Vehicle | None = Field(
        None, description="Radius of the circle that the rotors sweep, m; null: the footprint"
    )
    rotor_rise: NonNegative = Field(
        0.3, description="Height to which the ground beside the footprint may rise under the rotors, m"
    )
    headings: int = Field(
        8, ge=1, le=72, description="Number of headings tried with feet or skids; the worst one counts"
    )

    @property
    def has_gear(self) -> bool:
        """Whether feet or skids are given; without them the lander stands on its whole footprint."""
        return self.feet is not None or self.skids is not None

    @property
    def ground_reach(self) -> float:
        """Distance from the centre within which the lander may touch the ground, with its footprint or gear, metres."""
        feet = max((math.hypot(*f) + self.foot_radius for f in self.feet or ()), default=0.0)
        skids = 0.5 * math.hypot(*self.skids) if self.skids else 0.0
        return max(self.radius, feet, skids)

    @property
    def reach(self) -> float:
        """Distance from the centre within which an object may touch the lander or its rotors, metres."""
        return max(self.ground_reach, self.rotor_radius or 0.0)

    @property
    def tallest_obstacle(self) -> float:
        """Height limit of obstacles under the lander, metres: the roughness limit, or the belly clearance with gear."""
        return self.belly_clearance if self.has_gear and self.belly_clearance is not None else self.max_roughness

    @property
    def judging_cell(self) -> float:
        """Largest cell size for judging the ground, metres; finer cells cost time and change no verdict."""
        return 0.7 * self.tallest_obstacle

    @model_validator(mode="after")
    def _sound(self) -> Lander:
        if self.feet is not None and self.skids is not None:
            raise ValueError("give feet or skids, not both")
        if self.skids is not None and min(self.skids) <= 0:
            raise ValueError("skids: length and distance must be above 0")
        spans = (  # twice the area of a triangle
            abs((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])) > 1e-6
            for a, b, c in combinations(self.feet or (), 3)
        )
        if self.feet is not None and not any(spans):
            raise ValueError("feet: needs three or more that are not in one line")
        return self


class HazardsKeys(FrozenModel):
    """Settings for the strictness of the hazard judgement."""

    p_safe: Fraction = Field(0.95, description="Least probability of a safe touchdown at a site")
    alpha: NonNegative = Field(1.0, description="Weight of flatness in the quality Q of a site (paper, eq. 5)")
    beta: NonNegative = Field(1.0, description="Weight of land cover in the quality Q of a site (paper, eq. 5)")
    usual_sigma: NonNegative = Field(
        0.03, description="1-sigma of the heights of a raster that does not state it ('alight hazards'), m"
    )


class SitesKeys(FrozenModel):
    """Settings for the list of sites."""

    count: int = Field(8, ge=1, le=10_000, description="Most sites listed")
    margin: NonNegative = Field(0.5, description="Least distance between the footprint and the nearest hazard, m")
    separation: Positive | None = Field(
        None, description="Least distance between two listed places, m; never below four footprint radii, null: those"
    )
    distance_weight: NonNegative = Field(0.0, description="Loss of quality per metre from the vehicle to the site, 1/m")
    every: int = Field(
        32,
        ge=0,
        le=10**9,
        description="Keyframes from one judgement to the next (parallax.method=recursive); 0: at the end; in flight as "
        "often as the computer can",
    )


class RouteKeys(FrozenModel):
    """Settings of the route to the best site."""

    approach_height: Positive = Field(10.0, description="Height above the site at which the final descent starts, m")
    clearance: Positive = Field(
        3.0,
        description="Least distance to everything above and beside the way, m. "
        "Beside the way down a route only warns of it; a landing in flight is broken off",
    )
    cruise_speed: Positive = Field(5.0, description="Speed on the way to the site, m/s")
    descent_speed: Positive = Field(1.0, description="Speed of the descent, m/s")
    wind: tuple[Offset, Offset] | None = Field(
        None,
        description="Wind of a recording's flight: m/s to the east and north, where the air goes; null: not known. "
        "In flight the autopilot reports it",
    )


class ExecutiveKeys(FrozenModel):
    """Settings of a landing in flight: search, look, look closer, land or go around."""

    search_height: Positive = Field(30.0, description="Height above the ground at which a place is searched, m")
    search_speed: Positive = Field(7.0, description="Speed over the ground while a place is searched, m/s")
    search_side: Positive = Field(80.0, description="Side of the square about the start that is searched, m")
    commit_height: Positive = Field(
        6.0,
        description="Height above the site of the last look; a place in doubt is looked at once more from "
        "`tuning.executive.nearest`, m",
    )
    look_again: bool = Field(
        True,
        description="Look again from lower heights, and during the descent; false: for comparison, land without a "
        "further look on the first site, or candidate of `tuning.executive.probable`, that is found",
    )
    time_budget: Positive = Field(300.0, description="Time after which a landing that is not begun is given up, s")
    least_battery: Fraction = Field(0.2, description="Share of the battery below which the vehicle returns")
    most_wind: Positive = Field(8.0, description="Wind above which it does not land, m/s")
