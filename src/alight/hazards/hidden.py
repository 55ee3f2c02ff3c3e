"""What a matching window flattens: rocks and tufts too small for the heights, betrayed by their shadows (G9b)."""

from __future__ import annotations

import cv2
import numpy as np

from alight.hazards.footprint import disc_mask, disc_spans
from alight.records import F32, ElevationMap

SURROUNDINGS = 0.25  # metres, 1-sigma of the brightness that a spot is compared with
# log odds that nothing higher than the limit stands in a footprint: constant, per e-fold of the deviation over the
# limit, per e-fold of the darkness; fitted to four simulated flights (bench/bench_ground.py odds)
ODDS = (-5.55, -2.66, -2.90)
LEAST_DEVIATION, LEAST_DARKNESS = 0.03, 0.01  # of the limit; in log brightness: below, they tell nothing


def _blur(values: F32, weight: F32, sigma: float) -> F32:
    """Gaussian mean of what is seen."""
    total = cv2.GaussianBlur(values * weight, (0, 0), sigma)
    out: F32 = total / np.maximum(cv2.GaussianBlur(weight, (0, 0), sigma), np.float32(1e-3))
    return out


def darkest_near(elevation: ElevationMap, radius: float) -> F32:
    """How much darker than its surroundings the darkest spot of the disc about every cell is, in log brightness."""
    cell = elevation.grid.cell
    seen = (elevation.views > 0).astype(np.float32)
    log_brightness = np.log1p(elevation.rgb.mean(axis=2, dtype=np.float32))
    spot = (log_brightness - _blur(log_brightness, seen, SURROUNDINGS / cell)) * seen
    dark = -cv2.GaussianBlur(spot, (0, 0), 1.0)
    near = cv2.dilate(dark, disc_mask(disc_spans(radius / cell)), borderType=cv2.BORDER_CONSTANT, borderValue=0)
    return np.maximum(np.asarray(near, dtype=np.float32), np.float32(0))


def hidden_terms(elevation: ElevationMap, roughness: F32, limit: float, radius: float) -> tuple[F32, F32]:
    """What the odds depend on, (R, C) each: log of the deviation over the limit, log of the darkness."""
    rough: F32 = np.log(np.maximum(roughness / np.float32(limit), np.float32(LEAST_DEVIATION)))
    dark: F32 = np.log(np.maximum(darkest_near(elevation, radius), np.float32(LEAST_DARKNESS)))
    return rough, dark


def nothing_hidden(elevation: ElevationMap, roughness: F32, limit: float, radius: float) -> F32:
    """P(nothing in the footprint rises above the limit that the heights do not show), (R, C) (G9b).

    Args:
        elevation: heights from matched images, with what the cameras saw.
        roughness: (R, C) metres, largest deviation from the footprint's plane as the heights show it.
        limit: metres, the deviation or rise that is allowed.
        radius: metres, of the footprint.
    """
    rough, dark = hidden_terms(elevation, roughness, limit, radius)
    odds = np.float32(ODDS[0]) + np.float32(ODDS[1]) * rough + np.float32(ODDS[2]) * dark
    out: F32 = (1 / (1 + np.exp(-odds))).astype(np.float32)
    return out
