"""Limits of the cost of a trial: in proportion to its pixels over those of the healthy input, and never less than it.

Damage can make another healthy input: a scene file without some keys makes 60 pictures, and the healthy one makes
four. Time and memory are therefore compared with the pixels of the pictures and rasters that the command wrote,
finished or not. An endless loop writes nothing more, and an algorithm of higher order costs more for each pixel:
both are found. An output that is too large is not found.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import rasterio
from PIL import Image
from rasterio.errors import RasterioError

if TYPE_CHECKING:
    from trial import Outcome

SLOWER, LARGER = 10.0, 2.0  # times the cost of the healthy input
LEAST_SECONDS, MORE_MEGABYTES = 20.0, 300.0
LEAST_PIXELS = 100_000  # of the healthy input; many inputs make no picture at all
PATIENCE = 4.0  # times the limit of the healthy input, after which a trial is ended
TOO_SLOW = "too slow"


def pixels_left(folder: Path) -> int:
    """Number of pixels of pictures and cells of rasters below a folder; an incomplete file counts as none."""
    return sum(_pixels(path) for path in folder.rglob("*.*") if path.is_file())


def _pixels(path: Path) -> int:
    try:
        if path.suffix == ".tif":
            with rasterio.open(path) as raster:
                return int(raster.width * raster.height)
        if path.suffix in (".png", ".jpg"):
            with Image.open(path) as picture:
                return picture.width * picture.height
    except (OSError, RasterioError):
        pass
    return 0


@dataclass(frozen=True)
class Cost:
    """Cost of the healthy input of a kind."""

    seconds: float  # of processor time
    megabytes: float  # peak
    pixels: int  # that it writes
    idle: float  # megabytes of an idle process

    @property
    def limit(self) -> float:
        """Limit of processor time for as many pixels as the healthy input has, s."""
        return max(LEAST_SECONDS, SLOWER * self.seconds)

    def fault(self, found: Outcome, pixels: int) -> str | None:
        """Return the fault of a trial that wrote so many pixels, its answer or its cost; None: no fault."""
        if found.fault not in (None, TOO_SLOW):
            return found.fault
        more = max(1.0, pixels / max(self.pixels, LEAST_PIXELS))
        if found.seconds > more * self.limit:
            return TOO_SLOW
        own = max(self.megabytes - self.idle, 0.0)  # at its start a process counts its parent's memory
        if found.megabytes > self.idle + more * LARGER * own + MORE_MEGABYTES:
            return f"too large: {found.megabytes:.0f} MB"
        return None
