"""Pictures beyond eight bits, HEIC and raw pictures: their values as eight bits, by one range for a whole set."""

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

EXTRAS = {  # suffix of files that an optional package reads: the package, and our extra
    ".heic": ("pillow_heif", "heic"), ".heif": ("pillow_heif", "heic"), ".hif": ("pillow_heif", "heic"),
    ".dng": ("rawpy", "raw"),
}  # fmt: skip


def missing_extra(path: Path) -> MissingExtraError | None:
    """The error that names the extra without which a file cannot be read; None: it can."""
    package, extra = EXTRAS.get(path.suffix.lower(), ("PIL", ""))
    return None if find_spec(package) else MissingExtraError(package, extra)


def is_raw(path: Path) -> bool:
    """Whether a file holds the values of a sensor, by its name."""
    return EXTRAS.get(path.suffix.lower(), ("", ""))[1] == "raw"


def raw_size(path: Path) -> tuple[int, int]:
    """(width, height) of a raw picture.

    Raises:
        ValueError: it is damaged.
    """
    with _opened_raw(path) as raw:
        return int(raw.sizes.width), int(raw.sizes.height)


def raw_pixels(path: Path) -> U8:
    """Develop a raw picture, (H, W, 3), as it is stored; all pictures of a set with the same brightness.

    Raises:
        ValueError: it is damaged.
    """
    with _opened_raw(path) as raw:
        return np.asarray(raw.postprocess(use_camera_wb=True, no_auto_bright=True, user_flip=0), np.uint8)


def _opened_raw(path: Path) -> Any:
    import rawpy

    try:
        return rawpy.imread(str(path))
    except rawpy.LibRawError as e:
        raise ValueError(f"it is no raw picture ({e})") from e


def bits_of(image: Any) -> int:
    """Bits of the deepest value of a picture that pillow has opened."""
    if image.format == "PNG":
        return 16 if "16" in str(image.tile) else 8
    return max(image.tag_v2.get(BITSPERSAMPLE, (8,))) if image.format == "TIFF" else 8


class Levels(NamedTuple):
    """The values that become 0 and 255 in all pictures of a set with more than eight bits."""

    low: float
    high: float

    def eight_bits(self, path: Path) -> U8:
        """The pixels of a picture, (H, W) or (H, W, 3).

        Raises:
            ValueError: it cannot be read.
        """
        span = max(self.high - self.low, np.finfo(float).tiny)
        share = (np.nan_to_num(_values(path)) - self.low) / span
        return np.asarray(np.rint(255.0 * share.clip(0.0, 1.0)), np.uint8)


def levels_of(paths: Sequence[Path]) -> Levels | None:
    """The range of a set of pictures with more than eight bits, all of the same kind; None: none can be read.

    A thousandth of the pixels of a picture may lie below, and above it: hot pixels and reflections. Colours begin at
    0: a higher value would change their ratios.
    """
    lows, highs = [], []
    for path in paths:
        with suppress(ValueError):
            values = _values(path, 512)
            known = values[np.isfinite(values)]
            if known.size:
                low, high = np.percentile(known, [0.1, 99.9])
                lows.append(0.0 if values.ndim == 3 else float(low))
                highs.append(float(high))
    return Levels(min(lows), max(highs)) if lows else None


def _values(path: Path, longest: int | None = None) -> F64:
    """The values as stored, (H, W) or (H, W, 3), with fewer pixels if `longest` limits the longer side."""
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
