"""Heights from another source: a raster, its sigma and an image of the same ground."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from rasterio.crs import CRS
from rasterio.enums import ColorInterp
from rasterio.errors import NotGeoreferencedWarning, RasterioError

from alight.arrays import F32, F64, I64, U8, Mask
from alight.geometry import Grid
from alight.raster import unreadable
from alight.records import ElevationMap, Flag, InputError

LARGEST_SIGMA = 1000.0  # metres
HIGHEST = 12_000.0  # metres: no ground of the Earth lies as far from its ellipsoid


@dataclass(frozen=True, eq=False)
class GroundRaster:
    """Heights, sigma and image as read. East and north of the grid are the raster's own coordinates."""

    elevation: ElevationMap
    crs: CRS | None  # None: the raster has none, metres are assumed
    image: U8 | None  # (f R, f C) or (f R, f C, 3), f = 1, 2, 4, ... pixels a cell
    warnings: tuple[str, ...]
    files: tuple[Path, ...]  # that were read


def open_raster(path: Path) -> Any:
    """Open a raster with rasterio.

    Raises:
        InputError: it is no raster.
    """
    if not path.exists():
        raise InputError(f"{path}: there is no such file; name a raster such as a GeoTIFF")
    if not path.is_file():
        raise InputError(f"{path}: not a plain file; name a raster such as a GeoTIFF")
    try:
        with warnings.catch_warnings():  # we report missing coordinates ourselves, once and in words
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            return rasterio.open(path)
    except UnicodeEncodeError as e:
        raise InputError(f"{path}: its name is not UTF-8; rename it") from e
    except unreadable() as e:
        raise InputError(f"{path}: not a raster that can be read ({' '.join(str(e).split())}); give a GeoTIFF") from e


@contextmanager
def to_its_end(label: object) -> Iterator[None]:
    """Turn errors of reading a raster's cells into an `InputError` about a file."""
    try:
        yield
    except RasterioError as e:
        raise InputError(f"{label}: cannot be read to its end ({' '.join(str(e).split())}); copy it again") from e


def _grid(path: Path, dataset: Any) -> Grid:
    t, crs = dataset.transform, dataset.crs
    if crs is not None and crs.is_geographic:
        raise InputError(
            f"{path}: its cells are degrees; mend it with: gdalwarp -t_srs EPSG:<a UTM zone> {path} OUT.tif"
        )
    if crs is not None and not math.isclose(_metres(crs), 1.0, rel_tol=1e-6):
        raise InputError(f"{path}: its unit is not the metre; mend it with: gdalwarp -t_srs EPSG:<a UTM zone>")
    if t.b or t.d or t.a <= 0 or not math.isclose(t.a, -t.e, rel_tol=1e-6):
        raise InputError(f"{path}: cells are not square with north up; mend it with: gdalwarp -tr <size> <size>")
    if dataset.width * dataset.height > 100_000_000:
        raise InputError(
            f"{path}: {dataset.width} x {dataset.height} cells are too many; cut it: gdal_translate -srcwin"
        )
    if not 1e-3 <= t.a <= 1e3:
        raise InputError(
            f"{path}: cells of {t.a:g} m; the ground is judged on cells of 0.001 to 1000 m, check its geotransform: "
            "gdal_edit.py -a_ullr"
        )
    if not max(abs(t.c), abs(t.f)) <= 1e8:  # metres; maps of the Earth end before
        raise InputError(f"{path}: lies at {t.c:g}, {t.f:g} m, which is nowhere; check it: gdal_edit.py -a_ullr")
    return Grid(t.c + t.a / 2, t.f + t.e / 2, t.a, dataset.height, dataset.width)


def _metres(crs: CRS) -> float:
    try:
        return float(crs.linear_units_factor[1])
    except (RasterioError, ValueError):  # a local system without a unit that is known
        return 1.0


def _band(path: Path, dataset: Any, band: int) -> F32:
    if "complex" in dataset.dtypes[band - 1]:
        raise InputError(f"{path}: holds complex numbers; give heights in metres as float32")
    with to_its_end(path):
        values = dataset.read(band, masked=True)
    with np.errstate(over="ignore", invalid="ignore"):
        stored = values.astype(np.float64).filled(np.nan) * dataset.scales[band - 1] + dataset.offsets[band - 1]
        out: F32 = stored.astype(np.float32)
    return np.where(np.isfinite(out), out, np.float32(np.nan))


def _sigma(given: str, grid: Grid) -> F32:
    """1-sigma of every cell as the user gives it: metres, or a raster."""
    try:
        value = float(given)
    except ValueError:  # it names a raster
        return _sigma_raster(Path(given), grid)
    if not 0 <= value < LARGEST_SIGMA:
        raise InputError(f"--sigma {given}: needs a raster, or metres from 0 to {LARGEST_SIGMA:g}")
    return np.full(grid.shape, value, np.float32)


def _sigma_raster(path: Path, grid: Grid) -> F32:
    with open_raster(path) as d:
        sigma = _band(path, d, 1)
    if sigma.shape != grid.shape:
        raise InputError(
            f"{path}: {sigma.shape[1]} x {sigma.shape[0]} cells, the heights have {grid.cols} x {grid.rows}"
        )
    if (sigma < 0).any():
        raise InputError(f"{path}: sigma below 0; give 1-sigma in metres")
    return sigma


def _image(path: Path, grid: Grid) -> U8:
    """Pixels of an image that covers the same ground, a whole number of them a cell."""
    with open_raster(path) as d:
        bands = (1, 2, 3) if d.count >= 3 else (1,)
        if d.dtypes[0] != "uint8":
            raise InputError(f"{path}: {d.dtypes[0]} pixels; give 8 bit: gdal_translate -ot Byte -scale")
        pixels: U8 = np.stack([d.read(b) for b in bands], axis=-1)
        placed, bounds = d.crs is not None, d.bounds
    factor = pixels.shape[0] / grid.rows
    if factor not in (1, *range(2, 17, 2)) or pixels.shape[:2] != (factor * grid.rows, factor * grid.cols):
        raise InputError(
            f"{path}: {pixels.shape[1]} x {pixels.shape[0]} pixels on {grid.cols} x {grid.rows} heights; "
            "give 1, 2, 4, ... pixels a cell over the same extent: gdalwarp -te <extent> -ts <columns> <rows>"
        )
    west, top = grid.east - grid.cell / 2, grid.north + grid.cell / 2
    if placed and math.hypot(bounds.left - west, bounds.top - top) > 0.5 * grid.cell / factor:
        raise InputError(f"{path}: lies elsewhere than the heights; mend it with: gdalwarp -te <extent of the heights>")
    return pixels if len(bands) == 3 else pixels[..., 0]


def read_ground(path: Path, sigma: str | None, image: Path | None, usual_sigma: float) -> GroundRaster:
    """Read a height raster as a map that can be judged.

    Args:
        path: heights in metres, band 1; a second band named `sigma` is theirs.
        sigma: raster of 1-sigma or one number, metres.
        image: of the same ground, 8 bit.
        usual_sigma: metres, where no sigma is given.

    Raises:
        InputError: it is no raster, its cells are not square in metres with north up, no height is known, or sigma or
            image are on another grid.
    """
    with open_raster(path) as d:
        grid, crs = _grid(path, d), d.crs
        height = _band(path, d, 1)
        suspect = doubt_of_heights(path, height, d)
        own = _band(path, d, 2) if d.count > 1 and d.descriptions[1] == "sigma" else None
    known = np.isfinite(height)
    if not known.any():
        raise InputError(f"{path}: no height is known; check its nodata value")
    doubts = [] if crs is not None else [f"{path.name} has no coordinate system: metres east and north are assumed"]
    spread = own if sigma is None else _sigma(sigma, grid)
    if spread is None:
        spread = np.full(grid.shape, usual_sigma, np.float32)
        doubts.append(
            f"no sigma given: {usual_sigma:g} m is taken for every height; P(safe) is no better than that (--sigma)"
        )
    doubts += [suspect] if suspect else []
    spread = np.where((spread >= 0) & (spread < LARGEST_SIGMA), spread, np.float32(np.nan))
    known &= np.isfinite(spread)
    if not known.any():
        raise InputError(f"{path}: no height has a sigma; give --sigma in metres")
    pixels = None if image is None else _image(image, grid)
    files = (path, *(file for file in (sigma and Path(sigma), image) if file and file.is_file()))
    return GroundRaster(_as_map(grid, height, spread, known, pixels), crs, pixels, tuple(doubts), files)


def _as_map(grid: Grid, height: F32, sigma: F32, known: Mask, image: U8 | None) -> ElevationMap:
    grey = np.full((*grid.shape, 3), 128, np.uint8)
    if image is not None and image.shape[:2] == grid.shape:
        grey = image if image.ndim == 3 else np.repeat(image[..., None], 3, axis=2)
    return ElevationMap(
        grid=grid,
        height=np.where(known, height, np.float32(np.nan)),
        sigma=sigma,
        flags=np.where(known, np.uint16(0), np.uint16(Flag.UNSEEN)),
        views=np.where(known, np.uint8(9), np.uint8(0)),  # nominal
        rgb=grey,
        residual=np.zeros(grid.shape, np.float32),
        sampling=np.full(grid.shape, grid.cell, np.float32),
    )


def doubt_of_heights(path: Path, height: F32, dataset: Any) -> str | None:
    """Test whether a band may be taken for heights: undeclared no-data, classes and pictures are not flat ground.

    Args:
        path: of the raster, for messages.
        height: (R, C) metres, NaN where no-data is declared.
        dataset: that it was read from.

    Returns:
        A doubt in words; None: there is none.

    Raises:
        InputError: they are no heights, or a value stands for no-data that is not declared.
    """
    if dataset.colorinterp[0] == ColorInterp.palette or dataset.dtypes[0] in ("uint8", "int8"):
        raise InputError(
            f"{path}: 8 bit values are classes or a picture, not heights; give heights in metres as float32"
        )
    known = height[np.isfinite(height)].astype(np.float64)
    if not known.size:
        return None
    values, counts = np.unique(known, return_counts=True)
    if (wrong := _no_height(values, dataset.nodata)) is not None:
        times = int(counts[values == wrong][0])
        raise InputError(
            f"{path}: {wrong:g} stands in {times} of {known.size} cells and is no height; declare it as no-data: "
            f"gdal_edit.py -a_nodata {wrong:g} {path.name}"
        )
    if 1 < values.size <= 32 and (values == np.rint(values)).all():  # no map of land cover has more classes
        raise InputError(
            f"{path}: holds only {values.size} different values, all whole numbers: classes, or heights rounded to the "
            "metre, which show no obstacle; give heights in metres as float32"
        )
    return None if dataset.nodata is not None else _filled(path, values, counts)


def _no_height(values: F64, declared: float | None) -> float | None:
    """A value that cannot be a height, or that lies apart from all others at an end of them; None: there is none."""
    for v in (values[0], values[-1]):
        if not -HIGHEST <= v <= HIGHEST or v in (-9999.0, -999.0, 9999.0):  # as programs write unknown heights
            return float(v)
    if declared is not None or values.size < 3:
        return None
    for end, rest in ((values[0], values[1:]), (values[-1], values[:-1])):
        gap = abs(end - (rest[0] if end < rest[0] else rest[-1]))
        if gap > max(50.0, 2 * (rest[-1] - rest[0])):
            return float(end)
    return None


def _filled(path: Path, values: F64, counts: I64) -> str | None:
    """A doubt where one value stands in 2 % of the cells although one in five others does not repeat."""
    total, most = int(counts.sum()), int(counts.max())
    if values.size < 3 or most < 0.02 * total or (values.size - 1) < 0.2 * (total - most):
        return None
    value = float(values[counts.argmax()])
    return (
        f"{path.name}: the height {value:g} m stands in {100 * most / total:.0f} % of the cells exactly; if that means "
        f"'not known', declare it: gdal_edit.py -a_nodata {value:g}"
    )
