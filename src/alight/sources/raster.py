"""Read ground from another source: heights, their sigma, and an image."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from alight.arrays import F32, U8, Mask
from alight.geometry import Grid
from alight.raster import rgb_levels
from alight.records import ElevationMap, Flag, InputError
from alight.sources.beside_heights import Beside, image_beside, own_sigma, sigma_beside
from alight.sources.heights import RasterHeights, read_heights
from alight.sources.opened_raster import open_raster
from alight.sources.raster_plane import RasterPlane

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
        beside = _sigma(sigma, heights) if sigma is not None else own_sigma(raster, heights)
    known = np.isfinite(heights.metres)
    doubts = []
    if heights.plane.reference.plane is None:
        doubts.append(f"{path.name} has no coordinate system: metres east and north are assumed")
    if beside is None:
        beside = Beside(np.full(heights.metres.shape, usual_sigma), "", [])
        doubts.append(
            f"no sigma given: {usual_sigma:g} m is taken for every height; P(safe) is no better than that (--sigma)"
        )
    doubts += [*beside.warnings, *([heights.doubt] if heights.doubt else [])]
    spread = np.hypot(beside.values, heights.step / np.sqrt(12.0))  # includes the error of rounding
    spread = np.where((spread >= 0) & (spread < LARGEST_SIGMA), spread, np.nan).astype(np.float32)
    known &= np.isfinite(spread)
    if not known.any():
        raise InputError(f"{path}: no height has a sigma above 0; give --sigma in metres")
    picture = None if image is None else image_beside(image, heights)
    doubts += picture.warnings if picture else []
    pixels = picture.values if picture else None
    files = (path, *(file for file in (sigma and Path(sigma), image) if file and file.is_file()))
    words = (heights.settled, beside.settled, picture.settled if picture else "")
    elevation = _as_map(heights.plane.grid, heights.metres.astype(np.float32), spread, known, pixels)
    return GroundRaster(elevation, heights.plane, pixels, tuple(doubts), files, "; ".join(filter(None, words)))


def _sigma(given: str, heights: RasterHeights) -> Beside:
    try:
        value = float(given)
    except ValueError:  # the name of a raster
        return sigma_beside(Path(given), heights)
    if not 0 <= value < LARGEST_SIGMA:
        raise InputError(f"--sigma {given}: needs a raster, or metres from 0 to {LARGEST_SIGMA:g}")
    return Beside(np.full(heights.metres.shape, value), "", [])


def _as_map(grid: Grid, height: F32, sigma: F32, known: Mask, image: U8 | None) -> ElevationMap:
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
