"""One step of the recursive estimator: its views, and the rectangles that it refines and fuses with the map."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from alight.arrays import F32, U8, Mask
from alight.geometry import Box, Grid, box_of
from alight.parallax import gauss_newton as refine
from alight.parallax import temporal_consistency as witness
from alight.parallax import uncertainty as trust
from alight.parallax import uncertainty_kernels as kernels
from alight.parallax.views import Buffers, Kept, colour_at, maps
from alight.raster import close_mask, weighted_gaussian
from alight.records import ElevationMap, Flag, Heights, is_trusted
from alight.settings import ParallaxSettings

GAP = 4  # cells: a gap between heights that is narrower than twice this starts from them
HALO = 8  # cells about a rectangle that are refined with it and discarded: no seams
BESIDE = 0.02  # of the height: nearer cameras of one exposure have the same occlusions
APART = 0.06  # of the height: nearer cameras see so much alike that a sweep needs only one; seen from straight above
ALIKE = 0.1  # largest angle between the axes of such cameras, rad, and relative difference of their focal lengths


def unswept(settings: ParallaxSettings) -> float:
    """Return the cost ratio of a cell that was not swept: half way to AMBIGUOUS."""
    return settings.uncertainty.max_cost_ratio / 2


class Refined(NamedTuple):
    """Result of a step for one rectangle."""

    heights: Heights
    changed: Mask  # (R, C) ground that looks different since some instant; its height is from before that
    came: Mask  # (R, C) ground on which somebody has come to stand (eq. 16e)


@dataclass(frozen=True, eq=False)
class Window:
    """Input shared by all rectangles that one step refines."""

    settings: ParallaxSettings
    buffers: Buffers  # arrays that are reused
    grid: Grid
    known: ElevationMap  # the map before the step
    kept: list[Kept]  # the views used in the step
    seen: refine.ViewGeometry
    ratio: F32  # (R, C) best over second-best cost of the last sweep, or baseline if it failed; NaN: sweep again
    searched: tuple[float, float]  # metres, lowest and highest height
    drop: float  # metres, height of the newest camera above the ground
    nearly: NDArray[np.intp]  # (N,) index of the first view with the same occlusions: `first_of_twins` by `BESIDE`
    apart: NDArray[np.intp]  # (N,) index of the first view that sees nearly the same: `first_of_twins` by `APART`

    def views_of(self, where: Box) -> NDArray[np.intp]:
        """Return the indices of the views that see any part of a rectangle (rows, columns) of the window."""
        r, c = (slice(s.start // refine.SEEN_BLOCK, -(-s.stop // refine.SEEN_BLOCK)) for s in where)
        return np.flatnonzero(self.seen.views[:, r, c].any(axis=(1, 2)))

    def refined(self, skyline: refine.Skyline, start: F32, wrong: Mask, box: Box, recolour: bool) -> Refined | None:
        """Refine a rectangle by a Gauss-Newton step and fuse it with the map; None if nothing is known there.

        Args:
            skyline: skyline of `start`, for the rays that the map blocks.
            start: (R, C) initial heights of the window, metres.
            wrong: (R, C) cells whose height in the map is ignored.
            box: the rectangle, rows and columns of the window.
            recolour: whether the map's colours in the rectangle are coarse and must be renewed.
        """
        where, s = wider(box, self.grid.shape), self.settings
        grid, chosen, inner = self.grid.part(where), self.views_of(where), within(box, where)
        of_cells = start, self.ratio, self.seen.metres_per_px, self.seen.sampling
        h, cost, per_px, sampling = (np.ascontiguousarray(v[where]) for v in of_cells)
        h = bridged(h, ~np.isnan(cost) & (self.seen.count[where] >= s.recursive.first_views))
        if len(chosen) < 2 or not np.isfinite(h[inner]).any():
            return None
        kept = [self.kept[i] for i in chosen]
        fine, newest = [k.fine for k in kept], [self.kept[-1].fine]
        tuning = s.refinement.model_copy(update={"iterations": 1})
        first, owner = np.unique(self.nearly[chosen], return_inverse=True)
        centres = np.array([self.kept[i].fine.centre for i in first])
        visible = skyline.visible(centres, where, per_px, s.uncertainty.step_px)[owner]
        fit = refine.gauss_newton(fine, grid, h, per_px, visible, tuning, self.buffers)
        before = known = self.known.part(where)
        rgb = self._coloured(grid, fit.height, known, recolour)
        cost = trust.half_resolution(np.where(np.isnan(cost) | np.isnan(h), np.float32(unswept(s)), cost))
        if (off := wrong[where]).any():
            known = replace(known, height=np.where(off, np.float32(np.nan), known.height))
        found = trust.judged(fit, cost, newest, self.searched, sampling, rgb, s.uncertainty)
        samples = self.buffers.get("samples", (len(fine), *grid.shape))  # filled by the fit
        pairs = witness.instants([k.view for k in kept])
        moves = witness.moving(samples, pairs, fit, s.uncertainty)
        found = fused(replace(found, flags=found.flags | moves), known, s.recursive.worse)
        times = np.array([k.view.t_ns for k in kept])
        anew = witness.changed_since(samples, pairs, times, s.uncertainty)
        doubt = witness.contradicted(samples, before, s.uncertainty)
        anew |= (doubt.wrong | doubt.came) & is_trusted(found.flags)
        anew &= np.isfinite(found.height)
        found = replace(found, flags=found.flags | np.where(anew, np.uint16(Flag.MOVING), np.uint16(0)))
        return Refined(found.part(inner), anew[inner], doubt.came[inner])

    def _coloured(self, grid: Grid, height: F32, known: ElevationMap, recolour: bool) -> U8:
        """Return the colours of the map `known`; the newest view replaces them below its camera and on new cells.

        `height`: (R, C) new heights on `grid`, metres. `recolour`: whether the view replaces all colours that it can.
        """
        view, fine = self.kept[-1].view, self.kept[-1].fine
        out = known.rgb.copy()
        row, col = (float(v) for v in grid.index(view.centre[0], view.centre[1]))
        k = APART * self.drop / grid.cell
        under = (slice(max(0, int(row - k)), max(0, int(row + k))), slice(max(0, int(col - k)), max(0, int(col + k))))
        fresh = (np.isnan(known.height) | recolour) & np.isfinite(height)
        for where, only in ((box_of(fresh), fresh), (under, None)):
            r, c = where
            part = grid.window(r.start, c.start, *height[where].shape)
            if not part.rows * part.cols:
                continue
            mapx, mapy = maps(fine, *part.xy(), np.ascontiguousarray(height[where]))
            take = mapx >= 0  # not where there is no height
            if only is not None:
                take &= only[where]
            cv2.copyTo(colour_at(view, fine, mapx, mapy), take.view(np.uint8), out[where])
        return out


def wider(where: Box, shape: tuple[int, int]) -> Box:
    """Return the rectangle `where`, widened by `HALO` cells within a window of `shape`, from an even row and column."""
    r, c = (slice(max(0, s.start - HALO) & ~1, min(n, s.stop + HALO)) for s, n in zip(where, shape, strict=True))
    return r, c


def within(inner: Box, outer: Box) -> Box:
    """Return the rectangle `inner` in rows and columns relative to the rectangle `outer`, which contains it."""
    r, c = (slice(i.start - o.start, i.stop - o.start) for i, o in zip(inner, outer, strict=True))
    return r, c


def first_of_twins(kept: list[Kept], within: float) -> NDArray[np.intp]:
    """Return (N,) indices: for each view, the first view of the same exposure that sees nearly the same.

    That view is less than `within` metres away, with nearly the same direction and focal length.
    """
    out = list[int]()
    for i, of in enumerate(kept):
        out.append(next((j for j in range(i) if out[j] == j and _are_twins(kept[j], of, within)), i))
    return np.array(out, np.intp)


def _are_twins(a: Kept, b: Kept, within: float) -> bool:
    """Whether two views of one exposure are within `within` metres, with similar direction and focal length."""
    if a.view.t_ns != b.view.t_ns or np.linalg.norm(a.view.centre - b.view.centre) >= within:
        return False
    axes, k, m = [v.view.world_from_cam.rotation[:, 2] for v in (a, b)], a.fine.camera, b.fine.camera
    same_field = (k.width, k.height) == (m.width, m.height) and abs(k.fu / m.fu - 1) < ALIKE
    return same_field and float(axes[0] @ axes[1]) > np.cos(ALIKE)


def bridged(start: F32, wanted: Mask) -> F32:
    """Return the initial heights `start` (R, C) with narrow gaps filled from the heights around, where `wanted`."""
    # sweeps at the rim of the pictures often fail: seams, one cell wide, would stay there that no touchdown may cross
    known = np.isfinite(start)
    gaps = wanted & ~known
    if gaps.any():
        gaps &= close_mask(known, GAP)
    if not gaps.any():
        return start
    return np.where(gaps, weighted_gaussian(start, known.astype(np.float32), GAP).mean, start)


def fused(new: Heights, old: ElevationMap, worse: float) -> Heights:
    """Return the heights of a step fused with the map `old` (eq. 16); `worse` is as in `uncertainty_kernels.fuse`."""
    out = replace(new, height=new.height.copy(), views=new.views.copy())  # the rest is not held in buffers
    rasters = ("height", "sigma", "flags", "views", "residual", "sampling")
    kernels.fuse(*(getattr(out, k) for k in rasters), *(getattr(old, k) for k in rasters), worse)
    return out
