"""Colour and texture of each cell: ratios that a change of exposure leaves alone (docs/method/land-cover.md)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from alight.arrays import F32, Mask
from alight.raster import masked_gaussian
from alight.records import ElevationMap


@dataclass(frozen=True, eq=False)
class Appearance:
    """Colour and texture of every cell, (R, C) float32, NaN where nothing was seen."""

    cool: F32  # (B - R) / (R + G + B): above about -0.06 grey or bluish, below it brown and green
    green: F32  # (2 G - R - B) / (R + G + B), the excess green index
    texture: F32  # root mean square of log brightness about its 0.5 m mean
    coloured: bool  # False: grey images, colour says nothing


def seen(elevation: ElevationMap) -> Mask:
    """Cells that any camera saw."""
    return np.asarray((elevation.views > 0) & (elevation.rgb.max(axis=2) > 0))


def appearance(elevation: ElevationMap, scale: float = 0.1) -> Appearance:
    """Measure colour and texture.

    Args:
        elevation: its `rgb` and `views` are used.
        scale: metres, the finest detail looked at, so that maps of any cell size compare.
    """
    known = seen(elevation)
    weight = known.astype(np.float32)
    per_m = 1 / elevation.grid.cell
    fine = max(0.5, scale * per_m)
    r, g, b = (masked_gaussian(elevation.rgb[..., k].astype(np.float32), weight, fine) + 1 for k in range(3))
    total = r + g + b
    light = np.log(total / 3)
    detail = light - masked_gaussian(np.nan_to_num(light), weight, 0.5 * per_m)
    power = masked_gaussian(np.nan_to_num(detail) ** 2, weight, 0.25 * per_m)
    spread = np.abs(elevation.rgb[..., 0].astype(np.int16) - elevation.rgb[..., 2])[known]
    nan = np.float32(np.nan)
    return Appearance(
        cool=np.where(known, (b - r) / total, nan),
        green=np.where(known, (2 * g - r - b) / total, nan),
        texture=np.where(known, np.sqrt(np.maximum(power, 0)), nan),
        coloured=bool(spread.size and np.percentile(spread, 90) > 2),
    )
