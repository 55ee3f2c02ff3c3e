"""A GeoTIFF that is written in parts, as its bands are too large to be held in memory."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.crs import CRS
from rasterio.enums import Resampling
from rasterio.windows import Window

from alight.geometry.grid import Box
from alight.outputs.atomic_write import ANOTHER
from alight.outputs.rasters import RasterFile, describe_bands, profile_of
from alight.raster import unreadable
from alight.records import OutputError


def read_box(path: Path, box: Box, bands: Sequence[int]) -> NDArray[Any]:
    """Read a box of rows and columns of bands, numbered from 1: (B, R, C)."""
    with rasterio.open(path) as dataset:
        return np.asarray(dataset.read(list(bands), window=Window.from_slices(*box)))


class TiledFile:
    """A tiled, deflated GeoTIFF that is written in parts, and gets its overviews at the end; a context manager.

    Args:
        path: the file.
        like: grid of the file in units of `crs`, names, units and tags; its bands may be those of any part.
        crs: coordinate system.
    """

    def __init__(self, path: Path, like: RasterFile, crs: CRS) -> None:
        self._path, empty = path, np.broadcast_to(like.bands[:, :1, :1], (len(like.bands), *like.grid.shape))
        self._raster = replace(like, bands=empty)
        # the bands are apart and may have holes, as one of them is written later than the others
        options = {"driver": "GTiff", "tiled": True, "interleave": "band", "sparse_ok": True, "bigtiff": "if_safer"}
        options |= {"zlevel": 1, "predictor": 3 if empty.dtype.kind == "f" else 2}
        self._dataset: Any = rasterio.open(path, "w", **profile_of(self._raster, crs), **options)
        describe_bands(self._dataset, self._raster)

    def __enter__(self) -> TiledFile:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: object, trace: TracebackType | None) -> None:
        self._dataset.close()

    def write(self, box: Box, bands: NDArray[Any], numbers: Sequence[int]) -> None:
        """Write bands (B, R, C), numbered from 1, of a box of rows and columns.

        Raises:
            OutputError: the disk is full.
        """
        with self._errors():
            self._dataset.write(bands, list(numbers), window=Window.from_slices(*box))

    @contextmanager
    def _errors(self) -> Iterator[None]:
        try:
            yield
        except unreadable() as e:
            why = " ".join(str(e).split())
            raise OutputError(f"{self._path}: cannot be written ({why}); free some space or {ANOTHER}") from e

    def add_overviews(self) -> None:
        """Add the overviews; nothing is written after them.

        Raises:
            OutputError: the disk is full.
        """
        with self._errors():
            self._dataset.close()
        with self._errors(), rasterio.open(self._path, "r+") as dataset:
            most = max(dataset.shape) / dataset.block_shapes[0][0]
            factors = [2**n for n in range(1, 31) if 2 ** (n - 1) < most]
            dataset.build_overviews(factors, Resampling[self._raster.resampling.lower()])
