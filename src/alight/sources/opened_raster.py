"""Open rasters, split their coordinate systems into plane and height, and read their bands on any grid."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyproj
import rasterio
from pyproj.exceptions import CRSError
from rasterio.crs import CRS
from rasterio.enums import MaskFlags, Resampling
from rasterio.transform import Affine
from rasterio.vrt import WarpedVRT

from alight.arrays import F64
from alight.geometry import Grid
from alight.raster import placeless_rasters, unreadable
from alight.records import InputError


class Reference(NamedTuple):
    """Coordinate system of a raster, split into its plane and its vertical axis."""

    crs: CRS | None  # plane only; None: the raster has no coordinate system
    plane: pyproj.CRS | None  # `crs` as a pyproj object
    up: float | None  # metres per unit of the vertical axis, negative if it points down; None: undeclared
    datum: str  # vertical datum; empty: undeclared

    @property
    def is_geographic(self) -> bool:
        """Whether the coordinates of the plane are angles."""
        return self.plane is not None and bool(self.plane.is_geographic)

    @property
    def in_degrees(self) -> bool:
        """Whether the unit of the plane is the degree, and not the grad."""
        return self.is_geographic and math.isclose(self.unit, math.radians(1.0), rel_tol=1e-9)

    @property
    def is_metric(self) -> bool:
        """Whether the plane is in metres or angles, so that undeclared heights may be assumed to be in metres."""
        return self.is_geographic or self.unit == 1.0

    @property
    def on_earth(self) -> bool:
        """Whether positions have a latitude and longitude; in site grids (engineering systems) they have none."""
        return self.plane is not None and (self.is_geographic or bool(self.plane.is_projected))

    @property
    def unit(self) -> float:
        """Metres per unit of the plane, or radians if it is geographic; 1 without a plane."""
        return 1.0 if self.plane is None else float(self.plane.axis_info[0].unit_conversion_factor or 1.0)


@dataclass(frozen=True, eq=False)
class OpenedRaster:
    """An open raster with its coordinate system."""

    label: str  # start of messages
    path: Path
    dataset: Any
    reference: Reference

    @property
    def file(self) -> str:
        """The file's path, quoted for a command line."""
        return shlex.quote(str(self.path))

    @property
    def has_place(self) -> bool:
        """Whether the raster is georeferenced: its cells have a size and a position."""
        return not self.dataset.transform.is_identity

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """West, south, east and north limits of the raster, in units of its coordinate system."""
        t, (rows, cols) = self.dataset.transform, self.dataset.shape
        x = [t.c + t.a * u * cols + t.b * v * rows for u in (0, 1) for v in (0, 1)]
        y = [t.f + t.d * u * cols + t.e * v * rows for u in (0, 1) for v in (0, 1)]
        return min(x), min(y), max(x), max(y)


@contextmanager
def open_raster(path: Path, option: str = "") -> Iterator[OpenedRaster]:
    """Open a raster with rasterio, as a context manager.

    Args:
        path: the raster.
        option: command line option that names the raster, for messages.

    Raises:
        InputError: the file is not a raster, holds several rasters (netCDF, HDF), has control points only, or its
            coordinate system or cells cannot be used.
    """
    label = f"{option} {path}".strip()
    if not path.exists():
        raise InputError(f"{label}: there is no such file; name a raster such as a GeoTIFF")
    if not path.is_file():
        raise InputError(f"{label}: not a plain file; name a raster such as a GeoTIFF")
    try:
        with placeless_rasters():  # missing coordinates are reported elsewhere, once and in words
            dataset = rasterio.open(path)
    except UnicodeEncodeError as e:
        raise InputError(f"{label}: its name is not UTF-8; rename it") from e
    except unreadable() as e:
        raise InputError(f"{label}: not a raster that can be read ({' '.join(str(e).split())}); give a GeoTIFF") from e
    with dataset:
        if not dataset.count:
            within = shlex.quote(next(iter(dataset.subdatasets), "<one of them>"))
            raise InputError(f"{label}: holds several rasters; take one out with: gdal_translate {within} OUT.tif")
        if dataset.transform.is_identity and (dataset.gcps[0] or dataset.rpcs):
            raise InputError(
                f"{label}: is placed by control points only; mend it with: gdalwarp {shlex.quote(str(path))} OUT.tif"
            )
        try:
            yield OpenedRaster(label, path, dataset, _reference(label, dataset.crs))
        except unreadable() as e:
            raise InputError(f"{label}: cannot be read to its end ({' '.join(str(e).split())}); copy it again") from e


def _reference(label: str, crs: CRS | None) -> Reference:
    if crs is None:
        return Reference(None, None, None, "")
    try:
        whole = _unbound(pyproj.CRS.from_wkt(crs.to_wkt(version="WKT2_2019")))
    except CRSError as e:
        raise InputError(
            f"{label}: its coordinate system cannot be read ({e}); mend it with: gdal_edit.py -a_srs"
        ) from e
    axes, parts = whole.axis_info, whole.sub_crs_list
    plane = _unbound(parts[0]) if parts else whole.to_2d()
    is_plane = len(axes) > 1 and (plane.is_geographic or plane.is_projected or plane.is_engineering)
    if not is_plane or any(axis.direction == "west" for axis in axes):
        raise InputError(
            f"{label}: {whole.name} ({whole.type_name}) is no plane whose axes point east and north; mend it with: "
            "gdalwarp -t_srs EPSG:<a UTM zone>"
        )
    if len(axes) == 2:
        return Reference(crs, plane, None, "")
    down = -1.0 if axes[2].direction == "down" else 1.0
    datum = parts[1].name if len(parts) > 1 else f"ellipsoid of {plane.geodetic_crs.name}"
    return Reference(CRS.from_wkt(plane.to_wkt()), plane, down * axes[2].unit_conversion_factor, datum)


def _unbound(crs: pyproj.CRS) -> pyproj.CRS:
    """Return a coordinate system without the transformation to WGS 84 that is bound to it."""
    return crs.source_crs if crs.is_bound and crs.source_crs is not None else crs


def read_on(
    raster: OpenedRaster, bands: list[int], crs: CRS, grid: Grid, how: Resampling = Resampling.nearest, **more: Any
) -> F64:
    """Read bands on a grid, whatever the direction of the raster's rows and columns.

    Args:
        raster: open raster; without a coordinate system, it is assumed to be in `crs`.
        bands: band numbers, from 1.
        crs: coordinate system of the grid.
        grid: target cells, in units of `crs`.
        how: method of resampling.
        more: options of the warper, such as `src_transform`.

    Returns:
        (B, R, C) values as stored; NaN where no-data, a mask or transparency hides them, and outside the raster.
    """
    dataset = raster.dataset
    options = {
        **{"src_crs": raster.reference.crs or crs, "crs": crs, "transform": Affine(*grid.transform)},
        **{"width": grid.cols, "height": grid.rows, "resampling": how, "nodata": np.nan, "dtype": "float64"},
        **{"UNIFIED_SRC_NODATA": "NO"},  # each band has its own
        **more,
    }
    with WarpedVRT(dataset, **options) as warped:
        values = warped.read(bands)
    if dataset.nodata is not None and MaskFlags.per_dataset in dataset.mask_flag_enums[0]:
        with WarpedVRT(dataset, src_nodata=None, **options) as masked:  # apply the mask, which no-data overrides above
            values[np.isnan(masked.read(bands))] = np.nan
    return np.asarray(values)
