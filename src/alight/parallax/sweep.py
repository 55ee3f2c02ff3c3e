"""Plane sweep on the world grid with semi-global aggregation: heights from nothing (cold start, recorded flights)."""

from __future__ import annotations

import numpy as np

from alight.geometry import Grid
from alight.kernels import sweep as kernels
from alight.kernels.sorting import network
from alight.parallax.views import Prepared, stack
from alight.records import F32

KEEP = 0.7  # share of the views that has to agree
TRUNCATION = np.float32(1.5)  # normalised grey
P1, P2, EDGE = (
    np.float32(0.05),
    np.float32(0.5),
    np.float32(0.5),
)  # smoothness of one plane, of more, and at image edges
MOST_PLANES = 192


def parallax_per_metre(prepared: list[Prepared], height: float) -> float:
    """Metres of slide over the ground between the two outermost views, a metre of height."""
    v = np.array([p.centre[:2] / max(p.centre[2] - height, 1e-3) for p in prepared])
    return float(max(np.linalg.norm(v - a, axis=1).max() for a in v)) if len(v) else 0.0


def planes(prepared: list[Prepared], low: float, high: float, cell: float) -> F32:
    """The heights to try: 0.7 cells of parallax apart between the outermost views, at most `MOST_PLANES`."""
    slide = max(parallax_per_metre(prepared, 0.5 * (low + high)), 1e-3)
    count = int(np.clip(np.ceil((high - low) * slide / (0.7 * cell)) + 1, 5, MOST_PLANES))
    return np.linspace(low, high, count).astype(np.float32)


def sweep(prepared: list[Prepared], grid: Grid, levels: F32, ground: float) -> tuple[F32, F32]:
    """Find the height of every cell among `levels` (docs/method.md, eqs. 6 and 7).

    Cells that two views would not see if they lay at `ground` (metres) are left out: at the border of what is seen,
    only a wrong height brings them into a second image.

    Returns:
        heights (R, C), NaN where fewer than two views see, and best/second cost (R, C), near 1 where a second one fits.
    """
    rows, cols = grid.shape
    cost = np.empty((rows, cols, len(levels)), np.float32)
    plane, count = np.empty((rows, cols), np.float32), np.zeros((rows, cols), np.int32)
    seen = np.zeros((rows, cols), np.int32)
    usual = int(np.argmin(np.abs(levels - ground)))
    for k, z in enumerate(levels):
        samples = stack(prepared, grid, np.full((rows, cols), z, np.float32))
        kernels.sweep_cost(samples, network(len(samples)), KEEP, TRUNCATION, plane, count)
        cost[:, :, k] = plane
        if k == usual:
            seen = count.copy()
    smooth = window3(cost)
    guide = stack(prepared[:1], grid, np.full((rows, cols), np.median(levels), np.float32))[0]
    halves = np.empty((2, *cost.shape), np.float32)
    kernels.aggregate(smooth, np.nan_to_num(guide), P1, P2, EDGE, halves)
    total = np.add(halves[0], halves[1], out=halves[0])
    index, ratio = np.empty((rows, cols), np.float32), np.empty((rows, cols), np.float32)
    kernels.winner(total, smooth, seen, index, ratio)
    spacing = levels[1] - levels[0]
    return (levels[0] + spacing * index).astype(np.float32), ratio


def window3(cost: F32) -> F32:
    """Mean over 3x3 cells of a cost volume (R, C, D)."""
    padded = np.pad(cost, ((1, 1), (1, 1), (0, 0)), mode="edge")
    rows, cols = cost.shape[:2]
    out = np.zeros_like(cost)
    for dr in range(3):
        for dc in range(3):
            out += padded[dr : dr + rows, dc : dc + cols]
    return out / np.float32(9)
