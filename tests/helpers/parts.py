"""A map without heights, and one of which a step refined some rectangles."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from alight.elevation import FIELDS, TiledElevation
from alight.geometry import Grid
from alight.records import ElevationMap, Heights


def nothing_known(grid: Grid) -> ElevationMap:
    """A map without any height."""
    return TiledElevation(grid.cell, 64).read(grid)


def with_parts(known: ElevationMap, parts: Iterable[Heights]) -> ElevationMap:
    """The map with heights of some rectangles replaced."""
    fields: dict[str, Any] = {k: getattr(known, k).copy() for k in FIELDS}
    for part in parts:
        row, col = (round(float(v)) for v in known.grid.index(np.array(part.grid.east), np.array(part.grid.north)))
        for k, values in fields.items():
            values[row : row + part.grid.rows, col : col + part.grid.cols] = getattr(part, k)
    return replace(known, **fields)
