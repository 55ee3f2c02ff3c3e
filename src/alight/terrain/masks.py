"""Small things about masks: specks that do not count, gaps too narrow to stand in."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Bool = NDArray[np.bool_]


def without_specks(mask: Bool, cell: float, least: float = 0.1) -> Bool:
    """Drop patches of fewer square metres: the geometry judges what is that small."""
    labels, stats = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)[1:3]
    big = stats[:, cv2.CC_STAT_AREA] * cell**2 >= least
    big[0] = False
    return np.asarray(big[labels])


def close_mask(mask: Bool, cell: float, reach: float = 0.5) -> Bool:
    """Fill gaps narrower than twice the reach: there is nowhere to stand between two tufts."""
    n = max(1, round(reach / cell))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * n + 1, 2 * n + 1))
    return np.asarray(cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, disc, borderValue=0) > 0)


def without_pits(values: NDArray[np.float32], cell: float, reach: float = 0.15) -> NDArray[np.float32]:
    """Fill what is low and narrower than twice the reach: the geometry judges what is that small."""
    n = round(reach / cell)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * n + 1, 2 * n + 1))
    return np.asarray(cv2.morphologyEx(values, cv2.MORPH_CLOSE, disc), np.float32)
