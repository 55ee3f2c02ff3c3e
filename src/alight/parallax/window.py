"""One step of the recursive estimator: its views, and the rectangles that they refine and weigh against the map."""

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

GAP = 4  # cells: a gap narrower than twice this, between heights, starts from them
HALO = 8  # cells about a rectangle that are refined with it and thrown away: no seams
BESIDE = 0.02  # of the height: cameras of one exposure nearer to each other have the same occlusions
APART = 0.06  # of the height: cameras nearer to each other see so much alike that a sweep needs one of them
ALIKE = 0.1  # rad between the axes of such cameras
SAME_FOCAL = 0.05  # between their focal lengths, as a share


class Refined(NamedTuple):
    """A rectangle after a step."""

    heights: Heights
    changed: Mask  # (R, C) ground that looks different since some moment: the height is the old one
    came: Mask  # (R, C) ground on which somebody came to stand (eq. 16e)


@dataclass(frozen=True, eq=False)
class Window:
    """Common input of all rectangles of one step."""

    settings: ParallaxSettings
    buffers: Buffers  # arrays that are used again
    grid: Grid
    known: ElevationMap  # the map before the step
    kept: list[Kept]  # the views that take part
    seen: refine.ViewGeometry
    ratio: F32  # (R, C) best over second-best cost of the last sweep; NaN: to be swept anew
    searched: tuple[float, float]  # metres
    drop: float  # metres from the newest camera to the ground
    nearly: NDArray[np.intp]  # (N,) of each view, the first of its exposure within `BESIDE`
    apart: NDArray[np.intp]  # (N,) and within `APART`

    def views_of(self, where: Box) -> NDArray[np.intp]:
        """Indices of the views that see any of a rectangle."""
        r, c = (slice(s.start // refine.SEEN_BLOCK, -(-s.stop // refine.SEEN_BLOCK)) for s in where)
        return np.flatnonzero(self.seen.views[:, r, c].any(axis=(1, 2)))

    def refined(self, skyline: refine.Skyline, start: F32, wrong: Mask, box: Box, recolour: bool) -> Refined | None:
        """The heights of a rectangle after a Gauss-Newton step, weighed against the map; None where nothing is known.

        Args:
            skyline: of `start`, for the rays that the map stops.
            start: (R, C) of the window, heights to start from.
            wrong: (R, C) cells whose height in the map counts for nothing.
            recolour: the map's colours there are coarse.
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
        tuning = s.refinement.model_copy(update={"iterations": s.recursive.steps})
        first, owner = np.unique(self.nearly[chosen], return_inverse=True)
        centres = np.array([self.kept[i].fine.centre for i in first])
        visible = skyline.visible(centres, where, per_px, tuning.occlusion_px)[owner]
        fit = refine.gauss_newton(fine, grid, h, per_px, visible, tuning, self.buffers)
        before = known = self.known.part(where)
        rgb = self._coloured(grid, fit.height, known, recolour)
        cost = trust.half_resolution(
            np.where(np.isnan(cost) | np.isnan(h), np.float32(s.recursive.unknown_ratio), cost)
        )
        if (off := wrong[where]).any():
            known = replace(known, height=np.where(off, np.float32(np.nan), known.height))
        found = trust.judged(fit, cost, newest, self.searched, sampling, rgb, s.uncertainty)
        samples = self.buffers.get("samples", (len(fine), *grid.shape))  # left there by the fit
        pairs, consistency = witness.instants([k.view for k in kept]), s.consistency
        moves = witness.moving(samples, pairs, fit, consistency.least_views, consistency)
        found = fused(replace(found, flags=found.flags | moves), known, s.recursive.worse)
        times = np.array([k.view.t_ns for k in kept])
        anew = witness.changed_since(samples, pairs, times, consistency)
        doubt = witness.contradicted(samples, before, consistency.least_views, consistency)
        anew |= (doubt.wrong | doubt.came) & is_trusted(found.flags)
        anew &= np.isfinite(found.height)
        found = replace(found, flags=found.flags | np.where(anew, np.uint16(Flag.MOVING), np.uint16(0)))
        return Refined(found.part(inner), anew[inner], doubt.came[inner])

    def _coloured(self, grid: Grid, height: F32, known: ElevationMap, recolour: bool) -> U8:
        """The map's colour, renewed by the newest view just below it and where there was none."""
        view, fine = self.kept[-1].view, self.kept[-1].fine
        out = known.rgb.copy()
        row, col = (float(v) for v in grid.index(view.centre[0], view.centre[1]))
        k = self.settings.recursive.renew_below * self.drop / grid.cell
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
    """The rectangle with its halo, as far as the window goes, from even cells on."""
    r, c = (slice(max(0, s.start - HALO) & ~1, min(n, s.stop + HALO)) for s, n in zip(where, shape, strict=True))
    return r, c


def within(inner: Box, outer: Box) -> Box:
    """A rectangle in the numbers of another that holds it."""
    r, c = (slice(i.start - o.start, i.stop - o.start) for i, o in zip(inner, outer, strict=True))
    return r, c


def first_of_twins(kept: list[Kept], within: float) -> NDArray[np.intp]:
    """For each view (N,) the first one of its exposure that sees the same from a place `within` metres of it."""
    out = list[int]()
    for i, of in enumerate(kept):
        out.append(next((j for j in range(i) if out[j] == j and _are_twins(kept[j], of, within)), i))
    return np.array(out, np.intp)


def _are_twins(a: Kept, b: Kept, within: float) -> bool:
    """True for views of one exposure from nearly one place, by cameras of one model that look the same way."""
    if a.view.t_ns != b.view.t_ns or np.linalg.norm(a.view.centre - b.view.centre) >= within:
        return False
    axes, k, m = [v.view.world_from_cam.rotation[:, 2] for v in (a, b)], a.fine.camera, b.fine.camera
    same_field = (k.width, k.height) == (m.width, m.height) and abs(k.fu / m.fu - 1) < SAME_FOCAL
    return same_field and float(axes[0] @ axes[1]) > np.cos(ALIKE)


def bridged(start: F32, wanted: Mask) -> F32:
    """Start narrow gaps that are `wanted` from the heights beside them.

    A sweep at the rim of the pictures is often in vain, and the next one has to wait for twice the baseline. Without
    this, the rims of earlier steps stay in the map as seams, one cell wide, that no touchdown may cross.
    """
    known = np.isfinite(start)
    gaps = wanted & ~known
    if gaps.any():
        gaps &= close_mask(known, GAP)
    if not gaps.any():
        return start
    return np.where(gaps, weighted_gaussian(start, known.astype(np.float32), GAP).mean, start)


def fused(new: Heights, old: ElevationMap, worse: float) -> Heights:
    """Weigh a step against the map (eq. 16).

    Heights that disagree by more than three sigma are not averaged: the new one replaces the old. Where the new sigma
    is much larger than the old, at the edge of the pictures, the map stays as it is.
    """
    out = replace(new, height=new.height.copy(), views=new.views.copy())  # the rest is not held in buffers
    rasters = ("height", "sigma", "flags", "views", "residual", "sampling")
    kernels.fuse(*(getattr(out, k) for k in rasters), *(getattr(old, k) for k in rasters), worse)
    return out
