"""Small maps of ground for the tests of terrain, hazards, sites and route."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from alight.geometry import Grid
from alight.records import ElevationMap, Flag, Terrain, TerrainMap

GREY, GREEN, BROWN, POND = (128, 128, 128), (90, 130, 60), (150, 120, 90), (70, 85, 90)


def ground(
    height: ArrayLike, cell: float = 0.1, sigma: float = 0.0, rgb: tuple[int, int, int] | NDArray[np.uint8] = GREY
) -> ElevationMap:
    """Make a map of heights (NaN = unseen); its south-western cell is at (0, 0)."""
    h = np.asarray(height, dtype=np.float32)
    colour = np.broadcast_to(np.asarray(rgb, dtype=np.uint8), (*h.shape, 3)).copy()
    unseen = np.isnan(h)
    flags = np.where(unseen, np.uint16(Flag.UNSEEN), np.uint16(0))
    views = np.where(unseen, 0, 9).astype(np.uint8)
    grid = Grid(0.0, (h.shape[0] - 1) * cell, cell, *h.shape)
    sigmas, samplings = (np.full(h.shape, v, np.float32) for v in (sigma, cell))
    return ElevationMap(grid, h, sigmas, flags, views, colour, np.zeros_like(h), samplings)


def plane(rows: int, cols: int, east_slope: float, north_slope: float, cell: float = 0.1) -> NDArray[np.float64]:
    """Heights of a plane, slopes as tangents."""
    r, c = np.mgrid[:rows, :cols]
    return cell * (east_slope * c - north_slope * r)


def covered(elevation: ElevationMap, landable: ArrayLike, label: Terrain = Terrain.SHORT_GRASS) -> TerrainMap:
    """Land cover of one class, with P(landable) of each cell."""
    p = np.broadcast_to(np.asarray(landable, dtype=np.float32), elevation.grid.shape).copy()
    return land_cover(elevation.grid, np.full(elevation.grid.shape, label, np.uint8), p)


def land_cover(grid: Grid, label: NDArray[np.uint8], landable: NDArray[np.float32], **others: Any) -> TerrainMap:
    """Land cover of dry, open ground like all known ground, which bears where it is landable; `others` win."""
    nothing = np.zeros(grid.shape, np.float32)
    water = (label == Terrain.WATER).astype(np.float32)
    plain = {"water": water, "enclosed": nothing, "raised": nothing, "novelty": nothing, "bears": landable}
    return TerrainMap(grid, label, landable, **{**plain, **others})


def textured(colour: tuple[int, int, int], shape: tuple[int, int], contrast: float, seed: int) -> NDArray[np.uint8]:
    """A colour with a relative brightness noise of `contrast` from cell to cell."""
    noise = np.random.default_rng(seed).normal(1.0, contrast, shape)
    return np.clip(np.asarray(colour) * noise[..., None], 1, 255).astype(np.uint8)
