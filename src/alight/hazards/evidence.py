"""What a footprint is judged by, each term larger where it is less likely safe (docs/method/hazards.md, G7b)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.special import logit

from alight.hazards.blob_contrast import blob_contrast
from alight.hazards.contact import Footprint
from alight.hazards.footprint import disc_mask, disc_spans
from alight.hazards.probability import mean_near
from alight.records import F32, ElevationMap, TerrainMap
from alight.settings import HazardsSettings, Lander

INNER = 0.25  # metres: what lies that near to the rim may as well lie outside
BEYOND = 1.0  # metres past the rim: where tufts begin, there are more
LEAST = 1e-4  # probability
USUAL = 0.01  # of a tint, that no ground is evener than
SURE = np.float32(9.2)  # log odds: the cover where nobody judged it


@dataclass(frozen=True, eq=False)
class Shape:
    """What the geometry says of every footprint, (R, C) each."""

    footprint: Footprint
    even: F32  # metres, largest deviation of heights averaged over the noise's length
    broad: F32  # metres, of heights averaged over twice as much
    rise_margin: F32  # (limit - deviation or rise) / sigma


def worst_near(values: F32, radius: float, cell: float) -> F32:
    """The largest value in the disc about every cell."""
    disc = disc_mask(disc_spans(max(radius, cell) / cell))
    return np.asarray(cv2.dilate(values, disc, borderType=cv2.BORDER_REPLICATE), np.float32)


def _log(values: F32, floor: float) -> F32:
    return np.asarray(np.log(np.maximum(np.nan_to_num(values, nan=1.0), np.float32(floor))), np.float32)


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
    """P(an obstacle is too small for the pixels): 0 up to `resolved_share` of the limit, at most `hidden_hazard`."""
    excess = coarseness(elevation, lander) - math.log(settings.resolved_share)
    return settings.hidden_hazard * min(max(excess / math.log(4.0), 0.0), 1.0)


def hazard_terms(elevation: ElevationMap, terrain: TerrainMap | None, shape: Shape, lander: Lander) -> dict[str, F32]:
    """The terms of `weights`, (R, C) each."""
    cell, radius, limit = elevation.grid.cell, lander.radius, lander.max_roughness
    inner = radius - min(INNER, radius / 4)
    doubt = doubt_of(terrain, elevation.grid.shape)
    around = np.asarray(cv2.GaussianBlur(doubt, (0, 0), max(0.2 / cell, 0.5)), np.float32)
    sigma = np.nan_to_num(elevation.sigma, nan=1.0)
    small = blob_contrast(elevation)
    usual = mean_near(small["tint"], radius, cell) + np.float32(USUAL)
    residual = np.nan_to_num(elevation.residual)
    return {
        "coarse": np.full(elevation.grid.shape, coarseness(elevation, lander), np.float32),
        "rise": -shape.rise_margin,
        "even": _log(shape.even / np.float32(limit), 0.03),
        "broad": _log(shape.broad / np.float32(limit), 0.03),
        "over": _over(shape.even - np.float32(limit), mean_near(sigma, radius, cell)),
        "unknown": shape.footprint.unknown,
        "residual": mean_near(residual, radius, cell),
        "worst residual": worst_near(cv2.GaussianBlur(residual, (0, 0), 1.0), inner, cell),
        "cover": worst_near(doubt, inner, cell),
        "cover around": worst_near(around, inner, cell),
        "cover in the mean": mean_near(doubt, radius, cell),
        "cover beyond": worst_near(around, radius + BEYOND, cell),
        "cover far beyond": mean_near(around, radius + 3 * BEYOND, cell),
        "dark": worst_near(small["dark"], inner, cell),
        "bright": worst_near(small["bright"], inner, cell),
        "tint": np.log(worst_near(small["tint"], inner, cell) / usual + np.float32(0.1)),
    }
