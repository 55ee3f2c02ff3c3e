"""Colour and texture of each cell, as ratios that do not depend on the exposure (docs/method/land-cover.md)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from alight.arrays import F32, U8, Mask
from alight.raster import block_mean, masked_gaussian, upsample
from alight.records import ElevationMap, Flag, is_flagged
from alight.terrain.model import PIXEL


@dataclass(frozen=True, eq=False)
class Appearance:
    """Colour and texture of every cell, (R, C) float32, NaN where unseen."""

    cool: F32  # (B - R) / (R + G + B): grey or bluish above about -0.06, brown or green below
    green: F32  # (2 G - R - B) / (R + G + B), the excess green index
    texture: F32  # root mean square of log brightness minus its 0.5 m mean
    coloured: bool  # False: grey images without colour evidence


def seen(elevation: ElevationMap) -> Mask:
    """Return the mask of cells that a camera saw and that have a colour in the map or in its finest picture.

    A map that is built view by view holds only the colours of the newest view.
    """
    pictured = lit(elevation.rgb)
    if elevation.fine is not None:
        rows, cols = np.nonzero((elevation.views > 0) & ~pictured)
        (r, c), n = pictured.shape, elevation.finest[1]
        pictured[rows, cols] = elevation.fine.reshape(r, n, c, n, 3)[rows, :, cols].any(axis=(1, 2, 3))
    return (elevation.views > 0) & pictured


def black_ground(elevation: ElevationMap) -> Mask:
    """Return the mask of black cells flagged as saturated or textureless; other black cells have no colour yet."""
    return (elevation.views > 0) & ~lit(elevation.rgb) & is_flagged(elevation.flags, Flag.SATURATED | Flag.TEXTURE)


def lit(picture: U8) -> Mask:
    """Return the mask of pixels that are not black; a black pixel holds no picture."""
    return np.asarray((picture[..., 0] | picture[..., 1] | picture[..., 2]) > 0)


def appearance(elevation: ElevationMap, scale: float = PIXEL) -> Appearance:
    """Compute colour and texture from the finest picture.

    `scale` is the finest detail used, metres, so that maps of any cell size are comparable.
    """
    rgb, n = elevation.picture(scale)
    known = lit(rgb) & upsample(elevation.views > 0, n)
    weight = known.astype(np.float32)
    per_m = n / elevation.grid.cell
    fine = max(0.5, scale * per_m)
    r, g, b = (masked_gaussian(rgb[..., k].astype(np.float32), weight, fine) + 1 for k in range(3))
    total = r + g + b
    light = np.nan_to_num(np.log(total / 3))
    detail = light - np.nan_to_num(masked_gaussian(light, weight, 0.5 * per_m))
    power = masked_gaussian(detail**2, weight, 0.25 * per_m)
    spread = np.abs(rgb[..., 0].astype(np.int16) - rgb[..., 2])[known]
    looked, nan = seen(elevation), np.float32(np.nan)
    share = np.maximum(block_mean(weight, n), np.float32(1e-6))

    def of_cells(values: F32) -> F32:
        mean = block_mean(np.where(known, values, np.float32(0)), n) / share
        return np.where(looked, mean, nan)

    return Appearance(
        cool=of_cells((b - r) / total),
        green=of_cells((2 * g - r - b) / total),
        texture=of_cells(np.sqrt(np.maximum(power, 0))),
        coloured=bool(spread.size and np.percentile(spread, 90) > 2),
    )
