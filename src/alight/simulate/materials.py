"""What each class of ground looks like: colours, contrast at every scale, flecks, sway."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from alight.records import Terrain

F64 = NDArray[np.float64]
Colour = tuple[float, float, float]

OCTAVES = 9  # 3 m down to 1.2 cm


@dataclass(frozen=True)
class Material:
    """One look; linear reflectances."""

    first: Colour  # mixed with `second` by noise of some metres
    second: Colour
    contrast: float  # standard deviation of the reflectance over its mean, all octaves
    roughening: float  # amplitude of an octave goes with wavelength to this power: 0 = as much at every scale
    bump: float  # slope of the micro-relief that the sun shades
    flecks: float = 0.0  # share of lattice cells with a pebble, a leaf, a flower
    fleck_size: float = 0.02  # metres, radius
    fleck_gain: float = 0.5  # largest change of reflectance
    sway: float = 0.0  # metres, in the wind

    def row(self) -> list[float]:
        """The columns that the kernel takes."""
        numbers = (self.contrast, self.bump, self.flecks, self.fleck_size, self.fleck_gain, self.sway)
        return [*self.first, *self.second, *numbers]

    def amplitudes(self) -> F64:
        """(OCTAVES,) standard deviation of each octave, of unit sum of squares."""
        a = 0.5 ** (self.roughening * np.arange(OCTAVES, dtype=np.float64))
        return np.asarray(a / np.sqrt((a * a).sum()))


MATERIALS: dict[Terrain, Material] = {
    Terrain.UNKNOWN: Material((0.2, 0.2, 0.2), (0.2, 0.2, 0.2), 0.2, 0.1, 0.1),
    Terrain.BARE: Material((0.26, 0.19, 0.13), (0.32, 0.27, 0.21), 0.22, 0.05, 0.10, 0.5, 0.025, 0.6),
    Terrain.SHORT_GRASS: Material((0.09, 0.15, 0.035), (0.20, 0.19, 0.075), 0.24, 0.0, 0.10, 0.2, 0.03, 0.5),
    Terrain.TALL_VEGETATION: Material((0.10, 0.13, 0.035), (0.22, 0.20, 0.08), 0.38, -0.05, 0.2, sway=0.02),
    Terrain.TREE: Material((0.035, 0.07, 0.015), (0.09, 0.12, 0.025), 0.55, -0.15, 0.6, sway=0.03),
    Terrain.WATER: Material((0.035, 0.06, 0.05), (0.05, 0.08, 0.07), 0.1, 0.2, 0.0),
    Terrain.ROCK: Material((0.27, 0.26, 0.25), (0.36, 0.35, 0.31), 0.22, 0.1, 0.12, 0.3, 0.03, 0.4),
    Terrain.PAVED: Material((0.16, 0.16, 0.165), (0.22, 0.22, 0.22), 0.15, 0.0, 0.04, 0.6, 0.015, 0.5),
    Terrain.STRUCTURE: Material((0.30, 0.11, 0.07), (0.36, 0.17, 0.11), 0.15, 0.1, 0.05),
}


def tables() -> tuple[F64, F64]:
    """(9, 12) materials and (9, OCTAVES) amplitudes, rows by class code."""
    kinds = [MATERIALS[Terrain(k)] for k in range(len(MATERIALS))]
    return np.array([m.row() for m in kinds]), np.array([m.amplitudes() for m in kinds])
