"""Rest feet or skids on the ground at every cell: cells under the gear, contact planes, belly (G4, G5)."""

from __future__ import annotations

import math
from itertools import combinations

import cv2
import numpy as np

from alight.arrays import F32, F64, I64, Mask
from alight.hazards.contact_kernels import BLOCK, Belly, Feet, Skids, feet_contact, skid_contact
from alight.hazards.touchdown import Footprint
from alight.raster import RIM, disc_spans
from alight.settings import Lander

COARSE = 3.0  # least gauge or length of skids, cells: below, rounding to cells spoils the tilt


def unlike_directions(headings: int, points: F64) -> F64:
    """Return forward unit vectors (column, row), (n, 2), for `headings` evenly spaced headings clockwise from north.

    Headings whose contacts coincide with those of an earlier heading are left out; `points`: (n, 2) contacts (forward,
    left), metres.
    """
    kept: dict[bytes, F64] = {}
    for angle in 2 * math.pi * np.arange(headings) / headings:
        ahead = np.array([np.sin(angle), -np.cos(angle)])
        at = np.rint(1e6 * (points[:, :1] * ahead + points[:, 1:] * [ahead[1], -ahead[0]])) + 0.0
        kept.setdefault(at[np.lexsort(at.T)].tobytes(), ahead)
    return np.array(list(kept.values()))


def block_starts(spans: I64, side: int) -> I64:
    """Return (row, column) offsets, (b, 2), of blocks of `side` x `side` cells that cover the disc, middle first."""
    reach = spans.size // 2
    rows = range(-reach, reach + 1, side)
    widest = [max(int(spans[i + reach]) for i in range(r, min(r + side, reach + 1))) for r in rows]
    starts = np.array([(r, c) for r, w in zip(rows, widest, strict=True) for c in range(-w, w + 1, side)])
    nearest_first = np.argsort(np.hypot(*(starts + (side - 1) / 2).T), kind="stable")
    return starts[nearest_first].astype(np.int64)


def _cells_within(centre: F64, radius_cells: float) -> I64:
    """Return (row, column), (n, 2), of the cells centred in the disc around `centre` (column, row); at least one."""
    near = np.round(centre)
    reach = math.ceil(radius_cells) + 1
    grid = np.stack(np.meshgrid(*[np.arange(-reach, reach + 1)] * 2), axis=-1).reshape(-1, 2) + near
    inside = grid[np.hypot(*(grid - centre).T) <= radius_cells + RIM]
    return (inside if len(inside) else near[None])[:, ::-1].astype(np.int64)


def _corners(points: F64, triples: I64) -> F64:
    """Return the matrices (..., t, 3, 3) with rows (1, x, y) of the corners of triangles; `points`: (..., n, 2)."""
    corners = points[..., triples, :]
    return np.concatenate([np.ones((*corners.shape[:-1], 1)), corners], axis=-1)


def _triples(feet: F64, any_three: bool) -> I64:
    """Return the indices (t, 3) of three feet each that can carry the lander; small triangles are left out.

    Triangles that do not hold the lander's centre, where it would tip over, are left out as well, unless `any_three` or
    no triangle holds it.
    """
    every = np.array(list(combinations(range(len(feet)), 3)))
    area = np.abs(np.linalg.det(_corners(feet, every)))
    thick = every[area >= 0.1 * area.max()]
    weights = np.linalg.inv(_corners(feet, thick))[:, 0]  # of the corners at the centre
    held = (weights >= -1e-6).all(axis=1)
    return np.asarray(thick if any_three or not held.any() else thick[held], np.int64)


def is_coarse(lander: Lander, cell: float) -> bool:
    """Whether cells of this size (metres) are too coarse to separate the contacts of the gear (G5a)."""
    if lander.skids is not None:
        return min(lander.skids) < COARSE * cell
    return lander.feet is not None and feet_of(lander, cell).coarse


def feet_of(lander: Lander, cell: float) -> Feet:
    """Compute the cells under the lander's feet at every heading.

    Where the cells under three feet lie almost on a line, all feet get their exact positions, so that a plane exists.
    """
    assert lander.feet is not None
    body = np.array(lander.feet) / cell  # forward, left
    triples = _triples(body, lander.support == "any")
    ahead = unlike_directions(lander.headings, np.array(lander.feet))[:, None]  # (headings, 1, 2)
    left = np.stack([ahead[..., 1], -ahead[..., 0]], axis=-1)
    exact = body[:, :1] * ahead + body[:, 1:] * left
    cells = [[_cells_within(foot, lander.foot_radius / cell) for foot in feet] for feet in exact]
    centroids = np.array([[c[:, ::-1].mean(axis=0) for c in feet] for feet in cells])
    covered, spanned = (np.abs(np.linalg.det(_corners(points, triples))) for points in (centroids, exact))
    apart = np.asarray((covered >= 0.25 * spanned).all(axis=1))
    xy = np.where(apart[:, None, None], centroids, exact)
    counts = np.array([[len(c) for c in feet] for feet in cells], np.int64)
    ends = counts.cumsum().reshape(counts.shape)
    starts = np.concatenate([ends[:, :1] - counts[:, :1], ends], axis=1)
    offsets = np.concatenate([c for feet in cells for c in feet])
    how = (not bool(apart.all()), lander.foot_contact == "mean", lander.support == "any")
    return Feet(xy, offsets, starts, triples, np.asarray(np.linalg.inv(_corners(xy, triples)), np.float64), *how)


def skids_of(lander: Lander, cell: float) -> Skids:
    """Compute the cells under the lander's skids at every heading, two samples per cell of length.

    Length and gauge are measured between the cells under the rails, so that the tilt on a plane is right to 3 %. On
    cells that are too coarse (G5a), the lander's own length and gauge are used.
    """
    assert lander.skids is not None
    length, gauge = lander.skids[0] / cell, lander.skids[1] / cell
    along = np.linspace(-length / 2, length / 2, max(3, 2 * math.ceil(length / 2) + 1))
    corners = 0.5 * np.array([(f, g) for f in (-1, 1) for g in (-1, 1)]) * lander.skids
    axes = unlike_directions(lander.headings, corners)
    left = np.stack([axes[:, 1], -axes[:, 0]], axis=1)
    rails = [along[None, :, None] * axes[:, None] + side * gauge / 2 * left[:, None] for side in (1, -1)]
    cells = np.round(np.stack(rails, axis=1))  # (headings, rail, n, 2) (column, row)
    offsets = np.ascontiguousarray(cells.astype(np.int64)[..., ::-1])
    if is_coarse(lander, cell):
        return Skids(axes, offsets, np.tile(along, (len(axes), 1)), np.full(len(axes), gauge))
    stretch = np.einsum("hrnx,hx,n->h", cells, axes, along) / (2 * along @ along)
    apart = np.einsum("hnx,hx->h", cells[:, 0] - cells[:, 1], left) / along.size
    return Skids(axes, offsets, stretch[:, None] * along, apart)


def gear_contact(
    height: F32, footprint: Footprint, skip: Mask, lander: Lander, cell: float, spare: float = 0.0
) -> tuple[F32, F32]:
    """Compute the worst tilt and rise of a lander that rests on feet or skids, over all headings (G4, G5).

    Args:
        height: (R, C) metres, NaN = unknown.
        footprint: planes of the footprint.
        skip: (R, C) mask of cells that are not judged.
        lander: vehicle with feet or skids.
        cell: cell size, metres.
        spare: the rise is exact where it differs from the belly clearance by at most this distance, metres.

    Returns:
        The worst tilt (R, C) in rad, and the worst rise (R, C) of the ground under the body above the contact plane in
        metres. A rise farther than `spare` from the belly clearance is only known to be above or below it. NaN where a
        foot or rail would rest on unknown ground, and where `skip` is True.
    """
    scale, spans = np.float32(1 / cell), disc_spans(lander.radius / cell)
    heights = height * scale
    body = np.pad(np.fmax(heights, np.float32(-np.inf)), spans.size // 2 + BLOCK, constant_values=-np.inf)
    block = np.ones((BLOCK, BLOCK), np.uint8)
    tops = cv2.dilate(body, block, anchor=(0, 0), borderType=cv2.BORDER_CONSTANT, borderValue=-np.inf)
    own = np.stack([a * scale for a in (footprint.level, footprint.grad_c, footprint.grad_r, footprint.rise)])
    own[3, skip] = -np.inf
    clearance = math.inf if lander.belly_clearance is None else lander.belly_clearance
    least, most = (clearance - spare) / cell, (clearance + spare) / cell
    belly = Belly(body, tops, own, spans, block_starts(spans, BLOCK), least, most)
    tilt, rise = np.empty_like(height), np.full_like(height, least)
    if lander.feet is not None:
        feet = feet_of(lander, cell)
        ground, lost = _under_gear(heights, feet.offsets)
        feet_contact(ground, feet, belly, tilt, rise)
    else:
        skids = skids_of(lander, cell)
        ground, lost = _under_gear(heights, skids.offsets)
        skid_contact(ground, skids, belly, tilt, rise)
    lost |= skip
    nan = np.float32(np.nan)
    return np.where(lost, nan, np.arctan(tilt)), np.where(lost, nan, rise * np.float32(cell))


def _under_gear(height: F32, offsets: I64) -> tuple[F32, Mask]:
    """Pad heights (R, C) by the reach of the gear, +inf where unknown; mark touchdowns on unknown ground, (R, C).

    `offsets`: (..., 2) (row, column) offsets of the cells under the gear at all headings.
    """
    pad = int(np.abs(offsets).max())
    under = np.zeros((2 * pad + 1, 2 * pad + 1), np.uint8)
    under[tuple(offsets.reshape(-1, 2).T + pad)] = 1
    unknown = np.isnan(height)
    lost = cv2.dilate(unknown.astype(np.uint8), under, borderType=cv2.BORDER_CONSTANT, borderValue=1) > 0
    return np.pad(np.where(unknown, np.float32(np.inf), height), pad, constant_values=np.inf), np.asarray(lost)
