"""From appearance, relief and parallax flags to classes: first version, weights set by hand (docs/method-ground.md, 4).

Evidence is added as log odds, so that one sign alone (grey and smooth: a pond or a car park) does not refuse ground
and two together do.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from alight.records import F32, U8, ElevationMap, Flag, Terrain, TerrainMap
from alight.settings import TerrainSettings
from alight.terrain.appearance import Appearance, appearance, seen, smooth
from alight.terrain.relief import Relief, relief

Bool = NDArray[np.bool_]


def _ramp(values: F32, low: float, high: float) -> F32:
    """0 below `low`, 1 above `high`, straight between; no evidence (NaN) is 0."""
    out: F32 = np.nan_to_num(np.clip((values - np.float32(low)) / np.float32(high - low), 0, 1)).astype(np.float32)
    return out


def _moving(elevation: ElevationMap) -> F32:
    """Share of the cells about each that do not hold still: the parallax flags of water and swaying plants."""
    looked = seen(elevation).astype(np.float32)
    restless = (elevation.flags & np.uint16(Flag.MOVING | Flag.INCONSISTENT)) != 0
    share: F32 = np.nan_to_num(smooth(restless.astype(np.float32), looked, 0.5 / elevation.grid.cell))
    return share


def wet_look(look: Appearance) -> F32:
    """How much a cell looks like water, 0 to 1: smooth, and neither brown nor green. A car park does too."""
    plain = 1 - _ramp(look.texture, 0.03, 0.06)
    tone = _ramp(look.cool, -0.075, -0.04) * (1 - _ramp(look.green, 0.11, 0.16))
    out: F32 = plain * tone * np.float32(look.coloured)
    return out


def water_odds(look: Appearance, shape: Relief, moving: F32, settings: TerrainSettings) -> F32:
    """Log odds of water (G14): a closed basin, the look of water, restless; any two strong ones do."""
    d = settings.basin_depth
    basin = _ramp(shape.depth, d / 2, 1.5 * d)
    plain = 1 - _ramp(look.texture, 0.03, 0.06)
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
    seed = _without_specks(odds > 0, cell, 1.0)
    out = np.zeros_like(seed)
    alike = _grown(seed, wet > 0.4)
    count, labels = cv2.connectedComponents(alike.astype(np.uint8), connectivity=8)
    for i in range(1, count):
        pond = labels == i
        known = pond & np.isfinite(bed)
        if not known.any():
            out |= pond
            continue
        lower = _grown(pond, bed <= np.percentile(bed[known], 95))
        out |= lower if lower.sum() <= 2 * pond.sum() else pond
    return out


def plant_odds(look: Appearance, shape: Relief, moving: F32) -> F32:
    """Log odds of tall plants (G16): rough to the eye, rough or raised in height, green, restless."""
    busy = _ramp(look.texture, 0.055, 0.09)
    high = np.maximum(_ramp(shape.above, 0.15, 0.5), _ramp(shape.rough, 0.04, 0.10))
    tone = _ramp(look.green, 0.06, 0.14) * np.float32(look.coloured)
    odds: F32 = (-5 + 3.5 * busy + 3.0 * high + 2.0 * tone + 2.0 * moving).astype(np.float32)
    return odds


def object_odds(shape: Relief, settings: TerrainSettings) -> F32:
    """Log odds of something that stands on the ground: tree, rock, wall, vehicle."""
    return (-4 + 8 * _ramp(shape.above, 0.5 * settings.raised, 1.5 * settings.raised)).astype(np.float32)


def _without_specks(mask: Bool, cell: float, least: float = 0.1) -> Bool:
    """Drop patches of fewer square metres: the geometry judges what is that small."""
    labels, stats = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)[1:3]
    big = stats[:, cv2.CC_STAT_AREA] * cell**2 >= least
    big[0] = False
    return np.asarray(big[labels])


def beside_tall(elevation: ElevationMap, shape: Relief, settings: TerrainSettings) -> Bool:
    """Ground within reach of a crown (G18): seen from the side, what lies under it passes for open ground.

    Doubtful heights count here: most of a crown is doubtful, and a needless refusal costs little.
    """
    cell = elevation.grid.cell
    usable = (elevation.flags & np.uint16(Flag.UNSEEN | Flag.RANGE | Flag.SATURATED)) == 0
    above = np.where(usable, elevation.height - shape.ground, np.float32(np.nan))
    out = np.zeros(above.shape, dtype=np.bool_)
    for tall in (1.5, 3.0, 4.5, 6.0):
        n = round(settings.overhang * tall / cell)
        if n < 1:
            continue
        standing = _without_specks(np.nan_to_num(above) > tall, cell, 0.5)
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * n + 1, 2 * n + 1))
        out |= cv2.dilate(standing.astype(np.uint8), disc) > 0
    return out


def _labels(look: Appearance, shape: Relief, water: F32, plants: F32, objects: F32) -> U8:
    """The likeliest class; of open ground what its colour says, cautiously."""
    green = np.nan_to_num(look.green) > 0.09
    grey = (np.abs(look.cool) < 0.05) & (np.abs(look.green) < 0.04) & (look.texture < 0.05)
    out = np.where(green, Terrain.SHORT_GRASS, np.where(grey, Terrain.PAVED, Terrain.BARE))
    tall = np.nan_to_num(shape.above) > 1.5
    leafy = green | (plants > 0)
    standing = np.where(leafy, np.where(tall, Terrain.TREE, Terrain.TALL_VEGETATION), Terrain.STRUCTURE)
    out = np.where(objects > 0, standing, out)
    out = np.where((plants > 0) & (objects <= 0), Terrain.TALL_VEGETATION, out)
    return np.where(water > 0, Terrain.WATER, out).astype(np.uint8)


def _closed(mask: Bool, cell: float, reach: float = 0.5) -> Bool:
    """Fill gaps narrower than twice the reach: there is nowhere to stand between two tufts."""
    n = max(1, round(reach / cell))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * n + 1, 2 * n + 1))
    return np.asarray(cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, disc, borderValue=0) > 0)


def _verdict(elevation: ElevationMap, settings: TerrainSettings) -> tuple[U8, F32]:
    """Classes and `landable` of one map."""
    cell, looked = elevation.grid.cell, seen(elevation)
    look, moving = appearance(elevation), _moving(elevation)
    wet = np.nan_to_num(smooth(np.nan_to_num(wet_look(look)), looked.astype(np.float32), 0.5 / cell))
    shape = relief(elevation, wet, settings)
    odds = water_odds(look, shape, moving, settings), plant_odds(look, shape, moving), object_odds(shape, settings)
    water, plants, objects = (smooth(o, looked.astype(np.float32), 0.2 / cell) for o in odds)
    pond = flooded(water, wet, shape.level - shape.depth, cell)
    water = np.where(pond, np.maximum(water, np.float32(3)), np.minimum(water, np.float32(-0.5)))
    tufts = _closed(_without_specks(plants > 0, cell), cell)
    plants = np.where(tufts, np.maximum(plants, np.float32(1)), np.minimum(plants, np.float32(-0.5)))
    things = _without_specks(objects > 0, cell)
    objects = np.where(things, objects, np.minimum(objects, np.float32(-0.5)))
    worst = np.fmax(np.fmax(water, plants), objects)
    worst = np.where(beside_tall(elevation, shape, settings), np.fmax(worst, np.float32(1)), worst)
    landable = expit(-worst).astype(np.float32)
    label = _labels(look, shape, water, plants, objects)
    nothing = np.float32(np.nan)
    return np.where(looked, label, np.uint8(Terrain.UNKNOWN)).astype(np.uint8), np.where(looked, landable, nothing)


def classify(elevation: ElevationMap, settings: TerrainSettings) -> TerrainMap:
    """Name what covers each cell, and how likely it may be landed on.

    Args:
        elevation: heights, flags and colours.
        settings: scales and thresholds; `enabled` False gives UNKNOWN everywhere, which refuses nothing.

    Returns:
        Classes, UNKNOWN where nothing was seen; `landable` is a reason to refuse and never one to permit.
    """
    if not settings.enabled:
        nothing = np.full(elevation.grid.shape, np.nan, dtype=np.float32)
        return TerrainMap(elevation.grid, np.zeros(elevation.grid.shape, dtype=np.uint8), nothing)
    return TerrainMap(elevation.grid, *_verdict(elevation, settings))
