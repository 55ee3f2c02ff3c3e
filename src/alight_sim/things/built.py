"""Man-made things: houses, cars, crates, litter and parking grounds."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import Field

from alight.arrays import F64, Mask
from alight.records import Terrain
from alight_sim.kernels import stamps
from alight_sim.kernels.stamps import Column
from alight_sim.looks import Look
from alight_sim.materials import palette
from alight_sim.section import Side
from alight_sim.things.base import (
    Between,
    CoverName,
    Layer,
    LookName,
    Places,
    Scattered,
    Sheet,
    Tint,
    along_and_across,
    blank_things,
    overlapping,
    ramp,
    terrain_named,
)

if TYPE_CHECKING:
    from alight_sim.tiles import Lay

Generator = np.random.Generator


def stamp(sheet: Sheet, things: F64, kind: int, label: Terrain = Terrain.STRUCTURE) -> None:
    """Stamp boxes (N, COLUMNS) of shape `kind` (`kernels.stamps`) and class `label` on the sheet."""
    if len(things):
        stamps.stamp_boxes(
            sheet.x[0], sheet.y[:, 0], sheet.cell, things, int(kind), int(label),
            sheet.height, sheet.label, sheet.depth, sheet.look, sheet.tint,
        )  # fmt: skip


class Boxes(Scattered):
    """Things with vertical sides.

    Each box draws one of `tints`, which are factors on the colour. With `apart`, boxes at random positions keep clear
    of the things of earlier layers that also have `apart`.
    """

    turn_deg: float | None = Field(None, description="of the long side, counter-clockwise from east; none: at random")
    tints: tuple[Tint, ...] = Field((), description="factors [[red, green, blue], ...] on the look, to draw from")
    apart: bool = Field(True, description="random ones keep clear of the things of earlier layers that are apart too")

    @property
    def founded(self) -> bool:
        """True: a box stands on the highest ground under it."""
        return True

    def turns(self, rng: Generator, count: int) -> F64:
        """Return (count,) turns in rad: `turn_deg` if it is set, else random turns."""
        turns = rng.uniform(0.0, 2.0 * math.pi, count)
        return turns if self.turn_deg is None else np.full(count, math.radians(self.turn_deg))

    def paint(self, rng: Generator, things: F64, look: Look, usual: str) -> None:
        """Set the look of things (N, COLUMNS), and draw each tint from the user's, or else from the palette `usual`."""
        tints = np.array(self.tints) if self.tints else palette(usual)
        things[:, Column.RED : Column.BLUE + 1] = tints[rng.integers(len(tints), size=len(things))]
        things[:, Column.LOOK] = look

    def boxes(self, sheet: Sheet, lay: Lay, kind: int) -> None:
        """Stamp all boxes of the layer that reach the sheet; `kind`: shape (`kernels.stamps`)."""
        stamp(sheet, lay.things(sheet.box), kind)


class Houses(Boxes):
    """Houses with a gable, hip or flat roof and a chimney."""

    thing: Literal["houses"]
    length: Between = Field((8.0, 12.0), description="metres along the ridge")
    width: Between = Field((6.0, 8.0), description="metres across")
    walls: Between = Field((2.8, 5.5), description="metres to the eaves")
    roof: Literal["gable", "hip", "flat"] = Field("gable", description="gable | hip | flat (with a parapet)")
    look: LookName = Field(Look.ROOF_TILES, description="of a pitched roof: roof_tiles | roof_slate | roof_metal")
    pitch_deg: float = Field(40.0, gt=0.0, le=60.0, description="slope of the roof")

    @property
    def largest(self) -> float:
        """Half the diagonal of the largest house, metres."""
        return 0.5 * math.hypot(self.length[1], self.width[1])

    @property
    def rise(self) -> tuple[float, float]:
        return 0.0, self.walls[1] + 0.5 * self.width[1] * math.tan(math.radians(self.pitch_deg)) + 0.5

    def draw(self, rng: Generator, things: F64) -> None:
        """Draw the floor plan, the wall height and the tint of the roof of each house."""
        n = len(things)
        things[:, Column.HALF_U], things[:, Column.HALF_V] = (
            0.5 * rng.uniform(*self.length, n),
            0.5 * rng.uniform(*self.width, n),
        )
        things[:, Column.TOP], things[:, Column.TURN] = rng.uniform(*self.walls, n), self.turns(rng, n)
        things[:, Column.EXTRA] = 0.4 if self.roof == "flat" else math.tan(math.radians(self.pitch_deg))
        things[:, Column.REACH] = np.hypot(things[:, Column.HALF_U], things[:, Column.HALF_V])
        self.paint(rng, things, Look.FLAT_ROOF if self.roof == "flat" else self.look, "roofs")

    def stand(self, sheet: Sheet, lay: Lay) -> None:
        self.boxes(
            sheet, lay, {"gable": stamps.Roof.GABLE, "hip": stamps.Roof.HIP, "flat": stamps.Roof.FLAT}[self.roof]
        )


class Cars(Boxes):
    """Parked cars."""

    thing: Literal["cars"]
    length: Between = Field((3.7, 4.9), description="metres")
    width: Between = Field((1.65, 1.9), description="metres")
    height: Between = Field((1.4, 1.75), description="metres")
    upon: tuple[CoverName, ...] = Field(("paved", "bare"), description="classes of ground where random ones may stand")

    @property
    def largest(self) -> float:
        """Half the diagonal of the largest car, metres."""
        return 0.5 * math.hypot(self.length[1], self.width[1])

    @property
    def rise(self) -> tuple[float, float]:
        return 0.0, self.height[1]

    def draw(self, rng: Generator, things: F64) -> None:
        """Draw the size, turn and paint of each car."""
        n = len(things)
        things[:, Column.HALF_U], things[:, Column.HALF_V] = (
            0.5 * rng.uniform(*self.length, n),
            0.5 * rng.uniform(*self.width, n),
        )
        things[:, Column.TOP], things[:, Column.TURN] = rng.uniform(*self.height, n), self.turns(rng, n)
        things[:, Column.REACH] = np.hypot(things[:, Column.HALF_U], things[:, Column.HALF_V])
        self.paint(rng, things, Look.PAINT, "cars")

    def stand(self, sheet: Sheet, lay: Lay) -> None:
        self.boxes(sheet, lay, stamps.Roof.CAR)


class Crates(Boxes):
    """Crates, pallets, beams, posts, litter: boxes in many colours."""

    thing: Literal["crates"]
    size: Between = Field((0.3, 1.2), description="metres, of the long side")
    width: Between | None = Field(None, description="metres, of the short side; without it as `size`: beams, posts")
    height: Between = Field((0.15, 1.0), description="metres")
    upon: tuple[CoverName, ...] = Field(
        ("bare", "short_grass", "paved"), description="classes of ground for random ones"
    )

    @property
    def largest(self) -> float:
        """Half the diagonal of the largest crate, metres."""
        return 0.71 * max(self.size[1], self.width[1] if self.width else 0.0)

    @property
    def rise(self) -> tuple[float, float]:
        return 0.0, self.height[1]

    def draw(self, rng: Generator, things: F64) -> None:
        """Draw both sides, the height and the turn of each crate."""
        n = len(things)
        things[:, Column.HALF_U] = 0.5 * rng.uniform(*self.size, n)
        things[:, Column.HALF_V] = 0.5 * rng.uniform(*(self.width or self.size), n)
        things[:, Column.TOP], things[:, Column.TURN] = rng.uniform(*self.height, n), self.turns(rng, n)
        things[:, Column.REACH] = np.hypot(things[:, Column.HALF_U], things[:, Column.HALF_V])
        self.paint(rng, things, Look.PAINT, "litter")

    def stand(self, sheet: Sheet, lay: Lay) -> None:
        self.boxes(sheet, lay, stamps.Roof.FLAT)


class Parking(Layer):
    """A parking ground: level, with rows of marked bays, some with a car in them."""

    thing: Literal["parking"]
    at: Places = Field(min_length=1, description="[[east, north], ...] metres, middles of the grounds")
    size: tuple[Side, Side] = Field((40.0, 32.0), description="metres [along the rows, across]")
    turn_deg: float = Field(0.0, description="of the rows, counter-clockwise from east")
    full: float = Field(0.5, ge=0.0, le=1.0, description="share of the bays with a car")
    bay: tuple[Side, Side] = Field((2.5, 5.0), description="metres [width, length] of a bay")
    lane: float = Field(6.0, ge=0.0, le=50.0, description="metres between two rows")
    bank: float = Field(2.0, ge=0.0, le=100.0, description="metres over which it blends into the ground")
    kind: CoverName = Field("paved", description="class")
    look: LookName = Field(Look.ASPHALT, description="look")
    marked: bool = Field(True, description="lines between the bays")
    car: Cars = Field(Cars(thing="cars"), description="what stands there")

    @property
    def rise(self) -> tuple[float, float]:
        return 0.0, self.car.height[1]

    def shape(self, sheet: Sheet, lay: Lay) -> None:
        """Level, pave and mark the grounds."""
        for east, north, level in lay.keep("grounds", lambda: self._grounds(lay)):
            index, dx, dy = sheet.near(east, north, 0.5 * math.hypot(*self.size) + self.bank)
            u, v = along_and_across(dx, dy, math.radians(self.turn_deg))
            outside = np.maximum(np.abs(u) - 0.5 * self.size[0], np.abs(v) - 0.5 * self.size[1])
            blend = ramp(0.0, max(self.bank, 1e-9), outside)
            sheet.ground[index] = level + blend * (sheet.ground[index] - level)
            sheet.paint(index, outside <= 0.0, terrain_named(self.kind), self.look)
            if self.marked:
                sheet.tint[index] *= np.where(self._marks(u, v), 3.0, 1.0)[..., None].astype(np.float32)

    def stand(self, sheet: Sheet, lay: Lay) -> None:
        things = overlapping(lay.keep("cars", lambda: self._cars(lay)), sheet.box)
        stamp(sheet, things, stamps.Roof.CAR)

    def _grounds(self, lay: Lay) -> F64:
        """Return the (N, 3) east, north and height of the middle of each parking ground, metres."""
        places = np.array(self.at)
        return np.column_stack([places, lay.before(places[:, :1], places[:, 1:]).ground])

    @property
    def _pitch(self) -> float:
        return 2.0 * self.bay[1] + self.lane

    def _marks(self, u: F64, v: F64) -> Mask:
        """Return the mask of positions on the 10 cm lines between bays; `u`, `v`: metres along and across the rows."""
        width, length = self.bay
        count = math.floor(self.size[0] / width)
        across = np.abs(v / self._pitch - np.floor(v / self._pitch) - 0.5) * self._pitch
        line = np.abs(u / width - np.floor(u / width + 0.5)) * width < 0.05
        inside = (np.abs(u) <= 0.5 * count * width + 0.05) & (np.abs(v) <= 0.5 * self.size[1])
        return np.asarray(inside & (across <= length) & (line | (across < 0.05)))

    def _cars(self, lay: Lay) -> F64:
        rng = np.random.default_rng([lay.seed, 7])
        width, length = self.bay
        columns = np.arange(math.floor(self.size[0] / width)) - 0.5 * math.floor(self.size[0] / width) + 0.5
        rows = np.arange(-100, 101) + 0.5
        lines = np.concatenate([rows * self._pitch + side * 0.5 * length for side in (-1, 1)])
        lines = lines[np.abs(lines) <= 0.5 * self.size[1] - 0.4 * length]
        u, v = (a.ravel() for a in np.meshgrid(columns * width, lines))
        found = []
        for east, north, level in lay.keep("grounds", lambda: self._grounds(lay)):
            there = rng.random(len(u)) < self.full
            dx, dy = along_and_across(u[there], v[there], -math.radians(self.turn_deg))
            things = blank_things(
                np.column_stack([east + dx, north + dy]) + rng.normal(0.0, 0.12, (int(there.sum()), 2))
            )
            self.car.draw(rng, things)
            backwards = rng.integers(2, size=len(things)) * math.pi
            things[:, Column.TURN] = math.radians(self.turn_deg + 90.0) + backwards + rng.normal(0.0, 0.03, len(things))
            things[:, Column.LEVEL] = level
            found.append(things)
        return self._off_pads(lay, np.concatenate(found))

    @staticmethod
    def _off_pads(lay: Lay, cars: F64) -> F64:
        for other in lay.stack.lays[lay.index + 1 :]:
            if isinstance(other.layer, Scattered) and other.layer.apart:
                for east, north in other.layer.at:
                    away = np.hypot(cars[:, Column.EAST] - east, cars[:, Column.NORTH] - north)
                    cars = cars[away > other.layer.largest + cars[:, Column.HALF_U]]
        return cars
