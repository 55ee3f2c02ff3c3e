"""What each view shows that the others do not show on the ground: warped to the ground, less what they have in common.

On the ground all views agree. What hangs above it is elsewhere in every view, so that the mean of the views has little
of it, and the difference all of it. The differences are then moved to a level plane, on which a straight wire is a
straight line in every view, however rough the ground is that it hides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from alight.arrays import F32, F64, U8, Mask
from alight.geometry import Box, Grid, ground_projection
from alight.parallax.views import (
    Buffers,
    Prepared,
    border_rays,
    ground_sampling,
    halved,
    maps,
    on_level,
    radius2_limit,
    rolling_of,
    sample,
)
from alight.parallax.wires.line_kernels import BLOCK, REACH
from alight.raster import difference_of_gaussians, grey_levels, log_levels
from alight.records import View

BAND = 0.8, 2.6  # cells, 1-sigma of the two Gaussians whose difference keeps what is as thin as a wire
LONG = BLOCK * (2 * REACH + 1)  # cells, length of a line along its nearer axis; a view that shows less is left out
COMMON = 1.5  # mean deviations from the common picture at which a view is clipped, so that a wire leaves no ghost in it
CLIP = 3.0  # sigmas, the most that one cell counts in a line, and one view for a line: one stone is no line
WINDOW = 15  # cells that slide as one, and over which the noise is averaged
QUIET = 0.5  # of the median noise, the least noise that is assumed


@dataclass(frozen=True, eq=False)
class PlaneView:
    """The difference of one view from the others, on its part of a level plane."""

    grid: Grid  # part of the plane
    above: F64  # (3,) metres, camera centre: east, north, height above the plane
    difference: F32  # (R, C) sigmas; 0 where unknown
    known: U8  # (R, C) 255 where the difference is known, else 0


def _band(view: View, cell: float, ground: float) -> Prepared:
    """Return the view's log brightness, with what is about as thin as a cell only, on pixels of up to two a cell."""
    light, camera = log_levels(grey_levels(view.image)), view.camera
    ratio = cell / ground_sampling(view, ground)
    while ratio >= 1.9 and min(light.shape) > 2 * LONG:
        light, camera = halved(light, camera)
        ratio /= 2
    thin = difference_of_gaussians(light, *(s * max(ratio, 0.5) for s in BAND))
    H, b = ground_projection(view.world_from_cam)
    return Prepared(thin, thin, camera, H, b, np.array(view.centre), radius2_limit(camera), ratio, rolling_of(view))


class _OnGround(NamedTuple):
    """A view on its part of the ground."""

    view: View
    box: Box
    light: F32  # (R, C) band of log brightness; 0 where unknown
    known: F32  # (R, C) 1 where known, else 0


def plane_views(views: Sequence[View], grid: Grid, height: F32, seen: Mask, plane: float) -> list[PlaneView]:
    """Return the difference of every view from the others, on a level plane.

    Args:
        views: three or more; those that show too little of the ground are left out.
        grid: cells of the ground and of the plane.
        height: (R, C) metres up, of the ground; known everywhere.
        seen: (R, C) mask of the ground that counts.
        plane: metres up, height of the plane.
    """
    held, ground = Buffers(), list[_OnGround]()
    for view in views:
        p = _band(view, grid.cell, plane)
        box = grid.box_about(on_level(border_rays(p.camera) @ view.world_from_cam.rotation.T, view.centre, plane))
        part = grid.part(box)
        if min(part.shape) < LONG:
            continue
        light = sample(p.grey, *maps(p, *part.xy(), np.ascontiguousarray(height[box]), held))
        known = (np.isfinite(light) & seen[box]).astype(np.float32)
        ground.append(_OnGround(view, box, np.nan_to_num(light, copy=False) * known, known))
    if len(ground) < 3:
        return []
    mean, count = _common(ground, grid)
    differences = [(g.light - mean[g.box]) * (g.known * (count[g.box] >= 3)) for g in ground]
    differences = _less_slides(differences, ground, mean)
    noise = _noise(differences, ground, count)
    out = []
    for g, d in zip(ground, differences, strict=True):
        clear = cv2.erode(g.known, np.ones((5, 5), np.uint8))  # the band of a rim is a line of its own
        d = np.clip(d / noise[g.box], -CLIP, CLIP) * clear
        above = np.array([*g.view.centre[:2], g.view.centre[2] - plane])
        part = grid.part(g.box)
        to_plane = _RaysToPlane.of(part, height[g.box] - np.float32(plane), above)
        out.append(PlaneView(part, above, to_plane.moved(d), to_plane.moved((255 * clear).astype(np.uint8))))
    return out


def _common(ground: Sequence[_OnGround], grid: Grid) -> tuple[F32, F32]:
    """Return the common picture of the ground and the number of its views, (R, C).

    A second mean is taken of views clipped near the first one, or each view would have faint lines where the others
    have wires.
    """
    total, count, away = (np.zeros(grid.shape, np.float32) for _ in range(3))
    for g in ground:
        total[g.box] += g.light
        count[g.box] += g.known
    mean = total / np.maximum(count, 1)
    for g in ground:
        away[g.box] += np.abs(g.light - mean[g.box]) * g.known
    most = _smooth(away, count) * np.float32(COMMON)
    total[:] = 0
    for g in ground:
        m, limit = mean[g.box], most[g.box]
        total[g.box] += (m + np.clip(g.light - m, -limit, limit)) * g.known
    return np.asarray(total / np.maximum(count, 1), np.float32), count


def _less_slides(differences: Sequence[F32], ground: Sequence[_OnGround], mean: F32) -> list[F32]:
    """Return the differences (R, C) less what a slide of the common picture explains, window by window.

    Heights and poses are not exact, so that views of the same ground are a fraction of a cell apart: most of what
    differs. A slide by (a, b) cells adds `a dm/dx + b dm/dy`, which is fitted by least squares. No slide of the ground
    makes a wire.
    """
    size = (WINDOW, WINDOW)
    dx, dy = (cv2.Sobel(mean, -1, *d, ksize=1, scale=0.5) for d in ((1, 0), (0, 1)))
    xx, xy, yy = (cv2.boxFilter(v, -1, size) for v in (dx * dx, dx * dy, dy * dy))
    least = 0.1 * float(np.mean(xx + yy)) + 1e-12
    xx, yy = xx + least, yy + least
    scale = 1 / (xx * yy - xy * xy)
    out = []
    for g, d in zip(ground, differences, strict=True):
        x, y = dx[g.box], dy[g.box]
        ox, oy = (cv2.boxFilter(v * d, -1, size) for v in (x, y))
        a = (yy[g.box] * ox - xy[g.box] * oy) * scale[g.box]
        b = (xx[g.box] * oy - xy[g.box] * ox) * scale[g.box]
        out.append((d - a * x - b * y) * (d != 0))
    return out


def _noise(differences: Sequence[F32], ground: Sequence[_OnGround], count: F32) -> F32:
    """Return the standard deviation of the differences about each cell, (R, C)."""
    power = np.zeros_like(count)
    for g, d in zip(ground, differences, strict=True):
        power[g.box] += d * d
    return np.sqrt(_smooth(power, count))


def _smooth(total: F32, count: F32) -> F32:
    """Return the mean of a total over `count` views about each cell, at least `QUIET` of its median; (R, C)."""
    size = (WINDOW, WINDOW)
    out = cv2.boxFilter(total, -1, size) / np.maximum(cv2.boxFilter(count, -1, size), 1e-3)
    known = out[count > 0]
    least = QUIET * float(np.median(known)) if known.size else 0.0
    return np.asarray(np.maximum(out, max(least, 1e-6)), np.float32)


class _RaysToPlane(NamedTuple):
    """Where the rays of a camera through the cells of a plane end on the ground."""

    col: F32  # (R, C) on the same grid
    row: F32

    @classmethod
    def of(cls, grid: Grid, above_plane: F32, above: F64) -> _RaysToPlane:
        """Follow the rays: the ground is nearer to the camera by the share of its height in the camera's.

        Args:
            grid: cells of the plane and of the ground.
            above_plane: (R, C) metres, height of the ground.
            above: (3,) metres, camera centre: east, north, height above the plane.
        """
        east, north = grid.xy()
        away_e = ((east - above[0]) / grid.cell).astype(np.float32)[None, :]
        away_n = ((above[1] - north) / grid.cell).astype(np.float32)[:, None]
        col, row = np.float32((above[0] - grid.east) / grid.cell), np.float32((grid.north - above[1]) / grid.cell)
        over = above_plane * np.float32(1 / above[2])
        share = over
        for _ in range(2):
            at = col + away_e * (1 - share), row + away_n * (1 - share)
            share = cv2.remap(over, *at, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return cls(col + away_e * (1 - share), row + away_n * (1 - share))

    def moved(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return what each cell of the plane shows of the ground's `values` (R, C); 0 beyond the grid."""
        return np.asarray(cv2.remap(values, *self, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0))
