"""Level surfaces by their rims (docs/method/land-cover.md, G13b, G13c).

Water is level along its length and below both banks. So it is found even under algae and floating plants, which look
like lawn or soil, and where it leaves the map, as unseen parts of the rim are ignored. A flat roof is as bare and even
as a yard, but the ground around it is lower. Most of a roof's rim must be seen.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import cv2
import numpy as np

from alight.arrays import F32, F64, I64, Mask
from alight.raster import block_quantile, gradient, linear_ramp, nearest_known, upsample
from alight.records import ElevationMap
from alight.settings import TerrainSettings
from alight.terrain.relief import ground_under

RIM = 2, 6  # blocks from a surface, start and end of its rim, without the foot of a bank
ABOUT = 10  # blocks from a roof, end of its rim: heights beside a wall are doubtful


@dataclass(frozen=True)
class LevelSurfaces:
    """Connected level parts of a map, in blocks."""

    elevation: ElevationMap
    settings: TerrainSettings
    size: int  # side of a block, cells
    bed: F32  # (r, c) median trusted height of each block
    ground: F32  # (r, c) the same under hedges and cars, which are not banks
    parts: I64  # (r, c) index of each block's part, from 1; 0: no part
    areas: F64  # (parts + 1,) m^2, by index; NaN for index 0
    tilt: float  # rad, 1-sigma of the map's common tilt

    @classmethod
    def of(cls, elevation: ElevationMap, settings: TerrainSettings) -> LevelSurfaces:
        """Find the level surfaces of a map in its trusted heights, allowing for the tilt of its datum."""
        size = max(1, round(settings.block / elevation.grid.cell))
        block = size * elevation.grid.cell
        bed = block_quantile(np.where(elevation.trusted, elevation.height, np.float32(np.nan)), size, 0.5)
        tilt = 0.0 if elevation.datum is None else elevation.datum.tilt_sigma
        ground, level = ground_under(bed, settings.ground_window / (2 * block)), _is_level(bed, block, tilt, settings)
        return cls(elevation, settings, size, bed, ground, *_parts(level, block), tilt)

    def pools(self, alike: Mask) -> Mask:
        """Return the mask (R, C) of level patches of what looks like water and stands no higher than its rim (G15b).

        `alike`: (R, C) mask of cells that look like water and are not sealed, as sealed ground is as level.
        """
        patches = (block_quantile(alike.astype(np.float32), self.size, 0.5) > 0.5) & np.isfinite(self.bed)
        parts, areas = _parts(patches, self.size * self.elevation.grid.cell)
        return replace(self, parts=parts, areas=areas).enclosed(-self.settings.water_bank) > 0.5

    def enclosed(self, bank: float | None = None) -> F32:
        """Compute the degree, 0 to 1, to which each cell belongs to a level surface below its banks (G13b), (R, C).

        `bank`: least height of a bank above the surface, metres; None: that of the settings.
        """
        settings, block = self.settings, self.size * self.elevation.grid.cell
        bank = settings.water_bank if bank is None else bank
        large = np.flatnonzero(self.areas >= settings.water_area)
        return self._marked(
            large, 0, lambda part: _enclosure(part, self.bed, self.ground, block, self.tilt, bank, settings)
        )

    def raised(self) -> F32:
        """Compute the degree, 0 to 1, to which each cell belongs to a level surface above its rim (G13c), (R, C)."""
        settings = self.settings
        about = block_quantile(self.elevation.height, self.size, 0.5)
        about = np.pad(about, ABOUT, constant_values=np.nan)  # unseen beyond the map
        smallest, largest = settings.roof_area
        roofs = np.flatnonzero((smallest <= self.areas) & (self.areas <= largest))
        return self._marked(roofs, ABOUT, lambda part: _height_over_rim(part, about, settings))

    def _marked(self, numbers: Iterable[int], pad: int, measure: Callable[[Mask], float]) -> F32:
        """Return an array (R, C) with the measure of each part in `numbers` on its cells and on a margin; 0 elsewhere.

        `measure` gets the mask of a part, padded by `pad` blocks on every side.
        """
        out = np.zeros(self.bed.shape, np.float32)
        for number in numbers:
            part = self.parts == number
            out[part] = measure(np.pad(part, pad))
        grown = cv2.dilate(out, np.ones((2 * RIM[0] + 1,) * 2, np.uint8))
        return upsample(np.asarray(grown, np.float32), self.size, self.elevation.grid.shape)


def _is_level(bed: F32, block: float, tilt: float, settings: TerrainSettings) -> Mask:
    """Return the mask of level blocks.

    `bed`: (r, c) heights, metres. `block`: side of a block, metres. `tilt`: 1-sigma of the map's tilt, rad.
    """
    known = np.isfinite(bed)
    filled = nearest_known(np.nan_to_num(bed), known)
    north, east = gradient(cv2.GaussianBlur(filled, (0, 0), 0.8) / np.float32(block))
    flat = known & (np.hypot(north, east) < settings.water_slope + 2 * tilt)
    flat = cv2.morphologyEx(flat.astype(np.uint8), cv2.MORPH_OPEN, np.ones((2, 2), np.uint8)) > 0
    return np.asarray(flat & known)


def _parts(blocks: Mask, block: float) -> tuple[I64, F64]:
    """Return the index of each block's connected part, from 1, and the areas by index, m^2; `block`: side, metres."""
    count, parts = cv2.connectedComponents(blocks.astype(np.uint8), connectivity=4)
    areas = (np.bincount(parts.ravel(), minlength=count) * block**2).astype(np.float64)
    areas[0] = np.nan
    return parts.astype(np.int64), areas


def _rim(part: Mask, outer: int = RIM[1]) -> Mask:
    near, far = (cv2.dilate(part.astype(np.uint8), np.ones((2 * n + 1,) * 2, np.uint8)) > 0 for n in (RIM[0], outer))
    return np.asarray(far & ~near)


def _enclosure(
    part: Mask, bed: F32, ground: F32, block: float, tilt: float, bank: float, settings: TerrainSettings
) -> float:
    """Return the degree, 0 to 1, to which a part (mask of blocks) is level and lower than the ground of its rim.

    `bed`, `block`, `tilt`: see `_is_level`. `ground`: heights of the ground, metres, NaN = unseen.
    """
    rows, cols = np.nonzero(part)
    terms = np.column_stack([np.ones(len(rows)), cols * block, rows * block])
    plane = np.linalg.lstsq(terms, bed[rows, cols].astype(np.float64), rcond=None)[0]
    slope = float(np.hypot(plane[1], plane[2]))
    uneven = float(np.sqrt(np.mean((bed[rows, cols] - terms @ plane) ** 2)))
    r, c = np.nonzero(_rim(part) & np.isfinite(ground))
    if len(r) * block**2 < settings.water_area:  # too little of the rim was seen
        return 0.0
    above = ground[r, c] - np.column_stack([np.ones(len(r)), c * block, r * block]) @ plane
    higher = float((above > bank).mean())
    level = 1 - float(linear_ramp(np.array([slope - 2 * tilt], np.float32), *settings.water_level)[0])
    even = 1 - float(linear_ramp(np.array([uneven], np.float32), *settings.water_even)[0])
    return level * even * float(linear_ramp(np.array([higher], np.float32), *settings.rim)[0])


def _height_over_rim(part: Mask, ground: F32, settings: TerrainSettings) -> float:
    """Return the degree, 0 to 1, to which a part (mask of blocks) is a wall's height above its rim.

    It is 0 if half the rim is unseen. `ground`: heights of the surface, metres, NaN = unseen.
    """
    rim = ground[_rim(part, ABOUT)]
    seen = np.isfinite(rim)
    if seen.sum() < 0.5 * rim.size:
        return 0.0
    lower = float((float(np.nanmedian(ground[part])) - rim[seen] > settings.tall).mean())
    return float(linear_ramp(np.array([lower], np.float32), *settings.rim)[0])
