"""Grey-scale and binary morphology with OpenCV's elliptic structuring element (narrower than a true disc at its ends).

The exact disc of a lander's footprint is `disc.disc_mask`.
"""

from __future__ import annotations

import cv2
import numpy as np

from alight.arrays import F32, U8, Mask


def ellipse(reach: int) -> U8:
    """The structuring element (2 reach + 1, 2 reach + 1) of ones and zeros; `reach` in cells."""
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1)), np.uint8)


def close_mask(mask: Mask, reach: int) -> Mask:
    """Binary closing: the mask with its gaps filled that are narrower than twice the reach, cells."""
    closed = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, ellipse(reach), borderValue=0)
    return np.asarray(closed > 0)


def grow(mask: Mask, reach: int) -> Mask:
    """Binary dilation by `reach` cells."""
    return np.asarray(cv2.dilate(mask.astype(np.uint8), ellipse(reach)) > 0)


def fill_pits(values: F32, width: int) -> F32:
    """Grey-scale closing: raise low areas that are narrower than `width` cells.

    An element of even width has no middle: it is anchored at opposite corners, so that nothing shifts.
    """
    if width % 2:
        return np.asarray(cv2.morphologyEx(values, cv2.MORPH_CLOSE, ellipse(width // 2)), np.float32)
    square = np.ones((width, width), np.uint8)
    raised = cv2.dilate(values, square, anchor=(0, 0))
    return np.asarray(cv2.erode(raised, square, anchor=(width - 1, width - 1)), np.float32)


def local_max(values: F32, reach: int) -> F32:
    """Grey-scale dilation: the largest value within `reach` cells."""
    return np.asarray(cv2.dilate(values, ellipse(reach)), np.float32)


def without_specks(mask: Mask, cell: float, least: float, neighbours: int = 8) -> Mask:
    """Drop connected patches of less than `least` square metres; `cell` in metres, `neighbours` of a cell: 4 or 8."""
    labels, stats = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=neighbours)[1:3]
    big = stats[:, cv2.CC_STAT_AREA] * cell**2 >= least
    big[0] = False
    return np.asarray(big[labels])
