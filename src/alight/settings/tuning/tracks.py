"""Tuning of the feature tracks."""

from __future__ import annotations

from pydantic import Field

from alight.settings.base import Fraction, FrozenModel, NonNegative, Positive


class TracksTuning(FrozenModel):
    """Constants of the feature tracks, in time and between the cameras of a rig."""

    count: int = Field(250, ge=8, description="Features kept, spread over a grid of as many cells")
    window_px: int = Field(21, ge=5, description="Side of the matching window (SSD), px")
    levels: int = Field(4, ge=1, le=8, description="Levels of the image pyramid")
    search_px: Positive = Field(
        40.0,
        description="Largest distance of a match from the predicted place; predicted mean motion from which the common "
        "error of the prediction is found first, px",
    )
    search_sigmas: Positive = Field(
        4.0, description="The same limit in sigmas of the predicted place, where its covariance is known"
    )
    search_sigma_px: Positive = Field(0.75, description="Least 1-sigma of the predicted place, and of a parallax, px")
    forward_backward_px: Positive = Field(0.5, description="Largest distance after matching forward and backward, px")
    texture: Positive = Field(
        2e-4, description="Least Shi-Tomasi response of a feature (smaller eigenvalue per pixel, grey range 1)"
    )
    most_in_cell: int = Field(3, ge=1, description="Features kept in one cell of the grid; the oldest stay")
    close_px: Positive = Field(
        1.5,
        description="Distance over which a patch finds its feature; largest distance of a match from the epipolar "
        "line; last error of the prediction (90 %) below which patches alone are enough, px",
    )
    sure_px: Positive = Field(
        5.0, description="Last error of the prediction (90 %) from which patches are not compared across views, px"
    )
    depth_parallax_px: Positive = Field(
        10.0, description="Parallax from which a motion gives the depth of a feature, px"
    )
    depth_step: Positive = Field(0.12, description="Step of the search for a common depth, natural logarithm")
    patch_span: Fraction = Field(
        0.125, description="Motion after which a feature takes a new reference patch, share of the image width"
    )
    patch_correlation: Fraction = Field(0.8, description="Least correlation of a feature with its reference patch")
    same_gain: NonNegative = Field(
        0.05, description="Relative change of contrast and brightness between two images that is not equalised"
    )
    least_overlap: Fraction = Field(
        0.2,
        description="Least share of an image that two whole images have in common; share of features found below which "
        "the prediction is doubted",
    )
