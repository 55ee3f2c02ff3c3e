"""Rasters that belong to heights (a sigma or an image), matched by position and resampled to the heights' cells."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rasterio.crs import CRS
from rasterio.enums import ColorInterp, Resampling
from rasterio.transform import Affine
from rasterio.vrt import WarpedVRT

from alight.arrays import F64, Mask
from alight.geometry import Grid
from alight.records import InputError
from alight.sources.heights import RasterHeights
from alight.sources.opened_raster import OpenedRaster, open_raster, read_on
from alight.sources.raster_band import band_in_metres, bands_of_picture
from alight.sources.raster_plane import DRIFT

SIGMA = re.compile(r".*(sigma|std|standard dev|uncert)", re.I)  # names of bands that hold 1-sigma
MOST_PIXELS = 16  # greatest number of image pixels per cell side


class Beside(NamedTuple):
    """Values of a raster, resampled to the cells of the heights or to f x f pixels per cell."""

    values: NDArray[Any]  # (R, C) or, for an image, (f R, f C) or (f R, f C, 3)
    settled: str  # unit and resampling, in words
    warnings: list[str]


@dataclass(frozen=True, eq=False)
class _Placed:
    """An open raster with its place relative to the heights."""

    raster: OpenedRaster
    heights: RasterHeights
    crs: CRS
    transform: Affine  # of the raster as stored
    pixels: float  # pixels of the raster per side of a height cell
    warnings: list[str]

    @classmethod
    def of(cls, raster: OpenedRaster, heights: RasterHeights) -> _Placed:
        """Place a raster: by its georeference or, if it has none, over the whole extent of the heights."""
        own, other, dataset, crs = heights.plane.reference, raster.reference, raster.dataset, heights.plane.crs
        if not raster.has_place:
            (rows, cols), (height, width) = heights.shape, dataset.shape
            if height % rows or width * rows != height * cols:
                raise InputError(
                    f"{raster.label}: has no place, and its {width} x {height} cells do not fit {cols} x {rows} "
                    f"heights; mend it with: gdal_edit.py -a_ullr <west> <north> <east> <south> {raster.file}"
                )
            warning = f"{raster.path.name} has no place: it is taken to cover the heights"
            extent = heights.transform @ Affine.scale(rows / height)
            return cls(raster, heights, crs, extent, height // rows, [warning])
        if own.on_earth and other.on_earth:
            crs = other.crs
        elif own.crs and other.crs and (own.on_earth or other.on_earth or own.unit != other.unit):
            raise InputError(  # two site grids are assumed equal, whatever their names
                f"{raster.label}: {other.plane and other.plane.name} cannot be converted to "
                f"{own.plane and own.plane.name} of the heights; mend it with: gdal_edit.py -a_srs {raster.file}"
            )
        with WarpedVRT(dataset, src_crs=crs, crs=heights.plane.crs) as natural:
            pixel = natural.transform.a
        cell = heights.plane.grid_in_crs(heights.plane.grid).cell
        assumed = [f"{raster.path.name} has no coordinate system: that of the heights is assumed"]
        unknown = own.crs is not None and other.crs is None
        return cls(raster, heights, crs, dataset.transform, cell / pixel, assumed if unknown else [])

    def read(self, bands: list[int], how: Resampling, factor: int = 1) -> F64:
        """Read bands (numbers from 1) at f = `factor` pixels per side of a height cell; return (B, f R, f C)."""
        together = "YES" if len(bands) > 1 else "NO"  # a pixel is no-data if all of its colours are no-data
        more = {"src_crs": self.crs, "src_transform": self.transform, "UNIFIED_SRC_NODATA": together}
        return read_on(self.raster, bands, self.heights.plane.crs, self._grid(factor), how, **more)

    def shares_cells(self, factor: int = 1) -> bool:
        """Whether `factor` x `factor` cells make up each cell of the heights, in any stored orientation."""
        if self.crs != self.heights.plane.crs:
            return False
        move = ~Affine(*self._grid(factor).transform) @ self.transform
        turn, shift = np.array([move.a, move.b, move.d, move.e]), np.array([move.c, move.f])
        drift = np.abs(turn - np.rint(turn)).max() * max(self.raster.dataset.shape)
        is_turn = sorted(np.abs(np.rint(turn))) == [0.0, 0.0, 1.0, 1.0]
        return bool(is_turn and drift < DRIFT and np.abs(shift - np.rint(shift)).max() < DRIFT)

    def _grid(self, factor: int) -> Grid:
        return self.heights.plane.grid_in_crs(self.heights.plane.grid.finer(factor))

    def coverage(self, known: Mask, lost: str) -> list[str]:
        """Return one warning, which ends with `lost`, or none if all heights are covered: `known` is True everywhere.

        Raises:
            InputError: the raster covers no height.
        """
        raster, share = self.raster, 100.0 * float(known.mean()) if known.size else 0.0
        if not share:
            raise InputError(
                f"{raster.label}: lies elsewhere than the heights, or is empty; give one of the same place"
            )
        return [] if known.all() else [f"{raster.path.name} covers {share:.3g} % of the heights: {lost}"]


def own_sigma(raster: OpenedRaster, heights: RasterHeights) -> Beside | None:
    """Read the first band named as 1-sigma in the heights' own raster, (R, C) metres; None if there is no such band."""
    if (number := _band_of_sigma(raster)) is None:
        return None
    band = band_in_metres(raster, number, heights.band.unit == 1.0)
    sigma = band.lengths(heights.plane.read(raster, band.number))
    return _without_zeros(raster, heights, Beside(sigma, f"sigma in {band.settled}", []))


def _band_of_sigma(raster: OpenedRaster) -> int | None:
    return next((n for n, name in enumerate(raster.dataset.descriptions, 1) if SIGMA.match(name or "")), None)


def _without_zeros(raster: OpenedRaster, heights: RasterHeights, sigma: Beside) -> Beside:
    """Return a sigma with NaN in place of 0, because no measured height is exact and 0 often means "not measured"."""
    known = np.isfinite(heights.metres)
    share = 100.0 * float((sigma.values == 0)[known].sum()) / max(int(known.sum()), 1)
    warning = (
        f"{raster.path.name}: sigma is 0 in {share:.3g} % of the heights, which are taken as not measured; a sigma of "
        "all heights is given by --sigma METRES"
    )
    values = np.where(sigma.values == 0, np.nan, sigma.values)
    return Beside(values, sigma.settled, sigma.warnings + ([warning] if share else []))


def sigma_beside(path: Path, heights: RasterHeights, is_part: bool = False) -> Beside:
    """Read 1-sigma of the heights, (R, C) metres; each cell gets the largest of all sigma cells that it touches.

    A sigma of 0 is unknown. `is_part`: whether the heights are a part of their raster, so that none may have a sigma.

    Raises:
        InputError: the file is not a raster, its unit cannot be determined, it lies elsewhere, or has values below 0.
    """
    with open_raster(path) as raster:
        at, number = _Placed.of(raster, heights), _band_of_sigma(raster) or 1
        band = band_in_metres(raster, number, heights.band.unit == 1.0 and raster.reference.is_metric)
        resampled = not at.shares_cells()
        sigma = band.lengths(at.read([number], Resampling.nearest)[0])
        if resampled:
            touched = band.lengths(at.read([number], Resampling.max)[0])
            sigma = np.where(sigma == 0, sigma, np.maximum(sigma, touched))
        if (sigma < 0).any():
            raise InputError(f"{path}: sigma below 0; give 1-sigma in metres")
        known = np.isfinite(sigma)[np.isfinite(heights.metres)]
        beyond = [] if is_part else at.coverage(known, "no sigma beyond")
        words = f"{path.name}: sigma in {band.settled}{', resampled' if resampled else ''}"
        return _without_zeros(raster, heights, Beside(sigma, words, at.warnings + beyond))


def image_beside(path: Path, heights: RasterHeights) -> Beside:
    """Read an image of the ground as 8 bits, (f R, f C) or (f R, f C, 3), with f = 1, 2, 4, ... pixels per cell side.

    Bands are chosen by `bands_of_picture`; colours of a palette are expanded. Other depths than 8 bits are scaled, with
    0 as black. Pixels outside the image get its median colour.

    Raises:
        InputError: the file is not a raster, holds no picture, or lies elsewhere.
    """
    with open_raster(path) as raster:
        at, bands, dataset = _Placed.of(raster, heights), bands_of_picture(raster), raster.dataset
        factor = min(max(2 * int((at.pixels + DRIFT) / 2), 1), MOST_PIXELS)
        palette = dataset.colorinterp[bands[0] - 1] == ColorInterp.palette
        as_stored = palette or at.shares_cells(factor)
        pixels = at.read(bands, Resampling.nearest if as_stored else Resampling.average, factor)
        known = np.asarray(np.isfinite(pixels).all(axis=0))
        beyond = at.coverage(known, "grey beyond")
        if palette:
            colours = np.zeros((256, 3))
            for number, colour in dataset.colormap(bands[0]).items():
                colours[number] = colour[:3]
            pixels = np.moveaxis(colours[np.where(known, pixels[0], 0).astype(np.uint8)], 2, 0)
        elif dataset.dtypes[bands[0] - 1] != "uint8":
            bright = float(np.quantile(pixels[:, known], 0.999))  # except a few glints
            if not bright > 0:
                raise InputError(
                    f"{path}: no pixel is brighter than 0; give 8 bits, or scale it: gdal_translate -ot Byte -scale"
                )
            pixels = pixels * (255.0 / bright)
        pixels = np.rint(np.where(known, pixels, np.median(pixels[:, known], axis=1)[:, None, None]))
    out = np.moveaxis(np.clip(pixels, 0, 255).astype(np.uint8), 0, 2)
    kind = "as grey" if len(bands) == 1 and not palette else "as red, green, blue"
    words = f"{path.name}: band {', '.join(map(str, bands))} of {dataset.count} {kind}, {factor} pixel(s) a cell"
    if len(bands) == 1 and dataset.count > 2:
        beyond.append(
            f"{path.name}: which bands are red, green and blue is not clear, so band {bands[0]} is used as grey; take "
            "them out: gdal_translate -b <red> -b <green> -b <blue>"
        )
    return Beside(out if out.shape[2] == 3 else out[..., 0], words, at.warnings + beyond)
