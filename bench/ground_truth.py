"""Where a touchdown is truly safe, and why not: by brute force on the true surface and classes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from alight.evaluation.flight import NEAR, FlightTruth, at
from alight.geometry import Grid
from alight.records import LANDABLE, Terrain
from alight.settings import Lander
from alight_sim import TrueFootprint
from alight_sim.truth import safe_mask

Bool = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class GroundTruth:
    """One flight's truth on its own grid, (R, C) masks."""

    truth: FlightTruth
    lander: Lander

    @cached_property
    def even(self) -> Bool:
        """Slope and roughness of the true surface keep their limits, and no cell of the footprint is rock."""
        foot = TrueFootprint(self.lander.radius, self.lander.max_slope, self.lander.max_roughness)
        bare = np.full_like(self.truth.label, int(Terrain.BARE))
        level = np.asarray(safe_mask(self.truth.dem, bare, self.truth.grid.cell, foot), np.bool_)
        return level & self._without([Terrain.ROCK])

    @cached_property
    def bears(self) -> Bool:
        """No cell of the footprint has a class that may not be landed on, rock left aside."""
        return self._without([k for k in Terrain if k not in (*LANDABLE, Terrain.ROCK)])

    def _without(self, kinds: Sequence[Terrain]) -> Bool:
        barred = np.isin(self.truth.label, [int(k) for k in kinds])
        if not barred.any():
            return ~barred
        return np.asarray(distance_transform_edt(~barred) * self.truth.grid.cell > self.lander.radius)

    @property
    def safe(self) -> Bool:
        """Both."""
        return self.even & self.bears

    def near(self, mask: Bool, metres: float = NEAR) -> Bool:
        """The mask, and what lies within `metres` of it: edges are drawn no better than that."""
        if not mask.any():
            return mask
        return np.asarray(distance_transform_edt(~mask) * self.truth.grid.cell <= metres)

    def on(self, grid: Grid, mask: Bool) -> Bool:
        """The nearest value of a mask at every cell of another grid; False outside."""
        e, n = np.meshgrid(*grid.xy())
        return np.asarray(at(mask.astype(np.uint8), self.truth.grid, e, n) > 0)
