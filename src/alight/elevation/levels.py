"""Resample the map between levels: 2 x 2 means to coarser levels (eq. 16b), bilinear to finer ones (eq. 16c)."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np

from alight.elevation.level_kernels import halve
from alight.elevation.tiles import FIELDS, Fields, is_seen, nothing
from alight.raster import upsample
from alight.records import REFUSED, ElevationMap, Flag, is_trusted


def halve_fields(fine: Fields) -> Fields:
    """Compute fields at twice the cell size, as means of 2 x 2 cells (eq. 16b).

    If two or more of the four cells are trusted, only trusted cells are used. Variances are averaged but not divided,
    as neighbouring cells share matching windows, and so errors.
    """
    rows, cols = fine["flags"].shape
    out = nothing((rows // 2, cols // 2))
    whole = (np.ascontiguousarray(fine[k]) for k in FIELDS)
    halve(*whole, int(Flag.UNSEEN), int(REFUSED), *(out[k] for k in FIELDS))
    return out


def double_fields(coarse: Fields, inflation: np.float32) -> Fields:
    """Compute fields at half the cell size (eq. 16c): bilinear between trusted cells, elsewhere nearest neighbour.

    Sigma is multiplied by `inflation`.
    """
    near = {k: upsample(v, 2) for k, v in coarse.items()}
    shape = near["flags"].shape[::-1]
    bad = ~is_trusted(coarse["flags"])
    near["sigma"] *= inflation
    for k, scale in (("height", np.float32(1)), ("sigma", inflation)):
        linear = cv2.resize(np.where(bad, np.float32(np.nan), coarse[k] * scale), shape, interpolation=cv2.INTER_LINEAR)
        np.copyto(near[k], linear, where=np.isfinite(linear))
    mixed = cv2.resize(coarse["rgb"], shape, interpolation=cv2.INTER_LINEAR)
    whole = cv2.resize(is_seen(coarse["flags"]).astype(np.float32), shape, interpolation=cv2.INTER_LINEAR) == 1
    np.copyto(near["rgb"], mixed, where=whole[..., None])
    return near


def doublings_up_to(cell: float, most: float) -> int:
    """Return how often `cell` can be doubled without exceeding `most`, both in metres; rounding errors are ignored."""
    number = 0
    while math.ldexp(cell, number + 1) <= most * (1 + 1e-6):
        number += 1
    return number


def on_cells_up_to(elevation: ElevationMap, cell: float) -> ElevationMap:
    """Double the cell size of a map as often as it stays at most `cell` metres, and resample the map.

    The last row and column may reach beyond the map. The finest picture is not resampled.
    """
    for _ in range(doublings_up_to(elevation.grid.cell, cell)):
        rows, cols = elevation.grid.shape
        odd = ((0, rows % 2), (0, cols % 2))
        padded = nothing((rows + rows % 2, cols + cols % 2))
        for k, field in padded.items():
            field[:rows, :cols] = getattr(elevation, k)
        fine, n = elevation.finest
        corners = [
            None if v is None else np.pad(v, odd, mode="edge")[::2, ::2].copy()
            for v in (elevation.warp, elevation.fine_sampling)
        ]
        if odd != ((0, 0), (0, 0)):
            fine = np.pad(fine, (*((0, n * k[1]) for k in odd), (0, 0)))
        grid, fields = elevation.grid.coarser(2), halve_fields(padded)
        elevation = replace(elevation, grid=grid, warp=corners[0], fine=fine, fine_sampling=corners[1], **fields)  # type: ignore[arg-type]
    return elevation
