"""The part of the map that a picture shows: its crop, size and coordinates on the page, and its encoding."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from alight.arrays import U8
from alight.geometry import Grid
from alight.records import ElevationMap

WIDTH = 1000.0  # width of every picture, page units; the height follows from the crop
SHORTEST, TALLEST = 0.35, 1.6  # height over width of a picture; the crop grows to fit


@dataclass(frozen=True)
class Canvas:
    """A window of the map's cells, shown `WIDTH` page units wide. Cells outside the map are transparent."""

    grid: Grid  # grid of the window
    row: int  # of the window's first cell in the map, may be negative
    col: int

    @property
    def height(self) -> float:
        """Height of the picture, page units."""
        return WIDTH * self.grid.rows / self.grid.cols

    @property
    def per_metre(self) -> float:
        """Page units per metre."""
        return WIDTH / (self.grid.cols * self.grid.cell)

    def xy(self, east: float, north: float) -> tuple[float, float]:
        """Convert a position in the world, metres, to a position in the picture, page units."""
        row, col = self.grid.index(np.asarray(east), np.asarray(north))
        unit = WIDTH / self.grid.cols
        return round(float(col + 0.5) * unit, 2), round(float(row + 0.5) * unit, 2)

    def cut(self, array: NDArray[Any]) -> NDArray[Any]:
        """Return the part of a map array (R, C, ...) in this window, zero outside the map."""
        out = np.zeros((*self.grid.shape, *array.shape[2:]), array.dtype)
        r0, c0 = max(self.row, 0), max(self.col, 0)
        r1, c1 = min(self.row + self.grid.rows, array.shape[0]), min(self.col + self.grid.cols, array.shape[1])
        if r1 > r0 and c1 > c0:
            out[r0 - self.row : r1 - self.row, c0 - self.col : c1 - self.col] = array[r0:r1, c0:c1]
        return out

    def uri(self, rgba: U8) -> str:
        """Return the part of a full-map RGBA picture in this window as a data URI, shrunk to page size."""
        return embedded(webp(shrink(self.cut(rgba))))


def whole(elevation: ElevationMap, places: Sequence[tuple[float, float]] = ()) -> Canvas | None:
    """Return the canvas that shows all seen cells, without thin fringes, and `places` (m); None: no cell was seen."""
    seen = elevation.views > 0
    if not seen.any():
        return None
    rows, cols = _thick(seen.sum(1)), _thick(seen.sum(0))
    at = [elevation.grid.index(np.asarray(e), np.asarray(n)) for e, n in places]
    rows = np.unique([*rows, *(np.clip(round(float(r)), 0, seen.shape[0] - 1) for r, _ in at)])
    cols = np.unique([*cols, *(np.clip(round(float(c)), 0, seen.shape[1] - 1) for _, c in at)])
    return _canvas(elevation.grid, int(rows[0]), int(cols[0]), int(np.ptp(rows)) + 1, int(np.ptp(cols)) + 1)


def _thick(count: NDArray[Any]) -> NDArray[np.int64]:
    """Return the indices of rows (or columns) with more than a few seen cells, from the number `count` in each."""
    return np.flatnonzero(count > 0.03 * count.max())


def about(grid: Grid, east: float, north: float, radius: float) -> Canvas:
    """Return the square canvas that shows `radius` metres around a world position (metres)."""
    row, col = (round(float(v)) for v in grid.index(np.asarray(east), np.asarray(north)))
    n = max(4, round(radius / grid.cell))
    return _canvas(grid, row - n, col - n, 2 * n + 1, 2 * n + 1)


def _canvas(grid: Grid, row: int, col: int, rows: int, cols: int) -> Canvas:
    tall, wide = max(rows, round(cols * SHORTEST)), max(cols, round(rows / TALLEST))
    row, col = row - (tall - rows) // 2, col - (wide - cols) // 2
    return Canvas(grid.window(row, col, tall, wide), row, col)


def shrink(rgba: U8, longest: int = 1400) -> U8:
    """Return an RGBA picture reduced to at most `longest` pixels per side, as an area mean weighted by opacity."""
    scale = longest / max(rgba.shape[:2])
    if scale >= 1:
        return rgba
    size = (max(1, round(rgba.shape[1] * scale)), max(1, round(rgba.shape[0] * scale)))
    weighted = rgba.astype(np.float32)
    weighted[..., :3] *= weighted[..., 3:] / 255
    small = cv2.resize(weighted, size, interpolation=cv2.INTER_AREA)
    small[..., :3] *= 255 / np.maximum(small[..., 3:], 1)
    return np.asarray(np.clip(np.rint(small), 0, 255), dtype=np.uint8)


def webp(picture: U8) -> bytes:
    """Return a picture (R, C, 3) RGB or (R, C, 4) RGBA encoded as WebP."""
    swapped = cv2.COLOR_RGBA2BGRA if picture.shape[2] == 4 else cv2.COLOR_RGB2BGR
    _, data = cv2.imencode(".webp", cv2.cvtColor(picture, swapped), [cv2.IMWRITE_WEBP_QUALITY, 84])
    return data.tobytes()


def embedded(file: bytes) -> str:
    """Return a WebP file as a data URI."""
    return "data:image/webp;base64," + base64.b64encode(file).decode()
