"""Compiled loops that seek the contact of a lander's belly: the highest ground above the plane it rests on."""

import math

import numpy as np

from alight.arrays import F32, F64, I64, Mask
from alight.compiled import kernel

BLOCK = 4  # cells a side of the blocks that the search opens


@kernel
def raise_to(top: F32, line: F32) -> None:
    """Keep the larger of the two, cell by cell; slices without offsets vectorise."""
    for c in range(top.size):
        v, t = line[c], top[c]
        top[c] = v if v > t else t


@kernel
def _rise_in_block(
    body: F32, pad: int, r: int, c: int, br: int, bc: int, spans: I64, a: float, gx: float, gy: float, top: float
) -> float:
    """Largest rise in those cells of one block that belong to the disc, or `top` if none is higher."""
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
    """Largest rise of known ground in the disc above a plane (level, x, y), where it is between `least` and `most`.

    Below `least` that is returned; the search ends above `most`. A block of cells is opened only where its highest
    cell, above the block's lowest corner of the plane, would raise the answer.
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
    """Fill `out` with an upper bound of the ground's rise above a contact plane, less `least`, cell by cell.

    The ground lies no higher than `own[3]` above the footprint's own plane (level, x, y). The two planes differ by no
    more than their difference at the centre plus that of their gradients times the reach.
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
    """Raise `rise` (C,) to the rise above one contact plane where that may be higher, cell by cell of row `r`."""
    pad = spans.size // 2 + BLOCK
    for c in range(rise.size):
        if may[c] > 0.0 and rise[c] <= most:
            plane = (float(level[c]), float(across[c]), float(along[c]))
            rise[c] = _rise(body, tops, pad, r, c, spans, blocks, plane, rise[c], most)


@kernel
def gather(own: F32, r: int, skip: Mask, out: F32) -> None:
    """Fill out (4, C) with the footprints of row `r`; cells that are not judged have no ground that could rise."""
    for i in range(4):
        out[i] = own[i, r]
    for c in range(out.shape[1]):
        out[3, c] = np.float32(-np.inf) if skip[r, c] else out[3, c]


@kernel
def keep(skip: Mask, known: F32, steep: F32, tilt: F32, rise: F32) -> None:
    """Take tangents from squared tangents; NaN where the cell is skipped or a contact is unknown."""
    for c in range(tilt.size):
        tilt[c] = math.sqrt(steep[c])
        if skip[c] or known[c] == np.inf:
            tilt[c] = rise[c] = math.nan
