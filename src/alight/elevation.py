"""The elevation map: heights of many grids fused into one, in tiles that roll with the vehicle.

Only the tiles near the vehicle are held as arrays; those left behind are packed, and `snapshot` unpacks them.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from alight.geometry import Grid, box_of
from alight.records import REFUSED, ElevationMap, Flag, Heights

Key = tuple[int, int]  # (row, column) of a tile; rows count north

FIELDS = {
    "height": (np.float32, np.nan),
    "sigma": (np.float32, np.nan),
    "flags": (np.uint16, int(Flag.UNSEEN)),
    "views": (np.uint8, 0),
    "rgb": (np.uint8, 0),
    "residual": (np.float32, np.nan),
}


@dataclass(eq=False)
class _Tile:
    height: NDArray[np.float32]
    sigma: NDArray[np.float32]
    flags: NDArray[np.uint16]
    views: NDArray[np.uint8]
    rgb: NDArray[np.uint8]
    residual: NDArray[np.float32]

    @classmethod
    def empty(cls, side: int) -> _Tile:
        return cls(
            **{k: np.full((side, side, 3) if k == "rgb" else (side, side), v, t) for k, (t, v) in FIELDS.items()}
        )

    def pack(self) -> bytes:
        return zlib.compress(b"".join(getattr(self, k).tobytes() for k in FIELDS), 1)

    @classmethod
    def unpack(cls, packed: bytes, side: int) -> _Tile:
        raw, at, out = zlib.decompress(packed), 0, {}
        for k, (t, _) in FIELDS.items():
            shape = (side, side, 3) if k == "rgb" else (side, side)
            size = int(np.prod(shape)) * np.dtype(t).itemsize
            out[k] = np.frombuffer(raw[at : at + size], t).reshape(shape).copy()
            at += size
        return cls(**out)


def better(
    sigma_new: NDArray[np.float32], flags_new: NDArray[np.uint16], old: _Tile, at: tuple[slice, slice]
) -> NDArray[np.bool_]:
    """Where a new height replaces an old one: trusted before refused, then the smaller sigma; unseen never."""
    refused = np.uint16(REFUSED)
    new_ok, old_ok = (flags_new & refused) == 0, (old.flags[at] & refused) == 0
    seen = (flags_new & np.uint16(Flag.UNSEEN)) == 0
    smaller = ~(np.nan_to_num(sigma_new, nan=np.inf) >= np.nan_to_num(old.sigma[at], nan=np.inf))
    fresh = (old.flags[at] & np.uint16(Flag.UNSEEN)) != 0
    return np.asarray(seen & (fresh | (new_ok & ~old_ok) | ((new_ok == old_ok) & smaller)))


class Elevation:
    """One map of the ground in square tiles on the world's own raster.

    Cell centres lie at (k + 1/2) cells east and north of the origin.
    """

    def __init__(self, cell: float, side: int) -> None:
        self.cell = cell
        self.side = side
        self._near: dict[Key, _Tile] = {}
        self._far: dict[Key, bytes] = {}

    def tile_grid(self, key: Key, margin: int = 0) -> Grid:
        """The grid of one tile, `margin` cells wider on every side."""
        south, west = key[0] * self.side, key[1] * self.side
        n = self.side + 2 * margin
        return Grid((west - margin + 0.5) * self.cell, (south + self.side + margin - 0.5) * self.cell, self.cell, n, n)

    def cover(self, east: tuple[float, float], north: tuple[float, float]) -> Iterator[Key]:
        """The tiles that a rectangle (metres) touches, southern rows first."""
        span = self.side * self.cell
        rows, cols = np.floor(np.array(north) / span).astype(int), np.floor(np.array(east) / span).astype(int)
        for r in range(rows[0], rows[1] + 1):
            for c in range(cols[0], cols[1] + 1):
                yield r, c

    def window(self, east: tuple[float, float], north: tuple[float, float]) -> Grid:
        """The smallest grid of whole cells over a rectangle (metres)."""
        c0, c1 = (int(np.floor(e / self.cell)) for e in east)
        r0, r1 = (int(np.floor(n / self.cell)) for n in north)
        return Grid((c0 + 0.5) * self.cell, (r1 + 0.5) * self.cell, self.cell, r1 - r0 + 1, c1 - c0 + 1)

    def _tile(self, key: Key) -> _Tile:
        if key not in self._near:
            packed = self._far.pop(key, None)
            self._near[key] = _Tile.empty(self.side) if packed is None else _Tile.unpack(packed, self.side)
        return self._near[key]

    def _overlaps(self, grid: Grid) -> Iterator[tuple[Key, tuple[slice, slice], tuple[slice, slice]]]:
        """Tiles under a grid: (key, slices in the tile, slices in the grid)."""
        top, left = round(grid.north / self.cell - 0.5), round(grid.east / self.cell - 0.5)  # cell indices of (0, 0)
        for r in range((top - grid.rows + 1) // self.side, top // self.side + 1):
            for c in range(left // self.side, (left + grid.cols - 1) // self.side + 1):
                first = (r + 1) * self.side - 1  # northernmost cell index of the tile
                a, b = max(top - first, 0), min(top - first + self.side, grid.rows)
                x, y = max(c * self.side - left, 0), min((c + 1) * self.side - left, grid.cols)
                dr, dc = first - top, left - c * self.side
                yield (r, c), (slice(a + dr, b + dr), slice(x + dc, y + dc)), (slice(a, b), slice(x, y))

    def add(self, heights: Heights, replace_all: bool = False) -> None:
        """Fuse one step; each cell keeps the more trusted height (`replace_all`: the new one wherever it was seen)."""
        for key, at, here in self._overlaps(heights.grid):
            tile = self._tile(key)
            flags = heights.flags[here]
            take = better(heights.sigma[here], flags, tile, at)
            if replace_all:
                take = (flags & np.uint16(Flag.UNSEEN)) == 0
            for k in FIELDS:
                getattr(tile, k)[at][take] = getattr(heights, k)[here][take]

    def roll(self, centre: tuple[float, float], radius: float) -> None:
        """Pack the tiles farther than `radius` metres from the vehicle: memory follows the flight, not its length."""
        for key in list(self._near):
            middle = (np.array(key)[::-1] + 0.5) * self.side * self.cell
            if np.hypot(*(middle - centre)) > radius + self.side * self.cell:
                self._far[key] = self._near.pop(key).pack()

    def read(self, grid: Grid) -> ElevationMap:
        """The map on a grid of whole cells, copied."""
        fields = {k: np.full((*grid.shape, 3) if k == "rgb" else grid.shape, v, t) for k, (t, v) in FIELDS.items()}
        for key, at, here in self._overlaps(grid):
            tile = self._near.get(key)
            if tile is None and key in self._far:
                tile = _Tile.unpack(self._far[key], self.side)
            if tile is not None:
                for k in FIELDS:
                    fields[k][here] = getattr(tile, k)[at]
        return ElevationMap(grid, **fields)

    def snapshot(self) -> ElevationMap | None:
        """Everything that was ever seen, cropped to it; None when nothing was."""
        keys = [*self._near, *self._far]
        if not keys:
            return None
        rows, cols = [k[0] for k in keys], [k[1] for k in keys]
        span = self.side * self.cell
        inset = 0.5 * self.cell
        whole = self.window(
            (min(cols) * span + inset, (max(cols) + 1) * span - inset),
            (min(rows) * span + inset, (max(rows) + 1) * span - inset),
        )
        return cropped(self.read(whole))


def cropped(full: ElevationMap) -> ElevationMap | None:
    """The part of a map that was seen; None when nothing was."""
    seen = (full.flags & np.uint16(Flag.UNSEEN)) == 0
    if not seen.any():
        return None
    r, c = box_of(seen)
    grid = full.grid.window(r.start, c.start, r.stop - r.start, c.stop - c.start)
    return replace(full, grid=grid, **{k: np.ascontiguousarray(getattr(full, k)[r, c]) for k in FIELDS})
