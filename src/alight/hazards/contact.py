"""What the footprint, the feet or skids, the belly and the rotor meet at every cell."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from alight.hazards.footprint import disc_mask, disc_spans, feet_of, padded_spans, skids_of
from alight.kernels import contact as gear
from alight.kernels import hazards as kernels
from alight.records import F32
from alight.settings import Lander

Bool = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Footprint:
    """The ground under the footprint disc about every cell, all (R, C) float32."""

    unknown: F32  # share of the footprint that is unknown
    level: F32  # metres, the plane at the centre
    grad_c: F32  # metres a column
    grad_r: F32  # metres a row
    slope: F32  # rad
    roughness: F32  # metres, largest deviation (G2)
    scatter: F32  # metres, 1-sigma of the deviations
    count: F32  # known cells


def footprint_of(height: F32, radius: float, cell: float) -> Footprint:
    """Lay the least-squares plane of the footprint about every cell (G1, G2)."""
    spans = disc_spans(radius / cell)
    sums = np.empty((6, height.shape[0], height.shape[1] + 1))
    kernels.row_sums(height, sums)
    count, level, grad_c, grad_r, largest, squares = (np.empty_like(height) for _ in range(6))
    kernels.fit_planes(sums, spans, count, level, grad_c, grad_r, squares)
    kernels.deviations(height, level, grad_c, grad_r, spans, largest)
    judged = np.isfinite(level)
    slope = np.arctan(np.hypot(grad_c, grad_r) / np.float32(cell))
    scatter = np.sqrt(squares / np.maximum(count - 3, 1))
    unknown = 1 - count / np.float32(disc_mask(spans).sum())
    nan = np.float32(np.nan)
    return Footprint(
        unknown, level, grad_c, grad_r, slope, np.where(judged, largest, nan), np.where(judged, scatter, nan), count
    )


def step_of(height: F32, radius: float, cell: float) -> F32:
    """Largest height difference between neighbouring known cells in the footprint, metres; NaN where none is known."""
    step = np.empty_like(height)
    kernels.neighbour_steps(height, step)
    disc = disc_mask(disc_spans(radius / cell))
    worst = cv2.dilate(
        np.where(np.isnan(step), np.float32(-1), step), disc, borderType=cv2.BORDER_CONSTANT, borderValue=-1
    )
    return np.where(worst >= 0, worst, np.float32(np.nan))


def rotor_rise(height: F32, footprint: Footprint, lander: Lander, cell: float) -> F32:
    """Largest rise above the touchdown plane between the footprint's rim and the rotor's, metres (G6)."""
    assert lander.rotor_radius is not None
    outer = disc_spans(lander.rotor_radius / cell)
    inner = padded_spans(disc_spans(lander.radius / cell), outer.size // 2)
    rise = np.empty_like(height)
    kernels.highest_above(height, footprint.level, footprint.grad_c, footprint.grad_r, inner, outer, rise)
    return rise


def gear_contact(height: F32, footprint: Footprint, skip: Bool, lander: Lander, cell: float) -> tuple[F32, F32]:
    """Rest feet or skids on the ground at every heading (G4, G5).

    Returns:
        The worst tilt (R, C) rad, and the worst rise of the ground above the contact plane under the body, metres
        (where it is below the belly clearance only a bound). NaN where a foot or rail would stand on unknown ground,
        and where `skip` says that the answer is not wanted.
    """
    in_cells = [
        np.ascontiguousarray(a / np.float32(cell))
        for a in (height, footprint.level, footprint.grad_c, footprint.grad_r, footprint.roughness)
    ]
    spare = math.inf if lander.belly_clearance is None else lander.belly_clearance / cell
    tilt, rise = np.empty_like(height), np.empty_like(height)
    spans = disc_spans(lander.radius / cell)
    if lander.feet is not None:
        f = feet_of(lander, cell)
        gear.feet_contact(
            in_cells[0], skip, *in_cells[1:], f.xy, f.offsets, f.starts, f.triples, spans, spare, tilt, rise
        )
    else:
        s = skids_of(lander, cell)
        gear.skid_contact(
            in_cells[0], skip, *in_cells[1:], s.axes, s.offsets, s.along, s.gauge, spans, spare, tilt, rise
        )
    return np.arctan(tilt), rise * np.float32(cell)


def share_near(mask: Bool, radius: float, cell: float) -> F32:
    """Share of the disc about every cell where the mask holds; cells off the map do not count as holding it."""
    disc = disc_mask(disc_spans(radius / cell)).astype(np.float32)
    share: F32 = cv2.filter2D(mask.astype(np.float32), cv2.CV_32F, disc / disc.sum(), borderType=cv2.BORDER_CONSTANT)
    return share


def any_near(mask: Bool, radius: float, cell: float) -> Bool:
    """Whether the mask holds anywhere in the disc about every cell."""
    disc = disc_mask(disc_spans(radius / cell))
    near: Bool = cv2.dilate(mask.astype(np.uint8), disc, borderType=cv2.BORDER_CONSTANT, borderValue=0) > 0
    return near


def near_edge(shape: tuple[int, int], radius: float, cell: float) -> Bool:
    """Cells whose disc leaves the map."""
    reach = disc_spans(radius / cell).size // 2
    out = np.ones(shape, dtype=np.bool_)
    out[reach : shape[0] - reach, reach : shape[1] - reach] = False
    return out
