"""Choice of the points of an adjustment that count for the ground height."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from alight.arrays import F64, I64, Mask

SURE = 3  # photos whose rays meet in a point: a wrong match of two gives any height along a ray
NEAREST = 8  # number of these points that a point of two photos is compared with
BEYOND = 0.1  # of the height of the cameras above ground: margin by which it may lie beyond all of them
ENOUGH = 100  # points of three photos; with fewer, all points count


def confirmed(points: F64, photos: I64, above: float) -> Mask:
    """True for points (m, 3) seen by three photos or more, and for others about as high as such points near by.

    Two photos of a wood match many different leaves, and whole groups of wrong matches agree by chance. Their
    heights, tens of metres off, would be searched in every tile about them.

    Args:
        points: metres.
        photos: (m,) number of photos that saw each.
        above: metres, height of the cameras above ground.
    """
    sure = photos >= SURE
    if sure.sum() < ENOUGH:
        return np.ones(len(points), dtype=bool)
    _, near = cKDTree(points[sure, :2]).query(points[:, :2], NEAREST)
    z = points[sure, 2][near]
    margin = BEYOND * above
    return np.asarray(sure | ((points[:, 2] > z.min(axis=1) - margin) & (points[:, 2] < z.max(axis=1) + margin)))
