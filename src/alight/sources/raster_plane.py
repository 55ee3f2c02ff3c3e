"""Plane of a raster: its coordinate system, its orientation, and the length of its unit on the ground."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pyproj
from pyproj.exceptions import ProjError
from rasterio.crs import CRS
from rasterio.transform import Affine
from rasterio.warp import transform

from alight.arrays import F64
from alight.geometry import LOCAL_WKT, Grid, LocalFrame
from alight.records import InputError
from alight.sources.opened_raster import OpenedRaster, Reference, read_on

DRIFT = 0.1  # cells; largest offset of a corner from a grid of square cells with north up
SCALE_OF_SURVEYS = 1e-3  # greatest deviation from 1 in surveying grids (UTM, state planes), which are treated as metres
SCALE_CHANGE = 0.01  # greatest relative change by position or direction; more is refused


def upright_grid(raster: OpenedRaster) -> Grid:
    """Return the grid of a raster turned and mirrored to north up, in units of its coordinate system.

    Raises:
        InputError: the raster is not georeferenced, or its cells are not square along the axes. The message has the
            command that fixes the raster.
    """
    dataset, label, file = raster.dataset, raster.label, raster.file
    t, rows, cols = dataset.transform, dataset.height, dataset.width
    if not raster.has_place:
        raise InputError(
            f"{label}: has no place and no size of cells; mend it with: gdal_edit.py -a_ullr <west> <north> <east> "
            f"<south> {file}"
        )
    if abs(t.a) < abs(t.b):  # row numbers grow to the east or west
        t, rows, cols = Affine(t.b, t.a, t.c, t.e, t.d, t.f), cols, rows
    cell = abs(t.a)
    drift = max(abs(abs(t.e) - cell) * rows, abs(t.b) * rows, abs(t.d) * cols)
    if not drift <= DRIFT * cell:
        size = f"{math.sqrt(abs(t.determinant)):.9g}"
        raise InputError(
            f"{label}: cells are not square with north up; mend it with: gdalwarp -r bilinear -tr {size} {size} {file} "
            "OUT.tif"
        )
    west, north = t.c + min(t.a * cols, 0.0), t.f + max(t.e * rows, 0.0)
    return Grid(west + cell / 2, north - cell / 2, cell, rows, cols)


@dataclass(frozen=True)
class RasterPlane:
    """Plane in which a raster is judged: metres on the ground, north up.

    Coordinates are the raster's own if these are metres, else metres from the raster's middle.
    """

    grid: Grid  # of the raster, in metres
    reference: Reference
    settled: str  # coordinate system and cell size, in words
    x: float = 0.0  # position of the plane's origin, in units of the coordinate system
    y: float = 0.0
    metres: float = 1.0  # metres on the ground per unit of the coordinate system

    @property
    def crs(self) -> CRS:
        """Coordinate system of the raster; a local one if the raster has none."""
        return self.reference.crs or CRS.from_wkt(LOCAL_WKT)

    def in_crs(self, east: float, north: float) -> tuple[float, float]:
        """Convert a position in this plane from metres to units of the coordinate system."""
        return self.x + east / self.metres, self.y + north / self.metres

    def from_degrees(self, lon_lat: F64) -> F64:
        """Convert longitude and latitude, (N, 2) degrees, to positions in this plane, (N, 2) metres."""
        x, y = self._to_crs.transform(*lon_lat.T)
        return np.column_stack([x - self.x, y - self.y]) * self.metres

    @property
    def middle(self) -> tuple[float, float]:
        """Longitude and latitude of the raster's middle, degrees."""
        east, north = (axis.mean() for axis in self.grid.xy())
        lon, lat = self._to_crs.transform(*self.in_crs(east, north), direction="INVERSE")
        return float(lon), float(lat)

    @property
    def _to_crs(self) -> pyproj.Transformer:
        return pyproj.Transformer.from_crs("EPSG:4326", self.reference.plane, always_xy=True)

    def lies_in(self, local: LocalFrame) -> bool:
        """Whether coordinates in this plane equal coordinates in `local`, to a fraction of a cell; True if unknown."""
        if not self.reference.on_earth:
            return True  # cannot be checked
        corners = [axis[[0, -1]] for axis in self.grid.xy()]
        there = transform(self.crs, local.crs, *corners)
        return bool(np.abs(np.subtract(there, corners)).max() < DRIFT * self.grid.cell)

    def read(self, raster: OpenedRaster, band: int) -> F64:
        """Read a band (number from 1) of the plane's own raster, (R, C) as stored, turned to north up."""
        return np.asarray(read_on(raster, [band], self.crs, self.grid_in_crs(self.grid))[0])

    def grid_in_crs(self, grid: Grid) -> Grid:
        """Convert a grid from metres to units of the coordinate system."""
        east, north = self.in_crs(grid.east, grid.north)
        return replace(grid, east=east, north=north, cell=grid.cell / self.metres)


def metric_plane(raster: OpenedRaster) -> RasterPlane:
    """Determine the metric plane of a raster of heights.

    A projection maps one metre on the ground to a length called its point scale. In surveying grids it is nearly 1. If
    it differs more, as in Web Mercator and polar grids, cells and distances are corrected by its value at the raster's
    middle.

    Raises:
        InputError: cells are in degrees, not square with north up, too small or too large; the raster lies
            nowhere; or its point scale changes by more than 1 % with position or direction. The message has the command
            that fixes the raster.
    """
    reference = raster.reference
    if reference.is_geographic:
        west, south, east, north = raster.bounds
        lon, lat = (math.degrees(0.5 * (a + b) * reference.unit) for a, b in ((west, east), (south, north)))
        raise InputError(f"{raster.label}: its cells are degrees; mend it with: {_to_utm(raster, lon, lat)}")
    own = upright_grid(raster)
    if not 1e-3 <= own.cell * reference.unit <= 1e3:
        raise InputError(
            f"{raster.label}: cells of {own.cell * reference.unit:g} m; the ground is judged on cells of 0.001 to "
            "1000 m, check its geotransform and unit: gdal_edit.py -a_ullr, -a_srs"
        )
    if not max(abs(own.east), abs(own.north)) * reference.unit <= 1e8:  # metres; maps of the Earth are smaller
        raise InputError(
            f"{raster.label}: lies at {own.east:g}, {own.north:g}, which is nowhere; check it: gdal_edit.py -a_ullr"
        )
    return _in_metres(own, reference, *(_projection(raster, own) if reference.on_earth else (1.0, 0.0)))


def plane_in_memory(raster: OpenedRaster) -> RasterPlane:
    """Determine the metric plane of a raster that is to be held in memory.

    Raises:
        InputError: see `metric_plane`, or the cells are too many.
    """
    plane = metric_plane(raster)
    if (cells := plane.grid).rows * cells.cols > 100_000_000:
        size = f"{cells.cols} x {cells.rows}"
        raise InputError(f"{raster.label}: {size} cells are too many; cut it: gdal_translate -srcwin")
    return plane


def _in_metres(own: Grid, reference: Reference, scale: float, turn: float) -> RasterPlane:
    """Return the plane of a grid, from point scale and convergence (see `_projection`)."""
    corrected = abs(scale - 1.0) > SCALE_OF_SURVEYS
    name = "no coordinate system" if reference.plane is None else reference.plane.name
    settled = f"{name}, cells of {own.cell:.6g} "
    settled += "m" if reference.unit == 1.0 or reference.plane is None else reference.plane.axis_info[0].unit_name
    north = f", grid north is {turn:.0f} deg off true north" if round(turn) else ""
    metres = reference.unit / (scale if corrected else 1.0)
    if metres == 1.0:
        return RasterPlane(own, reference, settled + north)
    settled += f" are {own.cell * metres:.6g} m on the ground"
    settled += f" (point scale {scale:.4f})" if corrected else ""
    x, y = own.east + own.cell * (own.cols - 1) / 2, own.north - own.cell * (own.rows - 1) / 2
    settled += f", places in metres from its middle at {x:.12g} {y:.12g}"
    grid = Grid((own.east - x) * metres, (own.north - y) * metres, own.cell * metres, own.rows, own.cols)
    return RasterPlane(grid, reference, settled + north, x, y, metres)


def _projection(raster: OpenedRaster, own: Grid) -> tuple[float, float]:
    """Return the point scale, map length of one metre on the ground, and the degrees from true north to grid north.

    They are those in the middle of `own`, the raster's own grid (Tissot's indicatrix).

    Raises:
        InputError: the projection cannot be used there, or the point scale varies too much.
    """
    plane = raster.reference.plane
    assert plane is not None
    sides = np.linspace(-0.5, 0.5, 3)
    x = own.east + own.cell * own.cols * (sides[None, :] + 0.5) + np.zeros((3, 1))
    y = own.north + own.cell * own.rows * (sides[:, None] - 0.5) + np.zeros(3)
    try:
        projection = pyproj.Proj(plane)
        lon, lat = (np.asarray(v) for v in projection(x, y, inverse=True))
        tissot = projection.get_factors(lon, lat)
    except ProjError as e:
        raise InputError(f"{raster.label}: its projection cannot be used ({e}); mend it with: gdalwarp -t_srs") from e
    large, small = np.asarray(tissot.tissot_semimajor), np.asarray(tissot.tissot_semiminor)
    if not (np.isfinite([lon, lat, large, small]).all() and (small > 0).all()):
        raise InputError(
            f"{raster.label}: lies at {own.east:g}, {own.north:g}, which is nowhere in {plane.name}; check it: "
            "gdal_edit.py -a_srs, -a_ullr"
        )
    if large.max() > (1.0 + SCALE_CHANGE) * small.min():
        raise InputError(
            f"{raster.label}: a metre on the ground is {small.min():.4g} to {large.max():.4g} m in {plane.name}, by "
            f"place or direction; mend it with: {_to_utm(raster, float(lon[1, 1]), float(lat[1, 1]))}"
        )
    middle = float(np.sqrt(large[1, 1] * small[1, 1]))
    return middle, float(np.asarray(tissot.meridian_convergence)[1, 1])


def _to_utm(raster: OpenedRaster, lon: float, lat: float) -> str:
    """Return the command that converts a raster to the UTM zone of its middle at `lon`, `lat` in degrees."""
    if not (abs(lon) <= 360.0 and abs(lat) <= 90.0):
        return f"gdal_edit.py -a_srs <its coordinate system> {raster.file}"
    zone = int((lon + 180.0) % 360.0 // 6.0) + 1
    return f"gdalwarp -r bilinear -t_srs EPSG:{(32700 if lat < 0 else 32600) + zone} {raster.file} OUT.tif"
