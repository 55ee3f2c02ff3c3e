"""Select the usable heights, bridging small gaps of doubtful ones (G0)."""

from __future__ import annotations

import numpy as np

from alight.arrays import F32, Mask
from alight.raster import LEAST_SHARE, close_mask, weighted_gaussian
from alight.records import ElevationMap, Flag
from alight.settings import HazardsSettings, Lander

_NEVER = np.uint16(Flag.UNSEEN | Flag.MOVING | Flag.RANGE)  # no height, or one that cannot be right
ABOUT = 0.5  # metres, 1-sigma of the window of the trusted ground about a height
_PLAIN = np.uint16(Flag.TEXTURE | Flag.SATURATED)  # no texture: an obstacle would stand out against it


def _with_gaps(known: Mask, reach_cells: float) -> Mask:
    """Known cells, and gaps between them that are narrower than twice the reach."""
    n = int(reach_cells + 1e-6)
    if n < 1:
        return known
    return close_mask(known, n)


def usable_height(elevation: ElevationMap, lander: Lander, settings: HazardsSettings) -> F32:
    """Usable heights, about their own median (float32 keeps its digits there), NaN elsewhere (G0).

    These are the trusted heights, and doubtful ones in gaps narrower than twice `settings.bridge` that agree with the
    trusted ones beside them to half the height that the lander stands: an ambiguous match that lies on the ground
    around it. On the rendered sample flight 0.15 m finds a quarter more of the safe ground at the same false-safe rate;
    0.25 m quadruples that rate (a tree crown matched at ground level is let in).
    """
    known = elevation.trusted
    if not known.any():
        return np.full(elevation.grid.shape, np.nan, dtype=np.float32)
    height = elevation.height - np.float32(np.median(elevation.height[known]))
    usable = np.isfinite(height) & ((elevation.flags & _NEVER) == 0)
    plain = usable & ((elevation.flags & _PLAIN) != 0)
    for reach, where in (
        (settings.bridge, usable & ((elevation.flags & np.uint16(Flag.SATURATED)) == 0)),
        (settings.bridge_plain, plain),
    ):
        cells = reach / elevation.grid.cell
        if cells >= 1:
            gap = _with_gaps(known, cells) & ~known & where
            near = weighted_gaussian(height, known.astype(np.float32), cells)
            neighbours = np.where(near.share > LEAST_SHARE, near.mean, np.float32(np.nan))
            agrees = np.abs(height - neighbours) <= 0.5 * lander.tallest_obstacle
            known = known | (gap & agrees)
    return np.where(known, height, np.float32(np.nan))


def measured_height(elevation: ElevationMap, lander: Lander, settings: HazardsSettings) -> F32:
    """Measured heights (R, C), doubtful ones as well, as evidence of obstacles, metres (G7f).

    A vague one counts in full where it stands out by several of its sigmas from the trusted ground about it; else it
    counts as one sigma nearer to that ground, and as not measured, NaN, within one sigma.
    """
    vague = elevation.sigma > np.float32(settings.vague * lander.tallest_obstacle)
    known = elevation.trusted
    if not vague.any() or not known.any():
        return np.where(vague, np.float32(np.nan), elevation.height)
    middle = np.float32(np.median(elevation.height[known]))
    ground = weighted_gaussian(elevation.height - middle, known.astype(np.float32), ABOUT / elevation.grid.cell)
    about = np.where(ground.share > LEAST_SHARE, ground.mean + middle, np.float32(np.nan))
    off = elevation.height - about
    vague &= ~(np.abs(off) > np.float32(settings.stands_out) * elevation.sigma)
    above = np.abs(off) - elevation.sigma
    least = np.where(above > 0, about + np.copysign(above, off), np.float32(np.nan))
    return np.where(vague, least, elevation.height)


def smoothed_height(height: F32, cell: float, sigma: float) -> F32:
    """Heights (R, C) smoothed by `sigma` metres, NaN where unknown: their largest deviation is less noise."""
    known = np.isfinite(height)
    mean = weighted_gaussian(height, known.astype(np.float32), max(sigma / cell, 0.3)).mean
    return np.where(known, mean, np.float32(np.nan))
