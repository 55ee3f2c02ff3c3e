"""Compare two sources of the positions of a set: how far they lie apart, and what would make them agree."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from alight.arrays import F64, I64
from alight.geometry.geodesy import MEAN_RADIUS

METRES_A_DEGREE = math.radians(MEAN_RADIUS)
SAME_ALTITUDE = 1.0  # m; two altitudes of a photo that differ by less are treated as equal
STEADY = 5.0  # m; altitudes above sea level and above take-off may drift apart by this much, up or down, in a flight
FACTORS = {0.3048: "as feet", -1.0: "with the opposite sign"}  # of heights, and how they are then read
SIGNS = {"sign of the longitude": (1, -1), "sign of the latitude": (-1, 1), "signs": (-1, -1)}


def places_apart(places: F64, others: F64) -> tuple[float, str]:
    """Return the median distance in metres between two sources of locations, and what would make them agree.

    Args:
        places, others: (n, 2) latitude and longitude, degrees, of the same photos.

    Returns:
        The distance, and the change to `places` that reduces it to a tenth, in words; empty: none does.
    """

    def apart(changed: F64) -> float:
        off = (changed - others + 180) % 360 - 180
        return METRES_A_DEGREE * float(np.median(np.hypot(off[:, 0], off[:, 1] * np.cos(np.radians(others[:, 0])))))

    left = {f"with the {what} changed": apart(places * np.array(signs)) for what, signs in SIGNS.items()}
    left["with latitude and longitude exchanged"] = apart(places[:, ::-1])
    straight, best = apart(places), min(left, key=left.__getitem__)
    return straight, best if left[best] < 0.1 * straight else ""


def factor_by(heights: F64, others: F64, size: Callable[[F64], float]) -> float:
    """Return the factor of `FACTORS` that makes heights agree ten times better with another source; 1: none does.

    Args:
        heights, others: (n,) metres, of the same photos.
        size: returns the size in metres of differences (n,), for example their median.
    """
    left = {factor: size(factor * heights - others) for factor in FACTORS}
    best, straight = min(left, key=left.__getitem__), size(heights - others)
    return best if straight > SAME_ALTITUDE and left[best] < 0.1 * straight else 1.0


def drift(difference: F64, flights: I64) -> float:
    """Return the largest range (m, 5th to 95th percentile) of `difference` (n,) within one flight.

    `flights` (n,) are flight indices. NaN if all differences are NaN.
    """
    parts = [difference[(flights == f) & np.isfinite(difference)] for f in np.unique(flights)]
    return max((float(np.ptp(np.percentile(p, [5, 95]))) for p in parts if len(p)), default=math.nan)
