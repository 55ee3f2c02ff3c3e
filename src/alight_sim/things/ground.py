"""Things that shape the solid ground: terraces, craters, ponds, lakes, pads, clearings."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import Field

from alight.arrays import F64
from alight.records import Terrain
from alight_sim.kernels.stamps import Column
from alight_sim.looks import Look
from alight_sim.relief import FractalRelief, noise
from alight_sim.section import Side
from alight_sim.things.base import (
    UNTINTED,
    Between,
    CoverName,
    Layer,
    LookName,
    Scattered,
    Sheet,
    Tint,
    along_and_across,
    covered,
    power_law,
    ramp,
    terrain_named,
)

if TYPE_CHECKING:
    from alight_sim.tiles import Lay

Generator = np.random.Generator
ANYWHERE: tuple[CoverName, ...] = ("bare", "short_grass", "tall_vegetation", "rock", "paved")
ROUND = 1.0  # column TOP of a pad: a disc, not a rectangle


class Roughness(FractalRelief, Layer):
    """More relief on top of the layers before it."""

    thing: Literal["roughness"]
    height: float = Field(0.05, ge=0.0, le=20.0, description="metres, standard deviation")
    longest: float = Field(3.0, gt=0.0, le=5000.0, description="metres, longest wavelength")
    shortest: float = Field(0.3, gt=0.0, description="metres, shortest wavelength")
    upon: tuple[CoverName, ...] = Field(ANYWHERE, description="classes of ground that it lies on")

    def shape(self, sheet: Sheet, lay: Lay) -> None:
        """Add noise on ground of the given classes."""
        rough = np.zeros(sheet.x.shape)
        self.add(sheet.x, sheet.y, lay.seed, rough)
        sheet.ground += np.where(np.isin(sheet.label, [terrain_named(k) for k in self.upon]), rough, 0.0)

    @property
    def rise(self) -> tuple[float, float]:
        return 4.0 * self.height, 4.0 * self.height


class Terraces(Layer):
    """Steps along the contours, with nearly level treads and steep risers."""

    thing: Literal["terraces"]
    step: float = Field(1.0, gt=0.05, le=30.0, description="metres of height between two treads")
    riser: float = Field(0.06, gt=0.0, le=1.0, description="share of the width that the riser takes")
    tilt: float = Field(0.08, ge=0.0, le=1.0, description="share of the slope that is left on a tread")
    kind: CoverName | None = Field("rock", description="class of the risers")
    look: LookName = Field(Look.BY_CLASS, description="look of the risers")

    def shape(self, sheet: Sheet, lay: Lay) -> None:
        """Quantise the heights to treads and risers."""
        whole = np.floor(sheet.ground / self.step)
        part = sheet.ground / self.step - whole
        face = part > 1.0 - self.riser
        rise = np.where(face, (part - 1.0 + self.riser) / self.riser, 0.0)
        sheet.ground[:] = self.step * (whole + self.tilt * part + (1.0 - self.tilt) * rise)
        if self.kind is not None:
            sheet.paint(..., face, terrain_named(self.kind), self.look)

    @property
    def rise(self) -> tuple[float, float]:
        return self.step, self.step


class Craters(Scattered):
    """Bowls with a raised rim, of all ages."""

    thing: Literal["craters"]
    radius: Between = Field((1.0, 6.0), description="metres, [smallest, largest]")
    exponent: float = Field(
        1.8, ge=0.0, le=6.0, description="the number above a radius goes with it to the power -this"
    )
    depth: Between = Field((0.12, 0.4), description="metres of depth over the radius, old to fresh")
    upon: tuple[CoverName, ...] = Field(ANYWHERE, description="classes of ground where random ones may be")

    @property
    def largest(self) -> float:
        """Two radii of the largest crater, which include the blanket around the rim, metres."""
        return 2.0 * self.radius[1]

    @property
    def rise(self) -> tuple[float, float]:
        return self.radius[1] * self.depth[1], 0.25 * self.radius[1] * self.depth[1]

    def draw(self, rng: Generator, things: F64) -> None:
        """Draw the radius of each crater by the power law, and its depth by age."""
        radius = power_law(rng, self.radius, self.exponent, len(things))
        things[:, Column.HALF_U], things[:, Column.REACH] = radius, 2.0 * radius
        things[:, Column.TOP] = radius * rng.uniform(*self.depth, len(things))

    def shape(self, sheet: Sheet, lay: Lay) -> None:
        """Dig bowls, and heap a blanket around each that falls with distance cubed (McGetchin et al. 1973)."""
        for thing in lay.things(sheet.box):
            index, dx, dy = sheet.near(thing[Column.EAST], thing[Column.NORTH], thing[Column.REACH])
            rho = np.hypot(dx, dy) / thing[Column.HALF_U]
            rho = rho * (1.0 + 0.04 * noise(sheet.x[index], sheet.y[index], lay.seed, 1.5 * thing[Column.HALF_U], 0.4))
            rim = 0.2 * thing[Column.TOP]
            bowl = rim - (thing[Column.TOP] + rim) * (1.0 - rho * rho)
            blanket = rim * (np.maximum(rho, 1.0) ** -3 - 0.125) / 0.875
            sheet.ground[index] += np.where(rho < 1.0, bowl, np.maximum(blanket, 0.0))


class Ponds(Scattered):
    """Bowls of water with a wandering shore; the surface is level, below the ground around."""

    thing: Literal["ponds"]
    radius: Between = Field((3.0, 6.0), description="metres")
    depth: Between = Field((0.8, 1.4), description="metres of water in the middle")
    below: float = Field(0.5, ge=0.0, le=20.0, description="metres of the surface below the ground in the middle")
    look: LookName = Field(Look.BY_CLASS, description="of the water: clear_water | murky_water")
    shore: CoverName = Field("bare", description="class of the shore")
    shore_look: LookName = Field(Look.BY_CLASS, description="look of the shore: mud, sand, gravel ...")

    @property
    def largest(self) -> float:
        """2.2 radii of the largest pond, which include the bank, metres."""
        return 2.2 * self.radius[1]

    @property
    def rise(self) -> tuple[float, float]:
        return self.below, 0.0

    def draw(self, rng: Generator, things: F64) -> None:
        """Draw the radius and depth of each pond."""
        things[:, Column.HALF_U] = rng.uniform(*self.radius, len(things))
        things[:, Column.TOP] = rng.uniform(*self.depth, len(things))
        things[:, Column.REACH] = 2.2 * things[:, Column.HALF_U]

    def shape(self, sheet: Sheet, lay: Lay) -> None:
        """Dig, fill with water, and blend the bank into the ground."""
        for thing in lay.things(sheet.box):
            index, dx, dy = sheet.near(thing[Column.EAST], thing[Column.NORTH], thing[Column.REACH])
            radius = thing[Column.HALF_U]
            shore = noise(sheet.x[index], sheet.y[index], lay.seed, 0.9 * radius, 0.3 * radius)
            r = np.hypot(dx, 1.25 * dy) * (1.0 + 0.12 * shore) / radius
            level = thing[Column.LEVEL] - self.below
            wet = r < 1.0
            bank = level + ramp(1.0, 1.7, r) * (sheet.ground[index] - level)
            sheet.ground[index] = np.where(wet, level, bank)
            sheet.depth[index] = np.where(wet, np.maximum(thing[Column.TOP] * (1.0 - r * r), 0.02), sheet.depth[index])
            sheet.paint(index, (r < 1.12) & ~wet, terrain_named(self.shore), self.shore_look)
            sheet.paint(index, wet, Terrain.WATER, self.look)


class Water(Layer):
    """Water wherever the ground lies below a level: lakes with natural shores."""

    thing: Literal["water"]
    level: float = Field(0.0, description="metres above the origin")
    look: LookName = Field(Look.BY_CLASS, description="of the water: clear_water | murky_water")
    shore: CoverName | None = Field("bare", description="class of the ground just above")
    shore_look: LookName = Field(Look.BY_CLASS, description="look of the shore: mud, sand, gravel ...")
    shore_height: float = Field(0.15, ge=0.0, le=5.0, description="metres above the level that the shore reaches")

    def shape(self, sheet: Sheet, lay: Lay) -> None:
        """Flood the ground below the level, and paint the shore."""
        wet = sheet.ground < self.level
        edge = self.level + self.shore_height * (1.0 + 0.4 * noise(sheet.x, sheet.y, lay.seed, 6.0, 0.7))
        if self.shore is not None:
            sheet.paint(..., (sheet.ground < edge) & ~wet, terrain_named(self.shore), self.shore_look)
        sheet.depth[wet] = self.level - sheet.ground[wet]
        sheet.ground[wet] = self.level
        sheet.paint(..., wet, Terrain.WATER, self.look)


class Pads(Scattered):
    """Level ground (landing pads, yards, clearings), blended into the ground around."""

    thing: Literal["pads"]
    radius: float | None = Field(None, gt=0.0, le=500.0, description="metres: a disc; without it a rectangle of `size`")
    size: tuple[Side, Side] = Field((10.0, 10.0), description="metres [along, across]")
    turn_deg: float = Field(0.0, description="of the rectangle, counter-clockwise from east")
    tilt_deg: float = Field(0.0, ge=0.0, le=45.0, description="slope of the pad")
    tilt_towards_deg: float = Field(90.0, description="where it falls to, clockwise from north")
    up: float = Field(0.0, ge=-20.0, le=20.0, description="metres above the ground in the middle; its side is vertical")
    keep: float = Field(0.0, ge=0.0, le=1.0, description="share of the ground's own relief that is left")
    bank: float = Field(2.0, ge=0.0, le=100.0, description="metres over which it blends into the ground")
    kind: CoverName = Field("paved", description="class")
    look: LookName = Field(Look.BY_CLASS, description="look; without it that of the class")
    tint: Tint = Field(UNTINTED, description="factor on the look's reflectance: a number or [red, green, blue]")
    upon: tuple[CoverName, ...] = Field(ANYWHERE, description="classes of ground where random ones may be")
    apart: bool = Field(True, description="random things that are apart keep clear of it")

    @property
    def largest(self) -> float:
        """Radius or half the diagonal of a pad, plus the bank, metres."""
        return self.bank + (self.radius or 0.5 * math.hypot(*self.size))

    @property
    def rise(self) -> tuple[float, float]:
        return max(-self.up, 0.0), max(self.up, 0.0)

    def draw(self, rng: Generator, things: F64) -> None:
        """Set size and turn; all pads are equal."""
        things[:, Column.HALF_U], things[:, Column.HALF_V] = (self.radius or 0.5 * self.size[0]), 0.5 * self.size[1]
        things[:, Column.TURN], things[:, Column.TOP] = math.radians(self.turn_deg), ROUND if self.radius else 0.0
        things[:, Column.REACH] = self.largest

    def shape(self, sheet: Sheet, lay: Lay) -> None:
        """Level the ground, and paint it."""
        fall, towards = math.tan(math.radians(self.tilt_deg)), math.radians(self.tilt_towards_deg)
        for thing in lay.things(sheet.box):
            index, dx, dy = sheet.near(thing[Column.EAST], thing[Column.NORTH], thing[Column.REACH])
            u, v = along_and_across(dx, dy, thing[Column.TURN])
            outside = np.maximum(np.abs(u) - thing[Column.HALF_U], np.abs(v) - thing[Column.HALF_V])
            if thing[Column.TOP] == ROUND:
                outside = np.hypot(dx, dy) - thing[Column.HALF_U]
            plane = thing[Column.LEVEL] - fall * (math.sin(towards) * dx + math.cos(towards) * dy)
            blend = self.keep + (1.0 - self.keep) * ramp(0.0, max(self.bank, 1e-9), outside)
            inside = outside <= 0.0
            ground = plane + blend * (sheet.ground[index] - plane)
            sheet.ground[index] = ground + self.up * covered(-outside, sheet.cell)
            sheet.depth[index] = np.where(inside, 0.0, sheet.depth[index])
            sheet.paint(index, inside, terrain_named(self.kind), self.look, self.tint)
