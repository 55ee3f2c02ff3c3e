"""Read a DEM from another source around the world's origin, resampled to the world's axes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rasterio.crs import CRS
from rasterio.enums import Resampling
from rasterio.warp import transform_bounds

from alight.geometry import Grid, LocalFrame, world_up
from alight.raster import unreadable
from alight.records import InputError, PriorHeights
from alight.sources.heights import doubt_of_heights, words_of
from alight.sources.opened_raster import open_raster, read_on
from alight.sources.raster_band import band_of_heights

REACH = 2000.0  # metres that are read on each side of the origin


def read_prior(path: Path, local: LocalFrame) -> PriorHeights:
    """Read the part of a DEM around the world's origin.

    Args:
        path: heights in any coordinate system on Earth, in degrees, metres or feet.
        local: local frame of the world.

    Raises:
        InputError: the file is not a raster, has no position on Earth, lies elsewhere, holds no heights, or its unit
            cannot be determined (see `band_of_heights`).
    """
    with open_raster(path, "--prior-dem") as dem:
        label, crs = dem.label, dem.reference.crs
        if crs is None or not dem.reference.on_earth:
            raise InputError(
                f"{label}: has no coordinate system on Earth; mend it with: gdal_edit.py -a_srs EPSG:... {dem.file}"
            )
        band = band_of_heights(dem)
        try:
            west, south, east, north = transform_bounds(crs, local.crs, *dem.bounds)
        except unreadable() as e:
            raise InputError(f"{label}: its coordinate system cannot be used ({e})") from e
        cell = max((east - west) / dem.dataset.width, (north - south) / dem.dataset.height)
        west, south, east, north = max(west, -REACH), max(south, -REACH), min(east, REACH), min(north, REACH)
        if not (np.isfinite([west, south, east, north]).all() and west < east and south < north):
            raise InputError(f"{label}: lies elsewhere than the photos; give a DEM of the same place")
        cell = max(cell, (east - west) / 2000, (north - south) / 2000)  # finer cells are averaged
        cols, rows = (max(int(np.ceil(length / cell)), 1) for length in (east - west, north - south))
        grid = Grid(west + 0.5 * cell, north - 0.5 * cell, cell, rows, cols)
        stored = read_on(dem, [band.number], CRS.from_string(local.crs), grid, Resampling.bilinear)[0]
        doubt_of_heights(dem, band, stored)
        name = f"{path.name} (heights in {words_of(dem, band)})"
    height = band.heights(stored).astype(np.float32)
    if not np.isfinite(height).any():
        raise InputError(f"{label}: holds no height within {REACH:g} m of the photos; give another DEM")
    return PriorHeights(name, grid, world_up(height, grid, local))
