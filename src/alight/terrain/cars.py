"""Standing cars: boxes of a car's height and sides, or rows of them, beside bare or paved ground (G21)."""

from __future__ import annotations

import cv2
import numpy as np

from alight.arrays import F32, Mask
from alight.raster import ellipse, grow
from alight.settings import TerrainSettings

FILLED = 0.6  # least share of its rectangle that a car or a row of cars fills


def standing_cars(height_above: F32, green: F32, cell: float, settings: TerrainSettings) -> Mask:
    """Return the mask of cells, (R, C), on standing cars.

    Args:
        height_above: (R, C) height above the ground, metres, doubtful heights included; NaN = unknown. Windows and
            paint are matched badly, so that there may be few heights on a car.
        green: (R, C) excess green: a car is not green as plants are, nor is most of the ground beside it. The class of
            that ground does not count, as ground beside what is tall is taken for that (G18).
        cell: size of a cell, metres.
        settings: height and sides of a car.
    """
    (low, high), ((narrow, wide), (short, long)) = settings.car_height, settings.car_sides
    stands = ~(np.abs(height_above) < low / 2)
    stands = cv2.morphologyEx(stands.astype(np.uint8), cv2.MORPH_OPEN, ellipse(max(1, round(narrow / 4 / cell))))
    number, parts, boxes, _ = cv2.connectedComponentsWithStats(stands, connectivity=4)
    leafless, out = np.nan_to_num(green) < settings.leafy, np.zeros(green.shape, np.bool_)
    reach = max(1, round(narrow / cell))
    for k in range(1, number):
        left, top, width, depth, count = (int(v) for v in boxes[k])
        if count * cell**2 < narrow * short / 2:
            continue
        part = slice(max(top - reach, 0), top + depth + reach), slice(max(left - reach, 0), left + width + reach)
        at = parts[part] == k
        sides = sorted((np.array(cv2.minAreaRect(np.argwhere(at).astype(np.float32))[1]) + 1) * cell)
        known = height_above[part][at & np.isfinite(height_above[part])]
        is_car = narrow <= sides[0] <= wide and short <= sides[1] <= long
        is_row = short <= sides[0] <= long  # of cars side by side: their gaps are lost in the heights
        is_high = known.size > 0 and low <= np.quantile(known, 0.75) <= high
        if (is_car or is_row) and is_high and count * cell**2 > FILLED * np.prod(sides):
            beside = grow(at, reach) & ~at
            open_ground = (leafless[part] & (stands[part] == 0))[beside].mean()
            out[part] |= at & (min(open_ground, leafless[part][at].mean()) > 0.5)
    return out
