"""How likely the cover of a whole footprint may be landed on (docs/method-hazards.md, G9c)."""

from __future__ import annotations

import cv2
import numpy as np
from scipy.special import expit, logit

from alight.hazards.footprint import disc_mask, disc_spans
from alight.records import F32

# log odds that a footprint holds nothing but ground that may be landed on: constant, and per log odds of its most
# doubtful cell; fitted to what was not refused on simulated tuning flights (bench/bench_terrain.py footprint)
ODDS = (2.7, 1.8)
LEAST = 1e-4


def cover_probability(landable: F32, radius: float, cell: float) -> F32:
    """P(everything in the footprint is ground that may be landed on), (R, C); no evidence counts as sure.

    Args:
        landable: (R, C) probability of each cell, NaN where there is no evidence.
        radius: metres, of the footprint.
        cell: metres.
    """
    odds = logit(np.where(np.isfinite(landable), landable, 1).clip(LEAST, 1 - LEAST)).astype(np.float32)
    worst = cv2.erode(odds, disc_mask(disc_spans(radius / cell)), borderType=cv2.BORDER_CONSTANT, borderValue=1e3)
    sure = cv2.dilate(np.isfinite(landable).astype(np.uint8), disc_mask(disc_spans(radius / cell))) == 0
    out: F32 = np.where(sure, 1, expit(np.float32(ODDS[0]) + np.float32(ODDS[1]) * worst)).astype(np.float32)
    return out
