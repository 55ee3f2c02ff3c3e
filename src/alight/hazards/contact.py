"""Contact geometry of a touchdown at every cell: footprint plane, feet or skids, belly, rotor (G1 to G6)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from alight.arrays import F32, Mask
from alight.hazards import contact_kernels as gear
from alight.hazards import footprint_kernels as kernels
from alight.hazards.belly_kernels import BLOCK
from alight.hazards.footprint import block_starts, feet_of, padded_spans, skids_of
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


@dataclass(frozen=True, eq=False)
class _Ground:
    """Input of the contact kernels, heights in cells."""

    ground: F32  # (R, C), +inf where unknown
    body: F32  # (R + 2 pad, C + 2 pad), -inf where unknown and off the map
    tops: F32  # like `body`: highest cell of the block that starts there
    own: F32  # (4, R, C) the footprint's plane and the highest ground above it
    spans: NDArray[np.int64]
    blocks: NDArray[np.int64]


def _ground_of(height: F32, footprint: Footprint, lander: Lander, cell: float) -> _Ground:
    scale = np.float32(1 / cell)
    known = np.isfinite(height)
    spans = disc_spans(lander.radius / cell)
    pad = spans.size // 2 + BLOCK
    body = np.pad(np.where(known, height * scale, np.float32(-np.inf)), pad, constant_values=-np.inf)
    block = np.ones((BLOCK, BLOCK), np.uint8)
    tops = cv2.dilate(body, block, anchor=(0, 0), borderType=cv2.BORDER_CONSTANT, borderValue=-np.inf)
    own = np.stack(
        [footprint.level * scale, footprint.grad_c * scale, footprint.grad_r * scale, footprint.rise * scale]
    )
    ground = np.where(known, height * scale, np.float32(np.inf))
    return _Ground(ground, body, np.asarray(tops), own, spans, block_starts(spans, BLOCK))


def gear_contact(
    height: F32, footprint: Footprint, skip: Mask, lander: Lander, cell: float, spare: float = 0.0
) -> tuple[F32, F32]:
    """Rest feet or skids on the ground at every heading (G4, G5).

    Args:
        height: (R, C) metres, NaN = unknown.
        footprint: its planes.
        skip: (R, C) cells that are not judged.
        lander: its gear.
        cell: metres.
        spare: metres about the belly clearance within which the rise is computed exactly.

    Returns:
        The worst tilt (R, C) rad, and the worst rise of the ground above the contact plane under the body, metres
        (exact within `spare` of the belly clearance, elsewhere only on which side). NaN where a foot or rail would
        stand on unknown ground, and where `skip` holds.
    """
    g = _ground_of(height, footprint, lander, cell)
    clearance = math.inf if lander.belly_clearance is None else lander.belly_clearance
    limits = ((clearance - spare) / cell, (clearance + spare) / cell)
    tilt, rise = np.empty_like(height), np.empty_like(height)
    if lander.feet is not None:
        f = feet_of(lander, cell)
        feet = (f.xy, f.solve, f.offsets, f.starts, f.triples, g.spans, g.blocks, limits)
        how = (lander.foot_contact == "mean", lander.support == "any")
        gear.feet_contact(g.ground, g.body, g.tops, skip, g.own, *feet, *how, tilt, rise)
    else:
        s = skids_of(lander, cell)
        skids = (s.axes, s.offsets, s.along, s.gauge, g.spans, g.blocks, limits)
        gear.skid_contact(g.ground, g.body, g.tops, skip, g.own, *skids, tilt, rise)
    return np.arctan(tilt), rise * np.float32(cell)
