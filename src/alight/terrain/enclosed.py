"""Level surfaces by their rims (docs/method/land-cover.md, G13b, G13c).

Water is level along its length, and below both banks. So it is found under algae and floating plants, which look like
lawn or soil. It is found where it leaves the map, too: unseen parts of the rim do not count. A
flat roof is as bare and even as a yard, and the ground about it is lower; most of the rim must be seen for that.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import cv2
import numpy as np

from alight.arrays import F32, F64, I64, Mask
from alight.raster import block_quantile, gradient, linear_ramp, nearest_known, upsample
from alight.records import ElevationMap
from alight.settings import TerrainSettings
from alight.terrain.relief import ground_under

RIM = 2, 6  # blocks beyond a surface between which its rim lies: the foot of a bank is left out
ABOUT = 10  # blocks to which the rim of a roof reaches: beside a wall heights are in doubt


@dataclass(frozen=True)
class LevelSurfaces:
    """The connected level parts of a map, in blocks."""

    elevation: ElevationMap
    settings: TerrainSettings
    size: int  # cells of a block's side
    bed: F32  # (r, c) trusted heights of the blocks
    parts: I64  # (r, c) numbers of the parts, from 1; 0 is none
    areas: F64  # (parts + 1,) m^2; NaN for 0
    tilt: float  # rad, 1-sigma of the tilt that all heights share

    @classmethod
    def of(cls, elevation: ElevationMap, settings: TerrainSettings) -> LevelSurfaces:
        """Find the level surfaces of a map: trusted heights are surfaces, all are rims; they share the datum's tilt."""
        size = max(1, round(settings.block / elevation.grid.cell))
        block = size * elevation.grid.cell
        bed = block_quantile(np.where(elevation.trusted, elevation.height, np.float32(np.nan)), size, 0.5)
        tilt = 0.0 if elevation.datum is None else elevation.datum.tilt_sigma
        count, parts = _level_parts(bed, block, tilt, settings)
        areas = (np.bincount(parts.ravel(), minlength=count) * block**2).astype(np.float64)
        areas[0] = np.nan
        return cls(elevation, settings, size, bed, parts, areas, tilt)

    def enclosed(self) -> F32:
        """Degree to which every cell is part of a level surface below its banks (G13b), (R, C) 0 to 1."""
        settings, block = self.settings, self.size * self.elevation.grid.cell
        ground = ground_under(self.bed, settings.ground_window / (2 * block))  # hedges and cars are no banks
        large = np.flatnonzero(self.areas >= settings.water_area)
        return self._marked(large, 0, lambda part: _enclosure(part, self.bed, ground, block, self.tilt, settings))

    def raised(self) -> F32:
        """Degree to which every cell is part of a level surface above the ground about it (G13c), (R, C) 0 to 1."""
        settings = self.settings
        about = block_quantile(self.elevation.height, self.size, 0.5)
        about = np.pad(about, ABOUT, constant_values=np.nan)  # beyond the map: not seen
        smallest, largest = settings.roof_area
        roofs = np.flatnonzero((smallest <= self.areas) & (self.areas <= largest))
        return self._marked(roofs, ABOUT, lambda part: _height_over_rim(part, about, settings))

    def _marked(self, numbers: Iterable[int], pad: int, measure: Callable[[Mask], float]) -> F32:
        """Write the measure of some parts' masks to every cell of them and of their feet, (R, C); 0 elsewhere.

        `pad`: blocks that are added about the map for `measure`.
        """
        out = np.zeros(self.bed.shape, np.float32)
        for number in numbers:
            part = self.parts == number
            out[part] = measure(np.pad(part, pad))
        grown = cv2.dilate(out, np.ones((2 * RIM[0] + 1,) * 2, np.uint8))
        return upsample(np.asarray(grown, np.float32), self.size, self.elevation.grid.shape)


def _level_parts(bed: F32, block: float, tilt: float, settings: TerrainSettings) -> tuple[int, I64]:
    """Number of connected level parts plus 1, and the parts (R, C), numbered from 1."""
    known = np.isfinite(bed)
    filled = nearest_known(np.nan_to_num(bed), known)
    north, east = gradient(cv2.GaussianBlur(filled, (0, 0), 0.8) / np.float32(block))
    flat = known & (np.hypot(north, east) < settings.water_slope + 2 * tilt)
    flat = cv2.morphologyEx(flat.astype(np.uint8), cv2.MORPH_OPEN, np.ones((2, 2), np.uint8))
    count, parts = cv2.connectedComponents(flat * known.astype(np.uint8), connectivity=4)
    return count, parts.astype(np.int64)


def _rim(part: Mask, outer: int = RIM[1]) -> Mask:
    near, far = (cv2.dilate(part.astype(np.uint8), np.ones((2 * n + 1,) * 2, np.uint8)) > 0 for n in (RIM[0], outer))
    return np.asarray(far & ~near)


def _enclosure(part: Mask, bed: F32, ground: F32, block: float, tilt: float, settings: TerrainSettings) -> float:
    """Degree to which one part is level and lies below the ground of its rim, 0 to 1."""
    rows, cols = np.nonzero(part)
    terms = np.column_stack([np.ones(len(rows)), cols * block, rows * block])
    plane = np.linalg.lstsq(terms, bed[rows, cols].astype(np.float64), rcond=None)[0]
    slope = float(np.hypot(plane[1], plane[2]))
    uneven = float(np.sqrt(np.mean((bed[rows, cols] - terms @ plane) ** 2)))
    r, c = np.nonzero(_rim(part) & np.isfinite(ground))
    if len(r) < settings.water_rim_blocks:
        return 0.0
    above = ground[r, c] - np.column_stack([np.ones(len(r)), c * block, r * block]) @ plane
    higher = float((above > settings.water_bank).mean())
    level = 1 - float(linear_ramp(np.array([slope - 2 * tilt], np.float32), *settings.water_level)[0])
    even = 1 - float(linear_ramp(np.array([uneven], np.float32), *settings.water_even)[0])
    return level * even * float(linear_ramp(np.array([higher], np.float32), *settings.water_rim)[0])


def _height_over_rim(part: Mask, ground: F32, settings: TerrainSettings) -> float:
    """Degree to which the rim of one part lies a wall's height below it, 0 to 1; 0 where half of it is not seen."""
    rim = ground[_rim(part, ABOUT)]
    seen = np.isfinite(rim)
    if seen.sum() < max(settings.water_rim_blocks, 0.5 * rim.size):
        return 0.0
    lower = float((float(np.nanmedian(ground[part])) - rim[seen] > settings.roof_drop).mean())
    return float(linear_ramp(np.array([lower], np.float32), *settings.roof_rim)[0])
