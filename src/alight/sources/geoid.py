"""Height of the geoid above the ellipsoid at one position, from a grid that the user names."""

from __future__ import annotations

import logging
import math
from pathlib import Path
from typing import Any

import numpy as np
from rasterio.windows import Window

from alight.records import InputError
from alight.records.telemetry import FARTHEST_FROM_SEA
from alight.sources.opened_raster import open_raster
from alight.sources.raster_band import band_in_metres

STEEPEST = 110.0  # metres per degree of latitude, twice the geoid's steepest slope on Earth (100 arc seconds)
NEAR = 32  # cells on each side of the position that are checked

log = logging.getLogger(__name__)


def separation_at(grid: Path, latitude: float, longitude: float) -> float:
    """Return the geoid's height above the ellipsoid in metres, interpolated; add it to heights above sea level.

    Args:
        grid: raster of geoid heights in metres on cells in degrees, such as EGM96 or EGM2008 as GeoTIFF or GTX.
        latitude, longitude: degrees; longitude may range from -180 to 180 or from 0 to 360.

    Raises:
        InputError: the file is not such a raster, is steeper than a geoid, or does not cover the position.
    """
    with open_raster(grid, "--geoid") as raster:
        geoid = raster.dataset
        if raster.reference.crs is not None and not raster.reference.in_degrees:
            raise InputError(f"--geoid {grid}: its cells are not degrees; give a grid of geoid heights such as EGM2008")
        if "VERTICAL_TO_VERTICAL" in geoid.tags().get("TYPE", ""):  # declared in PROJ's grids
            raise InputError(f"--geoid {grid}: is between two levels of the sea; give a grid of geoid heights")
        band = band_in_metres(raster, 1, assume_metres=True)
        log.info("%s: geoid's heights in %s", grid.name, band.settled)
        row, col = _cell(grid, geoid, latitude, longitude)
        top, left = (int(min(place, size - 2)) for place, size in ((row, geoid.height), (col, geoid.width)))
        first_row, first_col = max(top - NEAR, 0), max(left - NEAR, 0)
        around = Window(first_col, first_row, left + NEAR - first_col, top + NEAR - first_row)
        read = geoid.read(1, window=around.intersection(Window(0, 0, geoid.width, geoid.height)), masked=True)
        heights = band.lengths(read.astype(np.float64).filled(np.nan))
        step = math.hypot(geoid.transform.b, geoid.transform.e)  # degrees
    corners = heights[top - first_row :, left - first_col :][:2, :2]
    v, u = row - top, col - left
    weights = np.outer([1.0 - v, v], [1.0 - u, u])
    counts = weights > 0.0  # ignore unknown cells of weight 0
    height = float(np.sum(corners[counts] * weights[counts]))
    if not abs(height) <= FARTHEST_FROM_SEA:
        raise InputError(f"--geoid {grid}: holds no geoid's height at {latitude:g}, {longitude:g} ({height:g} m)")
    rise = np.abs(np.diff(np.where(np.abs(heights) <= FARTHEST_FROM_SEA, heights, np.nan), axis=0))
    if (most := float(np.nan_to_num(rise).max())) > STEEPEST * step:
        raise InputError(
            f"--geoid {grid}: is no geoid, which does not rise by {most:.3g} m from cell to cell; give a grid of geoid "
            "heights such as EGM2008"
        )
    return height


def _cell(grid: Path, geoid: Any, latitude: float, longitude: float) -> tuple[float, float]:
    """Return the fractional row and column of a position (degrees) in `geoid`, the open raster of the file `grid`.

    0 is the centre of the first cell; values are clipped to the centres of the outer cells.
    """
    if min(geoid.height, geoid.width) < 2:
        raise InputError(f"--geoid {grid}: has {geoid.height} x {geoid.width} cells; give a whole grid such as EGM2008")
    rows, cols, t = geoid.height - 1.0, geoid.width - 1.0, ~geoid.transform
    for turns in (0.0, 360.0, -360.0):
        east = longitude + turns
        x, y = t.a * east + t.b * latitude + t.c, t.d * east + t.e * latitude + t.f
        if -0.5 <= x - 0.5 <= cols + 0.5 and -0.5 <= y - 0.5 <= rows + 0.5:
            return float(np.clip(y - 0.5, 0.0, rows)), float(np.clip(x - 0.5, 0.0, cols))
    raise InputError(f"--geoid {grid}: does not reach {latitude:g}, {longitude:g}; is the order LAT,LON?")
