"""Heights without initial heights: plane sweep along the rays of one view, then semi-global aggregation.

Used at a cold start and for recordings. At the height of the ground, the cells of the sweep are those of the world
grid. A hypothesis of another height moves along the ray to the reference view, not up: each ray then meets one surface.
With vertical hypotheses, an object in front of a cell could match at the height of the ground, and objects seen from
the side were lost.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from alight.arrays import F32, F64, I32, I64, Mask
from alight.geometry import Box, Grid, box_of
from alight.parallax import sweep_kernels as kernels
from alight.parallax.sorting_kernels import network
from alight.parallax.views import BLOCK, Prepared, centres_of, maps, sample, when_exposed
from alight.raster import upsample
from alight.settings.tuning.parallax import SweepTuning

LEAST_SIDE = 16  # cells across a coarse level, at least: aggregation finds no surface on fewer
OUTSIDE = 0.5  # percent of the heights found, at either end, that do not widen the search
CLOSE = 0.2  # share of the height of the lowest view above the lowest height searched, not swept
MARGIN_SHARE, MARGIN_PLANES = 0.2, 5  # margin about the heights found: share of their span, and coarse planes
ABOUT, MARGIN_ABOUT = 16, 1.0  # cells about an unseen region; margin, metres
ENOUGH = 40  # least number of points or cells to estimate a height


class Reach(NamedTuple):
    """Range of heights that a ray tries around the heights found on coarser cells."""

    beside: int  # coarse cells on either side whose heights the ray tries
    border: int  # coarse cells on either side that are used where none within `beside` has a height
    slack: int  # planes added at either end


NARROW, BROAD = Reach(1, 6, 2), Reach(8, 16, 8)  # at the finest level; at the levels between coarsest and finest

Span = tuple[float, float]  # lowest and highest height, metres


class Swept(NamedTuple):
    """Result of a sweep, (R, C); NaN where nothing was found."""

    height: F32  # metres
    ratio: F32  # best over second-best cost, near 1 where a second height fits as well

    @classmethod
    def nothing(cls, grid: Grid) -> Swept:
        """Return a result without any height: all NaN."""
        return cls(*np.full((2, *grid.shape), np.nan, np.float32))


def parallax_per_metre(centres: F64, height: float) -> float:
    """Return the largest parallax between cameras at `centres` (N, 3), per metre of height, for ground at `height`."""
    v = centres[:, :2] / np.maximum(centres[:, 2:] - height, 1e-3)
    return float(max(np.linalg.norm(v - a, axis=1).max() for a in v)) if len(v) else 0.0


def plane_count(slide: float, low: float, high: float, cell: float, most: int) -> int:
    """Return the number of planes, 5 to `most`, between the heights `low` and `high` at steps of 0.7 cells of parallax.

    `slide` is the parallax, metres per metre of height; `cell` is the cell size, metres.
    """
    return int(np.clip(np.ceil((high - low) * max(slide, 1e-3) / (0.7 * cell)) + 1, 5, most))


@dataclass(frozen=True, eq=False)
class Registered:
    """Views resampled to the plane at height `ground`. For other heights, each picture is shifted and scaled."""

    grid: Grid
    ground: float  # metres
    pictures: F32  # (N, R, C) normalised grey, NaN outside; only views that see part of the grid
    centres: F64  # (N, 3) metres
    guide: F32  # picture of the reference view on the swept cells, without the margin

    def at(self, cells: Grid, heights: F32, about: F64) -> tuple[F64, F64]:
        """Return scale (D, N) and shift (D, N, 2) that map rows and columns of `cells` to those of the N pictures.

        Args:
            heights: (D,) heights to which the cells are moved along their rays, metres.
            about: (3,) camera centre in which the rays meet, metres.
        """
        z = heights.astype(np.float64)[:, None]
        s = (about[2] - z) / (about[2] - self.ground)
        t = (self.centres[:, 2] - self.ground) / (self.centres[:, 2] - z)
        first = np.array([cells.east, cells.north])
        place = self.centres[:, :2] + t[..., None] * (
            about[:2] + s[..., None] * (first - about[:2]) - self.centres[:, :2]
        )
        row, col = self.grid.index(place[..., 0], place[..., 1])
        return s * t * (cells.cell / self.grid.cell), np.stack([row, col], axis=-1)


def register(prepared: list[Prepared], grid: Grid, ground: float, searched: Span, reference: int) -> Registered:
    """Return the views resampled to the plane at height `ground`, over `grid` and a margin for the heights `searched`.

    `reference`: index of the view whose picture becomes `Registered.guide`.
    """
    centres = centres_of(prepared)
    slide = np.abs(centres[:, None, :2] - centres[None, :, :2]).max()
    share = max(abs((centres[:, 2].min() - ground) / (centres[:, 2].min() - z) - 1) for z in searched)
    pad = math.ceil(slide * share / grid.cell) + 3
    wide = grid.window(-pad, -pad, grid.rows + 2 * pad, grid.cols + 2 * pad)
    level = np.full(wide.shape, ground, np.float32)
    pictures = np.empty((len(prepared), *wide.shape), np.float32)
    for i, p in enumerate(prepared):
        sample(p.norm, *maps(p, *wide.xy(), level), out=pictures[i], how=cv2.INTER_CUBIC)
    sees = np.isfinite(pictures[:, ::BLOCK, ::BLOCK]).any(axis=(1, 2))
    inner = pictures[reference, pad : pad + grid.rows, pad : pad + grid.cols]
    return Registered(wide, ground, pictures[sees], centres[sees], np.ascontiguousarray(inner))


def ray_lattice(grid: Grid, ground: float, searched: Span, reference: Prepared) -> Grid:
    """Return the rays to view `reference` that cross `grid` at heights `searched`, as a grid at the height `ground`."""
    about = reference.centre
    x, y = (v[[0, -1]] for v in grid.xy())
    share = np.array([(about[2] - ground) / (about[2] - z) for z in searched])
    east = (about[0] + np.multiply.outer(share, x - about[0])).ravel()
    north = (about[1] + np.multiply.outer(share, y - about[1])).ravel()
    (top, bottom), (left, right) = ((math.floor(i.min()), math.ceil(i.max()) + 1) for i in grid.index(east, north))
    wide = grid.window(top, left, bottom - top, right - left)
    seen = np.full(wide.coarser(BLOCK).shape, ground, np.float32)
    rows, cols = box_of(maps(reference, *wide.coarser(BLOCK).xy(), seen)[0] >= 0)
    top, left = max(rows.start - 1, 0) * BLOCK, max(cols.start - 1, 0) * BLOCK
    bottom, right = min((rows.stop + 1) * BLOCK, wide.rows), min((cols.stop + 1) * BLOCK, wide.cols)
    return wide.window(top, left, max(bottom - top, 1), max(right - left, 1))


def sweep_unseen(
    pyramid: Sequence[list[Prepared]],
    grid: Grid,
    searched: Span,
    ground: float,
    wanted: Mask,
    tuning: SweepTuning,
    known: F32 | None = None,
) -> Swept:
    """Find the heights of the `wanted` (R, C) cells by sweeps along the rays of the views that see them best.

    Cells that one view does not see, behind a step or beyond its border, are swept along the rays of another view.

    Args:
        pyramid: the views prepared for each cell size, as for `sweep`.
        searched: lowest and highest height, metres.
        ground: approximate height of the ground, metres.
        known: (R, C) heights, metres, NaN = unknown; those around a region of wanted cells narrow its search.
    """
    out = Swept.nothing(grid)
    left, tried = wanted.copy(), list[tuple[Box, int]]()
    for _ in range(tuning.references):
        for where in regions(left, tuning.least_wanted):
            part = grid.part(where)
            before = {
                k for its, k in tried
                if all(a.start < b.stop and b.start < a.stop for a, b in zip(its, where, strict=True))
            }  # fmt: skip
            reference = best_reference(pyramid[0], part, ground, left[where], before)
            if reference is None:
                continue
            tried.append((where, reference))
            heights = searched
            if known is not None:
                near = known[tuple(slice(max(s.start - ABOUT, 0), s.stop + ABOUT) for s in where)]
                heights = narrowed(near, searched, MARGIN_ABOUT, ENOUGH)
            found = sweep(pyramid, part, heights, ground, reference, tuning)
            take = left[where] & np.isfinite(found.height)
            for whole, new in zip(out, found, strict=True):
                np.copyto(whole[where], new, where=take)
            left[where] &= ~take
    return out


def narrowed(found: F32, searched: Span, margin: float, least: int = 1) -> Span:
    """Return the span `searched`, narrowed to the heights `found` plus a `margin`, metres, if `least` are known."""
    known = found[np.isfinite(found)]
    if len(known) < least:
        return searched
    low, high = (float(v) for v in np.percentile(known, [OUTSIDE, 100.0 - OUTSIDE]))
    margin = MARGIN_SHARE * (high - low) + margin
    return max(searched[0], low - margin), min(searched[1], high + margin)


def regions(wanted: Mask, least_share: float) -> list[Box]:
    """Return rectangles (rows, columns) around connected blocks in which a share above `least_share` is `wanted`."""
    shape = tuple(-(-n // BLOCK) for n in wanted.shape)
    whole = np.zeros((shape[0] * BLOCK, shape[1] * BLOCK), np.float32)
    whole[: wanted.shape[0], : wanted.shape[1]] = wanted
    share = cv2.resize(whole, shape[::-1], interpolation=cv2.INTER_AREA)
    count, labels = cv2.connectedComponents((share > least_share).astype(np.uint8), connectivity=4)
    boxes = [box_of(labels == k) for k in range(1, count)]
    return [
        (slice(r.start * BLOCK, min(r.stop * BLOCK, wanted.shape[0])),
         slice(c.start * BLOCK, min(c.stop * BLOCK, wanted.shape[1])))
        for r, c in boxes
    ]  # fmt: skip


def best_reference(
    prepared: list[Prepared], grid: Grid, ground: float, wanted: Mask, but: Collection[int]
) -> int | None:
    """Return the index of the view that sees most of the `wanted` cells; None if no view sees any.

    The cells are assumed to lie at the height `ground`. Steep views are preferred; views with an index in `but` are
    left out.
    """
    wide = grid.coarser(BLOCK)
    share = cv2.resize(wanted.astype(np.float32), wide.shape[::-1], interpolation=cv2.INTER_AREA)
    level = np.full(wide.shape, ground, np.float32)
    x, y = np.meshgrid(*wide.xy())
    worth = np.zeros(len(prepared))
    for k, p in enumerate(prepared):
        if k not in but:
            tangent = np.hypot(x - p.centre[0], y - p.centre[1]) / (p.centre[2] - ground)
            worth[k] = (share * (maps(p, *wide.xy(), level)[0] >= 0) * np.maximum(1.0 - tangent, 0.1)).sum()
    return int(np.argmax(worth)) if worth.max() > 0 else None


@dataclass(frozen=True, eq=False)
class Spans:
    """Indices of the first and the last plane that each ray tries."""

    low: I32  # (R, C)
    high: I32  # (R, C)

    @classmethod
    def whole(cls, shape: tuple[int, int], count: int) -> Spans:
        """Return spans in which every ray tries all `count` planes."""
        return cls(np.zeros(shape, np.int32), np.full(shape, count - 1, np.int32))

    @classmethod
    def about(cls, found: F32, shape: tuple[int, int], levels: F32, reach: Reach) -> Spans:
        """Return spans around heights `found` (R / 2, C / 2) on cells twice as large, for rays of `shape`.

        Beside a step, a ray tries the heights on both sides of it and all between (Rothermel et al. 2012, tSGM).
        `levels` (D,) are the heights of the planes. All heights are in metres.
        """
        low, high = extremes(found, reach.beside)
        beyond = extremes(found, reach.border)  # smaller cells reach nearer to the border of a picture
        for end, further in zip((low, high), beyond, strict=True):
            np.copyto(end, further, where=~np.isfinite(end))
        none = low > high  # no two views see anything there, at any resolution
        low[none] = high[none] = levels[0]
        spacing, last = levels[1] - levels[0], len(levels) - 1
        ends = np.floor((low - levels[0]) / spacing) - reach.slack, np.ceil((high - levels[0]) / spacing) + reach.slack
        wide = (upsample(v, 2, shape) for v in ends)
        return cls(*(np.clip(v, 0, last).astype(np.int32) for v in wide))

    @property
    def neighbours(self) -> Spans:
        """Spans that also contain the spans of the neighbouring rays, because the costs of neighbours are averaged."""
        near = np.ones((3, 3), np.uint8)
        low, high = -cv2.dilate(-self.low.astype(np.float32), near), cv2.dilate(self.high.astype(np.float32), near)
        return Spans(low.astype(np.int32), high.astype(np.int32))

    @property
    def first(self) -> I64:
        """Index of each ray's first cost in the cost volume, (R, C); the costs of one ray are adjacent."""
        count = (self.high - self.low + 1).astype(np.int64)
        return np.cumsum(count).reshape(count.shape) - count


def sweep(
    pyramid: Sequence[list[Prepared]], grid: Grid, searched: Span, ground: float, reference: int, tuning: SweepTuning
) -> Swept:
    """Find the height of every cell that view `reference` sees (docs/method/parallax.md, eqs. 6 and 7).

    Heights are NaN where the reference or all other views see nothing.

    Args:
        pyramid: the views prepared for the cells of `grid`, for cells twice as large, and so on. The coarsest level
            tries all planes that its views can separate. Each finer level tries planes around the heights of the
            coarser level.
        searched: lowest and highest height, metres; heights very near the lowest view (`CLOSE`) are left out.
        ground: approximate height of most of the ground, metres.
        reference: index of the view along whose rays heights are tried.
    """
    pyramid = [[when_exposed(p, grid, ground) for p in views] for views in pyramid]
    about = pyramid[0][reference].centre
    lowest = float(centres_of(pyramid[0])[:, 2].min())
    if lowest <= searched[0]:
        return Swept.nothing(grid)
    searched = searched[0], min(searched[1], lowest - CLOSE * (lowest - searched[0]))
    ground = min(ground, searched[1])
    rays = ray_lattice(grid, ground, searched, pyramid[0][reference])
    of = [rays]
    while len(of) < len(pyramid) and min(of[-1].shape) >= 2 * LEAST_SIDE:
        of.append(of[-1].coarser(2))
    found = ratio = np.empty((0, 0), np.float32)
    for k in reversed(range(len(of))):
        views = register(pyramid[k], of[k], ground, searched, reference)
        slide = parallax_per_metre(views.centres, 0.5 * (searched[0] + searched[1]))
        count = plane_count(slide, *searched, of[k].cell, tuning.most_planes << (len(of) - 1 - k))
        levels = np.linspace(*searched, count).astype(np.float32)
        narrow = k == 0 and len(of) > 1
        first, reach = k == len(of) - 1, NARROW if narrow else BROAD
        spans = Spans.whole(of[k].shape, len(levels)) if first else Spans.about(found, of[k].shape, levels, reach)
        found, doubt = along_rays(views, of[k], levels, spans, about, tuning)
        ratio = np.fmax(doubt, upsample(ratio, 2, rays.shape)) if narrow else doubt
        # smaller cells try the heights found, and a margin for objects too thin for the coarse cells
        searched = narrowed(found, searched, MARGIN_PLANES * float(levels[1] - levels[0]))
    return upright(found, ratio, rays, ground, about, grid, tuning.gap_cells)


def extremes(found: F32, reach: int) -> tuple[F32, F32]:
    """Return the lowest and highest known height within `reach` cells of each cell of `found`; inf, -inf if none is."""
    near, known = np.ones((2 * reach + 1,) * 2, np.uint8), np.isfinite(found)
    border = cv2.BORDER_REPLICATE  # OpenCV's own is the largest number, not infinity
    low = cv2.erode(np.where(known, found, np.float32(np.inf)), near, borderType=border)
    high = cv2.dilate(np.where(known, found, np.float32(-np.inf)), near, borderType=border)
    return np.asarray(low, np.float32), np.asarray(high, np.float32)


def along_rays(views: Registered, rays: Grid, levels: F32, spans: Spans, about: F64, tuning: SweepTuning) -> Swept:
    """Return the height (metres) and cost ratio of each of the `rays`, chosen among the planes in its span.

    The rays meet in the camera centre `about` (3,). `levels`: (D,) heights of the planes, metres.
    """
    first, near, everywhere = spans.first, spans.neighbours, Spans.whole(rays.shape, len(levels))
    cost = np.empty((spans.high - spans.low + 1).sum(dtype=np.int64), np.float32)  # of all rays
    plane, count = np.empty(rays.shape, np.float32), np.empty(rays.shape, np.int32)
    pairs, usual = network(len(views.pictures)), int(np.argmin(np.abs(levels - views.ground)))
    seen, truncation = np.zeros(rays.shape, np.int32), np.float32(tuning.truncation)
    scales, shifts = views.at(rays, levels, about)
    for k, (scale, shift) in enumerate(zip(scales, shifts, strict=True)):
        wanted = everywhere if k == usual else near
        kernels.sweep_cost(
            views.pictures, scale, shift, pairs, tuning.keep_share, truncation, wanted.low, wanted.high, k, plane, count
        )
        kernels.store(plane, k, spans.low, spans.high, first, cost)
        if k == usual:  # beyond a border, only a wrong height brings a second view into play
            seen = count.copy()
    seen[np.isnan(views.guide)] = 0
    halves = np.empty((2, len(cost)), np.float32)
    penalties = map(np.float32, (tuning.penalty_one_plane, tuning.penalty_more_planes, tuning.edge_discount))
    kernels.aggregate(cost, spans.low, spans.high, first, np.nan_to_num(views.guide), *penalties, halves)
    total = np.add(halves[0], halves[1], out=halves[0])
    index, ratio = np.empty(rays.shape, np.float32), np.empty(rays.shape, np.float32)
    kernels.winner(total, cost, spans.low, spans.high, first, seen, index, ratio)
    found = levels[0] + (levels[1] - levels[0]) * index
    return Swept(cv2.medianBlur(found.astype(np.float32), 3), ratio)  # without single spikes


def upright(found: F32, ratio: F32, rays: Grid, ground: float, about: F64, grid: Grid, gap: int) -> Swept:
    """Resample heights from rays to the world grid `grid`; of several heights in a cell, the highest is kept.

    Gaps are filled with the lowest height beside them, because ground hidden by a step lies at its foot. Filled heights
    have the ratio 1: another height may fit as well.

    Args:
        found, ratio: heights on the rays, metres, NaN = none, and their cost ratios.
        rays: grid of the rays at height `ground`; the rays meet in the camera centre `about` (3,), metres.
        gap: half the width of the widest gap that is filled, cells.
    """
    height, which = np.full(grid.shape, np.nan, np.float32), np.full(grid.shape, np.nan, np.float32)
    to = np.array(
        [rays.east - grid.east, rays.north - grid.north, about[0] - grid.east, about[1] - grid.north, about[2]]
    )
    kernels.splat(found, ratio, ground, rays.cell, to, height, which)
    known, near = np.isfinite(height), np.ones((2 * gap + 1,) * 2, np.uint8)
    hidden = cv2.morphologyEx(known.astype(np.uint8), cv2.MORPH_CLOSE, near).astype(np.bool_) & ~known
    height = np.where(hidden, cv2.erode(np.where(known, height, np.float32(np.inf)), near), height)
    np.copyto(which, np.float32(1), where=np.isnan(which) & np.isfinite(height))
    return Swept(height, which)
