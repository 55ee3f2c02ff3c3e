"""The things of a scene's ground, by their names in `layers`."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from alight_sim.things.base import Layer, Scattered, Sheet
from alight_sim.things.built import Cars, Crates, Houses, Parking
from alight_sim.things.cover import Fields, Patches, TallGrass
from alight_sim.things.ground import Craters, Pads, Ponds, Roughness, Terraces, Water
from alight_sim.things.laid import Bars, Tarpaulins
from alight_sim.things.lines import Hedges, Roads, Walls
from alight_sim.things.standing import Logs, Mounds, Rocks, Shrubs, Trees
from alight_sim.things.stones import Stones
from alight_sim.things.strung import Branches, GuyedMast, PowerLine, WashingLine
from alight_sim.things.water import Canals, Puddles

Thing = Annotated[
    Roughness
    | Terraces
    | Craters
    | Ponds
    | Water
    | Pads
    | Patches
    | TallGrass
    | Fields
    | Roads
    | Walls
    | Hedges
    | Rocks
    | Trees
    | Shrubs
    | Mounds
    | Houses
    | Cars
    | Crates
    | Logs
    | Parking
    | Stones
    | Canals
    | Puddles
    | PowerLine
    | WashingLine
    | GuyedMast
    | Branches
    | Bars
    | Tarpaulins,
    Field(discriminator="thing"),
]

__all__ = ["Layer", "Scattered", "Sheet", "Thing"]
