"""The simulated world: a height layer, a class layer, a sun. What is drawn is exactly what the truth says."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from alight.geometry import Grid, LocalFrame
from alight.kernels.raycast import max_pyramid, shadow_margin
from alight.records import F32, F64, U8

SHADOW_LIMIT = 3.0  # metres: a ray that clears by more is simply lit


@dataclass(frozen=True)
class Sun:
    """Where the light comes from, radians, and its linear colours on a white flat surface."""

    azimuth: float = math.radians(140.0)  # clockwise from north
    elevation: float = math.radians(43.0)
    colour: tuple[float, float, float] = (1.05, 1.0, 0.9)
    sky: tuple[float, float, float] = (0.24, 0.28, 0.34)

    @property
    def direction(self) -> F64:
        """(3,) unit vector towards the sun, world."""
        c = math.cos(self.elevation)
        return np.array([math.sin(self.azimuth) * c, math.cos(self.azimuth) * c, math.sin(self.elevation)])

    @property
    def numbers(self) -> F64:
        """(9,) direction, colour, sky: what the kernels take."""
        return np.array([*self.direction, *self.colour, *self.sky])


@dataclass(frozen=True, eq=False)
class World:
    """Ground to fly over. Heights are bilinear between the cells' centres, and nothing else is drawn."""

    name: str
    description: str
    seed: int
    local: LocalFrame
    grid: Grid
    height: F32  # (R, C) metres above the origin, topmost surface
    label: U8  # (R, C) Terrain codes
    depth: F32  # (R, C) metres of water below the surface
    sun: Sun = Sun()

    @cached_property
    def pyramid(self) -> tuple[F32, NDArray[np.int64], NDArray[np.int64]]:
        """The pyramid of maxima that speeds up the rays."""
        return max_pyramid(self.height)

    @cached_property
    def place(self) -> F64:
        """(3,) east and north of cell (0, 0), and the cell: what the kernels take."""
        return np.array([self.grid.east, self.grid.north, self.grid.cell])

    @cached_property
    def light(self) -> F32:
        """(R, C, 5) layers of light: slope east, slope north, shadow margin, share of open sky, water depth."""
        slope_south, slope_east = np.gradient(self.height, self.grid.cell)
        layers = [slope_east, -slope_south, self._shadow(), self._open_sky(), self.depth]
        return np.ascontiguousarray(np.stack(layers, axis=-1), dtype=np.float32)

    @property
    def level(self) -> float:
        """Height of the plane that goes on outside the world, metres."""
        h = self.height
        return float(np.mean([h[0].mean(), h[-1].mean(), h[:, 0].mean(), h[:, -1].mean()]))

    def height_at(self, east: float, north: float) -> float:
        """Height of the surface, metres above the origin; NaN outside the world."""
        r, c = (float(v) for v in self.grid.index(np.array(east), np.array(north)))
        rows, cols = self.grid.shape
        if not (0 <= r <= rows - 1 and 0 <= c <= cols - 1):
            return math.nan
        i, j = min(int(r), rows - 2), min(int(c), cols - 2)
        v, u = r - i, c - j
        p = self.height[i : i + 2, j : j + 2].astype(np.float64)
        return float(np.array([1 - v, v]) @ p @ np.array([1 - u, u]))

    def _shadow(self) -> F32:
        e, n, _ = self.sun.direction / np.hypot(*self.sun.direction[:2])
        step = np.array([e, -n, self.grid.cell * math.tan(self.sun.elevation)])
        out = np.empty_like(self.height)
        shadow_margin(self.height, float(self.height.max()), step, SHADOW_LIMIT, out)
        return out

    def _open_sky(self) -> F32:
        open_sky = np.ones_like(self.height)
        for width, gain in ((0.5, 2.0), (3.0, 0.5)):  # hollows of two sizes are darker
            n = 2 * round(0.5 * width / self.grid.cell) + 1
            hollow = cv2.blur(self.height, (n, n)) - self.height
            open_sky /= 1.0 + gain * np.maximum(hollow, 0.0)
        return open_sky
