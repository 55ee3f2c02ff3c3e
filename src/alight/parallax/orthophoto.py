"""Orthophoto on finer pixels than the heights have: the mean of the nearest views of each place.

Matching takes cells of nearly two pixels; stones and tufts that its windows flatten are three pixels wide. One view
shows them in its noise, the mean of five does not have it (docs/method/p-safe.md, G9b).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import cv2
import numpy as np

from alight.arrays import F32, U8
from alight.geometry import Grid, box_of, ground_projection
from alight.parallax.orthophoto_kernels import add_view, exposure_gains, sees
from alight.parallax.views import (
    ground_sampling,
    may_see,
    pixels_on_ground,
    project_cells,
    radius2_limit,
    rgb_of,
    rolling_of,
)
from alight.raster import nearest_known, upsample
from alight.records import ElevationMap, Flag, View

BLOCK = 192  # cells a side that are done at a time
MOST = 4  # fine pixels a cell, each way
SAME = 0.3  # share of a block that two views must share for their exposures to be compared
COARSER = 1.5  # a view whose pixel is larger than that of the finest by this factor does not count beside it


def _blocks(grid: Grid) -> Iterator[tuple[slice, slice, Grid]]:
    for r in range(0, grid.rows, BLOCK):
        for c in range(0, grid.cols, BLOCK):
            rows, cols = min(BLOCK, grid.rows - r), min(BLOCK, grid.cols - c)
            yield slice(r, r + rows), slice(c, c + cols), grid.window(r, c, rows, cols)


def _block(views: Sequence[View], grid: Grid, height: F32, count: int) -> tuple[F32, F32, F32]:
    """Mean of the `count` nearest views of every pixel, each brought to the exposure of the first.

    Beside it their number, and the pixel on the ground of the first, metres. A view with much coarser pixels than the
    first does not count. Only the window of pixels that want another view is looked at.
    """
    xs, ys = grid.xy()
    level = float(np.median(height))
    middle = np.array([xs.mean(), ys.mean(), level])
    away = [np.linalg.norm(v.centre - middle) / v.camera.fu for v in views]
    total, number = np.zeros((*grid.shape, 3), np.float32), np.zeros(grid.shape, np.float32)
    finest = np.full(grid.shape, np.inf, np.float32)
    wants = np.ones(grid.shape, bool)
    for i in np.argsort(away, kind="stable"):
        view, at = views[i], box_of(wants)
        camera, part = view.camera, grid.window(at[0].start, at[1].start, *wants[at].shape)
        mapx, mapy = np.empty((2, *part.shape), np.float32)
        H, b = ground_projection(camera, view.world_from_cam)
        level_of, maps = np.ascontiguousarray(height[at]), (mapx, mapy)
        project_cells(camera, radius2_limit(camera), H, b, *part.xy(), level_of, maps, rolling_of(view))
        pixel = pixels_on_ground(view.centre, camera.fu, part, np.float32(level))
        use = sees(mapx, pixel, wants[at], finest[at], np.float32(COARSER))
        if not use.any():
            continue
        seen = cv2.remap(rgb_of(view.image), mapx, mapy, cv2.INTER_LINEAR)
        both, gain = exposure_gains(seen, use, total[at], number[at])
        known = gain if both > SAME * wants.size else np.ones(3)
        add_view(seen, use, pixel, known, count, total[at], number[at], finest[at], wants[at])
        if not wants.any():
            break
    return np.asarray(total / np.maximum(number, 1)[..., None], np.float32), number, finest


def pixels_a_cell(views: Sequence[View], elevation: ElevationMap) -> int:
    """Fine pixels a cell, each way, that show all that the views show: a power of two, `MOST` at most."""
    level = float(np.nanmedian(elevation.height)) if np.isfinite(elevation.height).any() else 0.0
    finest = min((ground_sampling(v, level) for v in views), default=elevation.grid.cell)
    return int(np.clip(2 ** math.ceil(math.log2(max(0.95 * elevation.grid.cell / finest, 1e-3))), 1, MOST))


def orthophoto(views: Sequence[View], elevation: ElevationMap, count: int = 5) -> tuple[U8, F32]:
    """Look at the ground of a map on its views' own pixels.

    Args:
        views: with the poses that the map was made of.
        elevation: where the ground is.
        count: views whose mean is taken.

    Returns:
        The picture, (f R, f C, 3): the map's own colours where none of the views looks, black where nothing was seen.
        Metres of ground that a pixel of its views covers, (R, C): where none looks, the sampling of the heights.
    """
    grid, factor = elevation.grid, pixels_a_cell(views, elevation)
    height = np.nan_to_num(nearest_known(elevation.height, ~np.isnan(elevation.height)))
    unseen = (elevation.flags & np.uint16(Flag.UNSEEN)) != 0
    out, sampling = upsample(elevation.rgb, factor), np.maximum(elevation.sampling, np.float32(grid.cell))
    for rows, cols, part in _blocks(grid):
        if not unseen[rows, cols].all():
            fine = part.finer(factor)
            up = cv2.resize(height[rows, cols], fine.shape[::-1], interpolation=cv2.INTER_LINEAR)
            to = slice(rows.start * factor, rows.stop * factor), slice(cols.start * factor, cols.stop * factor)
            near = [views[k] for k in may_see(views, fine, float(up.min()), float(up.max()))]
            mean, number, pixel = _block(near, fine, up, count)
            seen = (number > 0) & ~upsample(unseen[rows, cols], factor)
            out[to][seen] = np.rint(mean[seen]).clip(0, 255).astype(np.uint8)
            middle = (slice(factor // 2, None, factor),) * 2
            np.copyto(sampling[rows, cols], pixel[middle], where=seen[middle])
    return out, sampling
