"""A DEM from another source, read about the world's origin and resampled to the world's grid."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rasterio.enums import Resampling
from rasterio.errors import RasterioError
from rasterio.transform import Affine
from rasterio.vrt import WarpedVRT
from rasterio.warp import transform_bounds

from alight.geometry import Grid, LocalFrame, world_up
from alight.records import InputError, PriorHeights
from alight.sources.raster import doubt_of_heights, open_raster, to_its_end

REACH = 2000.0  # metres about the origin that are read


def read_prior(path: Path, local: LocalFrame) -> PriorHeights:
    """Read the part of a DEM about the world's origin.

    Args:
        path: heights in metres, band 1, in any coordinate system.
        local: the world.

    Raises:
        InputError: it is no raster, has no coordinate system, lies elsewhere, or holds no heights.
    """
    with open_raster(path) as dem:
        if dem.crs is None:
            raise InputError(
                f"--prior-dem {path}: has no coordinate system; mend it with: gdal_edit.py -a_srs EPSG:..."
            )
        try:
            west, south, east, north = transform_bounds(dem.crs, local.crs, *dem.bounds)
        except RasterioError as e:
            raise InputError(f"--prior-dem {path}: its coordinate system cannot be used ({e})") from e
        cell = max((east - west) / dem.width, (north - south) / dem.height)
        west, south, east, north = max(west, -REACH), max(south, -REACH), min(east, REACH), min(north, REACH)
        if not (np.isfinite([west, south, east, north]).all() and west < east and south < north):
            raise InputError(f"--prior-dem {path}: lies elsewhere than the photos; give a DEM of the same place")
        cell = max(cell, (east - west) / 2000, (north - south) / 2000)  # finer ones are averaged
        cols, rows = (max(int(np.ceil(length / cell)), 1) for length in (east - west, north - south))
        with (
            to_its_end(f"--prior-dem {path}"),
            WarpedVRT(
                dem, crs=local.crs, transform=Affine(cell, 0, west, 0, -cell, north), width=cols, height=rows,
                resampling=Resampling.bilinear, nodata=dem.nodata if dem.nodata is not None else np.nan,
            ) as warped,
        ):  # fmt: skip
            height = warped.read(1, masked=True).astype(np.float32).filled(np.nan)
        doubt_of_heights(path, height, dem)
    grid = Grid(west + 0.5 * cell, north - 0.5 * cell, cell, rows, cols)
    if not np.isfinite(height).any():
        raise InputError(f"--prior-dem {path}: holds no height within {REACH:g} m of the photos; give another DEM")
    return PriorHeights(path.name, grid, world_up(height, grid, local))
