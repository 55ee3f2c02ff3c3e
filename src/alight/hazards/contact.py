"""Contact geometry of a touchdown at every cell: footprint plane and rotor (G1 to G3, G6); gear is in `gear`."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from alight.arrays import F32
from alight.hazards import footprint_kernels as kernels
from alight.hazards.footprint import padded_spans
from alight.raster import disc_mask, disc_spans
from alight.settings import Lander

STRIP = 512  # rows whose running sums are held at once
CERTAIN = np.float32(40.0)  # sigmas; a limit is kept, or broken, for sure
NO_NOISE = 1e-9  # metres; a smaller sigma is none


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


def _planes(height: F32, spans: NDArray[np.int64]) -> list[F32]:
    """Known cells, the plane's level and rise per column and per row, and the squared deviations from it; (R, C) each.

    By strips of rows, as the running sums take twelve times the memory of the heights.
    """
    rows, cols = height.shape
    reach, out = spans.size // 2, [np.empty_like(height) for _ in range(5)]
    for top in range(0, rows, STRIP):
        first, bottom = max(top - reach, 0), min(top + STRIP, rows)
        part = np.ascontiguousarray(height[first : bottom + reach])
        sums, found = np.empty((len(part), 6, cols + 1 + 2 * reach)), [np.empty_like(part) for _ in out]
        kernels.row_sums(part, reach, sums)
        kernels.fit_planes(sums, spans, *found)
        for whole, strip in zip(out, found, strict=True):
            whole[top:bottom] = strip[top - first : bottom - first]
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


def rotor_margin(height: F32, sigma: F32, footprint: Footprint, lander: Lander, cell: float) -> F32:
    """Least margin below the rotor between the footprint's rim and its own, (R, C) in sigmas of the heights (G6, G8c).

    Args:
        height: (R, C) metres, NaN = unknown.
        sigma: (R, C) metres, of each height.
        footprint: its planes; the ground under the rotor may rise above them by at most `rotor_rise`.
        lander: its rotor.
        cell: metres.
    """
    assert lander.rotor_radius is not None
    outer = disc_spans(lander.rotor_radius / cell)
    inner = padded_spans(disc_spans(lander.radius / cell), outer.size // 2)
    margin, weight = np.empty_like(height), 1 / np.fmax(sigma, np.float32(NO_NOISE))
    limit = footprint.level + np.float32(lander.rotor_rise)
    kernels.least_margin(height, weight, limit, footprint.grad_c, footprint.grad_r, inner, outer, margin)
    return margin.clip(-CERTAIN, CERTAIN)
