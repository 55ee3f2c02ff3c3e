"""The ground under the footprint disc about every cell: plane, deviations and steps (G1 to G3)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from alight.arrays import F32
from alight.hazards import footprint_kernels as kernels
from alight.raster import disc_mask, disc_spans


@dataclass(frozen=True, eq=False)
class Footprint:
    """The ground under the footprint disc about every cell, all (R, C) float32."""

    unknown: F32  # share of the footprint that is unknown
    level: F32  # metres, the plane at the centre
    grad_c: F32  # metres a column
    grad_r: F32  # metres a row
    slope: F32  # rad
    roughness: F32  # metres, largest deviation (G2)
    rise: F32  # metres, the highest ground over the plane
    scatter: F32  # metres, 1-sigma of the deviations
    count: F32  # known cells


def footprint_of(height: F32, radius: float, cell: float) -> Footprint:
    """Lay the least-squares plane of the footprint about every cell (G1, G2)."""
    spans = disc_spans(radius / cell)
    reach = spans.size // 2
    count, level, grad_c, grad_r, squares = _planes(height, spans)
    rise, dip = np.empty_like(height), np.empty_like(height)
    padded = np.pad(height, ((0, 0), (reach, reach)), constant_values=np.nan)
    kernels.deviations(padded, level, grad_c, grad_r, spans, rise, dip)
    judged = np.isfinite(level)
    slope = np.arctan(np.hypot(grad_c, grad_r) / np.float32(cell))
    scatter = np.sqrt(squares / np.maximum(count - 3, 1))
    unknown = 1 - count / np.float32(disc_mask(spans).sum())
    nan = np.float32(np.nan)
    rough, rise, scatter = (np.where(judged, a, nan) for a in (np.maximum(rise, -dip), rise, scatter))
    return Footprint(unknown, level, grad_c, grad_r, slope, rough, rise, scatter, count)


def _planes(height: F32, spans: NDArray[np.int64], strip: int = 512) -> list[F32]:
    """Known cells, the plane's level and rise per column and per row, and the squared deviations from it; (R, C) each.

    By strips of rows, as the running sums take twelve times the memory of the heights.
    """
    rows, cols = height.shape
    reach, out = spans.size // 2, [np.empty_like(height) for _ in range(5)]
    for top in range(0, rows, strip):
        first, bottom = max(top - reach, 0), min(top + strip, rows)
        part = np.ascontiguousarray(height[first : bottom + reach])
        sums, found = np.empty((len(part), 6, cols + 1 + 2 * reach)), [np.empty_like(part) for _ in out]
        kernels.row_sums(part, reach, sums)
        kernels.fit_planes(sums, spans, *found)
        for whole, some in zip(out, found, strict=True):
            whole[top:bottom] = some[top - first : bottom - first]
    return out


def step_of(height: F32, radius: float, cell: float) -> F32:
    """Largest height difference between neighbouring known cells in the footprint, metres; NaN where none is known."""
    step = np.empty_like(height)
    kernels.neighbour_steps(height, step)
    disc = disc_mask(disc_spans(radius / cell))
    worst = cv2.dilate(
        np.where(np.isnan(step), np.float32(-1), step), disc, borderType=cv2.BORDER_CONSTANT, borderValue=-1
    )
    return np.where(worst >= 0, worst, np.float32(np.nan))
