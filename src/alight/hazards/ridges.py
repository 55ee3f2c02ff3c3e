"""Straight ridges in the heights: kerbs, low walls, pipes, beams (docs/method/p-safe.md, G7i)."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np

from alight.arrays import F32, F64
from alight.raster import block_mean, difference_of_gaussians, filled_surface, upsample, whole_blocks

BAND = 0.1, 0.45  # metres, 1-sigma of the two Gaussians that isolate the relief of a kerb
CELL = 0.12  # metres, approximate cell size of the search for lines
PART = 0.7  # metres, length of each of the three parts of a line
DIRECTIONS = 24


def straight_ridges(height: F32, cell: float) -> F32:
    """Compute the relief of the straight ridge through every cell, (R, C) metres.

    Artificial objects have straight ridges; natural ground has few. The relief is a difference of Gaussians of the
    heights, averaged over each of three consecutive parts of a line. The result is the smallest of the three means, in
    the direction where it is largest. So a stone, which raises one part only, is no ridge, and noise averages out.

    A kerb of 0.1 m has a relief of about 0.045 m. An unknown height (NaN) is replaced by the nearest known height.
    """
    n = max(round(CELL / cell), 1)
    coarse = block_mean(whole_blocks(filled_surface(height), n), n)
    relief = difference_of_gaussians(coarse, *(s / cell / n for s in BAND))
    out, directions = np.zeros_like(relief), _directions(PART / cell / n)
    margin = max(abs(offset) for parts in directions for part in parts for offset in part[:2])
    wide = np.pad(relief, margin, mode="edge")
    for parts in directions:
        np.maximum(out, np.minimum.reduce([_mean(wide, part, margin) for part in parts]), out=out)
    return upsample(out, n, height.shape)


class _Part(NamedTuple):
    """One part of a line: offset in cells from the middle of the line, and weights around that offset."""

    rows: int
    columns: int
    weights: F32


@lru_cache(maxsize=8)
def _directions(length: float) -> tuple[tuple[_Part, ...], ...]:
    """Return the three parts of a line for every direction; `length` of a part in cells."""
    angles = np.arange(DIRECTIONS) * math.pi / DIRECTIONS
    alongs = length * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return tuple(tuple(_part(along, k) for k in (-1, 0, 1)) for along in alongs)


def _part(along: F64, place: int) -> _Part:
    """Build a part of a line; `along`: (column, row) vector of its length; `place`: -1 first, 0 middle, 1 last part."""
    columns, rows = (round(float(v)) for v in place * along)
    rest = place * along - (columns, rows)
    reach = math.ceil(0.5 * float(np.abs(along).max()) + 0.5) + 1
    out = np.zeros((2 * reach + 1, 2 * reach + 1), np.float32)
    for step in np.linspace(-0.5, 0.5, 4 * reach + 1):
        column, row = reach + rest + step * along
        c, r = int(column), int(row)
        across, down = column - c, row - r
        out[r : r + 2, c : c + 2] += np.outer([1 - down, down], [1 - across, across]).astype(np.float32)
    return _Part(rows, columns, np.asarray(out / out.sum(), np.float32))


def _mean(wide: F32, part: _Part, margin: int) -> F32:
    """Return the mean of a part about every cell; `wide`: the relief with a `margin` of cells on every side."""
    rows, cols = (n - 2 * margin for n in wide.shape)
    at = margin + part.rows, margin + part.columns
    moved = wide[at[0] : at[0] + rows, at[1] : at[1] + cols]
    return np.asarray(cv2.filter2D(moved, -1, part.weights, borderType=cv2.BORDER_REPLICATE))
