"""Worlds from arrays, or from a user's own height raster, classes and orthophoto."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import rasterio
from pydantic import AfterValidator, Field, ValidationInfo
from rasterio.enums import Resampling
from rasterio.vrt import WarpedVRT
from rasterio.warp import transform, transform_bounds
from scipy.ndimage import distance_transform_edt, gaussian_filter, map_coordinates

from alight.arrays import F32, F64, U8, Mask
from alight.geometry import Grid, LocalFrame
from alight.geometry.geodesy import MEAN_RADIUS
from alight.raster import unreadable
from alight.records import InputError, Terrain
from alight_sim.looks import Look
from alight_sim.section import Section
from alight_sim.spans import TrueSpans
from alight_sim.things.base import Box, Sheet
from alight_sim.tiles import SIDE, Tile

MOST_CELLS = 60_000_000  # of a world made from rasters, which is held in memory
FARTHEST = 50_000.0  # metres from the origin: beyond, east-north-up and the rasters' map differ too much


def _beside(value: Path | None, info: ValidationInfo) -> Path | None:
    """Return a raster's path, resolved against the folder of the scene file."""
    folder = (info.context or {}).get("folder")
    return None if value is None else ((folder or Path()) / value.expanduser()).resolve()


Beside = Annotated[Path, AfterValidator(_beside)]


class SceneRaster(Section):
    """GeoTIFFs of a world, in any coordinate system; without an origin, the centre of the height raster is the origin.

    Without a size the world is as large as the height raster. Layers may be added; relief is added only if given.
    """

    height: Beside = Field(description="heights of the surface, metres above the ellipsoid (band 1)")
    image: Beside | None = Field(None, description="orthophoto: RGB, 8 bits")
    classes: Beside | None = Field(None, description="classes, codes 0 to 8 of the flight log; without it: all bare")
    holes: float = Field(
        0.05, ge=0.0, le=1.0, description="largest share of cells without a height; they are filled from around them"
    )
    gamma: float = Field(2.2, gt=0.2, le=4.0, description="of the orthophoto")


@dataclass(frozen=True, eq=False)
class GroundRasters:
    """Rasters on the world's grid."""

    grid: Grid
    height: F32  # (R, C) metres above the origin
    label: U8  # (R, C)
    tint: F32 | None  # (R, C, 3)
    warnings: tuple[str, ...]

    def heights(self, x: F64, y: F64) -> F64:
        """Return bilinear heights at positions of any shape, metres; beyond the edge, heights of the nearest cells."""
        rows, cols = self.grid.index(x, y)
        return np.asarray(map_coordinates(self.height, [rows, cols], np.float64, order=1, mode="nearest"))

    def lay(self, sheet: Sheet) -> None:
        """Set the classes and colours of a sheet from the nearest cells."""
        rows, cols = self.grid.index(sheet.x, sheet.y)
        r = np.clip(np.rint(rows), 0, self.grid.rows - 1).astype(np.int64)
        c = np.clip(np.rint(cols), 0, self.grid.cols - 1).astype(np.int64)
        sheet.label[:] = self.label[r, c]
        sheet.depth[sheet.label == Terrain.WATER] = 1.0  # metres; the true depth is unknown
        if self.tint is not None:
            sheet.look[:], sheet.tint[:] = Look.PLAIN, self.tint[r, c]

    def range(self, box: Box) -> tuple[float, float]:
        """Return the lowest and highest height in a box, metres."""
        return raster_height_range(self.grid, self.height, box)


def raster_height_range(grid: Grid, height: F32, box: Box) -> tuple[float, float]:
    """Return the lowest and highest of heights (R, C) in a box, metres; outside the grid the nearest cells are used."""
    west, south, east, north = box
    rows, cols = grid.index(np.array([west, east]), np.array([north, south]))
    r0, r1 = (int(v) for v in np.clip([np.floor(rows[0]), np.ceil(rows[1])], 0, grid.rows - 1))
    c0, c1 = (int(v) for v in np.clip([np.floor(cols[0]), np.ceil(cols[1])], 0, grid.cols - 1))
    part = height[r0 : r1 + 1, c0 : c1 + 1]
    return float(part.min()), float(part.max())


@contextmanager
def _opened(path: Path, what: str) -> Iterator[Any]:
    try:
        with rasterio.open(path) as dataset:
            if dataset.crs is None:
                raise InputError(
                    f"{path}: the {what} has no coordinate system; give it one, for example with gdal_edit.py -a_srs"
                )
            yield dataset
    except unreadable() as e:
        raise InputError(f"{path}: the {what} cannot be read ({str(e).splitlines()[0]}); name a GeoTIFF") from e


def raster_middle(raster: SceneRaster) -> LocalFrame:
    """Return the origin of a scene without one: the centre of the height raster, at its median height."""
    with _opened(raster.height, "height raster") as dataset:
        west, south, east, north = transform_bounds(dataset.crs, "EPSG:4326", *dataset.bounds)
        thin = max(1, max(dataset.shape) // 500)
        sample = dataset.read(1, masked=True, out_shape=(max(1, dataset.height // thin), max(1, dataset.width // thin)))
        heights = np.ma.masked_invalid(sample).compressed()
    if not len(heights):
        raise InputError(f"{raster.height}: the height raster has no heights; choose another")
    return LocalFrame(0.5 * (south + north), 0.5 * (west + east), float(np.median(heights)))


def reach(raster: SceneRaster, local: LocalFrame, cell: float) -> Box:
    """Return the largest box that lies in the height raster, which may be rotated.

    Its sides are whole multiples of `cell` (m) from the origin of `local`.
    """
    with _opened(raster.height, "height raster") as dataset:
        t = np.linspace(0.0, 1.0, 33)
        a, b, c, d, e, f = dataset.transform[:6]
        sides = []
        for u, v in ((0.0 * t, t), (t, 0.0 * t + 1.0), (0.0 * t + 1.0, t), (t, 0.0 * t)):  # left, bottom, right, top
            x, y = (
                a * u * dataset.width + b * v * dataset.height + c,
                d * u * dataset.width + e * v * dataset.height + f,
            )
            sides.append(transform(dataset.crs, local.crs, x, y))
    west, south, east, north = max(sides[0][0]), max(sides[1][1]), min(sides[2][0]), min(sides[3][1])
    if max(abs(west), abs(south), abs(east), abs(north)) > FARTHEST:
        raise InputError(
            f"{raster.height}: the height raster is far from the scene's origin; mend origin, or leave it out"
        )
    half = 0.5 * cell  # centres of the raster's outermost cells are half a cell inside: no data are lost
    w, s = (math.ceil((v - half) / cell) * cell for v in (west, south))
    right, top = (math.floor((v + half) / cell) * cell for v in (east, north))
    return w, s, right, top


def load_rasters(raster: SceneRaster, local: LocalFrame, extent: Box, cell: float) -> GroundRasters:
    """Resample the rasters to cells of `cell` metres over an extent (west, south, east, north) in the frame `local`.

    Raises:
        InputError: a raster is not readable, has no coordinate system, too many holes or codes that are no classes, or
            does not overlap the extent.
    """
    west, south, east, north = extent
    cols, rows = round((east - west) / cell), round((north - south) / cell)
    if rows < 2 or cols < 2 or rows * cols > MOST_CELLS:
        raise InputError(
            f"{raster.height}: {cols} x {rows} cells of {cell:g} m cannot be held; "
            "set ground.size or a larger ground.cell"
        )
    grid = Grid(west + 0.5 * cell, north - 0.5 * cell, cell, rows, cols)
    height, filled = _heights(raster, local, grid)
    label = np.full(grid.shape, Terrain.BARE, np.uint8)
    warnings = []
    if raster.classes is None:
        warnings.append("the scene's raster has no classes: all of it counts as bare ground")
    else:
        label = _classes(raster.classes, local, grid)
    if filled.any():
        label[filled] = Terrain.UNKNOWN
        warnings.append(f"{100.0 * filled.mean():.2g} % of the height raster were holes: filled, class unknown")
    tint = None if raster.image is None else _image(raster.image, local, grid, raster.gamma)
    return GroundRasters(grid, height, label, tint, tuple(warnings))


def _warped(
    path: Path, what: str, local: LocalFrame, grid: Grid, bands: list[int], how: Resampling, **more: Any
) -> Any:
    """Return the values of a raster resampled to the grid, (bands, R, C).

    `what`: name of the raster in errors. `bands`: numbers from 1. `how`: method. `more`: options of `WarpedVRT`.
    """
    with _opened(path, what) as dataset:
        if len(bands) > dataset.count:
            raise InputError(f"{path}: the {what} has {dataset.count} band(s), {len(bands)} are needed; choose another")
        options = {
            "crs": local.crs,
            "transform": rasterio.Affine(*grid.transform),
            "width": grid.cols,
            "height": grid.rows,
        }
        with WarpedVRT(dataset, resampling=how, **options, **more) as warped:
            return warped.read(bands)


def _heights(raster: SceneRaster, local: LocalFrame, grid: Grid) -> tuple[F32, Mask]:
    """Return (R, C) metres above the origin's horizontal plane, and the (R, C) mask of filled holes."""
    options = {"nodata": float(np.finfo(np.float32).min), "dtype": "float32", "src_nodata": None}
    with _opened(raster.height, "height raster") as dataset:
        options["src_nodata"] = dataset.nodata if dataset.nodata is not None else math.nan
        fine = transform_bounds(dataset.crs, local.crs, *dataset.bounds)
        how = Resampling.average if (fine[2] - fine[0]) / dataset.width < 0.7 * grid.cell else Resampling.bilinear
    read = _warped(raster.height, "height raster", local, grid, [1], how, **options)[0]
    holes = ~np.isfinite(read) | (read < -1e5)
    share = float(holes.mean())
    if share == 1.0:
        raise InputError(f"{raster.height}: the height raster does not cover the world; set origin, or leave it out")
    if share > raster.holes:
        raise InputError(
            f"{raster.height}: {100.0 * share:.1f} % of the world have no height; set a smaller ground.size, or raise "
            f"ground.raster.holes above {share:.3f} to fill them from around"
        )
    if holes.any():
        _, nearest = distance_transform_edt(holes, return_indices=True)
        smooth = gaussian_filter(read[tuple(nearest)], 4.0)
        read = np.where(holes, smooth, read)
    east, north = grid.xy()
    fall = (east[None] ** 2 + north[:, None] ** 2) / (2.0 * MEAN_RADIUS)  # fall of the ellipsoid below the plane
    return (read.astype(np.float64) - local.height - fall).astype(np.float32), np.asarray(holes)


def _classes(path: Path, local: LocalFrame, grid: Grid) -> U8:
    codes = _warped(path, "class raster", local, grid, [1], Resampling.nearest)[0]
    if not np.isin(codes, [int(k) for k in Terrain]).all():
        raise InputError(f"{path}: holds codes that are no classes; use 0 to {max(Terrain):d} as in the flight log")
    if not codes.any():
        raise InputError(
            f"{path}: the class raster has no class anywhere in the world; choose another, or leave it out"
        )
    return np.asarray(codes, np.uint8)


def _image(path: Path, local: LocalFrame, grid: Grid, gamma: float) -> F32:
    """Return an orthophoto of some `gamma` as linear reflectance on the grid, (R, C, 3); grey outside the picture."""
    with _opened(path, "orthophoto") as dataset:
        if any(kind != "uint8" for kind in dataset.dtypes[:3]):
            raise InputError(f"{path}: the orthophoto is {dataset.dtypes[0]}; convert it to 8 bits")
    read = _warped(path, "orthophoto", local, grid, [1, 2, 3], Resampling.bilinear)
    dark = (read == 0).all(axis=0)
    if dark.all():
        raise InputError(f"{path}: the orthophoto does not cover the world; choose another, or leave it out")
    tone = (np.arange(256) / 255.0) ** gamma
    tint = np.moveaxis(tone.astype(np.float32)[read], 0, -1)
    return np.where(dark[..., None], np.float32(0.2), tint)


@dataclass(frozen=True, eq=False)
class Arrays:
    """Source of tiles from given arrays; the cells at their edges are repeated beyond them."""

    grid: Grid
    height: F32  # (R, C) metres above the origin
    label: U8  # (R, C)
    depth: F32 | None = None  # (R, C) metres of water
    look: U8 | None = None  # (R, C)
    tint: F32 | None = None  # (R, C, 3)
    wires: TrueSpans = field(default_factory=TrueSpans)

    def spans(self, box: Box) -> TrueSpans:
        """Return the spans in the air that come into a box."""
        return self.wires.within(box)

    @property
    def cell(self) -> float:
        """Size of a cell, metres."""
        return self.grid.cell

    @property
    def anchor(self) -> tuple[float, float]:
        """East and north of the south-west corner, metres."""
        grid = self.grid
        return grid.east - 0.5 * grid.cell, grid.north + 0.5 * grid.cell - grid.rows * grid.cell

    @property
    def extent(self) -> Box:
        """West, south, east, north of the arrays, metres."""
        west, south = self.anchor
        return west, south, west + self.grid.cols * self.cell, south + self.grid.rows * self.cell

    def tile(self, i: int, j: int) -> Tile:
        """Return the tile that is `i` tiles east and `j` tiles north of the anchor."""
        k = np.arange(SIDE)
        cols = np.clip(i * SIDE + k, 0, self.grid.cols - 1)
        rows = np.clip(self.grid.rows - (j + 1) * SIDE + k, 0, self.grid.rows - 1)
        at = np.ix_(rows, cols)
        depth = np.zeros((SIDE, SIDE), np.float32) if self.depth is None else self.depth[at]
        look = np.zeros((SIDE, SIDE), np.uint8) if self.look is None else self.look[at]
        return Tile(self.height[at], self.label[at], depth, look, None if self.tint is None else self.tint[at])

    def range(self, box: Box) -> tuple[float, float]:
        """Return the lowest and highest height in a box, metres."""
        return raster_height_range(self.grid, self.height, box)
