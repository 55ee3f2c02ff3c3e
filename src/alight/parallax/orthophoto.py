"""Orthophoto on finer pixels than the heights have: the mean of the nearest views of each place.

Matching takes cells of nearly two pixels; stones and tufts that its windows flatten are three pixels wide. One view
shows them in its noise, the mean of five does not have it (docs/method/hazards.md, G9b).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import cv2
import numpy as np

from alight.arrays import F32, U8
from alight.geometry import Grid, ground_projection
from alight.parallax.views import project_cells, radius2_limit, rgb_of
from alight.raster import nearest_known, upsample
from alight.records import ElevationMap, Flag, View

BLOCK = 192  # cells a side that are done at a time
FACTOR = 2  # fine pixels a cell, each way: cells are 1.8 pixels wide
SAME = 0.3  # share of a block that two views must share for their exposures to be compared


def _blocks(grid: Grid) -> Iterator[tuple[slice, slice, Grid]]:
    for r in range(0, grid.rows, BLOCK):
        for c in range(0, grid.cols, BLOCK):
            rows, cols = min(BLOCK, grid.rows - r), min(BLOCK, grid.cols - c)
            yield slice(r, r + rows), slice(c, c + cols), grid.window(r, c, rows, cols)


def _seen_by(view: View, grid: Grid, height: F32) -> F32:
    """Picture of one view at the grid's pixels, (R, C, 3); NaN outside of it."""
    camera, (mapx, mapy) = view.camera, (np.empty_like(height), np.empty_like(height))
    H, b = ground_projection(camera, view.world_from_cam)
    project_cells(camera, radius2_limit(camera), H, b, *grid.xy(), height, (mapx, mapy))
    seen: F32 = np.asarray(cv2.remap(rgb_of(view.image), mapx, mapy, cv2.INTER_LINEAR), np.float32)
    seen[mapx < 0] = np.nan
    return seen


def _block(views: Sequence[View], grid: Grid, height: F32, count: int) -> tuple[F32, F32]:
    """Mean of the `count` nearest views of every pixel, each brought to the exposure of the first, and their number."""
    xs, ys = grid.xy()
    middle = np.array([xs.mean(), ys.mean(), float(np.median(height))])
    away = [np.linalg.norm(v.centre - middle) for v in views]
    total, number = np.zeros((*grid.shape, 3), np.float32), np.zeros(grid.shape, np.float32)
    for i in np.argsort(away, kind="stable"):
        if (number >= count).all():
            break
        seen = _seen_by(views[i], grid, height)
        use = np.isfinite(seen[..., 0]) & (number < count)
        if not use.any():
            continue
        both = use & (number > 0)
        if both.mean() > SAME:
            before = (total[both] / number[both][:, None]).mean(axis=0)
            seen *= before / np.maximum(seen[both].mean(axis=0), 1.0)
        total[use] += seen[use]
        number += use
    return np.asarray(total / np.maximum(number, 1)[..., None], np.float32), number


def orthophoto(views: Sequence[View], elevation: ElevationMap, count: int = 5) -> U8:
    """Look at the ground of a map on its views' own pixels.

    Args:
        views: with the poses that the map was made of.
        elevation: where the ground is.
        count: views whose mean is taken.

    Returns:
        (2 R, 2 C, 3); the map's own colours where none of the views looks, black where nothing was seen.
    """
    grid, factor = elevation.grid, FACTOR
    height = np.nan_to_num(nearest_known(elevation.height, ~np.isnan(elevation.height)))
    unseen = (elevation.flags & np.uint16(Flag.UNSEEN)) != 0
    out = upsample(elevation.rgb, factor)
    for rows, cols, part in _blocks(grid):
        if not unseen[rows, cols].all():
            fine = part.finer(factor)
            up = cv2.resize(height[rows, cols], fine.shape[::-1], interpolation=cv2.INTER_LINEAR)
            to = slice(rows.start * factor, rows.stop * factor), slice(cols.start * factor, cols.stop * factor)
            mean, number = _block(views, fine, up, count)
            seen = (number > 0) & ~upsample(unseen[rows, cols], factor)
            out[to][seen] = np.rint(mean[seen]).clip(0, 255).astype(np.uint8)
    return out
