"""Roads by their shape: strips of even width and colour that go on, unlike the ground on both sides (G20)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from alight.arrays import F32, Mask
from alight.raster import (
    LEAST_SHARE,
    block_mean,
    close_mask,
    local_max,
    masked_gaussian,
    nearest_known,
    upsample,
    whole_blocks,
)
from alight.records import ElevationMap
from alight.settings import TerrainSettings
from alight.terrain.appearance import lit

ROAD = 1.5  # least length of a road, over that of the strips of which it consists
SUREST = 0.9  # share of the highest score near by from which a block is the middle of a road, whose hue counts
SAME_HUE = 3.5  # sigmas of `road_tints` by which the hue of one road varies; its brightness varies more, by shadows


def roads(elevation: ElevationMap, landable: F32, settings: TerrainSettings) -> Mask:
    """Return the mask of cells, (R, C), on roads.

    Single views are used where the map has them: their mean is smooth where trees and litter are not, and as a road is.

    Args:
        elevation: heights and colours.
        landable: (R, C) probability of ground that may be landed on: a road holds some.
        settings: widths and length of a road, and its contrast.
    """
    cell, shape = elevation.grid.cell, elevation.grid.shape
    if math.hypot(*shape) * cell < ROAD * settings.road_length:
        return np.zeros(shape, np.bool_)
    size = max(1, math.ceil(settings.block / cell - LEAST_SHARE))
    levels = np.where(lit(elevation.rgb)[..., None], elevation.rgb, elevation.picture(cell)[0])
    known = lit(levels) & (elevation.views > 0)
    red, green, blue = (levels[..., k].astype(np.float32) + 1 for k in range(3))
    total = red + green + blue
    leaves = (2 * green - red - blue) / total

    def blocks(values: F32) -> F32:
        """Return the mean of the known cells of each block, NaN without any."""
        mean = block_mean(whole_blocks(np.where(known, values, np.float32(0)), size), size)
        share = block_mean(whole_blocks(known.astype(np.float32), size), size)
        return np.where(share > 0.5, mean / np.maximum(share, LEAST_SHARE), np.float32(np.nan))

    of_cells = zip((np.log(total), (blue - red) / total, leaves), settings.road_tints, strict=True)
    tints = [blocks(v) / np.float32(noise) for v, noise in of_cells]
    plain = (leaves < settings.leafy).astype(np.float32), np.nan_to_num(landable)
    bare, open_ground = (np.nan_to_num(blocks(v)) for v in plain)
    score = _strips(tints, bare, size * cell, settings)
    return upsample(_connected(score, tints[1:], open_ground, size * cell, settings), size, shape)


class _Strip(NamedTuple):
    """Means over a rectangle about every block."""

    share: F32  # known blocks
    tints: Sequence[F32]
    within: F32  # variance of the tints, summed
    bare: F32


def _means(planes: Sequence[F32], length: int, width: int) -> _Strip:
    share, bare, squares, *tints = (cv2.blur(p, (length, width), borderType=cv2.BORDER_CONSTANT) for p in planes)
    known = np.maximum(share, LEAST_SHARE)
    means = [t / known for t in tints]
    return _Strip(share, means, np.maximum(squares / known - sum(m * m for m in means), 0), bare / known)


def _unlike(strip: _Strip, side: _Strip, rows: int) -> F32:
    """Return how unlike a strip is to the ground `rows` beside it: the share of the variance between them, 0 to 1."""

    def beside(values: F32) -> F32:
        return np.roll(values, rows, axis=0)

    between = sum((a - beside(b)) ** 2 for a, b in zip(strip.tints, side.tints, strict=True)) / 4
    found = between / (between + (strip.within + beside(side.within)) / 2 + 1)
    return np.where(beside(side.share) > 0.5, found, np.float32(0.5))


def _strips(tints: Sequence[F32], bare: F32, block: float, settings: TerrainSettings) -> F32:
    """Return for every block how surely it lies in a strip, 0 to 1: the best of all directions and widths."""
    known = np.isfinite(tints[0])
    tints = [np.where(known, t - np.nanmedian(t), np.float32(0)) if known.any() else t for t in tints]
    planes = [known.astype(np.float32), bare, sum(t * t for t in tints), *tints]
    rows, cols = known.shape
    side, out = math.ceil(math.hypot(rows, cols)) + 2, np.zeros((rows, cols), np.float32)
    for turn in np.arange(0.0, 180.0, 11.25):
        matrix = cv2.getRotationMatrix2D(((cols - 1) / 2, (rows - 1) / 2), turn, 1.0)
        matrix[:, 2] += (side - cols) / 2, (side - rows) / 2
        turned = [cv2.warpAffine(p, matrix, (side, side), flags=cv2.INTER_NEAREST) for p in planes]
        best = np.zeros((side, side), np.float32)
        for width in settings.road_widths:
            along = _along(turned, width / block, settings.road_length / block, settings.road_unlike[0])
            np.maximum(best, along, out=best)
        back = cv2.warpAffine(best, matrix, (cols, rows), flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP)
        np.maximum(out, back, out=out)
    return out


def _along(planes: Sequence[F32], width: float, length: float, least: float) -> F32:
    """Return for every block how surely it lies in a strip along the rows, of a width in blocks; 0 if none is `least`.

    Most ground is leafy and has no strips, and ends early.
    """
    across, piece = 2 * int((width - 1) / 2) + 1, 2 * round(length / 10) + 1
    flank = max(3, 2 * round(width / 6) + 1)
    strip = _means(planes, piece, across)
    no_strip = (strip.share < 0.8) | (strip.bare < 0.5)
    if no_strip.all():
        return np.zeros_like(strip.share)
    side = _means(planes, piece, flank)
    apart = across // 2 + flank // 2 + 2  # a row between them may be of both
    here = np.minimum(_unlike(strip, side, apart), _unlike(strip, side, -apart))
    here[no_strip] = 0
    long = 2 * round(max(length, 4 * width) / 2) + 1
    score = cv2.blur(here, (long, 1), borderType=cv2.BORDER_CONSTANT)
    if score.max() <= least:
        return np.zeros_like(score)
    score = cv2.dilate(score, np.ones((1, 2 * (long // 3) + 1), np.uint8))
    score[here < score / 2] = 0  # a strip ends where it looks like none
    spread = cv2.dilate(score, np.ones((across, 1), np.uint8))
    score[score < spread] = 0  # of strips that overlap, the surest
    return np.asarray(cv2.dilate(score, np.ones((across, 1), np.uint8)), np.float32)


def _connected(score: F32, hues: Sequence[F32], landable: F32, block: float, settings: TerrainSettings) -> Mask:
    """Return the mask of the roads: sure strips, and doubtful ones of the same hue that connect to them."""
    doubtful, sure = settings.road_unlike
    core = score > sure
    if not core.any():
        return core
    same, near = score > doubtful, round(settings.road_widths[0] / block)
    middle = core & (score >= SUREST * local_max(score, near))
    for hue in hues:
        own = _trimmed(np.nan_to_num(hue), middle & np.isfinite(hue), near)
        same &= np.abs(cv2.medianBlur(np.nan_to_num(hue), 3) - nearest_known(own, middle)) < SAME_HUE
    number, parts, boxes, _ = cv2.connectedComponentsWithStats(same.astype(np.uint8), connectivity=8)
    keep = np.zeros(number, np.bool_)
    for k in range(1, number):
        at = parts == k
        long = math.hypot(*boxes[k, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]]) * block
        keep[k] = long >= ROAD * settings.road_length and core[at].any() and landable[at].mean() > 0.1
    return close_mask(keep[parts], 1)


def _trimmed(values: F32, where: Mask, sigma: float) -> F32:
    """Return the Gaussian mean of the values (R, C) in a mask about each block, without those farthest from it."""
    for _ in range(2):
        mean = masked_gaussian(values, where.astype(np.float32), sigma)
        off = np.abs(values - mean)
        spread = np.sqrt(masked_gaussian(off**2, where.astype(np.float32), sigma))
        where = where & (off <= spread + LEAST_SHARE)
    return masked_gaussian(values, where.astype(np.float32), sigma)
