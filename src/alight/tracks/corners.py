"""Corners to follow: spread over a grid, each as strong as its texture (Shi-Tomasi)."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from alight.records import F32, F64, U8
from alight.tracks.corner_kernels import strongest, textures

Mask = NDArray[np.bool_]
Ids = NDArray[np.int64]

BORDER = 4  # px; nearer to the edge the SSD window hangs over it
_HALF = 2  # px of the window, less its middle, that a corner is told from


def strength(image: U8, pixels: F32, window_px: int) -> F64:
    """Return the (N,) Shi-Tomasi response a pixel over the SSD window: how sharp the minimum of the SSD is."""
    out = np.empty(len(pixels))
    textures(*cv2.spatialGradient(image), np.asarray(pixels, dtype=np.float32), window_px, out)
    return out


def spread_corners(ids: Ids, pixels: F32, good: Mask, cell: float, most: int) -> Mask:
    """Keep the `most` oldest good features of every cell: converging tracks add cost and no information."""
    keep, at = np.zeros(len(ids), bool), np.flatnonzero(good)
    column, row = np.floor(np.nan_to_num(pixels[at]) / cell).astype(np.int64).T
    key = row * 100_000 + column
    order = np.argsort(key, kind="stable")  # ids grow with the row, so the oldest of a cell come first
    ranked = key[order]
    rank = np.arange(len(at)) - np.searchsorted(ranked, ranked)
    keep[at[order[rank < most]]] = True
    return keep


def corners(image: U8, taken: F32, cell: float, texture: float) -> F32:
    """Return the best Shi-Tomasi corner of every grid cell that holds no feature yet, (N, 2) pixels.

    Args:
        taken: (M, 2) pixels of the features that are there; new ones keep 0.7 of a cell away.
        cell: px, side of a cell.
        texture: least response.
    """
    height, width = image.shape
    rows, cols = (int(np.ceil(n / cell)) for n in image.shape)
    column, line = np.clip(np.floor(np.nan_to_num(taken) / cell).astype(np.int64), 0, [cols - 1, rows - 1]).T
    empty = np.ones((rows, cols), np.uint8)
    empty[line, column] = 0
    beside = cv2.dilate(empty, np.ones((3, 3), np.uint8))  # features elsewhere are too far from any empty cell
    row, col = np.nonzero(empty)
    edges = np.ceil(np.stack([row, row + 1, col, col + 1], axis=1) * cell).astype(np.int64)
    b = BORDER + 4
    boxes = np.clip(edges, b, [height - b, height - b, width - b, width - b])
    found = np.empty((len(boxes), 3))
    gx, gy = cv2.spatialGradient(cv2.GaussianBlur(image, (3, 3), 0))
    near, side = taken[beside[line, column] > 0], int(cell) + 2
    response, sums = np.empty((side, side), np.float32), np.empty((3, side + 2 * _HALF), np.int32)
    strongest(gx, gy, boxes, near, max(2.0, 0.7 * cell), _HALF, response, sums, found)
    return np.asarray(found[found[:, 2] > texture, :2], dtype=np.float32)
