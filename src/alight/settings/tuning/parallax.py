"""Tuning of planar parallax (docs/lab/tuning-constants.md)."""

from __future__ import annotations

from pydantic import Field

from alight.settings.base import FrozenModel, Positive


class ParallaxTuning(FrozenModel):
    """Planar parallax on the world grid."""

    views: int = Field(16, ge=2, le=32, description="Most views that a cell uses (batch)")
    ring: int = Field(7, ge=3, le=16, description="Keyframes held (recursive)")
    keyframe_baseline: Positive = Field(0.02, description="Baseline between keyframes over the height above ground")
