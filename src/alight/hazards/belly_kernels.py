"""Compiled loops that search for the contact of a lander's belly: the highest ground above its contact plane."""

import math

import numpy as np

from alight.arrays import F32, F64, I64, Mask
from alight.compiled import kernel

BLOCK = 4  # side of the blocks that the search opens, cells


@kernel
def raise_to(top: F32, line: F32) -> None:
    """Replace each cell of `top` by the larger of `top` and `line`."""
    for c in range(top.size):
        v, t = line[c], top[c]
        top[c] = v if v > t else t


@kernel
def _rise_in_block(
    body: F32, pad: int, r: int, c: int, br: int, bc: int, spans: I64, a: float, gx: float, gy: float, top: float
) -> float:
    """Return the larger of `top` and the rise above a plane (a, gx, gy) in the block of the disc at offset (br, bc)."""
    reach = spans.size // 2
    for dr in range(br, min(br + BLOCK, reach + 1)):
        half = spans[dr + reach]
        level = a + gy * dr
        for dc in range(max(bc, -half), min(bc + BLOCK, half + 1)):
            e = body[r + dr + pad, c + dc + pad] - level - gx * dc
            top = e if e > top else top
    return top


@kernel
def _rise(
    body: F32,
    tops: F32,
    pad: int,
    r: int,
    c: int,
    spans: I64,
    blocks: I64,
    plane: tuple[float, float, float],
    least: float,
    most: float,
) -> float:
    """Return the largest rise of known ground in the disc around (r, c) above a plane, or `least` if that is larger.

    `plane`: level at (r, c), gradient per column, gradient per row. The search ends once the rise exceeds `most`.
    """
    a, gx, gy = plane
    fall = (BLOCK - 1) * (min(gx, 0.0) + min(gy, 0.0))
    top = least
    for i in range(blocks.shape[0]):
        br, bc = blocks[i, 0], blocks[i, 1]
        if tops[r + br + pad, c + bc + pad] - a - gx * bc - gy * br - fall > top:
            top = _rise_in_block(body, pad, r, c, br, bc, spans, a, gx, gy, top)
            if top > most:
                break
    return top


@kernel
def may_rise(own: F64, level: F64, across: F64, along: F64, reach: float, least: F32, out: F64) -> None:
    """Fill `out` (C,) with an upper bound of the rise of the ground above each contact plane, minus `least`.

    Args:
        own: (4, C) the footprint's plane (level, per column, per row) and the highest ground above it.
        level, across, along: (C,) contact planes: level, gradient per column, gradient per row.
        reach: radius of the disc, cells.
    """
    for c in range(out.size):
        gx, gy = own[1, c] - across[c], own[2, c] - along[c]
        out[c] = own[3, c] + (own[0, c] - level[c]) + math.sqrt(gx * gx + gy * gy) * reach - least[c]


@kernel
def search(
    body: F32,
    tops: F32,
    r: int,
    spans: I64,
    blocks: I64,
    most: float,
    may: F64,
    level: F64,
    across: F64,
    along: F64,
    rise: F32,
) -> None:
    """Raise `rise` (C,) to the largest rise of the ground above the contact planes (see `may_rise`) of row `r`.

    Only cells with `may` > 0, and with a rise of at most `most` so far, are searched.
    """
    pad = spans.size // 2 + BLOCK
    for c in range(rise.size):
        if may[c] > 0.0 and rise[c] <= most:
            plane = (float(level[c]), float(across[c]), float(along[c]))
            rise[c] = _rise(body, tops, pad, r, c, spans, blocks, plane, rise[c], most)


@kernel
def gather(own: F32, r: int, skip: Mask, out: F32) -> None:
    """Copy row `r` of the footprints `own` to `out` (4, C); the highest ground of skipped cells becomes -inf."""
    for i in range(4):
        out[i] = own[i, r]
    for c in range(out.shape[1]):
        out[3, c] = np.float32(-np.inf) if skip[r, c] else out[3, c]


@kernel
def keep(skip: Mask, known: F32, steep: F32, tilt: F32, rise: F32) -> None:
    """Fill `tilt` with the root of `steep`; where skipped or where `known` is inf, set `tilt` and `rise` to NaN."""
    for c in range(tilt.size):
        tilt[c] = math.sqrt(steep[c])
        if skip[c] or known[c] == np.inf:
            tilt[c] = rise[c] = math.nan
