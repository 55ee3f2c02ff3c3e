"""Verdicts for the executive, in the frame of their map."""

from __future__ import annotations

import numpy as np

from alight.geometry import Grid
from alight.pipeline import Verdict
from alight.pipeline.map_frame import MapFrame
from alight.records.executive import LookPicture, LookRecord, Seen


def look_picture(look: LookRecord, seen: Seen, reach: float = 5.0, size: int = 200) -> LookPicture:
    """The ground about the place of a look, `reach` metres each way, on `size` pixels a side."""
    cell, (east, north, _) = 2 * reach / size, look.place
    edge = reach - cell / 2  # the middle of the first pixel
    shown = Grid(east - edge, north + edge, cell, size, size)
    photo = seen.elevation.grid.nearest_on(shown, seen.elevation.rgb)
    return LookPicture(look, photo, seen.hazards.grid.nearest_on(shown, seen.hazards.p_safe), reach)


def as_seen(verdict: Verdict, number: int, t: float) -> Seen:
    """Return a verdict in the frame of its map, for the executive.

    Args:
        verdict: in the world.
        number: of the verdict, rising.
        t: s, of the newest exposure that its map holds.
    """
    frame = verdict.frame
    back = MapFrame(frame.frame_id, -frame.offset_world, frame.covariance)
    elevation = back.elevation(verdict.elevation)
    heights = elevation.height[elevation.trusted]
    ground = float(np.median(heights)) if heights.size else 0.0
    return Seen(number, t, frame.frame_id, back.sites(verdict.sites), back.on_grid(verdict.danger), elevation, ground)
