"""Relief: height above the ground, roughness, depth of standing water."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from alight.arrays import F32, Mask
from alight.raster import block_quantile, ellipse, masked_gaussian, nearest_known, upsample
from alight.records import ElevationMap
from alight.settings import TerrainSettings
from alight.terrain.basin_kernels import fill_basins


@dataclass(frozen=True, eq=False)
class Relief:
    """Shape of the ground around every cell, (R, C) float32 metres; NaN where no height is near."""

    height_above: F32  # height above the surrounding ground, minus what a hill of that width may have (G12)
    rough: F32  # root mean square height minus its 0.5 m mean
    depth: F32  # depth of the water that the basin holds (G13)
    walled: F32  # depth if every map edge is an outlet, even an edge that looks like water
    level: F32  # height of the water surface
    ground: F32  # height of the ground below objects; where unknown, the nearest known height


def ground_under(low: F32, window_cells: float) -> F32:
    """Remove objects narrower than the window from the heights `low` (NaN: unknown) by a morphological opening."""
    reach = max(1, round(window_cells / 2))
    disc = ellipse(reach)
    eroded = cv2.erode(np.where(np.isfinite(low), low, np.float32(1e6)), disc, borderValue=1e6)
    opened = cv2.dilate(np.where(eroded < 1e5, eroded, np.float32(-1e6)), disc, borderValue=-1e6)
    return np.where(np.isfinite(low), np.minimum(opened, low), np.float32(np.nan))


def height_above_ground(height: F32, low: F32, size: int, settings: TerrainSettings, cell: float) -> F32:
    """Compute the height above the surrounding ground, metres (G12); `low`: heights of blocks of `size` x `size` cells.

    The result is the largest over several windows. A hill may rise by `settings.bulge` per metre of window width,
    because hilltops are broad and objects are not.
    """
    out = np.full(height.shape, -np.inf, dtype=np.float32)
    for window in (settings.ground_window / 4, settings.ground_window / 2, settings.ground_window):
        ground = ground_under(low, window / (size * cell))
        flat = masked_gaussian(np.nan_to_num(ground), np.isfinite(ground).astype(np.float32), 1.0)
        under = cv2.resize(flat, (flat.shape[1] * size, flat.shape[0] * size), interpolation=cv2.INTER_LINEAR)
        out = np.fmax(out, height - under[: height.shape[0], : height.shape[1]] - np.float32(settings.bulge * window))
    return np.where(np.isfinite(out), out, np.float32(np.nan))


def open_to_rim(unknown: Mask) -> Mask:
    """Return the mask of unknown cells connected to the edge of the map. Other unknown cells are holes, not outlets."""
    framed = np.pad(unknown, 1, constant_values=True).astype(np.uint8)
    labels = cv2.connectedComponents(framed, connectivity=4)[1]
    return np.asarray(labels == labels[0, 0])[1:-1, 1:-1]


def standing_water(ground: F32, wet: Mask) -> tuple[F32, F32]:
    """Compute depth and level of the water that heights `ground` (R, C) would hold (G13), metres; NaN where unknown.

    Water runs off over the map's edge and into unknown cells connected to it. An edge that looks like water (`wet`)
    holds the water back, as a pond may continue beyond the map.
    """
    unknown = np.isnan(ground)
    off = np.pad(open_to_rim(unknown), 1, constant_values=True).astype(np.uint8)
    beside = cv2.dilate(off, np.ones((3, 3), np.uint8))[1:-1, 1:-1] > 0
    surface = np.where(unknown, np.float32(np.inf), ground)
    level = np.empty_like(surface)
    fill_basins(surface, beside & ~unknown & ~wet, level)
    level = np.where(unknown | ~np.isfinite(level), ground, level)  # enclosed by holes: unknown
    return level - ground, level


def relief(elevation: ElevationMap, wet: F32, settings: TerrainSettings) -> Relief:
    """Compute the shape of the ground from trusted heights; `wet`: (R, C) likeness of each cell to water, 0 to 1."""
    cell = elevation.grid.cell
    shape = elevation.grid.shape
    known = elevation.trusted
    height = np.where(known, elevation.height, np.float32(np.nan))
    size = max(1, round(settings.block / cell))
    bed = ground_under(block_quantile(height, size, 0.5), settings.ground_window / (2 * size * cell))
    like_water = block_quantile(wet, size, 0.5) > 0.5
    depth, level = standing_water(bed, like_water)
    walled = standing_water(bed, np.zeros_like(like_water))[0] if like_water.any() else depth
    weight = known.astype(np.float32)
    detail = np.nan_to_num(height) - np.nan_to_num(masked_gaussian(np.nan_to_num(height), weight, 0.5 / cell))
    power = masked_gaussian(detail**2, weight, 0.35 / cell)
    return Relief(
        height_above=height_above_ground(height, block_quantile(height, size, 0.1), size, settings, cell),
        rough=np.where(known, np.sqrt(power), np.float32(np.nan)),
        depth=upsample(depth, size, shape),
        walled=upsample(walled, size, shape),
        level=upsample(level, size, shape),
        ground=upsample(nearest_known(bed, ~np.isnan(bed)), size, shape),
    )
