"""Spots of the picture as wide as an obstacle: difference of Gaussians on fine pixels (docs/method/p-safe.md, G9b)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from alight.arrays import F32, U8, Mask
from alight.raster import block_light, block_max, block_mean, difference_of_gaussians, gaussian_mean
from alight.records import ElevationMap

NARROW, WIDE = 0.45, 2.3  # heights of the obstacle, 1-sigma: an obstacle is about twice as wide as high
GREY = 0.02  # excess green of the greenest spot of a grey picture, which shows none: as ground with a few plants
STRIP = 256  # rows of cells that are done at a time


class PictureSpots(NamedTuple):
    """Contrast of spots against their surroundings, natural logarithms of brightness, (R, C) each."""

    power: F32  # mean square of the contrast in the cell
    dark: F32  # the darkest pixel
    bright: F32  # the brightest pixel


def spots_of(light: F32, height: float) -> F32:
    """Contrast of spots as wide as an obstacle of a height in pixels, (R, C), of log brightness or another measure."""
    return difference_of_gaussians(light, NARROW * height, WIDE * height)


def picture_spots(elevation: ElevationMap, height: float) -> PictureSpots:
    """Measure the finest picture.

    Args:
        elevation: its finest picture is used; what was not seen counts as even.
        height: metres, of the obstacle that is looked for.
    """
    rgb, factor = elevation.finest
    halves = min(factor, 2)
    pixel = elevation.grid.cell / halves
    light, seen = _light_and_seen(rgb, factor // halves)
    if not seen.all():
        _fill_evenly(light, seen, WIDE * height / pixel)
    spot = spots_of(light, height / pixel)
    del light
    spot *= seen
    return PictureSpots(block_mean(spot * spot, halves), block_max(-spot, halves), block_max(spot, halves))


def green_spots(elevation: ElevationMap, height: float) -> F32:
    """The greenest spot of every cell against its surroundings, (R, C) of excess green (2 G - R - B) / (R + G + B).

    A tuft on bare ground is a plant, however flat matching makes it.

    Args:
        elevation: its finest picture is used; what was not seen counts as even.
        height: metres, of the obstacle that is looked for.
    """
    rgb, factor = elevation.finest
    halves = min(factor, 2)
    pixel = elevation.grid.cell / halves
    green, seen, coloured = _green_and_seen(rgb, factor // halves)
    if not coloured:
        return np.full(elevation.grid.shape, GREY, np.float32)
    if not seen.all():
        _fill_evenly(green, seen, WIDE * height / pixel)
    spot = spots_of(green, height / pixel)
    spot *= seen
    return block_max(spot, halves)


def _green_and_seen(rgb: U8, inner: int) -> tuple[F32, Mask, bool]:
    """Excess green of blocks of `inner` x `inner` pixels, which of them were seen whole, and if any has a colour."""
    rows, cols = rgb.shape[0] // inner, rgb.shape[1] // inner
    green, seen, coloured = np.zeros((rows, cols), np.float32), np.empty((rows, cols), np.bool_), False
    for top in range(0, rows, STRIP):
        part, at = rgb[top * inner : (top + STRIP) * inner], slice(top, top + STRIP)
        r, g, b = (block_mean(part[..., k].astype(np.float32), inner) for k in range(3))
        total = r + g + b
        green[at] = (2 * g - r - b) / np.maximum(total, 1)
        seen[at] = block_mean((part[..., 1] > 0).astype(np.float32), inner) > 0.999
        coloured = coloured or bool((part[..., 0] != part[..., 1]).any())
    return green, seen, coloured


def _light_and_seen(rgb: U8, inner: int) -> tuple[F32, Mask]:
    light, share, _ = block_light(rgb, inner)
    return light, share > 0.999


def _fill_evenly(light: F32, seen: Mask, sigma: float) -> None:
    """Give what was not seen the mean about it, `sigma` pixels wide; in place: pictures have tens of megapixels."""
    light *= seen
    share = gaussian_mean(seen.astype(np.float32), sigma)
    np.maximum(share, np.float32(1e-3), out=share)
    around = gaussian_mean(light, sigma)
    around /= share
    np.copyto(light, around, where=~seen)
