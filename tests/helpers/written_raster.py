"""GeoTIFFs for the tests of rasters from elsewhere."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rasterio

UTM = "EPSG:32610"


def write(path: Path, bands: np.ndarray, cell: float = 0.1, crs: str | None = UTM, **more: object) -> Path:
    """Write a GeoTIFF with its north-western corner at (550000, 4180000)."""
    bands = np.atleast_3d(bands.T).T
    profile = {"driver": "GTiff", "width": bands.shape[2], "height": bands.shape[1], "count": bands.shape[0]}
    place = rasterio.Affine(cell, 0, 550000, 0, -cell, 4180000)
    with rasterio.open(path, "w", dtype=bands.dtype.name, crs=crs, **{"transform": place, **profile, **more}) as d:
        d.write(bands)
    return path
