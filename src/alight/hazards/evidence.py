"""What a footprint is judged by, each term larger where it is less likely safe (docs/method-hazards.md, G7b)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.special import logit

from alight.hazards.blob_contrast import blob_contrast
from alight.hazards.contact import Footprint
from alight.learned.terms import HazardTerm
from alight.raster import disc_max, disc_mean, log_at_least
from alight.records import F32, ElevationMap, TerrainMap
from alight.settings import HazardsSettings, Lander

INNER = 0.25  # metres: what lies that near to the rim may as well lie outside
BEYOND = 1.0  # metres past the rim: where tufts begin, there are more
LEAST = 1e-4  # probability
RESOLVED = 0.8  # of the limit, pixel: a stone as high is two of them wide
USUAL = 0.01  # of a tint, that no ground is evener than
SURE = np.float32(9.2)  # log odds: the cover where nobody judged it


@dataclass(frozen=True, eq=False)
class Shape:
    """What the geometry says of every footprint, (R, C) each."""

    footprint: Footprint
    even: F32  # metres, largest deviation of heights averaged over the noise's length
    broad: F32  # metres, of heights averaged over twice as much
    rise_margin: F32  # (limit - deviation or rise) / sigma


def _over(excess: F32, sigma: F32) -> F32:
    return np.asarray(excess / np.maximum(sigma, np.float32(0.005)), np.float32)


def doubt_of(terrain: TerrainMap | None, shape: tuple[int, int]) -> F32:
    """Log odds against ground that may be landed on; nothing is said of cells without evidence."""
    if terrain is None:
        return np.full(shape, -SURE, np.float32)
    landable = np.where(np.isfinite(terrain.landable), terrain.landable, 1.0)
    return np.asarray(-logit(landable.clip(LEAST, 1 - LEAST)), np.float32)


def coarseness(elevation: ElevationMap, lander: Lander) -> float:
    """Log of the finest pixel that there is over the height that matters."""
    factor = elevation.finest[1]
    limit = lander.max_roughness if lander.belly_clearance is None else lander.belly_clearance
    return math.log(elevation.grid.cell / factor / limit)


def unresolved(elevation: ElevationMap, lander: Lander, settings: HazardsSettings) -> float:
    """P(something too high is too small for the pixels): 0 up to `RESOLVED` of the limit, at most `hidden_hazard`."""
    excess = coarseness(elevation, lander) - math.log(RESOLVED)
    return settings.hidden_hazard * min(max(excess / math.log(4.0), 0.0), 1.0)


def hazard_terms(elevation: ElevationMap, terrain: TerrainMap | None, shape: Shape, lander: Lander) -> dict[str, F32]:
    """Evidence against every footprint, (R, C) each, in the order of `HazardTerm`."""
    cell, radius, limit = elevation.grid.cell, lander.radius, lander.max_roughness
    inner = radius - min(INNER, radius / 4)
    doubt = doubt_of(terrain, elevation.grid.shape)
    around = np.asarray(cv2.GaussianBlur(doubt, (0, 0), max(0.2 / cell, 0.5)), np.float32)
    sigma = np.nan_to_num(elevation.sigma, nan=1.0)
    small = blob_contrast(elevation)
    usual = disc_mean(small["tint"], radius, cell) + np.float32(USUAL)
    residual = np.nan_to_num(elevation.residual)
    return {
        HazardTerm.COARSENESS: np.full(elevation.grid.shape, coarseness(elevation, lander), np.float32),
        HazardTerm.DEVIATION_SIGMAS: -shape.rise_margin,
        HazardTerm.ROUGHNESS_SMOOTH: log_at_least(shape.even / np.float32(limit), 0.03),
        HazardTerm.ROUGHNESS_TREND: log_at_least(shape.broad / np.float32(limit), 0.03),
        HazardTerm.EXCESS_SIGMAS: _over(shape.even - np.float32(limit), disc_mean(sigma, radius, cell)),
        HazardTerm.UNKNOWN: shape.footprint.unknown,
        HazardTerm.RESIDUAL_MEAN: disc_mean(residual, radius, cell),
        HazardTerm.RESIDUAL_WORST: disc_max(cv2.GaussianBlur(residual, (0, 0), 1.0), inner, cell),
        HazardTerm.COVER_WORST: disc_max(doubt, inner, cell),
        HazardTerm.COVER_WORST_SMOOTH: disc_max(around, inner, cell),
        HazardTerm.COVER_MEAN: disc_mean(doubt, radius, cell),
        HazardTerm.COVER_WORST_BEYOND: disc_max(around, radius + BEYOND, cell),
        HazardTerm.COVER_MEAN_BEYOND: disc_mean(around, radius + 3 * BEYOND, cell),
        HazardTerm.BLOB_DARK: disc_max(small["dark"], inner, cell),
        HazardTerm.BLOB_BRIGHT: disc_max(small["bright"], inner, cell),
        HazardTerm.BLOB_TINT: np.log(disc_max(small["tint"], inner, cell) / usual + np.float32(0.1)),
    }
