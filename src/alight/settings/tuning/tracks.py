"""Tuning of the feature tracks (docs/lab/tuning-constants.md says where the values come from)."""

from __future__ import annotations

from pydantic import Field

from alight.settings.base import FrozenModel, Positive


class TracksTuning(FrozenModel):
    """Feature tracks, in time and between the cameras of a rig."""

    count: int = Field(250, ge=8, description="Features kept, spread over a grid of as many cells")
    window_px: int = Field(21, ge=5, description="Side of the matching window (SSD), px")
    levels: int = Field(4, ge=1, le=8, description="Levels of the image pyramid")
    search_px: Positive = Field(40.0, description="Largest distance of a match from the predicted place, px")
    search_sigmas: Positive = Field(
        4.0, description="The same limit in sigmas of the predicted place, where its covariance is known"
    )
    search_sigma_px: Positive = Field(0.75, description="Least 1-sigma of the predicted place, px")
    forward_backward_px: Positive = Field(0.5, description="Largest distance after matching forward and backward, px")
    epipolar_px: Positive = Field(1.5, description="Largest distance of a match from the epipolar line, px")
    texture: Positive = Field(
        2e-4, description="Least Shi-Tomasi response of a feature (smaller eigenvalue per pixel, grey range 1)"
    )
