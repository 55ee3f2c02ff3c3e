"""What a trial may cost: so much more than the healthy input as it leaves more pixels, and never less than that input.

Damage can make another healthy input: a scene file that lost its keys asks for 60 pictures where ours has four. Time
and memory are therefore held against the pixels of the pictures and rasters that the command left, or had left when
it was ended. A loop without end leaves nothing more, and what grows faster than its output costs more for each pixel:
both are found. An output that is larger than it ought to be is not.
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

SLOWER, LARGER = 10.0, 2.0  # than the healthy input
LEAST_SECONDS, MORE_MEGABYTES = 20.0, 300.0
LEAST_PIXELS = 100_000  # of the healthy input; many leave no picture at all
PATIENCE = 4.0  # times the limit of the healthy input, that a trial is waited for
TOO_SLOW = "too slow"


def pixels_left(folder: Path) -> int:
    """Pixels of the pictures and cells of the rasters below a folder; a file that is not whole has none."""
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
    """What the healthy input of a kind costs."""

    seconds: float  # of the processor
    megabytes: float  # at the most
    pixels: int  # that it leaves
    idle: float  # megabytes of a process that does nothing

    @property
    def limit(self) -> float:
        """Seconds of the processor for as many pixels."""
        return max(LEAST_SECONDS, SLOWER * self.seconds)

    def fault(self, found: Outcome, pixels: int) -> str | None:
        """What is wrong with a trial that left so many pixels: its answer, or what it cost; None: nothing."""
        if found.fault not in (None, TOO_SLOW):
            return found.fault
        more = max(1.0, pixels / max(self.pixels, LEAST_PIXELS))
        if found.seconds > more * self.limit:
            return TOO_SLOW
        own = max(self.megabytes - self.idle, 0.0)  # a process that idles counts its parent's memory when it is young
        if found.megabytes > self.idle + more * LARGER * own + MORE_MEGABYTES:
            return f"too large: {found.megabytes:.0f} MB"
        return None
