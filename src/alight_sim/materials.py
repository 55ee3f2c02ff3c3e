"""Material of each look: colours, contrast at every scale, patches, cracks, stones, leaves, shine, water.

The values are in `materials.yaml`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alight.arrays import F32, F64
from alight.documents import parse_yaml, read_text
from alight.records import Terrain
from alight_sim.kernels.texture import Pattern
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
    things: Four = (0.0, 0.0, 0.0, 0.0)  # share of lattice cells with a stone or leaf of up to 1.2, 3, 8, 22 cm
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


@cache
def _tables() -> dict[str, Any]:
    found: dict[str, Any] = parse_yaml(read_text(Path(__file__).with_suffix(".yaml")))
    return found


def table(name: str) -> Any:
    """Return one table of the card."""
    return _tables()[name]


@cache
def materials() -> dict[Look, Material]:
    """Return the material of each look."""
    out, kinds = dict[Look, Material](), table("kinds")
    for name, given in table("materials").items():
        values = kinds.get(given.get("like"), {}) | {k: v for k, v in given.items() if k != "like"}
        values = {k: tuple(v) if isinstance(v, list) else v for k, v in values.items()}
        if "pattern" in values:
            values["pattern"] = Pattern[values["pattern"]]
        if "bed" in values:
            values["bed"] = Look[values["bed"]]
        out[Look[name]] = Material(**values)
    return out


def palette(name: str) -> F64:
    """Return the colours (K, 3) of a kind of things, linear RGB."""
    return np.array(table("palettes")[name])


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
    looks = np.array([materials()[k].row() for k in Look], np.float32)
    wet = np.array([k in (Look.CLEAR_WATER, Look.MURKY_WATER, Look.STILL_WATER) for k in Look], np.float32)
    return looks, np.array([BY_CLASS[k] for k in Terrain], np.int32), wet
