"""Statistics over the disc of cells whose centres lie within a radius: the cells of a lander's footprint."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np

from alight.arrays import F32, I64, U8, Mask

RIM = 1e-6  # cells; a centre exactly on the rim belongs to the disc, however the radius is rounded


def disc_spans(radius_cells: float) -> I64:
    """Half width of each row of the disc of cells whose *centres* lie within the radius.

    Args:
        radius_cells: radius over cell size.

    Returns:
        (2 n + 1,) half widths in cells, from the northernmost row to the southernmost.
    """
    reach = math.floor(radius_cells + RIM)
    rows = np.arange(-reach, reach + 1, dtype=np.float64)
    return np.floor(np.sqrt(np.maximum((radius_cells + RIM) ** 2 - rows**2, 0.0)) + RIM).astype(np.int64)


def disc_mask(spans: I64) -> U8:
    """The disc as a (2 n + 1, 2 n + 1) array of ones and zeros, as OpenCV's filters take it."""
    reach = spans.size // 2
    return (np.abs(np.arange(-reach, reach + 1)) <= spans[:, None]).astype(np.uint8)


def _disc(radius: float, cell: float) -> U8:
    return disc_mask(disc_spans(radius / cell))


def disc_mean(values: F32, radius: float, cell: float) -> F32:
    """Mean of the known values in the disc about every cell, NaN where none is known; radius and cell in metres."""
    known = np.isfinite(values)
    if known.all():
        return np.asarray(_sums(values, radius, cell) / _cells_in(values.shape, radius, cell), np.float32)
    total, weight = (_sums(a, radius, cell) for a in (np.where(known, values, 0), known))
    out = np.full(values.shape, np.nan, dtype=np.float32)
    np.divide(total, weight, out=out, where=weight > 0.5)
    return out


def _sums(values: F32 | Mask, radius: float, cell: float) -> F32:
    """Sum over the disc about every cell; cells off the map count as 0."""
    disc = _disc(radius, cell).astype(np.float32)
    return np.asarray(cv2.filter2D(values.astype(np.float32), cv2.CV_32F, disc, borderType=cv2.BORDER_CONSTANT))


@lru_cache(maxsize=16)
def _cells_in(shape: tuple[int, ...], radius: float, cell: float) -> F32:
    """Cells of the map in the disc about every cell."""
    cells = _sums(np.ones(shape, np.bool_), radius, cell)
    cells.flags.writeable = False
    return cells


def disc_max(values: F32, radius: float, cell: float) -> F32:
    """Largest value in the disc about every cell, at least one cell wide each way; radius and cell in metres."""
    return np.asarray(cv2.dilate(values, _disc(max(radius, cell), cell), borderType=cv2.BORDER_REPLICATE), np.float32)


def disc_share(mask: Mask, radius: float, cell: float) -> F32:
    """Share of the disc about every cell where the mask holds; cells off the map do not count as holding it."""
    disc = _disc(radius, cell).astype(np.float32)
    share: F32 = cv2.filter2D(mask.astype(np.float32), cv2.CV_32F, disc / disc.sum(), borderType=cv2.BORDER_CONSTANT)
    return share


def disc_any(mask: Mask, radius: float, cell: float) -> Mask:
    """True where the mask holds anywhere in the disc about the cell."""
    disc = _disc(radius, cell)
    near: Mask = cv2.dilate(mask.astype(np.uint8), disc, borderType=cv2.BORDER_CONSTANT, borderValue=0) > 0
    return near


def disc_crosses_edge(shape: tuple[int, int], radius: float, cell: float) -> Mask:
    """True for the cells whose disc leaves the map."""
    reach = disc_spans(radius / cell).size // 2
    out = np.ones(shape, dtype=np.bool_)
    out[reach : shape[0] - reach, reach : shape[1] - reach] = False
    return out


class DiscWindow(NamedTuple):
    """The cells of a disc, cut at the map's edge."""

    rows: slice
    cols: slice
    inside: Mask  # (rows, cols) of the window


def disc_window(shape: tuple[int, int], row: int, col: int, radius_cells: float) -> DiscWindow:
    """The window of the disc about one cell of a map of `shape`, and the cells of the disc in it."""
    reach = math.floor(radius_cells + RIM)
    rows = slice(max(0, row - reach), min(shape[0], row + reach + 1))
    cols = slice(max(0, col - reach), min(shape[1], col + reach + 1))
    y, x = np.ogrid[rows.start - row : rows.stop - row, cols.start - col : cols.stop - col]
    return DiscWindow(rows, cols, np.hypot(x, y) <= radius_cells + RIM)
