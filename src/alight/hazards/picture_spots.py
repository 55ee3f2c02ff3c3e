"""Spots of the picture as wide as an obstacle: difference of Gaussians on fine pixels (docs/method/p-safe.md, G9b)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from alight.arrays import F32, U8, Mask
from alight.raster import block_green, block_light, block_max, block_mean, difference_of_gaussians, gaussian_mean
from alight.records import ElevationMap

NARROW, WIDE = 0.45, 2.3  # heights of the obstacle, 1-sigma: an obstacle is about twice as wide as high
GREY = 0.02  # excess green that the greenest spot of a grey picture counts as: ground with a few plants
WHOLE = 0.999  # share of a block from which it was seen whole


class PictureSpots(NamedTuple):
    """Contrast of spots against their surroundings, natural logarithms of brightness, (R, C) each."""

    power: F32  # mean square of the contrast in the cell
    dark: F32  # the darkest pixel
    bright: F32  # the brightest pixel


def spots_of(light: F32, height: float) -> F32:
    """Contrast of spots as wide as an obstacle of a height in pixels, (R, C), of log brightness or another measure."""
    return difference_of_gaussians(light, NARROW * height, WIDE * height)


def picture_spots(elevation: ElevationMap, height: float) -> PictureSpots:
    """Contrast of the spots of the finest picture.

    Args:
        elevation: its finest picture is used; unseen ground counts as even.
        height: metres, of the obstacle that is looked for.
    """
    rgb, factor = elevation.finest
    halves = min(factor, 2)
    spot = _seen_spots(*_light_and_seen(rgb, factor // halves), height * halves / elevation.grid.cell)
    return PictureSpots(block_mean(spot * spot, halves), block_max(-spot, halves), block_max(spot, halves))


def green_spots(elevation: ElevationMap, height: float) -> F32:
    """The greenest spot of every cell against its surroundings, (R, C) of excess green (2 G - R - B) / (R + G + B).

    A tuft on bare ground is a plant, however flat matching makes it.

    Args:
        elevation: its finest picture is used; unseen ground counts as even.
        height: metres, of the obstacle that is looked for.
    """
    rgb, factor = elevation.finest
    halves = min(factor, 2)
    green, share, coloured = block_green(rgb, factor // halves)
    if not coloured:
        return np.full(elevation.grid.shape, GREY, np.float32)
    return block_max(_seen_spots(green, share > WHOLE, height * halves / elevation.grid.cell), halves)


def _light_and_seen(rgb: U8, inner: int) -> tuple[F32, Mask]:
    light, share, _ = block_light(rgb, inner)
    return light, share > WHOLE


def _seen_spots(measure: F32, seen: Mask, height: float) -> F32:
    """Spots of a measure as wide as an obstacle of a height in pixels; unseen pixels are 0. Overwrites `measure`."""
    if not seen.all():
        _fill_evenly(measure, seen, WIDE * height)
    return spots_of(measure, height) * seen


def _fill_evenly(light: F32, seen: Mask, sigma: float) -> None:
    """Fill unseen pixels with the mean about them, `sigma` pixels wide; in place: pictures have tens of megapixels."""
    light *= seen
    share = gaussian_mean(seen.astype(np.float32), sigma)
    np.maximum(share, np.float32(1e-3), out=share)
    around = gaussian_mean(light, sigma)
    around /= share
    np.copyto(light, around, where=~seen)
