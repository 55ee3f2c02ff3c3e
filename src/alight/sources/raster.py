"""Read ground from another source: heights, their sigma, and an image."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from alight.arrays import F32, F64, U8
from alight.geometry import Grid
from alight.geometry.grid import Box
from alight.raster import rgb_levels
from alight.records import ElevationMap, Flag, InputError
from alight.sources.beside_heights import Beside, image_beside, own_sigma, sigma_beside
from alight.sources.heights import RasterHeights, checked_heights, heights_on, read_heights, words_of
from alight.sources.opened_raster import OpenedRaster, open_raster
from alight.sources.raster_band import Band, band_of_heights
from alight.sources.raster_plane import RasterPlane, metric_plane

LARGEST_SIGMA = 1000.0  # metres


@dataclass(frozen=True, eq=False)
class GroundRaster:
    """Heights, sigma and image of a raster."""

    elevation: ElevationMap
    plane: RasterPlane | None  # plane of the elevation's grid; None: metres without a position on Earth
    image: U8 | None  # (f R, f C) or (f R, f C, 3), f = 1, 2, 4, ... pixels per cell side; None: no image
    warnings: tuple[str, ...]
    files: tuple[Path, ...]  # files that were read
    settled: str = ""  # units, coordinate system and datum, in words


def read_ground(path: Path, sigma: str | None, image: Path | None, usual_sigma: float) -> GroundRaster:
    """Read a height raster as a map that can be judged.

    Args:
        path: raster of heights; its band named `sigma`, `std` or `uncertainty`, if any, holds their 1-sigma.
        sigma: raster of 1-sigma, or one number in metres; None: the band named so, else `usual_sigma`.
        image: image of the same ground, or None.
        usual_sigma: 1-sigma in metres if none is given.

    Raises:
        InputError: see `read_heights`, `sigma_beside`, `image_beside`; or no height has a sigma.
    """
    with open_raster(path) as raster:
        heights = read_heights(raster)
        beside = _sigma(sigma, raster, heights, usual_sigma)
    spread = _spread(beside, heights)
    known = np.isfinite(heights.metres) & np.isfinite(spread)
    if not known.any():
        raise InputError(f"{path}: no height has a sigma above 0; give --sigma in metres")
    doubts = [*_place_doubts(heights.plane, path), *beside.warnings, *([heights.doubt] if heights.doubt else [])]
    picture = None if image is None else image_beside(image, heights)
    doubts += picture.warnings if picture else []
    pixels = picture.values if picture else None
    files = _files(path, sigma, image)
    words = (heights.settled, beside.settled, picture.settled if picture else "")
    elevation = as_map(heights.plane.grid, heights.metres.astype(np.float32), spread, pixels)
    return GroundRaster(elevation, heights.plane, pixels, tuple(doubts), files, "; ".join(filter(None, words)))


def _files(path: Path, sigma: str | None, image: Path | None) -> tuple[Path, ...]:
    return (path, *(file for file in (sigma and Path(sigma), image) if file and file.is_file()))


def _place_doubts(plane: RasterPlane, path: Path) -> list[str]:
    """Return a warning if the raster has no coordinate system."""
    has_none = plane.reference.plane is None
    return [f"{path.name} has no coordinate system: metres east and north are assumed"] if has_none else []


def _spread(beside: Beside, heights: RasterHeights) -> F32:
    """Return the 1-sigma of heights with the error of their rounding, (R, C) metres; NaN = unknown."""
    spread = np.hypot(beside.values, heights.step / np.sqrt(12.0))
    return np.where((spread >= 0) & (spread < LARGEST_SIGMA), spread, np.nan).astype(np.float32)


def _sigma(
    given: str | None, raster: OpenedRaster, heights: RasterHeights, usual: float, is_part: bool = False
) -> Beside:
    """Return the 1-sigma that is given, else the raster's own, else the usual one with a warning."""
    if given is None:
        doubt = f"no sigma given: {usual:g} m is taken for every height; P(safe) is no better than that (--sigma)"
        own = own_sigma(raster, heights)
        return Beside(np.full(heights.metres.shape, usual), "", [doubt]) if own is None else own
    try:
        value = float(given)
    except ValueError:  # the name of a raster
        return sigma_beside(Path(given), heights, is_part)
    if not 0 <= value < LARGEST_SIGMA:
        raise InputError(f"--sigma {given}: needs a raster, or metres from 0 to {LARGEST_SIGMA:g}")
    return Beside(np.full(heights.metres.shape, value), "", [])


@dataclass(frozen=True, eq=False)
class GroundParts:
    """Heights and sigma of a raster that is read in parts, as it is too large to be held in memory."""

    path: Path
    plane: RasterPlane
    warnings: tuple[str, ...]
    files: tuple[Path, ...]  # files that are read
    settled: str  # units, coordinate system and datum, in words
    known: int  # number of heights
    _band: Band
    _sigma: str | None
    _usual_sigma: float

    @property
    def grid(self) -> Grid:
        """Grid of the whole raster, in metres."""
        return self.plane.grid

    def part(self, box: Box) -> ElevationMap:
        """Read a box of rows and columns."""
        with open_raster(self.path) as raster:
            heights, _ = heights_on(raster, replace(self.plane, grid=self.grid.part(box)), self._band)
            beside = _sigma(self._sigma, raster, heights, self._usual_sigma, is_part=True)
        return as_map(heights.plane.grid, heights.metres.astype(np.float32), _spread(beside, heights))


def ground_in_parts(path: Path, sigma: str | None, usual_sigma: float, strip: int, every: int) -> GroundParts:
    """Check a height raster that is to be read in parts.

    Args:
        path, sigma, usual_sigma: see `read_ground`.
        strip: rows that are read at once.
        every: whether the values are heights is checked on every so many-th row and column, and on the extremes.

    Raises:
        InputError: see `read_ground`.
    """
    with open_raster(path) as raster:
        plane, band = metric_plane(raster), band_of_heights(raster)
        sample, known = list[F64](), 0
        for top in range(0, plane.grid.rows, strip):
            rows = slice(top, min(top + strip, plane.grid.rows))
            part = replace(plane, grid=plane.grid.part((rows, slice(0, plane.grid.cols))))
            heights, stored = heights_on(raster, part, band)
            some, values = stored[::every, ::every].ravel(), stored[np.isfinite(stored)]
            extremes = [values.min(), values.max()] if values.size else []
            sample += [some, np.setdiff1d(extremes, some)]
            known += int(np.isfinite(heights.metres).sum())
        doubt = checked_heights(raster, band, np.concatenate(sample))
        beside = _sigma(sigma, raster, heights, usual_sigma, is_part=True)
    assumed = beside.warnings if sigma is None and not beside.settled else []
    words = f"{path.name}: heights in {words_of(raster, band)}, {plane.settled}", beside.settled
    return GroundParts(
        path, plane, (*_place_doubts(plane, path), *assumed, *([doubt] if doubt else [])), _files(path, sigma, None),
        "; ".join(filter(None, words)), known, band, sigma, usual_sigma,
    )  # fmt: skip


def count_cells(path: Path) -> int:
    """Return the number of cells of a height raster.

    Raises:
        InputError: see `metric_plane`.
    """
    with open_raster(path) as raster:
        grid = metric_plane(raster).grid
    return grid.rows * grid.cols


def as_map(grid: Grid, height: F32, sigma: F32, image: U8 | None = None) -> ElevationMap:
    """Return heights and their sigma, (R, C) metres and NaN where unknown, as a map; see `GroundRaster.image`."""
    known = np.isfinite(height) & np.isfinite(sigma)
    rgb, fine = np.full((*grid.shape, 3), 128, np.uint8), None
    if image is not None:
        fine, size = rgb_levels(image), grid.shape[::-1]
        same = image.shape[:2] == grid.shape
        rgb = fine if same else np.asarray(cv2.resize(fine, size, interpolation=cv2.INTER_AREA), np.uint8)
    return ElevationMap(
        grid=grid,
        height=np.where(known, height, np.float32(np.nan)),
        sigma=sigma,
        flags=np.where(known, np.uint16(0), np.uint16(Flag.UNSEEN)),
        views=np.where(known, np.uint8(9), np.uint8(0)),  # nominal
        rgb=rgb,
        residual=np.full(grid.shape, np.nan, np.float32),  # nothing was matched
        sampling=np.full(grid.shape, grid.cell, np.float32),
        fine=fine,
        fine_sampling=None if fine is None else np.full(grid.shape, grid.cell * len(rgb) / len(fine), np.float32),
    )
