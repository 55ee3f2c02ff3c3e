"""Memory beyond single maps: roofs, traffic, people, and the land cover of earlier maps.

A road between two cars looks as level and empty as a yard. `Flag.MOVING` marks only present motion, which the next map
has lost. On paved ground it is traffic; on plants or water it is their own motion. Bare ground is treated like plants:
dry grass is often classified as bare, and it sways.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from alight.arrays import F32, F64, I64, U16, Mask
from alight.geometry import Grid
from alight.landing.reserve import SIGMAS_OF_TIE
from alight.raster import cells_as_blocks, upsample, without_specks
from alight.records import Flag, MovingBody, Terrain, TerrainMap, View, Wire

CELL = 0.5  # metres, size of the remembered cells
SHARE = 0.5  # least covered share of a remembered cell
FADES = 60.0  # s, age that doubles the novelty of an earlier look
WIRES_KEPT = 120.0  # s, for which a wire is remembered: from below it is not seen
SEEN_FROM = 3.0  # metres above a wire, from which a search finds it
RENEWED = 0.4  # share of new exposures from which a map is searched for wires again
SURE = 0.3  # metres, largest sigma of a tie at which earlier looks are kept


@dataclass(frozen=True, eq=False)
class Remembered:
    """Cells where something was seen, with the newest time, in a map frame; immutable."""

    cells: I64 = field(default_factory=lambda: np.zeros((0, 2), np.int64))  # (N, 2) east, north in units of `CELL`
    t_ns: I64 = field(default_factory=lambda: np.zeros(0, np.int64))  # (N,) newest time of each cell

    def with_seen(self, cells: I64, t_ns: int) -> Remembered:
        """Return a copy with cells (M, 2) added that were seen at `t_ns`."""
        kept = ~np.isin(_keys(self.cells), _keys(cells))
        times = np.concatenate([self.t_ns[kept], np.full(len(cells), t_ns)])
        return Remembered(np.concatenate([self.cells[kept], cells]), times)

    def among(self, cells: I64) -> I64:
        """Return those of the cells (M, 2) that are remembered."""
        return np.asarray(cells[np.isin(_keys(cells), _keys(self.cells))])

    def since(self, t_ns: int) -> Remembered:
        """Return a copy with only the cells seen at `t_ns` or later."""
        kept = self.t_ns >= t_ns
        return Remembered(self.cells[kept], self.t_ns[kept])

    def moved(self, shift: F64, sigma: float = 0.0) -> Remembered:
        """Return a copy for a map frame where positions are larger by `shift`, metres.

        The cells grow by twice `sigma`, the horizontal 1-sigma of the shift in metres, but by 5 m at most. A site's
        clearance must cover the same distance.
        """
        out = Remembered(self.cells + np.rint(shift[:2] / CELL).astype(np.int64), self.t_ns)
        square = np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1], indexing="ij"), axis=-1).reshape(-1, 2)
        cross = square[(square == 0).any(axis=1)]
        for k in range(math.ceil(min(5.0, SIGMAS_OF_TIE * sigma) / CELL)):
            out = out._spread(cross if k % 2 else square)  # alternating: an octagon around the disc
        return out

    def _spread(self, beside: I64) -> Remembered:
        """Return a copy with each cell replaced by the cells at offsets `beside` (K, 2); newest times are kept."""
        cells = (self.cells[:, None] + beside).reshape(-1, 2)
        t_ns = np.repeat(self.t_ns, len(beside))
        latest = np.argsort(-t_ns, kind="stable")
        at = latest[np.unique(_keys(cells[latest]), return_index=True)[1]]
        return Remembered(cells[at], t_ns[at])

    def on(self, grid: Grid) -> Mask:
        """Return the mask (R, C) of the cells of a grid that overlap remembered cells."""
        if not len(self.cells):
            return np.zeros(grid.shape, np.bool_)
        columns, rows = _numbers(grid)
        low, high = np.array([columns.min(), rows.min()]), np.array([columns.max(), rows.max()])
        inside = self.cells[((self.cells >= low) & (self.cells <= high)).all(axis=1)]  # others may be kilometres away
        seen = np.zeros(high - low + 1, np.bool_)
        seen[tuple((inside - low).T)] = True
        touched = seen[np.ix_(columns - low[0], rows - low[1])].T
        return np.asarray(cells_as_blocks(touched, _across(grid)).any(axis=(1, 3)))


NOWHERE = Remembered()


def share_covered(grid: Grid, where: Mask) -> tuple[F64, I64]:
    """Compute the share of each cell of size `CELL` that a mask (R, C) of a grid covers.

    Returns:
        Shares (E, N), by east and north, and the first cell (east, north), (2,), in units of `CELL`.
    """
    columns, rows = _numbers(grid)
    where = upsample(where, _across(grid))
    low = np.array([columns.min(), rows.min()])
    shape = columns.max() - low[0] + 1, rows.max() - low[1] + 1
    at = ((columns - low[0])[None, :] * shape[1] + (rows - low[1])[:, None]).ravel()
    count, there = (np.bincount(at, weights=w, minlength=shape[0] * shape[1]) for w in (None, where.ravel()))
    return (there / np.maximum(count, 1)).reshape(shape), low


def _cells(there: Mask, low: I64) -> I64:
    return np.asarray(np.argwhere(there) + low, np.int64)


def shown_at(grid: Grid, where: Mask) -> I64:
    """Return the cells (N, 2) of size `CELL` of which a mask (R, C) of a grid covers at least `SHARE`."""
    share, low = share_covered(grid, where)
    return _cells(share >= SHARE, low)


def what_moves(grid: Grid, flags: U16, anew: Mask | None = None) -> I64:
    """Return the cells (N, 2) of size `CELL` that are mostly MOVING, in connected patches of 2 m^2 or more.

    `anew`: (R, C) mask of cells with new flags, as older flags were remembered before; None: all flags are new.
    """
    moves = (flags & np.uint16(Flag.MOVING)) != 0
    if not moves.any():
        return np.zeros((0, 2), np.int64)
    share, low = share_covered(grid, moves)
    there = without_specks(share >= SHARE, CELL, 2.0, neighbours=4)  # m^2; less is noise: a car has 8 to 15
    if anew is not None:
        there &= share_covered(grid, anew)[0] >= SHARE
    return _cells(there, low)


def who_came(grid: Grid, came: Mask) -> I64:
    """Return the cells (N, 2) that patches of `came` (R, C) touch; patches too small for a person are ignored."""
    share, low = share_covered(grid, without_specks(came, grid.cell, 0.08))  # m^2, shoulders of a person
    return _cells(share > 0, low)


def around(movers: Sequence[MovingBody], margin: float) -> I64:
    """Return the cells (N, 2) within `margin` metres of people and cars that move."""
    found = [np.zeros((0, 2), np.int64)]
    for m in movers:
        cells = math.ceil((m.reach + margin) / CELL)
        beside = np.stack(np.meshgrid(*[np.arange(-cells, cells + 1)] * 2, indexing="ij"), axis=-1).reshape(-1, 2)
        found.append(np.floor(m.place / CELL).astype(np.int64) + beside[np.hypot(*beside.T) <= cells])
    return np.unique(np.concatenate(found), axis=0)


def traffic(passed: Remembered, grid: Grid, land_cover: TerrainMap | None) -> Mask:
    """Return the mask (R, C) of cells that moving objects crossed; if the land cover is known, of paved cells only."""
    out = passed.on(grid)
    return out if land_cover is None else out & (land_cover.label == Terrain.PAVED)


def _across(grid: Grid) -> int:
    """Return how many points per axis of a cell of `grid` are looked up, to hit all cells of size `CELL` in it."""
    return 1 if grid.cell <= CELL else math.ceil(grid.cell / CELL) + 1


def _numbers(grid: Grid) -> tuple[I64, I64]:
    """Return cells at k points per axis of each cell of a grid: east (k C,) and north (k R,), in units of `CELL`."""
    k = _across(grid)
    inner = 0.5 * grid.cell - 1e-6 if k > 1 else 0.0  # a cell does not reach into its neighbour
    beside = np.linspace(-inner, inner, k)
    x, y = grid.xy()
    points = (x[:, None] + beside, y[:, None] - beside)
    east, north = (np.floor(v / CELL).astype(np.int64).ravel() for v in points)
    return east, north


def _keys(cells: I64) -> I64:
    return np.asarray(cells[:, 0] * (1 << 32) + cells[:, 1], np.int64)


@dataclass(frozen=True, eq=False)
class CoverMemory:
    """Least novel land cover so far of each cell of the newest map, in its frame (docs/method/p-safe.md, T8).

    Land cover is fitted to pictures from several metres and higher. A puddle that is obvious from 10 m looks like wet
    asphalt from 3 m, where its novelty (T6) is larger. So the values with the least novelty are kept.
    """

    grid: Grid | None = None  # None: nothing seen yet
    bears: F32 = field(default_factory=lambda: np.zeros((0, 0), np.float32))  # (R, C) as `TerrainMap.bears`
    novelty: F32 = field(default_factory=lambda: np.zeros((0, 0), np.float32))  # (R, C) of these values, grows with age
    t_ns: int = 0

    def with_seen(self, land_cover: TerrainMap, t_ns: int) -> CoverMemory:
        """Return the memory updated with a newer land-cover map of time `t_ns`, on the grid of that map."""
        bears, novelty = land_cover.bears, land_cover.novelty
        if self.grid is not None:
            age = max(t_ns - self.t_ns, 0) * 1e-9
            before = self.grid.nearest_on(land_cover.grid, self.bears, np.nan)
            unlike = self.grid.nearest_on(land_cover.grid, self.novelty, np.nan) * np.float32(2 ** (age / FADES))
            keeps = ~np.isnan(before) & (np.isnan(bears) | ~(unlike >= novelty))
            bears, novelty = np.where(keeps, before, bears), np.where(keeps, unlike, novelty)
        return CoverMemory(land_cover.grid, bears, novelty, t_ns)

    def doubted(self, land_cover: TerrainMap) -> TerrainMap:
        """Return the land cover with `bears` lowered to the memory's values where these are lower; grids must match."""
        return replace(land_cover, bears=np.where(self.bears < land_cover.bears, self.bears, land_cover.bears))

    def moved(self, shift: F64, sigma: float) -> CoverMemory:
        """Return the memory in a frame where positions are larger by `shift`, metres; empty if `sigma` > `SURE`."""
        if self.grid is None or not sigma <= SURE:
            return CoverMemory()
        east, north = self.grid.east + float(shift[0]), self.grid.north + float(shift[1])
        return replace(self, grid=replace(self.grid, east=east, north=north))


@dataclass(frozen=True, eq=False)
class RememberedWire:
    """A wire, and how often it was found and missed."""

    wire: Wire
    t_ns: int  # time of the map that showed it last
    found: int = 1  # maps that showed it
    missed: int = 0  # maps over its ground, from above it, that did not

    def lasts(self, t_ns: int) -> bool:
        """Whether it is still believed at a time: seen lately, and not missed more often than found."""
        return t_ns - self.t_ns <= round(WIRES_KEPT * 1e9) and self.missed <= self.found

    def looked_for(self, grid: Grid, height: float) -> RememberedWire:
        """Return the wire after a search that did not find it on a map, from cameras at `height`, metres up."""
        middle = 0.5 * (self.wire.start + self.wire.end)
        row, col = grid.index(middle[0], middle[1])
        inside = 0 <= row < grid.rows and 0 <= col < grid.cols
        above = height > middle[2] + SEEN_FROM
        return replace(self, missed=self.missed + 1) if inside and above else self


@dataclass(frozen=True, eq=False)
class WireMemory:
    """Wires found on this map and earlier ones, in a map frame; immutable.

    A search costs as much as a verdict, and shows little new from the same views. So a map is searched once enough of
    its exposures are new.
    """

    kept: tuple[RememberedWire, ...] = ()
    searched_ns: frozenset[int] = frozenset()  # exposures of the newest map that was searched

    @property
    def wires(self) -> tuple[Wire, ...]:
        """The wires."""
        return tuple(k.wire for k in self.kept)

    def is_search_due(self, views: Sequence[View]) -> bool:
        """Whether enough exposures of a map's views have not been searched."""
        times = {v.t_ns for v in views}
        return len(times - self.searched_ns) > RENEWED * len(times)

    def with_search(self, wires: Sequence[Wire], views: Sequence[View], grid: Grid) -> WireMemory:
        """Return the memory after a search of a map.

        Args:
            wires: wires that were found; the longer of two that cover each other is kept.
            views: views of the map.
            grid: grid of the map.
        """
        t_ns, kept = max(v.t_ns for v in views), list(self.kept)
        height = float(np.median([v.centre[2] for v in views]))
        new = list[RememberedWire]()
        for w in wires:
            same = [k for k in kept if k.wire.covers(w) or w.covers(k.wire)]
            kept = [k for k in kept if k not in same]
            longest, found = _longest([w, *(k.wire for k in same)]), max((k.found for k in same), default=0)
            new.append(RememberedWire(longest, t_ns, found + 1))
        later = new + [k.looked_for(grid, height) for k in kept]
        return WireMemory(tuple(k for k in later if k.lasts(t_ns)), frozenset(v.t_ns for v in views))

    def moved(self, shift: F64) -> WireMemory:
        """Return a copy for a map frame where positions are larger by `shift`, metres."""
        return replace(self, kept=tuple(replace(k, wire=k.wire.moved(shift)) for k in self.kept))


def _longest(wires: Sequence[Wire]) -> Wire:
    """Return the longest of the surest wires, at the best of their chances."""
    best = max(wires, key=lambda w: (w.is_found, w.length))
    return replace(best, chance=max(w.chance for w in wires))
