"""Log brightness and excess green of a picture: contrasts in them do not depend on the exposure."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from alight.arrays import F32, U8
from alight.raster.blocks import block_mean

STRIP = 256  # rows of blocks that are worked on at once: pictures have tens of megapixels
GREY = 2.0  # levels added: noise in the dark is no contrast
_LOG = np.log(np.arange(256, dtype=np.float32) + np.float32(GREY))


def log_levels(levels: U8) -> F32:
    """Natural logarithm of grey levels, of any shape."""
    return np.asarray(_LOG[levels])


def log_brightness(rgb: U8) -> F32:
    """Natural logarithm of the brightness of a picture, (R, C) of (R, C, 3)."""
    return log_levels(np.asarray(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), np.uint8))


class BlockLight(NamedTuple):
    """Log brightness of square blocks of pixels, (R, C) each."""

    mean: F32
    seen: F32  # share of the block that was seen: black counts as unseen
    within: F32  # variance of the pixels of a block; zeros unless `within` is set


def block_light(rgb: U8, inner: int, within: bool = False) -> BlockLight:
    """Log brightness of blocks of `inner` x `inner` pixels of a picture (R inner, C inner, 3)."""
    rows, cols = rgb.shape[0] // inner, rgb.shape[1] // inner
    out = BlockLight(*(np.zeros((rows, cols), np.float32) for _ in BlockLight._fields))
    for top in range(0, rows, STRIP):
        part, at = rgb[top * inner : (top + STRIP) * inner], slice(top, top + STRIP)
        light = log_brightness(part)
        out.mean[at] = block_mean(light, inner)
        out.seen[at] = _seen_share(part, inner)
        if within and inner > 1:
            out.within[at] = np.maximum(block_mean(light * light, inner) - out.mean[at] * out.mean[at], 0)
    return out


class BlockGreen(NamedTuple):
    """Excess green, (2 G - R - B) / (R + G + B), of square blocks of pixels, (R, C)."""

    mean: F32  # of the mean colour
    seen: F32  # as `BlockLight.seen`
    coloured: bool  # some pixel is not grey


def block_green(rgb: U8, inner: int) -> BlockGreen:
    """Excess green of blocks of `inner` x `inner` pixels of a picture (R inner, C inner, 3)."""
    rows, cols = rgb.shape[0] // inner, rgb.shape[1] // inner
    mean, seen, coloured = np.zeros((rows, cols), np.float32), np.zeros((rows, cols), np.float32), False
    for top in range(0, rows, STRIP):
        part, at = rgb[top * inner : (top + STRIP) * inner], slice(top, top + STRIP)
        r, g, b = (block_mean(part[..., k].astype(np.float32), inner) for k in range(3))
        mean[at] = (2 * g - r - b) / np.maximum(r + g + b, 1)
        seen[at] = _seen_share(part, inner)
        coloured = coloured or bool((part[..., 0] != part[..., 1]).any())
    return BlockGreen(mean, seen, coloured)


def _seen_share(rgb: U8, inner: int) -> F32:
    """Share of every block that is not black."""
    return block_mean((rgb[..., 1] > 0).astype(np.float32), inner)
