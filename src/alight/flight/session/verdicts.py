"""Verdicts for the executive, in the frame of their map."""

from __future__ import annotations

import numpy as np

from alight.geometry import Grid
from alight.pipeline import Verdict
from alight.records.executive import LookPicture, LookRecord, MapVerdict


def look_picture(look: LookRecord, seen: MapVerdict, reach: float = 5.0, size: int = 200) -> LookPicture:
    """The ground about the place of a look, `reach` metres each way, on `size` pixels a side."""
    cell, (east, north, _) = 2 * reach / size, look.place
    edge = reach - cell / 2  # the middle of the first pixel
    shown = Grid(east - edge, north + edge, cell, size, size)
    photo = seen.elevation.grid.nearest_on(shown, seen.elevation.rgb)
    return LookPicture(look, photo, seen.hazards.grid.nearest_on(shown, seen.hazards.p_safe), reach)


def for_executive(verdict: Verdict, number: int, t: float) -> MapVerdict:
    """The part of a verdict that the executive decides by, in the frame of its map.

    Args:
        verdict: in the frame of its map.
        number: of the verdict, rising.
        t: s, of the newest exposure that its map holds.
    """
    heights = verdict.elevation.height[verdict.elevation.trusted]
    ground = float(np.median(heights)) if heights.size else 0.0
    return MapVerdict(
        number, t, verdict.frame.frame_id, verdict.sites, verdict.hazards, verdict.elevation, ground
    )  # fmt: skip
