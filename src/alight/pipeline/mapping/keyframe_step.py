"""The step from one keyframe to the next, in both ways of mapping."""

from __future__ import annotations

from alight.records import Motion
from alight.settings import ParallaxSettings

NO_HEIGHT = "no height could be measured: no place was seen by two views"


def keyframe_step(motion: Motion, ground: float | None, settings: ParallaxSettings) -> float:
    """The baseline from one keyframe to the next, metres, at the motion's height above the ground."""
    above = motion.world_from_body.translation[2] - (ground or 0.0)
    return float(settings.keyframe_baseline * max(above, 1.0))
