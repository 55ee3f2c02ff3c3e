"""Orthophoto on pixels finer than the cells of the heights: the mean of the nearest views at each pixel.

Matching uses cells of nearly two pixels; its windows smooth away stones and tufts three pixels wide. One view shows
them with noise; the mean of five views has less noise (docs/method/p-safe.md, G9b).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np

from alight.arrays import F32, U8, Mask
from alight.geometry import Box, Grid, box_of, ground_projection
from alight.parallax import orthophoto_kernels as kernels
from alight.parallax.views import (
    border_rays,
    ground_sampling,
    is_grey,
    may_see,
    radius2_limit,
    rolling_of,
    tone_of,
)
from alight.raster import nearest_known, upsample
from alight.records import ElevationMap, Flag, View

BLOCK = 192  # cells on a side of a block that is processed at a time
MOST = 4  # fine pixels on a side of a cell, at most
LARGE = 80_000_000  # pixels, 240 MB: a larger picture is made coarser; few photos are taken from so near
SAME = 0.3  # share of a block that two views must both show to compare their exposures
AROUND = 0.05  # margin for rolling shutter and lens: share of the side of the ground that a picture shows
COARSER = 1.5  # a view is not used if its pixel is larger than the finest view's by this factor


def _window(view: View, grid: Grid, low: float, high: float) -> Box:
    """Return rows and columns of `grid` that a picture may show, for ground at heights from `low` to `high`, metres."""
    rays, centre = border_rays(view.camera) @ view.world_from_cam.rotation.T, view.centre
    if (rays[:, 2] >= 0).any():
        return slice(0, grid.rows), slice(0, grid.cols)
    reach = np.minimum(np.array([[low], [high]]) - centre[2], 0.0) / rays[:, 2]  # it shows nothing above the camera
    places = centre[:2] + (reach[..., None] * rays[:, :2]).reshape(-1, 2)
    around = AROUND * np.ptp(places, axis=0) + grid.cell
    return grid.box_about(np.concatenate([places - around, places + around]))


def _block(views: Sequence[View], grid: Grid, height: F32, wants: Mask, count: int) -> tuple[F32, F32, F32]:
    """Return, per wanted pixel, the sum of colours of the `count` finest views, their number, and the finest pixel, m.

    The sum (R, C, 1) is grey if all views are.

    `height`, `wants`: (R, C) on `grid`, the pixels; `wants` becomes False, in place, where no further view is needed.
    Exposures of the views are matched; a view with much coarser pixels than the finest one is not used.
    """
    xs, ys = grid.xy()
    level, low, high = (float(of(height)) for of in (np.median, np.min, np.max))
    middle = np.array([xs.mean(), ys.mean(), level])
    away = [np.linalg.norm(v.centre - middle) / v.camera.fu for v in views]
    number, finest, pixels = (np.full(grid.shape, v, np.float32) for v in (0.0, np.inf, np.nan))
    channels = 1 if all(is_grey(v) for v in views) else 3
    total, colours = (np.zeros((*grid.shape, channels), t) for t in (np.float32, np.uint8))
    used = np.zeros(grid.shape, np.bool_)
    for view in (views[i] for i in np.argsort(away, kind="stable")):
        box = _window(view, grid, low, high)
        r, c = (slice(o.start + s.start, o.start + s.stop) for o, s in zip(box, box_of(wants[box]), strict=True))
        at, camera, part = (r, c), view.camera, grid.part((r, c))
        if not wants[at].size:
            continue
        picture, exposures = np.asarray(view.image), np.empty((part.rows, kernels.EXPOSURES))
        seen, use, pixel = colours[at], used[at], pixels[at]
        kernels.sample_view(
            np.ascontiguousarray(picture if picture.ndim == 3 else picture[..., None]), tone_of(view),
            *ground_projection(view.world_from_cam), np.array([camera.fu, camera.fv, camera.cu, camera.cv]),
            camera.coefficients, camera.code, radius2_limit(camera), rolling_of(view), view.centre, *part.xy(),
            np.ascontiguousarray(height[at]), level, COARSER, wants[at], finest[at], total[at], number[at], seen, use,
            pixel, exposures,
        )  # fmt: skip
        both, before, now = np.split(exposures.sum(axis=0), (1, 4))
        gain = before / np.maximum(now, both) if both[0] > SAME * wants.size else np.ones(3)
        kernels.add_view(seen, use, pixel, gain, count, total[at], number[at], finest[at], wants[at])
    return total, number, finest


def _mean(total: F32, number: F32) -> U8:
    """Return mean colours (R, C, 1 or 3) in levels; green is at least 1, because 0 means that there is no picture."""
    out = np.rint(total / np.maximum(number, 1)[..., None]).clip(0, 255).astype(np.uint8)
    green = out[..., out.shape[2] // 2]
    np.maximum(out, 1, out=out, where=(green == 0)[..., None])
    return out


def orthophoto(views: Sequence[View], elevation: ElevationMap, count: int = 5, most: int = LARGE) -> tuple[U8, F32]:
    """Return a picture of the mapped ground at the resolution of its views, and its ground sampling.

    Args:
        views: views with the poses from which the map was made.
        elevation: the map, for the heights of the ground.
        count: number of views that are averaged.
        most: largest number of pixels.

    Returns:
        The picture (f R, f C, 3), with f x f pixels per cell, and the ground sampling (R, C), metres per pixel of the
        views used. Where no view is used, the picture has the map's colours, and the sampling is that of the heights.
        Black means that nothing was seen; black ground is made one level brighter.
    """
    grid, level = elevation.grid, float(np.nanmedian(elevation.height)) if np.isfinite(elevation.height).any() else 0.0
    finest = min((ground_sampling(v, level) for v in views), default=grid.cell)
    # as fine as the views, by a power of two
    factor = wanted = int(np.clip(2 ** math.ceil(math.log2(max(0.95 * grid.cell / finest, 1e-3))), 1, MOST))
    while factor > 1 and elevation.height.size * factor**2 > most:
        factor //= 2
    narrowest = np.float32(grid.cell / factor if factor < wanted else 0.0)
    height = np.nan_to_num(nearest_known(elevation.height, ~np.isnan(elevation.height)))
    unseen = (elevation.flags & np.uint16(Flag.UNSEEN)) != 0
    out, sampling = upsample(elevation.rgb, factor), np.maximum(elevation.sampling, np.float32(grid.cell))
    starts = ((r, c) for r in range(0, grid.rows, BLOCK) for c in range(0, grid.cols, BLOCK))
    for rows, cols in (tuple(slice(a, min(a + BLOCK, n)) for a, n in zip(s, grid.shape, strict=True)) for s in starts):
        if not unseen[rows, cols].all():
            fine = grid.part((rows, cols)).finer(factor)
            up = cv2.resize(height[rows, cols], fine.shape[::-1], interpolation=cv2.INTER_LINEAR)
            to = slice(rows.start * factor, rows.stop * factor), slice(cols.start * factor, cols.stop * factor)
            near = [views[k] for k in may_see(views, fine, float(up.min()), float(up.max()))]
            wants = ~upsample(unseen[rows, cols], factor)
            total, number, pixel = _block(near, fine, up, wants, count)
            seen = number > 0
            at = box_of(seen)
            np.copyto(out[to][at], _mean(total[at], number[at]), where=seen[at][..., None])
            middle = (slice(factor // 2, None, factor),) * 2
            np.copyto(sampling[rows, cols], np.maximum(pixel[middle], narrowest), where=seen[middle])
    return out, sampling
