"""Standing water from bed shape, colour and texture (docs/method/land-cover.md, G13 to G15)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import median

from alight.arrays import F32, Mask
from alight.raster import linear_ramp, masked_gaussian, nearest_known, without_specks
from alight.records import ElevationMap, Flag, Terrain, TerrainMap, is_flagged
from alight.settings import TerrainSettings
from alight.terrain.appearance import Appearance, seen
from alight.terrain.relief import Relief

ALIKE = 0.4  # likeness to water of a patch that is taken for water if it is connected to water, or level
DRY = 1.0  # metres above open water: plants that stand lower may stand on wet soil (Murphy et al. 2009)


def water_likeness(colours: Appearance) -> F32:
    """Compute the likeness of each cell to water, 0 to 1; it is high for smooth cells that are neither brown nor green.

    Other smooth grey surfaces, such as car parks, score high too.
    """
    plain = 1 - linear_ramp(colours.texture, 0.03, 0.06)
    tone = linear_ramp(colours.cool, -0.075, -0.04) * (1 - linear_ramp(colours.green, 0.11, 0.16))
    return np.asarray(plain * tone * np.float32(colours.coloured))


def wetness(elevation: ElevationMap, colours: Appearance) -> F32:
    """Compute the mean likeness to water around each cell, (R, C), 0 to 1."""
    return _near(np.nan_to_num(water_likeness(colours)), elevation)


def _near(values: F32, elevation: ElevationMap) -> F32:
    weight = seen(elevation).astype(np.float32)
    return np.asarray(np.nan_to_num(masked_gaussian(values, weight, 0.5 / elevation.grid.cell)))


def water_odds(colours: Appearance, depth: F32, moving: F32, settings: TerrainSettings) -> F32:
    """Compute the log odds of water (G14), (R, C), from basin, likeness to water and motion.

    `depth`: depth of the water that a basin holds, metres; `moving`: share of nearby cells that move.
    """
    d = settings.basin_depth
    basin = linear_ramp(depth, d / 2, 1.5 * d)
    plain = 1 - linear_ramp(colours.texture, 0.03, 0.06)
    return np.asarray(-5 + 3.5 * basin + 1.5 * plain + 2.5 * water_likeness(colours) + 3.0 * moving, np.float32)


def _grown(seed: Mask, into: Mask) -> Mask:
    labels = cv2.connectedComponents((into | seed).astype(np.uint8), connectivity=8)[1]
    return np.asarray(np.isin(labels, np.unique(labels[seed]))) & (into | seed)


@dataclass(frozen=True, eq=False)
class WaterSigns:
    """Evidence of water, (R, C) arrays."""

    odds: F32  # log odds
    walled_odds: F32  # log odds if every map edge is an outlet, even an edge that looks like water
    wet: F32  # likeness to water, 0 to 1
    moving: F32  # share of nearby cells that move
    bed: F32  # metres, smoothed heights, NaN = unknown
    outside: Mask  # cells outside all basins


def flooded(signs: WaterSigns, cell: float, least_share: float) -> Mask:
    """Grow water over the connected ground that must be wet too (G15), and return its mask.

    First, connected cells that look like water are added. Then connected lower cells are added, because the surface of
    a pond is level. This second step is skipped if it would more than double the area. A patch that would drain over
    dry ground is not water, unless at least half of it moves. A patch that lies mostly outside all basins, with less
    than a fifth of it moving, is water only where `walled_odds` are positive.

    Args:
        signs: evidence of water.
        cell: cell size, metres.
        least_share: share of a patch with positive odds below which only that part is water, as on a wet slab.
    """
    seed, walled = (without_specks(odds > 0, cell, 1.0) for odds in (signs.odds, signs.walled_odds))
    out = np.zeros_like(seed)
    alike = _grown(seed, signs.wet > ALIKE)
    count, labels = cv2.connectedComponents(alike.astype(np.uint8), connectivity=8)
    for i in range(1, count):
        pond = labels == i
        known, moving = pond & np.isfinite(signs.bed), signs.moving[pond].mean()
        if known.any() and moving < 0.2 and signs.outside[known].mean() > 0.5:
            out |= pond & walled
            continue
        if seed[pond].mean() < least_share:  # a slab with a wet corner is not a pond
            out |= pond & seed
            continue
        if not known.any():
            out |= pond
            continue
        if moving < 0.5 and _drains(known, signs.wet, signs.bed):
            continue
        lower = _grown(pond, signs.bed <= np.percentile(signs.bed[known], 95))
        out |= lower if lower.sum() <= 2 * pond.sum() else pond
    return out


def _drains(pond: Mask, wet: F32, bed: F32) -> bool:
    """Whether dry ground connected to a patch, at least 0.5 m below its median height, covers twice its area.

    `pond`: mask of the patch. `wet`: likeness to water, 0 to 1. `bed`: heights, metres. All (R, C).
    """
    level = np.median(bed[pond])
    dry = _grown(pond & (bed <= level), bed <= level) & ~pond & (wet < 0.2) & (bed < level - 0.5)
    return bool(dry.sum() > 2 * pond.sum())


def ponds(elevation: ElevationMap, colours: Appearance, shape: Relief, wet: F32, settings: TerrainSettings) -> Mask:
    """Return the mask of standing water, (R, C), from its signs: basin, colour, texture and motion; see `flooded`."""
    cell, weight = elevation.grid.cell, seen(elevation).astype(np.float32)
    restless = is_flagged(elevation.flags, Flag.MOVING | Flag.INCONSISTENT)  # water and swaying plants
    moving = _near(restless.astype(np.float32), elevation)
    odds, walled = (
        masked_gaussian(water_odds(colours, depth, moving, settings), weight, 0.2 / cell)
        for depth in (shape.depth, shape.walled)
    )
    outside = shape.depth < 0.25 * settings.basin_depth
    return flooded(WaterSigns(odds, walled, wet, moving, shape.level - shape.depth, outside), cell, settings.pond_share)


def open_water(land_cover: TerrainMap) -> Mask:
    """Return the mask of water patches with a median P(water) of at least 0.5, (R, C); the sample's pond has 0.98.

    A refused cell is labelled with its likeliest hazard, even an improbable one: a shadow beside a bush may be labelled
    water. The refusal does not depend on the label. Heights, however, are refused only on probable water.
    """
    wet = np.asarray(land_cover.label == Terrain.WATER)
    if not wet.any():
        return wet
    count, patches = cv2.connectedComponents(wet.astype(np.uint8), connectivity=8)
    middle = median(land_cover.water[wet], patches[wet], np.arange(1, count))
    return np.asarray(np.concatenate([[False], middle >= 0.5])[patches])


def dryness(water: Mask, height: F32) -> F32:
    """Compute from 0 to 1 how far each cell stands above the nearest open water, (R, C); 1 from `DRY` on.

    Height above the nearest water predicts how wet soil is (HAND, Nobre et al. 2011).

    Args:
        water: (R, C) mask of open water.
        height: (R, C) metres, NaN = unknown.
    """
    if not water.any():
        return np.ones(water.shape, np.float32)
    count, patches = cv2.connectedComponents(water.astype(np.uint8), connectivity=8)
    filled = nearest_known(np.nan_to_num(height), np.isfinite(height))
    level = np.asarray(median(filled, patches, np.arange(count)), np.float32)
    return np.asarray(np.clip((height - nearest_known(level[patches], water)) / np.float32(DRY), 0, 1), np.float32)
