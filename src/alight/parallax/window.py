"""One rectangle of a recursive step: its views, refinement, sigma, flags, colour, and the weighing against the map."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from alight.arrays import F32, U8, Mask
from alight.geometry import Box, Camera, Grid, box_of
from alight.parallax import gauss_newton as refine
from alight.parallax import temporal_consistency as witness
from alight.parallax import uncertainty as trust
from alight.parallax import uncertainty_kernels as kernels
from alight.parallax.views import Buffers, Kept, enlarged, maps, picture_at, rgb_of
from alight.raster import close_mask, weighted_gaussian
from alight.records import ElevationMap, Flag, Heights, is_trusted
from alight.settings import ParallaxSettings

GAP = 4  # cells: a gap narrower than twice this, between heights, starts from them
HALO = 8  # cells about a rectangle that are refined with it and thrown away: no seams
FUSED = ("height", "sigma", "flags", "views", "residual", "sampling")
FIELDS = (*FUSED, "rgb")
BESIDE = 0.02  # of the height: cameras of one exposure nearer to each other have the same occlusions
APART = 0.06  # of the height: cameras nearer to each other see so much alike that a sweep needs one of them
ALIKE = 0.1  # rad between the axes of such cameras
SAME_FOCAL = 0.05  # between their focal lengths, as a share


T = TypeVar("T", bound=np.generic)
Raster = TypeVar("Raster", Heights, ElevationMap)


@dataclass(frozen=True, eq=False)
class Window:
    """Common input of all rectangles of one step."""

    grid: Grid
    known: ElevationMap  # the map before the step
    kept: list[Kept]  # the views that take part
    seen: refine.ViewGeometry
    per_px: F32  # (R, C) metres a parallax pixel
    searched: tuple[float, float]  # metres
    drop: float  # metres from the newest camera to the ground
    picture: U8  # (H, W, 3) of the newest view
    nearly: NDArray[np.intp]  # (N,) of each view, the first of its exposure within `BESIDE`
    apart: NDArray[np.intp]  # (N,) and within `APART`

    @classmethod
    def of(
        cls, kept: list[Kept], grid: Grid, known: ElevationMap, searched: tuple[float, float], drop: float
    ) -> Window:
        """The window for these views; `drop`: metres from the newest camera to the ground."""
        ground = float(kept[-1].view.centre[2]) - drop
        seen = refine.view_geometry([k.fine for k in kept], grid, known.height, ground)
        per_px = enlarged(seen.metres_per_px, grid.shape, refine.SEEN_BLOCK)
        near, far = (first_of_twins(kept, share * drop) for share in (BESIDE, APART))
        return cls(grid, known, kept, seen, per_px, searched, drop, rgb_of(kept[-1].view.image), near, far)

    def views_of(self, where: Box) -> NDArray[np.intp]:
        """Indices of the views that see any of a rectangle."""
        r, c = (slice(s.start // refine.SEEN_BLOCK, -(-s.stop // refine.SEEN_BLOCK)) for s in where)
        return np.flatnonzero(self.seen.views[:, r, c].any(axis=(1, 2)))

    def part_of(self, values: NDArray[T], where: Box) -> NDArray[T]:
        """Values of blocks of `refine.SEEN_BLOCK` cells, on the cells of a rectangle."""
        n = refine.SEEN_BLOCK
        r, c = (slice(s.start // n, -(-s.stop // n)) for s in where)
        part, a = np.ascontiguousarray(values[r, c]), [s.start - n * (s.start // n) for s in where]
        shape = a[0] + where[0].stop - where[0].start, a[1] + where[1].stop - where[1].start
        return np.ascontiguousarray(enlarged(part, shape, n)[a[0] :, a[1] :])


def part_of(found: Raster, where: Box) -> Raster:
    """A rectangle of a map or of heights, copied."""
    fields: dict[str, Any] = {k: np.ascontiguousarray(getattr(found, k)[where]) for k in FIELDS}
    return type(found)(found.grid.part(where), **fields)


def wider(where: Box, shape: tuple[int, int]) -> Box:
    """The rectangle with its halo, as far as the window goes, from even cells on."""
    r, c = (slice(max(0, s.start - HALO) & ~1, min(n, s.stop + HALO)) for s, n in zip(where, shape, strict=True))
    return r, c


def within(inner: Box, outer: Box) -> Box:
    """A rectangle in the numbers of another that holds it."""
    r, c = (slice(i.start - o.start, i.stop - o.start) for i, o in zip(inner, outer, strict=True))
    return r, c


def _same_field(a: Camera, b: Camera) -> bool:
    """True if two cameras have the same field of view: of one model, calibrated one by one."""
    return (a.width, a.height) == (b.width, b.height) and abs(a.fu / b.fu - 1) < SAME_FOCAL


def first_of_twins(kept: list[Kept], within: float) -> NDArray[np.intp]:
    """For each view (N,) the first one of its exposure that looks the same way from a place `within` metres of it."""
    out = list[int]()
    for i, (view, fine) in enumerate((k.view, k.fine) for k in kept):
        axis = view.world_from_cam.rotation[:, 2]
        same = (
            j for j in range(i)
            if out[j] == j and kept[j].view.t_ns == view.t_ns and _same_field(kept[j].fine.camera, fine.camera)
            and np.linalg.norm(kept[j].view.centre - view.centre) < within
            and float(axis @ kept[j].view.world_from_cam.rotation[:, 2]) > np.cos(ALIKE)
        )  # fmt: skip
        out.append(next(same, i))
    return np.array(out, np.intp)


class Refined(NamedTuple):
    """A rectangle after a step."""

    heights: Heights
    changed: Mask  # (R, C) ground that looks different since some moment: the height is the old one
    came: Mask  # (R, C) ground on which somebody came to stand (eq. 16e)


@dataclass(eq=False)
class Refiner:
    """Refines rectangles of a window with its views.

    Args:
        settings: of parallax.
        buffers: arrays that are used again.
    """

    settings: ParallaxSettings
    buffers: Buffers

    def refined(
        self, window: Window, skyline: refine.Skyline, start: F32, ratio: F32, wrong: Mask, box: Box, recolour: bool
    ) -> Refined | None:
        """The heights of a rectangle after a Gauss-Newton step, weighed against the map; None where nothing is known.

        Args:
            skyline: of `start`, for the rays that the map stops.
            start, ratio: (R, C) of the window, heights to start from, and best over second-best cost.
            wrong: (R, C) cells whose height in the map counts for nothing.
            box: the rectangle.
            recolour: the map's colours there are coarse.
        """
        where = wider(box, window.grid.shape)
        grid, chosen = window.grid.part(where), window.views_of(where)
        h, cost = (np.ascontiguousarray(v[where]) for v in (start, ratio))
        count = window.part_of(window.seen.count, where)
        h = bridged(h, ~np.isnan(cost) & (count >= self.settings.recursive.first_views))
        if len(chosen) < 2 or not np.isfinite(h[within(box, where)]).any():
            return None
        kept, per_px = [window.kept[i] for i in chosen], np.ascontiguousarray(window.per_px[where])
        fine, steps = [k.fine for k in kept], self.settings.recursive.steps
        tuning = self.settings.refinement.model_copy(update={"iterations": steps})
        first, owner = np.unique(window.nearly[chosen], return_inverse=True)
        centres = np.array([window.kept[i].fine.centre for i in first])
        visible = skyline.visible(centres, where, per_px, tuning.occlusion_px)[owner]
        fit = refine.gauss_newton(fine, grid, h, per_px, visible, tuning, self.buffers)
        before = known = part_of(window.known, where)
        rgb = self._coloured(window, grid, fit.height, known, recolour)
        cost = trust.half_resolution(
            np.where(np.isnan(cost) | np.isnan(h), np.float32(self.settings.recursive.unknown_ratio), cost)
        )
        if (off := wrong[where]).any():
            known = replace(known, height=np.where(off, np.float32(np.nan), known.height))
        sampling = window.part_of(window.seen.sampling, where)
        newest = [window.kept[-1].fine]
        found = trust.judged(fit, cost, newest, window.searched, sampling, rgb, self.settings.uncertainty)
        samples = self.buffers.get("samples", (len(fine), *grid.shape))  # left there by the fit
        pairs, consistency = witness.instants([k.view for k in kept]), self.settings.consistency
        moves = witness.moving(samples, pairs, fit, consistency.least_views, consistency)
        found = fused(replace(found, flags=found.flags | moves), known, self.settings.recursive.worse)
        times = np.array([k.view.t_ns for k in kept])
        anew = witness.changed_since(samples, pairs, times, consistency)
        doubt = witness.contradicted(samples, before, consistency.least_views, consistency)
        anew |= (doubt.wrong | doubt.came) & is_trusted(found.flags)
        anew &= np.isfinite(found.height)
        found = replace(found, flags=found.flags | np.where(anew, np.uint16(Flag.MOVING), np.uint16(0)))
        inner = within(box, where)
        return Refined(part_of(found, inner), anew[inner], doubt.came[inner])

    def _coloured(self, window: Window, grid: Grid, height: F32, known: ElevationMap, recolour: bool) -> U8:
        """The map's colour, renewed by the newest view just below it and where there was none."""
        view, fine = window.kept[-1].view, window.kept[-1].fine
        out = known.rgb.copy()
        row, col = (float(v) for v in grid.index(view.centre[0], view.centre[1]))
        k = self.settings.recursive.renew_below * window.drop / grid.cell
        under = (slice(max(0, int(row - k)), max(0, int(row + k))), slice(max(0, int(col - k)), max(0, int(col + k))))
        fresh = (np.isnan(known.height) | recolour) & np.isfinite(height)
        for where, only in ((box_of(fresh), fresh), (under, None)):
            r, c = where
            part = grid.window(r.start, c.start, *height[where].shape)
            if not part.rows * part.cols:
                continue
            mapx, mapy = maps(fine, part, np.ascontiguousarray(height[where]))
            take = mapx >= 0  # not where there is no height
            if only is not None:
                take &= only[where]
            cv2.copyTo(picture_at(window.picture, view.camera, fine, mapx, mapy), take.view(np.uint8), out[where])
        return out


def bridged(start: F32, wanted: Mask) -> F32:
    """Start narrow gaps that are `wanted` from the heights beside them.

    A sweep at the rim of the pictures is often in vain, and the next one has to wait for twice the baseline. Without
    this, the rims of earlier steps stay in the map as seams, one cell wide, that no touchdown may cross.
    """
    known = np.isfinite(start)
    gaps = wanted & ~known
    if not gaps.any():
        return start
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
    kernels.fuse(*(getattr(out, f) for f in FUSED), *(getattr(old, f) for f in FUSED), worse)
    return out
