"""Water by its shape and look: what the bed of a clear pond betrays (docs/method-ground.md, G13 to G15)."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median

from alight.raster import masked_gaussian, ramp, without_specks
from alight.records import F32, ElevationMap, Flag, Terrain, TerrainMap
from alight.settings import TerrainSettings
from alight.terrain.appearance import Appearance, seen
from alight.terrain.relief import Relief

Bool = NDArray[np.bool_]
SEEN_AS = 0.2  # share of what looks alike that must be water by itself: of ponds on flights 0.2 to 1, of pavement less
LIKELY = 0.5  # median P(water) of a patch whose heights are those of a bed: of the sample's pond 0.98


def _moving(elevation: ElevationMap) -> F32:
    """Share of the cells about each that do not hold still: the parallax flags of water and swaying plants."""
    looked = seen(elevation).astype(np.float32)
    restless = (elevation.flags & np.uint16(Flag.MOVING | Flag.INCONSISTENT)) != 0
    share: F32 = np.nan_to_num(masked_gaussian(restless.astype(np.float32), looked, 0.5 / elevation.grid.cell))
    return share


def wet_look(look: Appearance) -> F32:
    """How much a cell looks like water, 0 to 1: smooth, and neither brown nor green. A car park does too."""
    plain = 1 - ramp(look.texture, 0.03, 0.06)
    tone = ramp(look.cool, -0.075, -0.04) * (1 - ramp(look.green, 0.11, 0.16))
    out: F32 = plain * tone * np.float32(look.coloured)
    return out


def wetness(elevation: ElevationMap, look: Appearance) -> F32:
    """How much the surroundings of a cell look like water, 0 to 1."""
    weight = seen(elevation).astype(np.float32)
    out: F32 = np.nan_to_num(masked_gaussian(np.nan_to_num(wet_look(look)), weight, 0.5 / elevation.grid.cell))
    return out


def water_odds(look: Appearance, shape: Relief, moving: F32, settings: TerrainSettings) -> F32:
    """Log odds of water (G14): a closed basin, the look of water, restless; any two strong ones do."""
    d = settings.basin_depth
    basin = ramp(shape.depth, d / 2, 1.5 * d)
    plain = 1 - ramp(look.texture, 0.03, 0.06)
    odds: F32 = (-5 + 3.5 * basin + 1.5 * plain + 2.5 * wet_look(look) + 3.0 * moving).astype(np.float32)
    return odds


def _grown(seed: Bool, into: Bool) -> Bool:
    """The connected parts of `into` that hold a seed."""
    labels = cv2.connectedComponents((into | seed).astype(np.uint8), connectivity=8)[1]
    return np.asarray(np.isin(labels, np.unique(labels[seed]))) & (into | seed)


def flooded(odds: F32, wet: F32, bed: F32, cell: float) -> Bool:
    """Spread water over what must be wet too (G15).

    First to what looks alike and hangs together with it; then to all that hangs together with it and lies lower,
    because the surface of a pond is level: this closes the gaps where the bed looks like the shore. Water that would
    run over far more ground than it covers cannot stand there: then the second step is left out.

    Args:
        odds: (R, C) log odds of water.
        wet: (R, C) how much a cell looks like water.
        bed: (R, C) metres, smoothed heights, NaN = unknown.
        cell: metres.
    """
    seed = without_specks(odds > 0, cell, 1.0)
    out = np.zeros_like(seed)
    alike = _grown(seed, wet > 0.4)
    count, labels = cv2.connectedComponents(alike.astype(np.uint8), connectivity=8)
    for i in range(1, count):
        pond = labels == i
        if seed[pond].mean() < SEEN_AS:  # a slab looks like water too, and a wet corner of it does not make it a pond
            out |= pond & seed
            continue
        known = pond & np.isfinite(bed)
        if not known.any():
            out |= pond
            continue
        lower = _grown(pond, bed <= np.percentile(bed[known], 95))
        out |= lower if lower.sum() <= 2 * pond.sum() else pond
    return out


def ponds(elevation: ElevationMap, look: Appearance, shape: Relief, wet: F32, settings: TerrainSettings) -> Bool:
    """(R, C): what is water by its basin, its look and its restlessness, and what hangs together with it."""
    cell = elevation.grid.cell
    odds = water_odds(look, shape, _moving(elevation), settings)
    near = masked_gaussian(odds, seen(elevation).astype(np.float32), 0.2 / cell)
    return flooded(near, wet, shape.level - shape.depth, cell)


def open_water(cover: TerrainMap) -> Bool:
    """(R, C): the patches of water that are more likely water than not, all of each.

    A cell that must not be landed on is called water where that is the likeliest hazard, however unlikely: a shadow
    beside a bush is. For a refusal the name is no matter; a height is taken back only where the patch is water.
    """
    wet = np.asarray(cover.label == Terrain.WATER)
    if cover.probability is None or not wet.any():
        return wet
    count, patches = cv2.connectedComponents(wet.astype(np.uint8), connectivity=8)
    likely = cover.probability[wet, Terrain.WATER - 1].astype(np.float32)
    middle = median(likely, patches[wet], np.arange(1, count))
    return np.asarray(np.concatenate([[False], middle >= LIKELY])[patches])
