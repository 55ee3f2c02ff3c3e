"""Test of a band for heights: undeclared no-data, classes and pictures must not be judged as flat ground."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from rasterio.enums import ColorInterp

from alight.arrays import F32, F64
from alight.records import InputError

LOWEST, HIGHEST = -12_000.0, 12_000.0  # metres: no ground of the Earth lies outside
NO_DATA = (-9999.0, -999.0, 9999.0)  # metres: values that programs write for unknown heights
FEW = 32  # different whole numbers: more classes than any map of land cover has
OFTEN = 0.02  # share of the cells with exactly one value, from which it may stand for no-data
TELLING = 0.2  # share of different values among the others, from which a repeated one is no accident


def doubt_of_heights(path: Path, height: F32, dataset: Any) -> str | None:
    """Test whether a band may be taken for heights; return None, or a doubt in words.

    Args:
        path: of the raster, for messages.
        height: (R, C) metres, NaN where no-data is declared.
        dataset: that it was read from.

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
    if 1 < values.size <= FEW and (values == np.rint(values)).all():
        raise InputError(
            f"{path}: holds only {values.size} different values, all whole numbers: classes, or heights rounded to the "
            "metre, which show no obstacle; give heights in metres as float32"
        )
    return None if dataset.nodata is not None else _filled(path, values, counts)


def _no_height(values: F64, declared: float | None) -> float | None:
    """A value that cannot be a height, or that lies apart from all others at an end of them; None: there is none."""
    for v in (values[0], values[-1]):
        if not LOWEST <= v <= HIGHEST or v in NO_DATA:
            return float(v)
    if declared is not None or values.size < 3:
        return None
    for end, rest in ((values[0], values[1:]), (values[-1], values[:-1])):
        gap = abs(end - (rest[0] if end < rest[0] else rest[-1]))
        if gap > max(50.0, 2 * (rest[-1] - rest[0])):
            return float(end)
    return None


def _filled(path: Path, values: F64, counts: np.ndarray[Any, np.dtype[np.int64]]) -> str | None:
    """A doubt where one value stands in many cells although the others hardly ever repeat."""
    total, most = int(counts.sum()), int(counts.max())
    others = total - most
    if values.size < 3 or most < OFTEN * total or (values.size - 1) < TELLING * others:
        return None
    value = float(values[counts.argmax()])
    return (
        f"{path.name}: the height {value:g} m stands in {100 * most / total:.0f} % of the cells exactly; if that means "
        f"'not known', declare it: gdal_edit.py -a_nodata {value:g}"
    )
