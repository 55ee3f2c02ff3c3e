"""Compiled loops on the shape of the ground (docs/method/land-cover.md)."""

import math

import numpy as np

from alight.arrays import F64, Mask
from alight.compiled import inline, kernel


@inline
def _lowest_neighbour(water: F64, r: int, c: int) -> float:
    rows, cols = water.shape
    low = math.inf
    for q in range(max(0, r - 1), min(rows, r + 2)):
        for p in range(max(0, c - 1), min(cols, c + 2)):
            if (q != r or p != c) and water[q, p] < low:
                low = water[q, p]
    return low


@kernel
def fill_basins(surface: F64, outlet: Mask, water: F64) -> None:
    """Compute the level of standing water on a surface with outlets, by morphological reconstruction (G13).

    Sweeps from opposite corners repeat until no level sinks. Each cell ends at the lowest level from which its water
    runs off over the 8 neighbours.

    Args:
        surface: (R, C) heights; +inf is a wall.
        outlet: (R, C) bool, cells from which water runs off.
        water: (R, C) filled with the level of standing water, or with the surface where it is dry.
    """
    rows, cols = surface.shape
    for r in range(rows):
        for c in range(cols):
            water[r, c] = surface[r, c] if outlet[r, c] else np.inf
    moved = True
    while moved:
        moved = False
        for sweep in range(2):
            for i in range(rows):
                r = i if sweep == 0 else rows - 1 - i
                for j in range(cols):
                    c = j if sweep == 0 else cols - 1 - j
                    if water[r, c] > surface[r, c]:
                        level = max(surface[r, c], _lowest_neighbour(water, r, c))
                        if level < water[r, c]:
                            water[r, c] = level
                            moved = True
