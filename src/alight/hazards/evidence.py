"""Evidence against a footprint: terms that are larger where it is less likely safe (docs/method/hazards.md, G7b)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.special import logit

from alight.arrays import F32
from alight.hazards.blob_contrast import blob_contrast
from alight.hazards.contact import Footprint
from alight.learned.terms import HazardTerm
from alight.raster import disc_max, disc_mean, log_at_least
from alight.records import ElevationMap, TerrainMap
from alight.settings import HazardsSettings, Lander

RIM = 0.25  # metres; an object this near to the rim may as well lie outside
BEYOND = 1.0  # metres past the rim that count: where tufts begin, there are more
MIN_PROBABILITY = 1e-4  # keeps log odds finite
MIN_TINT_CONTRAST = 0.01  # log ratio; keeps the ratio to the footprint's mean bounded
CERTAIN = np.float32(9.2)  # log odds of landable ground where no land cover was given


@dataclass(frozen=True, eq=False)
class FootprintShape:
    """Geometry of every footprint, (R, C) each."""

    footprint: Footprint
    roughness_smooth: F32  # metres, largest deviation of heights smoothed by 0.2 m
    roughness_trend: F32  # metres, of heights smoothed by 0.45 m
    rise_margin: F32  # (limit - deviation or rise) / sigma


def _in_sigmas(excess: F32, sigma: F32) -> F32:
    return np.asarray(excess / np.maximum(sigma, np.float32(0.005)), np.float32)


def hazard_odds(land_cover: TerrainMap | None, shape: tuple[int, int]) -> F32:
    """Log odds (R, C) against landable ground; a cell without a class counts as landable."""
    if land_cover is None:
        return np.full(shape, -CERTAIN, np.float32)
    landable = np.where(np.isfinite(land_cover.landable), land_cover.landable, 1.0)
    return np.asarray(-logit(landable.clip(MIN_PROBABILITY, 1 - MIN_PROBABILITY)), np.float32)


def coarseness(elevation: ElevationMap, lander: Lander) -> float:
    """Log of the finest pixel that there is over the height that matters."""
    factor = elevation.finest[1]
    limit = lander.max_roughness if lander.belly_clearance is None else lander.belly_clearance
    return math.log(elevation.grid.cell / factor / limit)


def unresolved(elevation: ElevationMap, lander: Lander, settings: HazardsSettings) -> float:
    """P(an obstacle above the limit is below the resolution): 0 up to `resolved_share`, at most `hidden_hazard`."""
    excess = coarseness(elevation, lander) - math.log(settings.resolved_share)
    return settings.hidden_hazard * min(max(excess / math.log(4.0), 0.0), 1.0)


def hazard_terms(
    elevation: ElevationMap, land_cover: TerrainMap | None, shape: FootprintShape, lander: Lander
) -> dict[str, F32]:
    """Evidence against every footprint, (R, C) each, in the order of `HazardTerm`."""
    cell, radius, limit = elevation.grid.cell, lander.radius, lander.max_roughness
    inner = radius - min(RIM, radius / 4)
    odds = hazard_odds(land_cover, elevation.grid.shape)
    odds_smooth = np.asarray(cv2.GaussianBlur(odds, (0, 0), max(0.2 / cell, 0.5)), np.float32)
    sigma = np.nan_to_num(elevation.sigma, nan=1.0)
    blobs = blob_contrast(elevation)
    tint_mean = disc_mean(blobs["tint"], radius, cell) + np.float32(MIN_TINT_CONTRAST)
    residual = np.nan_to_num(elevation.residual)
    return {
        HazardTerm.COARSENESS: np.full(elevation.grid.shape, coarseness(elevation, lander), np.float32),
        HazardTerm.DEVIATION_SIGMAS: -shape.rise_margin,
        HazardTerm.ROUGHNESS_SMOOTH: log_at_least(shape.roughness_smooth / np.float32(limit), 0.03),
        HazardTerm.ROUGHNESS_TREND: log_at_least(shape.roughness_trend / np.float32(limit), 0.03),
        HazardTerm.EXCESS_SIGMAS: _in_sigmas(
            shape.roughness_smooth - np.float32(limit), disc_mean(sigma, radius, cell)
        ),
        HazardTerm.UNKNOWN: shape.footprint.unknown,
        HazardTerm.RESIDUAL_MEAN: disc_mean(residual, radius, cell),
        HazardTerm.RESIDUAL_WORST: disc_max(cv2.GaussianBlur(residual, (0, 0), 1.0), inner, cell),
        HazardTerm.COVER_WORST: disc_max(odds, inner, cell),
        HazardTerm.COVER_WORST_SMOOTH: disc_max(odds_smooth, inner, cell),
        HazardTerm.COVER_MEAN: disc_mean(odds, radius, cell),
        HazardTerm.COVER_WORST_BEYOND: disc_max(odds_smooth, radius + BEYOND, cell),
        HazardTerm.COVER_MEAN_BEYOND: disc_mean(odds_smooth, radius + 3 * BEYOND, cell),
        HazardTerm.BLOB_DARK: disc_max(blobs["dark"], inner, cell),
        HazardTerm.BLOB_BRIGHT: disc_max(blobs["bright"], inner, cell),
        HazardTerm.BLOB_TINT: np.log(disc_max(blobs["tint"], inner, cell) / tint_mean + np.float32(0.1)),
    }
