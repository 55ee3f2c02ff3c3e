"""How likely the cover of a whole footprint may be landed on (docs/method-hazards.md, G9c)."""

from __future__ import annotations

import cv2
import numpy as np
from scipy.special import expit, logit

from alight.hazards.contact import any_near
from alight.hazards.footprint import disc_mask, disc_spans
from alight.records import F32

# log odds that a footprint holds nothing else, nearer than 0.3 m to its rim and larger than 0.1 m^2: constant, and per
# log odds of its most doubtful cell; fitted to what the rest of P calls likely on tuning flights
# (bench/bench_terrain.py footprint)
ODDS = (3.4, 2.2)
LEAST = 1e-4


def worst_odds(landable: F32, radius: float, cell: float) -> F32:
    """Log odds of the most doubtful cell of the disc about every cell; cells without evidence doubt nothing."""
    odds = logit(np.where(np.isfinite(landable), landable, 1).clip(LEAST, 1 - LEAST)).astype(np.float32)
    disc = disc_mask(disc_spans(radius / cell))
    return np.asarray(cv2.erode(odds, disc, borderType=cv2.BORDER_CONSTANT, borderValue=1e3), np.float32)


def cover_probability(landable: F32, radius: float, cell: float) -> F32:
    """P(everything in the footprint is ground that may be landed on), (R, C); no evidence counts as sure.

    Args:
        landable: (R, C) probability of each cell, NaN where there is no evidence.
        radius: metres, of the footprint.
        cell: metres.
    """
    looked = any_near(np.isfinite(landable), radius, cell)
    p = expit(np.float32(ODDS[0]) + np.float32(ODDS[1]) * worst_odds(landable, radius, cell))
    out: F32 = np.where(looked, p, 1).astype(np.float32)
    return out
