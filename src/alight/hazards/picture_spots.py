"""Spots of the picture as wide as an obstacle: difference of Gaussians on fine pixels (docs/method/p-safe.md, G9b)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from alight.arrays import F32
from alight.raster import (
    BlockGreen,
    BlockLight,
    block_green,
    block_light,
    block_max,
    block_mean,
    difference_of_gaussians,
    gaussian_mean,
)
from alight.records import ElevationMap

BAND = 0.45, 2.3  # heights of the obstacle, 1-sigma: an obstacle is about twice as wide as high
GREY = 0.02  # excess green that the greenest spot of a grey picture counts as: ground with a few plants


class PictureSpots(NamedTuple):
    """Contrast of spots against their surroundings, natural logarithms of brightness, (R, C) each."""

    power: F32  # mean square of the contrast in the cell
    dark: F32  # the darkest pixel
    bright: F32  # the brightest pixel


def spots_of(light: F32, height: float) -> F32:
    """Contrast of spots as wide as an obstacle of a height in pixels, (R, C), of log brightness or another measure."""
    return difference_of_gaussians(light, *(s * height for s in BAND))


def picture_spots(elevation: ElevationMap, height: float) -> PictureSpots:
    """Contrast of the spots of the finest picture, as wide as an obstacle of `height` metres; unseen ground is even."""
    rgb, factor = elevation.finest
    halves = min(factor, 2)
    spot = _seen_spots(block_light(rgb, factor // halves), height * halves / elevation.grid.cell)
    return PictureSpots(block_mean(spot * spot, halves), block_max(-spot, halves), block_max(spot, halves))


def green_spots(elevation: ElevationMap, height: float) -> F32:
    """The greenest spot of every cell against its surroundings, (R, C) of excess green (2 G - R - B) / (R + G + B).

    A tuft on bare ground is a plant, however flat matching makes it. Arguments as of `picture_spots`.
    """
    rgb, factor = elevation.finest
    halves = min(factor, 2)
    green = block_green(rgb, factor // halves)
    if not green.coloured:
        return np.full(elevation.grid.shape, GREY, np.float32)
    return block_max(_seen_spots(green, height * halves / elevation.grid.cell), halves)


def _seen_spots(found: BlockLight | BlockGreen, height: float) -> F32:
    """Spots as wide as an obstacle of a height in pixels; unseen pixels are 0. Overwrites what was found."""
    measure, seen = found.mean, found.seen > 0.999
    del found  # pictures have tens of megapixels
    if not seen.all():  # these are filled with the mean about them
        measure *= seen
        share = gaussian_mean(seen.astype(np.float32), BAND[1] * height)
        np.maximum(share, np.float32(1e-3), out=share)
        around = gaussian_mean(measure, BAND[1] * height)
        around /= share
        np.copyto(measure, around, where=~seen)
    return spots_of(measure, height) * seen
