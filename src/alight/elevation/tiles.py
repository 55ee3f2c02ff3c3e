"""Square tiles of one cell size. Tiles near the vehicle are held as arrays, all other tiles are packed."""

from __future__ import annotations

from collections.abc import Iterator, MutableMapping
from typing import Any

import cv2
import lz4.frame
import numpy as np
from numpy.typing import NDArray

from alight.geometry import Box, Grid, box_of, plane_on
from alight.records import Flag, is_flagged

Key = tuple[int, int]  # (row, column) of a tile; rows count north
Name = tuple[int, int, int]  # level, row, column
TileStore = MutableMapping[Name, bytes]  # packed tiles: a dict, a file, or nothing at all
Fields = dict[str, NDArray[Any]]  # (R, C) arrays, rgb (R, C, 3), by the names of FIELDS

FIELDS = {
    "height": (np.float32, np.nan),
    "sigma": (np.float32, np.nan),
    "flags": (np.uint16, int(Flag.UNSEEN)),
    "views": (np.uint8, 0),
    "rgb": (np.uint8, 0),
    "residual": (np.float32, np.nan),
    "sampling": (np.float32, np.nan),
}


def _shape(name: str, shape: tuple[int, int]) -> tuple[int, ...]:
    return (*shape, 3) if name == "rgb" else shape


def nothing(shape: tuple[int, int]) -> Fields:
    """Return fields of unseen cells."""
    return {k: np.full(_shape(k, shape), v, t) for k, (t, v) in FIELDS.items()}


def bytes_a_cell() -> int:
    """Return the size of a cell in memory."""
    return sum(v.nbytes for v in nothing((1, 1)).values())


def pack_tile(tile: Fields) -> bytes:
    """Compress a tile to bytes."""
    return bytes(lz4.frame.compress(b"".join(tile[k].tobytes() for k in FIELDS)))


def unpack_tile(packed: bytes, side: int) -> Fields:
    """Decompress a tile of `side` x `side` cells: the inverse of `pack_tile`."""
    raw, at, out = lz4.frame.decompress(packed), 0, {}
    for k, (t, _) in FIELDS.items():
        shape = _shape(k, (side, side))
        size = int(np.prod(shape)) * np.dtype(t).itemsize
        out[k] = np.frombuffer(raw[at : at + size], t).reshape(shape).copy()
        at += size
    return out


def is_seen(flags: NDArray[np.uint16]) -> NDArray[np.bool_]:
    """Return the mask of seen cells, from flags of any shape."""
    return ~is_flagged(flags, Flag.UNSEEN)


def _extent(tile: Fields) -> tuple[Box, int]:
    seen = is_seen(tile["flags"])
    return box_of(seen), int(seen.sum())


class NullStore(dict[Name, bytes]):
    """Tile store that discards all tiles: the map forgets ground that the vehicle has left."""

    def __setitem__(self, name: Name, packed: bytes) -> None:
        """Discard the tile."""


class TileLayer:
    """The map at one cell size; cell centres lie at (k + 1/2) cells east and north of the origin."""

    def __init__(self, level: int, cell: float, side: int, far: TileStore) -> None:
        self.level, self.cell, self.side = level, cell, side
        self.near: dict[Key, Fields] = {}  # tiles in memory
        self._far = far
        self.packed: dict[Key, tuple[Box, int]] = {}  # bounding box and number of seen cells

    # -- the raster

    def tile_grid(self, key: Key, margin: int = 0) -> Grid:
        """Return the grid of one tile, extended by `margin` cells on every side."""
        south, west = key[0] * self.side, key[1] * self.side
        n = self.side + 2 * margin
        return Grid((west - margin + 0.5) * self.cell, (south + self.side + margin - 0.5) * self.cell, self.cell, n, n)

    def cover(self, east: tuple[float, float], north: tuple[float, float]) -> Iterator[Key]:
        """Yield the tiles that touch a rectangle, southern rows first; `east` and `north`: its limits, metres."""
        span = self.side * self.cell
        rows, cols = np.floor(np.array(north) / span).astype(int), np.floor(np.array(east) / span).astype(int)
        for r in range(rows[0], rows[1] + 1):
            for c in range(cols[0], cols[1] + 1):
                yield r, c

    def window(self, east: tuple[float, float], north: tuple[float, float]) -> Grid:
        """Return the smallest grid of whole cells over a rectangle; `east` and `north`: its limits, metres."""
        c0, c1 = (int(np.floor(e / self.cell)) for e in east)
        r0, r1 = (int(np.floor(n / self.cell)) for n in north)
        return self.cells(r0, r1, c0, c1)

    def cells(self, south: int, north: int, west: int, east: int) -> Grid:
        """Return the grid of the cells between these cell numbers, both ends included; numbers grow north and east."""
        return Grid((west + 0.5) * self.cell, (north + 0.5) * self.cell, self.cell, north - south + 1, east - west + 1)

    def numbers(self, grid: Grid) -> tuple[int, int, int, int]:
        """Return the first and last cell numbers (south, north, west, east) of a grid: the inverse of `cells`."""
        north, west = round(grid.north / self.cell - 0.5), round(grid.east / self.cell - 0.5)
        return north - grid.rows + 1, north, west, west + grid.cols - 1

    def _overlaps(self, grid: Grid) -> Iterator[tuple[Key, Box, Box]]:
        """Yield each tile under a grid: the tile's key, and the box of the overlap in the tile and in the grid."""
        south, north, west, east = self.numbers(grid)
        for r in range(south // self.side, north // self.side + 1):
            for c in range(west // self.side, east // self.side + 1):
                first = (r + 1) * self.side - 1  # northernmost cell of the tile
                a, b = max(north - first, 0), min(north - first + self.side, grid.rows)
                x, y = max(c * self.side - west, 0), min((c + 1) * self.side - west, grid.cols)
                dr, dc = first - north, west - c * self.side
                yield (r, c), (slice(a + dr, b + dr), slice(x + dc, y + dc)), (slice(a, b), slice(x, y))

    # -- content

    def write(self, grid: Grid, fields: Fields, take: NDArray[np.bool_]) -> None:
        """Replace the cells of a grid where `take` (R, C) is True by `fields`."""
        for key, at, here in self._overlaps(grid):
            if (some := take[here]).any():
                tile = self._tile(key)
                mask = np.ascontiguousarray(some).view(np.uint8)
                for k in FIELDS:
                    cv2.copyTo(fields[k][here], mask, tile[k][at])  # 20 times as fast as NumPy for the colours

    def _tile(self, key: Key) -> Fields:
        if key not in self.near:
            packed = self._far.pop((self.level, *key)) if self.packed.pop(key, None) else None
            self.near[key] = nothing((self.side, self.side)) if packed is None else unpack_tile(packed, self.side)
        return self.near[key]

    def read(self, grid: Grid) -> Fields:
        """Return a copy of the fields on a grid; unseen where the layer has no tile."""
        out = {k: np.empty(_shape(k, grid.shape), t) for k, (t, _) in FIELDS.items()}
        for key, at, here in self._overlaps(grid):  # covers every cell once
            tile = self.near.get(key)
            if tile is None and key in self.packed:
                tile = unpack_tile(self._far[self.level, *key], self.side)
            for k, (_, none) in FIELDS.items():
                out[k][here] = none if tile is None else tile[k][at]
        return out

    def add_plane(self, plane: NDArray[np.float64], about: NDArray[np.float64]) -> None:
        """Add a plane to the heights of the tiles in memory; see `plane_on` for `plane` (3,) and `about` (2,)."""
        for key, tile in self.near.items():
            tile["height"] += plane_on(*self.tile_grid(key).xy(), plane, about)

    def roll(self, centre: tuple[float, float], radius: float) -> None:
        """Pack the tiles farther than `radius` metres from `centre` (east, north)."""
        for key in list(self.near):
            middle = (np.array(key)[::-1] + 0.5) * self.side * self.cell
            if np.hypot(*(middle - centre)) > radius + self.side * self.cell:
                tile, name = self.near.pop(key), (self.level, *key)
                self._far[name] = pack_tile(tile)
                if name in self._far:
                    self.packed[key] = _extent(tile)

    def _extents(self) -> dict[Key, tuple[Box, int]]:
        return self.packed | {k: _extent(t) for k, t in self.near.items()}

    def count(self) -> int:
        """Return the number of seen cells."""
        return sum(n for _, n in self._extents().values())

    def box(self) -> tuple[int, int, int, int] | None:
        """Return the bounding rectangle of all seen cells, in the order of `numbers`; None if no cell was seen."""
        found = [
            ((k[0] + 1) * self.side - r.stop, (k[0] + 1) * self.side - 1 - r.start,
             k[1] * self.side + c.start, k[1] * self.side + c.stop - 1)
            for k, ((r, c), n) in self._extents().items() if n
        ]  # fmt: skip
        if not found:
            return None
        south, north, west, east = zip(*found, strict=True)
        return min(south), max(north), min(west), max(east)
