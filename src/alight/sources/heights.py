"""Read the heights of a raster in metres, and check whether its values can be heights."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from rasterio.enums import ColorInterp
from rasterio.transform import Affine

from alight.arrays import F64, I64
from alight.records import InputError
from alight.records.telemetry import HIGHEST
from alight.sources.opened_raster import OpenedRaster
from alight.sources.raster_band import Band, band_of_heights
from alight.sources.raster_plane import RasterPlane, plane_in_memory


@dataclass(frozen=True, eq=False)
class RasterHeights:
    """Heights of a raster, turned to north up."""

    plane: RasterPlane
    band: Band
    metres: F64  # (R, C) above the vertical datum, NaN = unknown
    step: float  # metres, rounding of heights stored as integers; 0: stored as floating point
    doubt: str | None  # why the values may not be heights, in words; None: no doubt
    settled: str  # unit, datum and coordinate system, in words
    transform: Affine  # of the raster as stored
    shape: tuple[int, int]  # rows, columns of the raster as stored


def read_heights(raster: OpenedRaster) -> RasterHeights:
    """Read the heights of a raster in metres, in a metric plane, north up.

    Raises:
        InputError: plane or unit cannot be determined (see `plane_in_memory`, `band_in_metres`), the values are not
            heights (see `doubt_of_heights`), or no height is known.
    """
    found, stored = heights_on(raster, plane_in_memory(raster), band_of_heights(raster))
    return replace(found, doubt=checked_heights(raster, found.band, stored))


def checked_heights(raster: OpenedRaster, band: Band, stored: F64) -> str | None:
    """Check that there are heights; see `doubt_of_heights`.

    Raises:
        InputError: no height is known, or see `doubt_of_heights`.
    """
    if not np.isfinite(band.heights(stored)).any():
        raise InputError(f"{raster.label}: no height is known; check its nodata value")
    return doubt_of_heights(raster, band, stored)


def heights_on(raster: OpenedRaster, plane: RasterPlane, band: Band) -> tuple[RasterHeights, F64]:
    """Read the heights of a raster on the grid of a plane, which may be a part of the raster; and the stored values."""
    dataset, stored = raster.dataset, plane.read(raster, band.number)
    whole = np.dtype(dataset.dtypes[band.number - 1]).kind in "iu"
    found = RasterHeights(
        plane,
        band,
        band.heights(stored),
        step=abs(band.scale * band.unit) if whole else 0.0,
        doubt=None,
        settled=f"{raster.path.name}: heights in {words_of(raster, band)}, {plane.settled}",
        transform=dataset.transform,
        shape=dataset.shape,
    )
    return found, stored


def words_of(raster: OpenedRaster, band: Band) -> str:
    """Return unit and vertical datum of heights in words."""
    return f"{band.settled}, vertical datum {raster.reference.datum or 'undeclared'}"


def doubt_of_heights(raster: OpenedRaster, band: Band, stored: F64) -> str | None:
    """Check whether a band holds heights, so that undeclared no-data, classes or pictures do not pass for flat ground.

    Args:
        raster: open raster.
        band: the band that was read.
        stored: values of the band, NaN at declared no-data.

    Returns:
        A doubt in words; None if there is none.

    Raises:
        InputError: the values are not heights, or one value means no-data without being declared.
    """
    dataset, at = raster.dataset, band.number - 1
    if dataset.colorinterp[at] == ColorInterp.palette or dataset.dtypes[at] in ("uint8", "int8"):
        raise InputError(
            f"{raster.label}: 8 bit values are classes or a picture, not heights; give heights in metres as float32"
        )
    known = stored[np.isfinite(stored)]
    if not known.size:
        return None
    values, counts = np.unique(known, return_counts=True)
    if (wrong := _no_height(values, band.heights(values), dataset.nodata)) is not None:
        times = int(counts[values == wrong][0])
        raise InputError(
            f"{raster.label}: {wrong:g} stands in {times} of {known.size} cells and is no height; declare it as "
            f"no-data: gdal_edit.py -a_nodata {wrong:g} {raster.file}"
        )
    whole = dataset.scales[at] == 1.0 and (values == np.rint(values)).all()
    if whole and 1 < values.size <= 32:  # land-cover maps have no more classes
        raise InputError(
            f"{raster.label}: holds only {values.size} different values, all whole numbers: classes, or heights "
            "rounded to the metre, which show no obstacle; give heights in metres as float32"
        )
    return None if dataset.nodata is not None else _filled(raster, band, values, counts)


def _no_height(values: F64, metres: F64, declared: float | None) -> float | None:
    """Return a value that cannot be a height or, if no-data is not `declared`, is far from all others; else None.

    `values` (n,) are the different stored values, ascending, and `metres` (n,) the same values in metres. Common codes
    for unknown heights are no heights in metres. In another unit they may be (9999 dm), unless the step to the next
    value is the largest of all.
    """
    steps = np.abs(np.diff(metres))
    for at, own, others in ((0, steps[:1], steps[1:]), (-1, steps[-1:], steps[:-1])):
        is_alone = abs(metres[at]) == abs(values[at]) or not own.size or own[0] > others.max(initial=0.0)
        is_code = is_alone and values[at] in (-9999.0, -999.0, 9999.0)
        if is_code or not -HIGHEST <= metres[at] <= HIGHEST:
            return float(values[at])
    if declared is not None or values.size < 3:
        return None
    for at, rest in ((0, metres[1:]), (-1, metres[:-1])):
        gap = np.abs(metres[at] - rest).min()
        if gap > max(50.0, 2 * abs(rest[-1] - rest[0])):
            return float(values[at])
    return None


def _filled(raster: OpenedRaster, band: Band, values: F64, counts: I64) -> str | None:
    """Return a warning if one value fills 2 % of the cells although the other values hardly repeat; None otherwise.

    `values` (n,) are the different stored values, and `counts` (n,) the number of cells that hold each.
    """
    total, most = int(counts.sum()), int(counts.max())
    if values.size < 3 or most < 0.02 * total or (values.size - 1) < 0.2 * (total - most):
        return None
    value = values[counts.argmax()]
    return (
        f"{raster.path.name}: the height {band.heights(value):g} m stands in {100 * most / total:.0f} % of the cells "
        f"exactly; if that means 'not known', declare it: gdal_edit.py -a_nodata {value:g} {raster.file}"
    )
