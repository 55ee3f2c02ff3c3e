"""Truly safe touchdowns, and their parts (shape, class), by brute force on the true surface and classes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from alight.evaluation.flight import NEAR, FlightTruth
from alight.geometry import Grid
from alight.records import LANDABLE, Terrain
from alight.settings import Lander
from alight_sim import TrueFootprint
from alight_sim.truth import safe_mask

Bool = NDArray[np.bool_]
STANDS = 0.08  # metres above the ground about it: flat rock is no obstacle


@dataclass(frozen=True, eq=False)
class GroundTruth:
    """One flight's truth on its own grid, (R, C) masks."""

    truth: FlightTruth
    lander: Lander

    @cached_property
    def level(self) -> Bool:
        """Slope and roughness of the true surface keep the lander's limits, whatever class the ground has."""
        foot = TrueFootprint(self.lander.radius, self.lander.max_slope, self.lander.max_roughness)
        bare = np.full_like(self.truth.label, int(Terrain.BARE))
        return np.asarray(safe_mask(self.truth.dem, bare, self.truth.grid.cell, foot), np.bool_)

    @cached_property
    def even(self) -> Bool:
        """`level` holds, and no rock stands in the footprint: from afar the height of a stone is uncertain."""
        return self.level & self._away_from((self.truth.label == Terrain.ROCK) & self._standing)

    @cached_property
    def bears(self) -> Bool:
        """No cell of the footprint has a class that may not be landed on, rock left aside."""
        return self._away_from(~np.isin(self.truth.label, [int(k) for k in (*LANDABLE, Terrain.ROCK)]))

    @cached_property
    def safe(self) -> Bool:
        """The shape keeps its limits, and no cell of the footprint has a class that may not be landed on."""
        return self.even & self._away_from(~np.isin(self.truth.label, [int(k) for k in LANDABLE]))

    @property
    def _standing(self) -> Bool:
        """Cells that are higher than the ground about them, an opening by a window of 2 m."""
        window = np.ones((2 * round(1.0 / self.truth.grid.cell) + 1,) * 2, np.uint8)
        dem = np.nan_to_num(self.truth.dem, nan=float(np.nanmin(self.truth.dem))).astype(np.float32)
        return np.asarray(dem - cv2.morphologyEx(dem, cv2.MORPH_OPEN, window) > STANDS)

    def _away_from(self, barred: Bool) -> Bool:
        if not barred.any():
            return ~barred
        return np.asarray(distance_transform_edt(~barred) * self.truth.grid.cell > self.lander.radius)

    def near(self, mask: Bool, metres: float = NEAR) -> Bool:
        """The mask, and all cells within `metres` of it: edges are drawn no better than that."""
        if not mask.any():
            return mask
        return np.asarray(distance_transform_edt(~mask) * self.truth.grid.cell <= metres)

    def on(self, grid: Grid, mask: Bool) -> Bool:
        """The nearest value of a mask at every cell of another grid; False outside."""
        return self.truth.grid.nearest_on(grid, mask)
