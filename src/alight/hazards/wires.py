"""Touchdowns under wires: no vehicle comes down or goes up there."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from alight.arrays import F32, Mask
from alight.geometry import Grid
from alight.records import Wire, nearest_wire
from alight.records.wires import BEYOND
from alight.settings import Lander

SLACK = 0.7  # metres: how far a wire may be from where it was found


def under_wires(wires: Sequence[Wire], grid: Grid, lander: Lander) -> Mask:
    """Return the mask of touchdowns (R, C) with a found wire over the vehicle or beside it, at any height."""
    return _below([w.longer(BEYOND) for w in wires if w.is_found], grid, lander)


def no_wire(wires: Sequence[Wire], grid: Grid, lander: Lander) -> F32:
    """Return the probability (R, C) that none of the doubtful wires hangs over a touchdown."""
    out = np.ones(grid.shape, np.float32)
    for w in wires:
        if not w.is_found:
            out[_below([w], grid, lander)] *= np.float32(1 - w.chance)
    return out


def _below(wires: Sequence[Wire], grid: Grid, lander: Lander) -> Mask:
    distance, _ = nearest_wire(wires, grid)
    return np.asarray(distance <= lander.reach + SLACK)
