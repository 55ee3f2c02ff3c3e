"""Contact of feet or skids with the ground at every cell, and of the belly (G4, G5)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from alight.arrays import F32, Mask
from alight.hazards import contact_kernels as kernels
from alight.hazards.belly_kernels import BLOCK
from alight.hazards.contact import Footprint
from alight.hazards.footprint import block_starts, feet_of, skids_of
from alight.raster import disc_spans
from alight.settings import Lander


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
        kernels.feet_contact(g.ground, g.body, g.tops, skip, g.own, *feet, *how, tilt, rise)
    else:
        s = skids_of(lander, cell)
        skids = (s.axes, s.offsets, s.along, s.gauge, g.spans, g.blocks, limits)
        kernels.skid_contact(g.ground, g.body, g.tops, skip, g.own, *skids, tilt, rise)
    return np.arctan(tilt), rise * np.float32(cell)
