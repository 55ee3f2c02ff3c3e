"""Corner detection (Shi and Tomasi 1994), spread over a grid."""

from __future__ import annotations

import cv2
import numpy as np

from alight.arrays import F32, F64, I64, U8, Mask
from alight.tracks.corner_kernels import corner_responses, strongest_corners

BORDER = 4  # px; nearer to the edge, the SSD window extends beyond the image


def corner_response(image: U8, pixels: F32, window_px: int) -> F64:
    """Return the (N,) Shi-Tomasi response of the window around each pixel (N, 2), divided by the window's area."""
    out = np.empty(len(pixels))
    corner_responses(image, np.asarray(pixels, dtype=np.float32), window_px, out)
    return out


def oldest_per_cell(ids: I64, pixels: F32, good: Mask, cell: float, most: int) -> Mask:
    """Return the (N,) mask of the `most` oldest features that are `good` (N,), per cell of `cell` px; ids ascend."""
    keep, at = np.zeros(len(ids), bool), np.flatnonzero(good)
    column, row = np.floor(np.nan_to_num(pixels[at]) / cell).astype(np.int64).T
    key = row * 100_000 + column
    order = np.argsort(key, kind="stable")  # rows are in ascending order of ids, so the oldest of a cell come first
    ranked = key[order]
    rank = np.arange(len(at)) - np.searchsorted(ranked, ranked)
    keep[at[order[rank < most]]] = True
    return keep


def detect_corners(image: U8, taken: F32, cell: float, texture: float, border: int = 2 * BORDER) -> F32:
    """Return the (M, 2) pixels of the strongest Shi-Tomasi corner of each grid cell without a feature.

    Args:
        image: smoothed image.
        taken: (K, 2) pixels of the present features; new ones keep a distance of 0.7 cells from them.
        cell: side of a cell, px.
        texture: least response of a corner.
        border: width of the border without corners, px; it is never less than 2 `BORDER`.
    """
    height, width = image.shape
    rows, cols = (int(np.ceil(n / cell)) for n in image.shape)
    column, line = np.clip(np.floor(np.nan_to_num(taken) / cell).astype(np.int64), 0, [cols - 1, rows - 1]).T
    empty = np.ones((rows, cols), np.uint8)
    empty[line, column] = 0
    beside = cv2.dilate(empty, np.ones((3, 3), np.uint8))  # features elsewhere are too far from any empty cell
    row, col = np.nonzero(empty)
    edges = np.ceil(np.stack([row, row + 1, col, col + 1], axis=1) * cell).astype(np.int64)
    b = max(border, 2 * BORDER)
    boxes = np.clip(edges, b, [height - b, height - b, width - b, width - b])
    found = np.empty((len(boxes), 3))
    near = np.ascontiguousarray(taken[beside[line, column] > 0])
    strongest_corners(image, boxes, near, max(2.0, 0.7 * cell), 2, found)
    return np.asarray(found[found[:, 2] > texture, :2], dtype=np.float32)
