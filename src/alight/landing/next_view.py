"""The next view: from where an undecided place should be seen again."""

from __future__ import annotations

import cv2
import numpy as np

from alight.raster import disc_window
from alight.records import ElevationMap, Hazard, HazardMap, NextView
from alight.settings import Lander, SitesSettings


def next_view(
    hazards: HazardMap, elevation: ElevationMap, settings: SitesSettings, lander: Lander, height_above_ground: float
) -> NextView | None:
    """Propose a view of the most promising undecided place: straight above it, and nearer than the last.

    The most promising place is refused by no limit and has the highest mean P(safe) over a footprint. `nearer` of the
    height shrinks the pixel, the noise of heights and the size of what matching flattens alike.

    Args:
        hazards: of the last map.
        elevation: heights, on the same grid.
        settings: how much nearer.
        lander: its footprint.
        height_above_ground: metres, from where the map was seen.

    Returns:
        The view, or None where every place is refused for good or one is safe already.
    """
    undecided = (hazards.reasons == Hazard.DOUBT) & np.isfinite(hazards.p_safe)
    if (hazards.reasons == 0).any() or not undecided.any():
        return None
    p = np.where(undecided, hazards.p_safe, np.float32(0))
    side = 2 * max(1, round(lander.radius / hazards.grid.cell)) + 1
    around = cv2.blur(p, (side, side), borderType=cv2.BORDER_CONSTANT)
    row, col = divmod(int(np.argmax(np.where(undecided, around, -1.0))), p.shape[1])
    rows, cols, disc = disc_window(p.shape, row, col, lander.radius / hazards.grid.cell)
    ground = elevation.height[rows, cols][disc & elevation.trusted[rows, cols]]
    if not ground.size:
        return None
    grid, up = hazards.grid, float(np.median(ground))
    place = np.array([grid.east + col * grid.cell, grid.north - row * grid.cell, up])
    height = max(settings.nearer * height_above_ground, settings.lowest_look)
    return NextView(place + np.array([0.0, 0.0, height]), place, float(p[row, col]), height)
