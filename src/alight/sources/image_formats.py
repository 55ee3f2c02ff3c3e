"""Read HEIC and raw pictures, and scale pictures with more than eight bits to eight by one range for a whole set."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL.TiffImagePlugin import BITSPERSAMPLE

from alight.arrays import F64, U8
from alight.records import InputError, MissingExtraError

PLAIN = (".jpg", ".jpeg", ".png", ".tif", ".tiff")  # suffixes that need no extra
EXTRAS = {  # suffix: the optional package that reads such files, and Alight's extra
    ".heic": ("pillow_heif", "heic"), ".heif": ("pillow_heif", "heic"), ".hif": ("pillow_heif", "heic"),
    ".dng": ("rawpy", "raw"),
}  # fmt: skip


def missing_extra(path: Path) -> MissingExtraError | None:
    """Return the error that names the extra needed to read a file; None if no further extra is needed."""
    package, extra = EXTRAS.get(path.suffix.lower(), ("PIL", ""))
    return None if find_spec(package) else MissingExtraError(package, extra)


def extra_of(path: Path) -> str:
    """Return Alight's extra for a file's format, by its suffix; empty: none is needed."""
    return EXTRAS.get(path.suffix.lower(), ("PIL", ""))[1]


def developed(path: Path) -> U8:
    """Develop a raw picture, (H, W, 3) RGB, without rotation and without adjusting its brightness.

    Raises:
        ValueError: the file is damaged.
    """
    with opened_raw(path) as raw:
        return np.asarray(raw.postprocess(use_camera_wb=True, no_auto_bright=True, user_flip=0), np.uint8)


def opened_raw(path: Path) -> Any:
    """Open a raw picture with rawpy, as a context manager; raise ValueError if the file is damaged."""
    import rawpy

    try:
        return rawpy.imread(str(path))
    except rawpy.LibRawError as e:
        raise ValueError(f"it is no raw picture ({e})") from e


def bits_of(image: Any) -> int:
    """Return the most bits per value of a picture opened by pillow."""
    if image.format == "PNG":
        return 16 if "16" in str(image.tile) else 8
    return max(image.tag_v2.get(BITSPERSAMPLE, (8,))) if image.format == "TIFF" else 8


class Levels(NamedTuple):
    """Pixel values that map to 0 and 255, the same for all pictures of a set; for pictures of more than eight bits."""

    low: float
    high: float

    def eight_bits(self, path: Path) -> U8:
        """Read a picture and scale it to eight bits, (H, W) or (H, W, 3).

        Raises:
            ValueError: the picture cannot be read.
        """
        span = max(self.high - self.low, np.finfo(float).tiny)
        share = (np.nan_to_num(_values(path)) - self.low) / span
        return np.asarray(np.rint(255.0 * share.clip(0.0, 1.0)), np.uint8)


def levels_of(paths: Sequence[Path]) -> Levels | None:
    """Determine the levels of a set of similar pictures of more than eight bits, from about 24; None: none can be read.

    Up to a thousandth of a picture's pixels, such as hot pixels and reflections, may lie below the lower level, and as
    many above the upper level. In colour, the lower level is 0, because a higher one would change the ratios of
    colours.
    """
    lows, highs = [], []
    for path in paths[:: -(-len(paths) // 24) or 1]:
        with suppress(ValueError):
            values = _values(path, 512)
            known = values[np.isfinite(values)]
            if known.size:
                low, high = np.percentile(known, [0.1, 99.9])
                lows.append(0.0 if values.ndim == 3 else float(low))
                highs.append(float(high))
    return Levels(min(lows), max(highs)) if lows else None


def _values(path: Path, longest: int | None = None) -> F64:
    """Return the values as stored, (H, W) or (H, W, 3), downsampled if `longest` limits the longer side."""
    from alight.sources.opened_raster import open_raster
    from alight.sources.raster_band import bands_of_picture

    try:
        with open_raster(path) as raster:
            rows, cols = raster.dataset.shape
            share = min(1.0, (longest or rows + cols) / max(rows, cols))
            bands = bands_of_picture(raster)
            shape = len(bands), max(1, round(rows * share)), max(1, round(cols * share))
            values = raster.dataset.read(bands, out_shape=shape).astype(np.float64)
    except InputError as e:
        raise ValueError(str(e)) from e
    return np.asarray(values[0] if len(bands) == 1 else np.moveaxis(values, 0, -1))
