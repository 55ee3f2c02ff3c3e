"""Square blocks of cells: reductions to a coarser raster, and back."""

from __future__ import annotations

from functools import reduce
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from alight.arrays import F32

T = TypeVar("T", bound=np.generic)


def cells_as_blocks(fine: NDArray[T], factor: int) -> NDArray[T]:
    """Pixels by the cell that they lie in, (R, factor, C, factor), of (R factor, C factor)."""
    rows, cols = fine.shape[0] // factor, fine.shape[1] // factor
    return fine.reshape(rows, factor, cols, factor)


def whole_blocks(values: NDArray[T], factor: int) -> NDArray[T]:
    """Repeat the last row and column of (R, C) until all blocks of `factor` cells a side are whole."""
    missing = [(0, -n % factor) for n in values.shape]
    return np.pad(values, missing, mode="edge") if any(n for _, n in missing) else values


def block_mean(fine: F32, factor: int) -> F32:
    """Mean of the pixels of each cell, (R, C) of (R factor, C factor)."""
    size = (fine.shape[1] // factor, fine.shape[0] // factor)
    return np.asarray(cv2.resize(fine, size, interpolation=cv2.INTER_AREA), np.float32)


def block_max(fine: F32, factor: int) -> F32:
    """Largest of the pixels of each cell, (R, C) of (R factor, C factor)."""
    pixels = (fine[r::factor, c::factor] for r in range(factor) for c in range(factor))
    return np.asarray(reduce(np.maximum, pixels), np.float32)


def block_quantile(values: F32, factor: int, share: float) -> F32:
    """Quantile of the known cells of each block; NaN where none is known.

    Args:
        values: (R, C), NaN = unknown; the last row and column of blocks may be cut short.
        factor: cells a side of a block.
        share: 0 to 1; the cell of that rank, not interpolated.
    """
    rows, cols = (-(-n // factor) for n in values.shape)
    padded = np.full((rows * factor, cols * factor), np.nan, dtype=np.float32)
    padded[: values.shape[0], : values.shape[1]] = values
    cells = np.sort(cells_as_blocks(padded, factor).transpose(0, 2, 1, 3).reshape(rows, cols, -1), axis=2)
    known = np.isfinite(cells).sum(axis=2)
    pick = np.clip(np.floor(share * known), 0, np.maximum(known - 1, 0)).astype(np.int64)
    return np.take_along_axis(cells, pick[..., None], axis=2)[..., 0]


def upsample(coarse: NDArray[T], factor: int, shape: tuple[int, int] | None = None) -> NDArray[T]:
    """Each cell's value for all its pixels, (R factor, C factor, ...), cut to `shape` (rows, columns) where given."""
    fine = np.repeat(np.repeat(coarse, factor, axis=0), factor, axis=1)
    return fine if shape is None else fine[: shape[0], : shape[1]]
