"""Touchdowns under wires: no vehicle comes down or goes up there."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from alight.arrays import Mask
from alight.geometry import Grid
from alight.records import Wire, nearest_wire
from alight.settings import Lander

SLACK = 0.7  # metres: how far a wire may be from where it was found
BEYOND = 4.0  # metres by which a wire may go on at either end of what was found of it


def under_wires(wires: Sequence[Wire], grid: Grid, lander: Lander) -> Mask:
    """Return the mask of touchdowns (R, C) with a wire over the vehicle or beside it, at any height."""
    distance, _ = nearest_wire([w.longer(BEYOND) for w in wires], grid)
    return np.asarray(distance <= lander.reach + SLACK)
