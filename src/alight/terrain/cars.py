"""Standing cars: boxes of a car's height and sides beside bare or paved ground (G21)."""

from __future__ import annotations

import cv2
import numpy as np

from alight.arrays import F32, U8, Mask
from alight.raster import ellipse, grow
from alight.records import Terrain
from alight.settings import TerrainSettings

FILLED = 0.65  # least share of its rectangle that a car fills


def standing_cars(height_above: F32, label: U8, cell: float, settings: TerrainSettings) -> Mask:
    """Return the mask of cells, (R, C), on standing cars.

    Args:
        height_above: (R, C) height above the ground, metres, doubtful heights included; NaN = unknown. Windows and
            paint are matched badly, so that there may be few heights on a car.
        label: (R, C) land cover: most of the ground beside a car is paved or bare.
        cell: size of a cell, metres.
        settings: height and sides of a car.
    """
    (low, high), ((narrow, wide), (short, long)) = settings.car_height, settings.car_sides
    stands = ~(np.abs(height_above) < low / 2)
    stands = cv2.morphologyEx(stands.astype(np.uint8), cv2.MORPH_OPEN, ellipse(max(1, round(narrow / 4 / cell))))
    number, parts, boxes, _ = cv2.connectedComponentsWithStats(stands, connectivity=4)
    drives, out = np.isin(label, (Terrain.PAVED, Terrain.BARE)), np.zeros(label.shape, np.bool_)
    reach = max(1, round(narrow / cell))
    for k in range(1, number):
        left, top, width, depth, count = (int(v) for v in boxes[k])
        if not narrow * short / 2 < count * cell**2 < wide * long:
            continue
        part = slice(max(top - reach, 0), top + depth + reach), slice(max(left - reach, 0), left + width + reach)
        at = parts[part] == k
        sides = sorted((np.array(cv2.minAreaRect(np.argwhere(at).astype(np.float32))[1]) + 1) * cell)
        known = height_above[part][at & np.isfinite(height_above[part])]
        is_box = narrow <= sides[0] <= wide and short <= sides[1] <= long and count * cell**2 > FILLED * np.prod(sides)
        if is_box and known.size and low <= np.quantile(known, 0.75) <= high:
            beside = grow(at, reach) & ~at
            out[part] |= at & (drives[part][beside].mean() > 0.5)
    return out
