"""Material of each look: colours, contrast at every scale, patches, cracks, stones, leaves, shine, water."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alight.arrays import F32
from alight.records import Terrain
from alight_sim.kernels import texture as t
from alight_sim.looks import Look

Colour = tuple[float, float, float]
Four = tuple[float, float, float, float]


@dataclass(frozen=True)
class Material:
    """Material of one look; reflectances are linear RGB. Texture is noise with waves of 130 m to 1.2 cm."""

    first: Colour  # mixed with `second` over areas of 6 to 130 m
    second: Colour
    third: Colour = (0.2, 0.16, 0.12)  # patches: moss, bare soil, stains
    mix: float = 0.0  # more (to 1) or less (to -1) of `second`
    patch: float = -1.5  # more (0 = half) or less (-2 = hardly any) of `third`
    edge: float = 0.5  # softness of a patch's border
    contrast: float = 0.25  # standard deviation of the reflectance over its mean, octaves of 3 m to 1.2 cm
    uneven: float = 0.5  # variation of that contrast from area to area
    vary: float = 0.2  # variation of the reflectance over areas of 6 to 130 m
    hue: float = 0.06  # variation of the colour
    roughening: float = 0.0  # amplitude of an octave is proportional to its wavelength to this power
    ridge: float = 0.0  # share of creases in the noise
    bump: float = 0.1  # slope of the micro-relief that the sun shades
    crack: float = 0.0  # darkness of the cracks
    things: Four = (
        0.0,
        0.0,
        0.0,
        0.0,
    )  # share of lattice cells with a stone or leaf of up to 1.2, 3, 8, 22 cm
    tone: float = 0.0  # brightness of a thing over the ground's, less 1
    spread: float = 0.4  # variation of that brightness
    tall: float = 0.3  # height of a thing over its radius, for its shadow
    deep: float = 0.0  # metres, visible depth between leaves
    lift: float = 0.0  # metres of its tips above the true height, which is the mean of the visible heights
    open: float = 0.0  # more (1) or less (-1) gaps between the leaves
    coarse: float = 0.5  # leaves in tufts of 40 cm (1) or as single blades (0)
    sway: float = 0.0  # metres, in a wind of 4 m/s
    hot: float = 0.1  # gain of brightness with the sun behind the camera
    gloss: float = 0.0
    pattern: int = 0  # man-made pattern: see kernels.texture
    bed: Look = Look.MUD  # look of the bed below water
    waves: float = 1.0  # factor on the slope of waves
    scum: float = 0.0  # share of water that algae or foam cover

    def row(self) -> list[float]:
        """Return the parameters as numbers, in the order of kernels.texture."""
        return [
            *self.first, *self.second, *self.third, self.mix, self.patch, self.edge, self.contrast, self.uneven,
            self.vary, self.hue, 0.5**self.roughening, self.ridge, self.bump, self.crack, *self.things, self.tone,
            self.spread, self.tall, self.deep, self.open, self.coarse, self.sway, self.hot, self.gloss,
            float(self.pattern), self.lift, float(self.bed), self.waves, self.scum,
        ]  # fmt: skip


def _plant(first: Colour, second: Colour, third: Colour, **more: Any) -> Material:
    return replace(Material(first, second, third, contrast=0.28, uneven=0.4, hot=0.25, hue=0.12, ridge=0.3), **more)


def _crown(first: Colour, second: Colour, **more: Any) -> Material:
    crown = _plant(first, second, (0.05, 0.045, 0.03), contrast=0.4, bump=0.5, deep=1.4, sway=0.03, hot=0.35, ridge=0.4)
    return replace(crown, **{"open": 0.3, "coarse": 0.6, "vary": 0.15, "roughening": -0.1, **more})


def _laid(first: Colour, second: Colour, third: Colour, **more: Any) -> Material:
    plain = Material(first, second, third, contrast=0.06, uneven=0.9, vary=0.14, hue=0.03, bump=0.015, hot=0.05)
    return replace(plain, **{"edge": 0.3, "patch": -1.3, "ridge": 0.2, "roughening": 0.1, **more})


SOIL = (0.125, 0.10, 0.072)
MOSS = (0.05, 0.085, 0.02)

MATERIALS: dict[Look, Material] = {
    Look.BY_CLASS: Material((0.2, 0.2, 0.2), (0.2, 0.2, 0.2)),
    Look.MEADOW: _plant((0.06, 0.115, 0.022), (0.17, 0.17, 0.06), SOIL, patch=-1.15, deep=0.10, coarse=0.2,
                        lift=0.028, sway=0.01, things=(0.25, 0.22, 0.10, 0.05), tone=0.25, spread=0.7, tall=0.3,
                        open=-0.25, vary=0.22),
    Look.LAWN: _plant((0.055, 0.12, 0.025), (0.11, 0.15, 0.04), MOSS, contrast=0.17, patch=-1.2, vary=0.16, deep=0.02,
                      lift=0.004, open=-0.7, coarse=0.0, things=(0.1, 0.05, 0.0, 0.0), tone=0.5, uneven=0.7),
    Look.DRY_GRASS: _plant((0.20, 0.17, 0.085), (0.29, 0.245, 0.13), SOIL, patch=-0.9, deep=0.12, coarse=0.3,
                           lift=0.029, sway=0.01, things=(0.3, 0.25, 0.12, 0.06), tone=0.1, spread=0.6, open=-0.4,
                           vary=0.25),
    Look.TALL_GRASS: _plant((0.07, 0.11, 0.025), (0.19, 0.17, 0.065), (0.17, 0.15, 0.075), contrast=0.4, patch=-1.2,
                            deep=0.45, open=0.2, coarse=0.35, sway=0.035, bump=0.25, roughening=-0.05, vary=0.22),
    Look.CROP: _plant((0.05, 0.11, 0.02), (0.13, 0.15, 0.04), SOIL, contrast=0.35, patch=-1.3, deep=0.4, open=0.15,
                      coarse=0.2, sway=0.03, bump=0.2),
    Look.STUBBLE: _plant((0.24, 0.19, 0.10), (0.31, 0.25, 0.14), SOIL, contrast=0.3, patch=-0.6, deep=0.08, open=0.2,
                         lift=0.042, coarse=0.0, things=(0.5, 0.4, 0.1, 0.0), tone=0.3, spread=0.5, roughening=-0.1),
    Look.REED: _plant((0.12, 0.14, 0.045), (0.24, 0.20, 0.095), (0.05, 0.05, 0.03), contrast=0.4, deep=0.6, open=0.35,
                      coarse=0.15, sway=0.05, bump=0.3, roughening=-0.1),
    Look.HEATH: _plant((0.07, 0.055, 0.035), (0.12, 0.10, 0.045), (0.17, 0.15, 0.09), contrast=0.38, patch=-0.7,
                       deep=0.12, lift=0.054, open=0.1, coarse=0.4, bump=0.3),
    Look.SOIL: Material((0.105, 0.082, 0.06), (0.19, 0.155, 0.115), (0.055, 0.044, 0.034), patch=-0.9, contrast=0.24,
                        vary=0.25, bump=0.14, things=(0.5, 0.35, 0.15, 0.04), tone=0.35, spread=0.5, tall=0.55),
    Look.MUD: Material((0.075, 0.06, 0.045), (0.12, 0.095, 0.07), (0.16, 0.13, 0.10), patch=-1.0, contrast=0.13,
                       vary=0.25, uneven=0.9, bump=0.06, crack=0.4, things=(0.1, 0.08, 0.03, 0.0), gloss=0.15),
    Look.SAND: Material((0.34, 0.28, 0.19), (0.41, 0.345, 0.245), (0.28, 0.22, 0.15), patch=-1.4, edge=1.2,
                        contrast=0.025, vary=0.10, uneven=0.8, bump=0.012, hot=0.15, roughening=0.1,
                        things=(0.02, 0.02, 0.01, 0.006), tone=-0.4, spread=0.3, tall=0.6),
    Look.GRAVEL: Material((0.21, 0.20, 0.185), (0.30, 0.28, 0.25), (0.15, 0.12, 0.09), patch=-1.2, contrast=0.2,
                          vary=0.2, bump=0.12, things=(0.85, 0.7, 0.12, 0.01), tone=0.15, spread=0.65, tall=0.7),
    Look.LEAF_LITTER: Material((0.10, 0.065, 0.035), (0.16, 0.11, 0.06), MOSS, patch=-0.9, contrast=0.3, vary=0.25,
                               bump=0.15, hue=0.15, things=(0.5, 0.75, 0.45, 0.05), tone=0.4, spread=0.8, tall=0.25,
                               ridge=0.3),
    Look.SNOW: Material((0.82, 0.84, 0.88), (0.88, 0.89, 0.91), (0.70, 0.71, 0.73), patch=-1.5, edge=1.5, contrast=0.02,
                        vary=0.04, uneven=0.9, hue=0.005, bump=0.01, hot=0.1, things=(0.01, 0.01, 0.004, 0.001),
                        tone=-0.7, spread=0.2, tall=0.5),
    Look.BROADLEAF: _crown((0.035, 0.075, 0.014), (0.075, 0.115, 0.022)),
    Look.CONIFER: _crown((0.018, 0.038, 0.014), (0.035, 0.06, 0.02), coarse=0.3, deep=1.6, open=0.35, sway=0.02),
    Look.BUSH: _crown((0.05, 0.075, 0.02), (0.11, 0.12, 0.04), deep=0.6, coarse=0.4, open=0.25),
    Look.ROCK: Material((0.17, 0.165, 0.16), (0.27, 0.255, 0.23), (0.09, 0.095, 0.06), patch=-0.7, edge=0.25,
                        contrast=0.22, uneven=0.5, vary=0.25, bump=0.2, crack=0.6, ridge=0.4, roughening=0.1,
                        things=(0.1, 0.1, 0.05, 0.0), tall=0.5),
    Look.PALE_ROCK: Material((0.38, 0.36, 0.32), (0.47, 0.44, 0.385), (0.24, 0.22, 0.18), patch=-0.9, edge=0.25,
                             contrast=0.16, uneven=0.7, vary=0.2, bump=0.15, crack=0.6, ridge=0.4, roughening=0.15,
                             things=(0.1, 0.1, 0.05, 0.0), tall=0.5),
    Look.SCREE: Material((0.19, 0.18, 0.17), (0.29, 0.27, 0.24), (0.12, 0.10, 0.08), patch=-1.0, contrast=0.24,
                         vary=0.22, bump=0.25, ridge=0.4, things=(0.6, 0.8, 0.85, 0.6), tone=0.1, spread=0.5, tall=0.9),
    Look.ASPHALT: _laid((0.065, 0.065, 0.067), (0.12, 0.118, 0.115), (0.04, 0.04, 0.042), crack=0.7, vary=0.2,
                        contrast=0.07, edge=0.08, patch=-1.25, things=(0.03, 0.03, 0.006, 0.0), tone=0.9, spread=0.8),
    Look.CONCRETE: _laid((0.30, 0.295, 0.28), (0.39, 0.385, 0.36), (0.21, 0.20, 0.185), crack=0.6, edge=0.5,
                         pattern=t.JOINTS, contrast=0.045, things=(0.02, 0.02, 0.004, 0.0), tone=-0.5, spread=0.3),
    Look.SLABS: _laid((0.22, 0.215, 0.205), (0.30, 0.29, 0.27), (0.14, 0.14, 0.11), pattern=t.SLABS, contrast=0.09,
                      things=(0.03, 0.03, 0.006, 0.0), tone=-0.3, spread=0.5),
    Look.WHITE: _laid((0.80, 0.80, 0.79), (0.86, 0.86, 0.85), (0.66, 0.65, 0.62), contrast=0.025, vary=0.05,
                      uneven=0.9, patch=-1.5, bump=0.008, things=(0.005, 0.004, 0.0, 0.0), tone=-0.6),
    Look.ROOF_TILES: _laid((0.22, 0.085, 0.05), (0.30, 0.14, 0.085), (0.10, 0.085, 0.055), pattern=t.TILES,
                           contrast=0.14, patch=-0.9, edge=0.6, vary=0.2),
    Look.ROOF_SLATE: _laid((0.07, 0.072, 0.08), (0.11, 0.11, 0.115), (0.12, 0.125, 0.08), pattern=t.TILES,
                           contrast=0.12, patch=-1.0, gloss=0.1),
    Look.ROOF_METAL: _laid((0.33, 0.34, 0.35), (0.42, 0.42, 0.42), (0.25, 0.15, 0.10), pattern=t.SEAMS, contrast=0.04,
                           gloss=0.5, patch=-1.4),
    Look.FLAT_ROOF: _laid((0.16, 0.155, 0.15), (0.25, 0.245, 0.235), (0.09, 0.085, 0.075), contrast=0.10, patch=-0.8,
                          edge=0.6, things=(0.15, 0.06, 0.01, 0.0), tone=0.2),
    Look.WALL: _laid((0.42, 0.40, 0.36), (0.50, 0.47, 0.42), (0.27, 0.25, 0.21), contrast=0.07, patch=-1.2, edge=0.8),
    Look.PAINT: _laid((1.0, 1.0, 1.0), (1.0, 1.0, 1.0), (0.9, 0.9, 0.9), contrast=0.015, vary=0.02, patch=-2.0,
                      gloss=0.7, bump=0.0),
    Look.CLEAR_WATER: Material((0.010, 0.028, 0.032), (0.01, 0.03, 0.03), (1.5, 0.55, 0.5), bed=Look.GRAVEL),
    Look.MURKY_WATER: Material((0.040, 0.045, 0.022), (0.04, 0.05, 0.03), (3.6, 3.0, 4.2), bed=Look.MUD, scum=0.9),
    Look.PLAIN: Material((1.0, 1.0, 1.0), (1.0, 1.0, 1.0), (0.9, 0.9, 0.9), patch=-3.0, contrast=0.05, vary=0.0,
                         hue=0.0, bump=0.03, roughening=-0.5),
    Look.GLASS: _laid((0.02, 0.022, 0.025), (0.02, 0.022, 0.025), (0.02, 0.02, 0.02), contrast=0.02, gloss=1.0,
                      patch=-3.0, bump=0.0),
    Look.TWIGS: _crown((0.13, 0.115, 0.10), (0.20, 0.18, 0.155), deep=2.0, open=0.9, coarse=0.0, hot=0.1, sway=0.02),
    # no texture of these is larger than 6 cm: larger objects are in the height layer
    Look.FINE_GRAVEL: Material((0.215, 0.20, 0.18), (0.27, 0.25, 0.225), (0.18, 0.16, 0.14), patch=-1.2, edge=0.9,
                               contrast=0.13, uneven=0.4, vary=0.11, hue=0.03, bump=0.11, roughening=-0.05,
                               things=(0.55, 0.4, 0.0, 0.0), tone=0.05, spread=0.45, tall=0.7),
    Look.PACKED_GRAVEL: Material((0.215, 0.20, 0.18), (0.27, 0.25, 0.225), (0.185, 0.165, 0.145), patch=-1.3, edge=0.9,
                                 contrast=0.09, uneven=0.4, vary=0.10, hue=0.03, bump=0.06,
                                 things=(0.4, 0.15, 0.0, 0.0), tone=0.05, spread=0.4, tall=0.5),
    Look.PASTURE: _plant((0.070, 0.098, 0.030), (0.125, 0.13, 0.055), (0.115, 0.10, 0.06), patch=-1.2, edge=0.9,
                         deep=0.05, coarse=0.1, lift=0.014, sway=0.006, things=(0.25, 0.15, 0.0, 0.0), tone=0.25,
                         spread=0.45, open=-0.5, vary=0.13, contrast=0.12, hue=0.07, ridge=0.2),
    Look.LOAM: Material((0.118, 0.090, 0.058), (0.168, 0.132, 0.088), (0.088, 0.068, 0.045), patch=-1.1, edge=0.8,
                        contrast=0.16, uneven=0.5, vary=0.13, hue=0.03, bump=0.14, things=(0.4, 0.25, 0.0, 0.0),
                        tone=0.15, spread=0.4, tall=0.6),
    Look.PLOUGHED: Material((0.095, 0.073, 0.05), (0.145, 0.115, 0.08), (0.075, 0.058, 0.042), patch=-1.0, edge=0.8,
                            contrast=0.2, uneven=0.4, vary=0.16, hue=0.03, bump=0.25, things=(0.5, 0.45, 0.0, 0.0),
                            tone=0.1, spread=0.5, tall=0.8),
    # plants that float on still water; not wet, so that the level surface looks like ground
    Look.DUCKWEED: Material((0.095, 0.15, 0.028), (0.14, 0.185, 0.045), (0.04, 0.06, 0.02), patch=-1.4, edge=0.3,
                            contrast=0.11, uneven=0.7, vary=0.13, hue=0.06, bump=0.012,
                            things=(0.3, 0.02, 0.0, 0.0), tone=0.2, spread=0.4, tall=0.05),
    Look.ALGAE: Material((0.065, 0.085, 0.028), (0.115, 0.125, 0.05), (0.09, 0.08, 0.042), patch=-0.8, edge=0.7,
                         contrast=0.16, uneven=0.6, vary=0.18, hue=0.08, bump=0.02, ridge=0.3,
                         things=(0.15, 0.05, 0.0, 0.0), tone=0.2, spread=0.5, tall=0.05),
    Look.SLUDGE: Material((0.11, 0.097, 0.062), (0.16, 0.145, 0.10), (0.075, 0.08, 0.04), patch=-1.0, edge=0.7,
                          contrast=0.13, uneven=0.7, vary=0.16, hue=0.05, bump=0.02, ridge=0.2,
                          things=(0.15, 0.08, 0.0, 0.0), tone=0.3, spread=0.6, tall=0.05),
    Look.STILL_WATER: Material((0.020, 0.022, 0.014), (0.02, 0.022, 0.014), (2.2, 1.9, 2.6), bed=Look.MUD, waves=0.35),
    Look.WET_ASPHALT: _laid((0.03, 0.03, 0.032), (0.06, 0.06, 0.06), (0.022, 0.022, 0.024), crack=0.5, vary=0.2,
                            contrast=0.06, edge=0.3, patch=-0.9, gloss=0.35, things=(0.03, 0.03, 0.0, 0.0), tone=0.9,
                            spread=0.8),
}  # fmt: skip

BY_CLASS: dict[Terrain, Look] = {
    Terrain.UNKNOWN: Look.SOIL,
    Terrain.BARE: Look.SOIL,
    Terrain.SHORT_GRASS: Look.MEADOW,
    Terrain.TALL_VEGETATION: Look.TALL_GRASS,
    Terrain.TREE: Look.BROADLEAF,
    Terrain.WATER: Look.MURKY_WATER,
    Terrain.ROCK: Look.ROCK,
    Terrain.PAVED: Look.ASPHALT,
    Terrain.STRUCTURE: Look.ROOF_TILES,
}


@cache
def tables() -> tuple[F32, NDArray[np.int32], F32]:
    """Return the inputs of the kernels for the L surface looks (`Look`).

    Parameters per look, (L, PARAMS); look of each `Terrain` code, 0 to 8, (9,); 1 for a look of water, else 0, (L,).
    """
    looks = np.array([MATERIALS[k].row() for k in Look], np.float32)
    wet = np.array([k in (Look.CLEAR_WATER, Look.MURKY_WATER, Look.STILL_WATER) for k in Look], np.float32)
    return looks, np.array([BY_CLASS[k] for k in Terrain], np.int32), wet
