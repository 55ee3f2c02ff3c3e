"""Tuning of the hazard judgement."""

from __future__ import annotations

from pydantic import Field

from alight.settings.base import Fraction, FrozenModel, Gap, NonNegative, Part, Positive, Vehicle


class SharpenTuning(FrozenModel):
    """Constants for sharpening heights by the shading of an image with finer pixels ('alight hazards --image')."""

    least_explained: Fraction = Field(
        0.5, description="Least share of the image's variance that shading explains; below, the image is not used"
    )
    shade_floor: Positive = Field(0.0075, description="Least 1-sigma of the shading model over the sun's brightness")
    bend: Positive = Field(0.4, description="1-sigma of the Laplacian of the heights over a pixel, m")


class HazardsTuning(FrozenModel):
    """Constants of the hazard judgement."""

    unknown_share: Fraction = Field(0.02, description="Largest share of the footprint that was never seen")
    doubtful_share: Fraction = Field(
        0.35, description="Largest share of the footprint without a height that can be trusted"
    )
    bridge: Gap = Field(
        0.15, description="Half the width of gaps across which doubtful heights count if they agree with the rim, m"
    )
    bridge_plain: Gap = Field(0.75, description="The same where the image is plain (little texture, glare), m")
    min_landable: Fraction = Field(
        0.2, description="Least probability of landable ground; below it the cell is refused, above it P weighs it"
    )
    tilt_sigma: NonNegative = Field(
        0.0,
        description="1-sigma of a common tilt of the map, rad, added to that of its poses: for maps from elsewhere",
    )
    noise_length: Part = Field(0.6, description="Distance over which neighbouring heights share their noise, m")
    smoothed: bool = Field(
        True, description="The heights come from matched images, which flatten small obstacles: P is lowered for it"
    )
    traffic_memory: NonNegative = Field(
        120.0, description="Time for which paved ground is refused after something moved across it, s; 0: it is not"
    )
    traffic_margin: NonNegative = Field(1.0, description="Distance from the footprint to such ground that is wanted, m")
    traffic_height: Positive = Field(
        5.0, description="Height above the ground from which what moves is noted: below it pictures show too little, m"
    )
    came_memory: NonNegative = Field(
        15.0, description="Time for which ground is refused after somebody came to stand on it in the pictures, s"
    )
    patch_length: Positive = Field(0.15, description="Radius of the patches whose brightness is compared, m")
    patch_contrast: Positive = Field(
        0.4, description="Difference of their log brightness that costs as much quality as a slope at its limit"
    )
    hidden_hazard: Fraction = Field(0.25, description="Probability that a footprint that was never seen hides a hazard")
    unseen_bare: NonNegative = Field(
        0.03, description="Obstacles above the limit that bare ground and short grass may have unseen at first, 1/m^2"
    )
    unseen_paved: NonNegative = Field(0.015, description="The same of paved ground, 1/m^2")
    unseen_unknown: NonNegative = Field(0.06, description="The same where the kind of ground is not known, 1/m^2")
    enclosed_hazard: NonNegative = Field(
        1.5, description="Hazards that a level surface below both its banks is expected to hold: water under algae"
    )
    novel_hazard: NonNegative = Field(
        0.3, description="Hazards expected for every limit by which ground is more unlike all known ground than usual"
    )
    unchecked_hazard: NonNegative = Field(
        0.02,
        description="Hazards expected of a footprint that no colour can refuse, in grey pictures, or if no measured "
        "attitude shows whether the map is level",
    )
    one_camera_hazard: NonNegative = Field(
        0.01, description="The same where one camera sees the ground: no second one shows what moves"
    )
    clearly_sigmas: NonNegative = Field(
        2.0, description="Sigmas by which averaged heights must exceed the limit of roughness to be refused at once"
    )
    surely_sigmas: NonNegative = Field(
        4.0, description="The same for single heights; a vague one that stands out by as many counts in full"
    )
    vague: Positive = Field(
        1.5,
        description="Sigma over the limit of roughness from which a height is lowered by one sigma towards the ground",
    )
    even_length: Vehicle = Field(0.2, description="1-sigma of the window of averaged heights, m")
    broad_length: Vehicle = Field(0.45, description="1-sigma of the window of broadly averaged heights, m")
    sharpen: SharpenTuning = SharpenTuning()
