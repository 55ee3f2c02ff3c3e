"""Ground beside the footprint: ground that gear beyond it may touch, and the circle of the rotors (G6, G6a)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from alight.arrays import F32, Mask
from alight.hazards.contact import Footprint, rotor_margin
from alight.hazards.footprint import padded_spans
from alight.raster import disc_any, disc_crosses_edge, disc_mask, disc_spans
from alight.records import ElevationMap, Terrain, TerrainMap, is_measured
from alight.settings import HazardsSettings, Lander

STANDING = (Terrain.TREE, Terrain.STRUCTURE)  # classes that rise into the circle of the rotors
SUPPORT = 0.15  # metres: a doubtful height counts where all within a square of this side are as high
MOST_SIGMA = 0.5  # of the rise under the rotors: largest sigma that a doubtful height counts with
ROUNDING = 1e-4  # of a share


@dataclass(frozen=True, eq=False)
class Beside:
    """Reasons beside the footprint to refuse a touchdown, (R, C) each."""

    edge: Mask  # gear or rotors leave the map
    unknown: Mask  # too much was not seen, or has no height
    standing: Mask  # land cover rises into the rotors
    rotor: F32 | None  # sigmas, the least margin of heights below the rotors; None: they are within the footprint


def ring_share(mask: Mask, inner: float, outer: float, cell: float) -> F32:
    """Share of the ring between two radii (metres) about every cell where the mask holds; 0 where it has no cells."""
    spans = disc_spans(outer / cell)
    ring = disc_mask(spans) - disc_mask(padded_spans(disc_spans(inner / cell), spans.size // 2))
    kernel = ring.astype(np.float32) / max(float(ring.sum()), 1.0)
    share = cv2.filter2D(mask.astype(np.float32), cv2.CV_32F, kernel, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(share, np.float32)


def beside_of(
    height: F32,
    unseen: Mask,
    elevation: ElevationMap,
    terrain: TerrainMap | None,
    footprint: Footprint,
    lander: Lander,
    settings: HazardsSettings,
) -> Beside:
    """Judge the ground beside every footprint; none counts where neither gear nor rotors reach beyond the radius.

    Args:
        height: (R, C) metres, usable heights, NaN elsewhere.
        unseen: (R, C) cells that were not seen.
        elevation: all heights, doubtful ones as well, about any level.
        terrain: classes; None for none.
        footprint: its planes.
        lander: reach of its gear and its rotors.
        settings: limits of the judgement.
    """
    cell = elevation.grid.cell
    edge, unknown, standing = (np.zeros(height.shape, np.bool_) for _ in range(3))
    doubtful = settings.doubtful_share if settings.smoothed else settings.unknown_share
    for reach in {lander.ground_reach, lander.reach} - {lander.radius}:
        edge |= disc_crosses_edge(height.shape, reach, cell)
        unknown |= ring_share(unseen, lander.radius, reach, cell) > settings.unknown_share + ROUNDING
        unknown |= ring_share(np.isnan(height), lander.radius, reach, cell) > doubtful + ROUNDING
    if lander.rotor_radius is None or lander.rotor_radius <= lander.radius:
        return Beside(edge, unknown, standing, None)
    if terrain is not None:
        plants = (terrain.label == Terrain.TALL_VEGETATION) & np.isnan(height)
        standing = disc_any(plants | np.isin(terrain.label, STANDING), lander.rotor_radius, cell)
    known = np.isfinite(height)
    tops = np.where(known, height, _supported(elevation, height))
    most = np.float32(MOST_SIGMA * lander.rotor_rise)
    sigma = np.where(elevation.trusted, elevation.sigma, np.fmin(elevation.sigma, most))
    return Beside(edge, unknown, standing, rotor_margin(tops, sigma, footprint, lander, cell))


def _supported(elevation: ElevationMap, height: F32) -> F32:
    """Measured heights (R, C), opened by a square (erosion, then dilation); metres on the level of `height`.

    A single doubtful height is a wrong match. Several as high side by side are an object. NaN where not all are known.
    """
    side, at = max(2, round(SUPPORT / elevation.grid.cell)), int(np.isfinite(height).argmax())
    level = elevation.height.flat[at] - height.flat[at]
    tops = np.where(is_measured(elevation.flags), elevation.height - level, np.float32(np.nan))
    square = np.ones((side, side), np.uint8)
    low = cv2.erode(np.where(np.isfinite(tops), tops, np.float32(-np.inf)), square, anchor=(0, 0))
    opened = cv2.dilate(low, square, anchor=(side - 1, side - 1))
    return np.where(np.isfinite(opened), opened, np.float32(np.nan)).astype(np.float32)
