"""Tuning of the bundle adjustment of photos (docs/lab/tuning-constants.md)."""

from __future__ import annotations

from pydantic import Field

from alight.settings.base import FrozenModel, NonNegative, Positive


class BundleTuning(FrozenModel):
    """Bundle adjustment of photos taken far apart."""

    features: int = Field(4000, ge=200, description="SIFT features in each photo")
    image_px: int = Field(1600, ge=400, description="Longest side of the images on which features are found, px")
    neighbours: int = Field(
        10, ge=2, description="Nearest photos with which each photo is matched, besides one in each direction"
    )
    matches: int = Field(20, ge=8, description="Least matches of a pair of photos after two-view geometry")
    observations: int = Field(4000, ge=50, description="Observations of each photo in the adjustment")
    attitude_sigma: Positive = Field(0.05, description="1-sigma of the roll and pitch of the gimbal, rad")
    heading_sigma: Positive = Field(0.15, description="1-sigma of the heading of the gimbal, rad")
    mounting_sigma: NonNegative = Field(
        0.03, description="1-sigma of the mounting of the camera on the gimbal, rad; 0: as calibrated"
    )
    position_sigma: Positive = Field(3.0, description="1-sigma of the GPS position where a photo states none, m")
