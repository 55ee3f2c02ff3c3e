"""Compiled loops that search for the contact of a lander's belly: the highest ground above its contact plane."""

import math

import numpy as np

from alight.arrays import F32, F64, I64, Mask
from alight.compiled import kernel

BLOCK = 4  # side of the blocks that the search opens, cells


@kernel
def raise_to(top: F32, line: F32) -> None:
    """Replace `top` by the larger of `top` and `line`, cell by cell; slices without offsets vectorise."""
    for c in range(top.size):
        v, t = line[c], top[c]
        top[c] = v if v > t else t


@kernel
def _rise_in_block(
    body: F32, pad: int, r: int, c: int, br: int, bc: int, spans: I64, a: float, gx: float, gy: float, top: float
) -> float:
    """Return the largest rise of the ground above the plane (a, gx, gy) in one block of the disc, or `top`."""
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
    """Return the largest rise of known ground in the disc above a plane (level, x, y), or `least` if that is larger.

    The search ends above `most`. A block of cells is opened only if its highest cell could increase the result: it is
    compared with the lowest corner of the plane over the block.
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
    """Fill `out` with an upper bound of the ground's rise above a contact plane, minus `least`, cell by cell.

    The ground is at most `own[3]` above the footprint's own plane (level, x, y). The two planes differ by at most their
    difference at the centre plus the difference of their gradients times the reach.
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
    """Raise `rise` (C,) to the largest rise of the ground above one contact plane in row `r`, where `may` > 0."""
    pad = spans.size // 2 + BLOCK
    for c in range(rise.size):
        if may[c] > 0.0 and rise[c] <= most:
            plane = (float(level[c]), float(across[c]), float(along[c]))
            rise[c] = _rise(body, tops, pad, r, c, spans, blocks, plane, rise[c], most)


@kernel
def gather(own: F32, r: int, skip: Mask, out: F32) -> None:
    """Fill `out` (4, C) with the footprints of row `r`; skipped cells get -inf as highest ground."""
    for i in range(4):
        out[i] = own[i, r]
    for c in range(out.shape[1]):
        out[3, c] = np.float32(-np.inf) if skip[r, c] else out[3, c]


@kernel
def keep(skip: Mask, known: F32, steep: F32, tilt: F32, rise: F32) -> None:
    """Fill `tilt` with the square root of `steep`; set tilt and rise to NaN if skipped or if a contact is unknown."""
    for c in range(tilt.size):
        tilt[c] = math.sqrt(steep[c])
        if skip[c] or known[c] == np.inf:
            tilt[c] = rise[c] = math.nan
