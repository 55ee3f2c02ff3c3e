"""Corners to follow: spread over a grid, each as strong as its texture (Shi-Tomasi)."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from alight.records import F32, F64, U8

Mask = NDArray[np.bool_]
Ids = NDArray[np.int64]

BORDER = 4  # px; nearer to the edge the SSD window hangs over it
_PER_CELL = 3  # features that may run together in one cell of the grid before the younger are dropped


def strength(image: U8, pixels: F32, window_px: int) -> F64:
    """Return the (N,) Shi-Tomasi response a pixel over the SSD window: how sharp the minimum of the SSD is."""
    response = cv2.cornerMinEigenVal(image, window_px)
    height, width = image.shape
    x = np.clip(np.round(pixels[:, 0]).astype(int), 0, width - 1)
    y = np.clip(np.round(pixels[:, 1]).astype(int), 0, height - 1)
    return np.asarray(response[y, x], dtype=np.float64)


def spread(ids: Ids, pixels: F32, good: Mask, cell: float) -> Mask:
    """Keep the `_PER_CELL` oldest good features of every cell: converging tracks add cost and no information."""
    keep, at = np.zeros(len(ids), bool), np.flatnonzero(good)
    column, row = np.floor(np.nan_to_num(pixels[at]) / cell).astype(np.int64).T
    key = row * 100_000 + column
    order = np.argsort(key, kind="stable")  # ids grow with the row, so the oldest of a cell come first
    ranked = key[order]
    rank = np.arange(len(at)) - np.searchsorted(ranked, ranked)
    keep[at[order[rank < _PER_CELL]]] = True
    return keep


def corners(image: U8, taken: F32, cell: float, texture: float) -> F32:
    """Return the best Shi-Tomasi corner of every grid cell that holds no feature yet, (N, 2) pixels.

    Args:
        taken: (M, 2) pixels of the features that are there; new ones keep 0.7 of a cell away.
        cell: px, side of a cell.
        texture: least response.
    """
    response = cv2.cornerMinEigenVal(cv2.GaussianBlur(image, (3, 3), 0), 5)
    b = BORDER + 4
    response[:b], response[-b:], response[:, :b], response[:, -b:] = 0, 0, 0, 0
    rows, cols = (int(np.ceil(n / cell)) for n in response.shape)
    column, line = np.clip(np.floor(np.nan_to_num(taken) / cell).astype(np.int64), 0, [cols - 1, rows - 1]).T
    empty = np.ones((rows, cols), np.uint8)
    empty[line, column] = 0
    beside = cv2.dilate(empty, np.ones((3, 3), np.uint8))  # features elsewhere are too far from any empty cell
    for x, y in taken[beside[line, column] > 0]:
        cv2.circle(response, (round(float(x)), round(float(y))), max(2, int(0.7 * cell)), 0.0, -1)
    found = []
    for row, col in zip(*np.nonzero(empty), strict=True):
        y, x = int(np.ceil(row * cell)), int(np.ceil(col * cell))
        part = response[y : int(np.ceil((row + 1) * cell)), x : int(np.ceil((col + 1) * cell))]
        r, c = divmod(int(part.argmax()), part.shape[1]) if part.size else (0, 0)
        if part.size and part[r, c] > texture:
            found.append((x + c, y + r))
    return np.array(found, np.float32).reshape(-1, 2)
